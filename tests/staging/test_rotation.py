"""Conversions between rotations: they agree with each other, whatever the leading shape."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shuttle_marl.staging.rotation import about, exponential, from_yaw_pitch_roll, matrix, quaternion, to_yaw_pitch_roll

ANGLE = st.floats(-3.1, 3.1)


@pytest.mark.parametrize("shape", [(), (5,), (2, 3)])
def test_quaternions_and_matrices_of_any_shape(shape: tuple[int, ...]) -> None:
    v = np.random.default_rng(0).normal(size=(*shape, 3))
    turn = exponential(v)
    assert turn.shape == (*shape, 3, 3)
    q = quaternion(turn)
    assert q.shape == (*shape, 4)
    assert (q[..., 3] >= 0).all()
    np.testing.assert_allclose(matrix(q), turn, atol=1e-15)
    np.testing.assert_allclose(matrix(2 * q), turn, atol=1e-15)


@given(angle=ANGLE)
def test_rotation_vectors_turn_about_their_own_direction(angle: float) -> None:
    axis = np.array([0.6, 0.0, -0.8])
    np.testing.assert_allclose(exponential(angle * axis), about(axis, angle), atol=1e-15)


@given(yaw=ANGLE, pitch=st.floats(-1.5, 1.5), roll=ANGLE)
def test_angles_of_the_body_are_found_again(yaw: float, pitch: float, roll: float) -> None:
    angles = [np.array(angle) for angle in (yaw, pitch, roll)]
    np.testing.assert_allclose(to_yaw_pitch_roll(from_yaw_pitch_roll(*angles)), angles, atol=1e-9)
