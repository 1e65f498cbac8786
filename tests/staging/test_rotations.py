"""Vectors and rotations of compiled code and of arrays, beside those of numpy and scipy."""

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from shuttle_marl.base.arrays import F64
from shuttle_marl.court.staging import geometry

RIGHTWARDS, FORWARD, UP = np.eye(3)


def random(*shape: int) -> F64:
    return np.random.default_rng(7).normal(size=shape)


def by_scipy(yaw: float, pitch: float, roll: float) -> F64:
    """Turn left about the vertical, then bow about the line to the left, then lean about the line ahead."""
    turns = [Rotation.from_rotvec(v).as_matrix() for v in (yaw * UP, -pitch * RIGHTWARDS, roll * FORWARD)]
    return turns[0] @ turns[1] @ turns[2]


A, B = random(2, 3)
M, N = random(2, 3, 3)
AXIS = A / np.linalg.norm(A)
ACROSS = B - (B @ AXIS) * AXIS
ACROSS /= np.linalg.norm(ACROSS)


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (geometry.add(A, B), A + B),
        (geometry.sub(A, B), A - B),
        (geometry.scaled(3.0, A), 3 * A),
        (geometry.over(A, 4.0), A / 4),
        (geometry.dot(A, B), A @ B),
        (geometry.cross_of(A, B), np.cross(A, B)),
        (geometry.unit_of(A), AXIS),
        (geometry.unit_of(1e-6 * A), AXIS),
        (geometry.unit_of(np.zeros(3)), np.zeros(3)),
        (geometry.transposed(M), M.T),
        (geometry.mat_vec(M, A), M @ A),
        (geometry.mat_mul(M, N), M @ N),
        (geometry.frame_of(A, B), np.column_stack([AXIS, ACROSS, np.cross(AXIS, ACROSS)])),
        (geometry.frame(A, B), np.column_stack([AXIS, ACROSS, np.cross(AXIS, ACROSS)])),
        (geometry.cross(M, N), np.cross(M, N)),
        (geometry.unit(np.stack([A, 1e-6 * A, np.zeros(3)])), [AXIS, AXIS, np.zeros(3)]),
        (geometry.apply(np.stack([M, N]), np.stack([A, B])), [M @ A, N @ B]),
    ],
)
def test_vectors_and_matrices_are_those_of_numpy(found: F64, expected: F64) -> None:
    assert_allclose(np.array(found), expected, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("angle", [-2.5, -0.4, 0.0, 1.1, 3.0])
def test_rotations_are_those_of_scipy(angle: float) -> None:
    assert_allclose(geometry.rotation_about(AXIS, angle), Rotation.from_rotvec(angle * AXIS).as_matrix(), atol=1e-14)
    for other in (0.3, -1.2):
        angles = angle, other, angle - other
        assert_allclose(geometry.turned_by(*angles), by_scipy(*angles), atol=1e-14)
        many = geometry.from_yaw_pitch_roll(*(np.array([x, 0.0]) for x in angles))
        assert_allclose(many, [by_scipy(*angles), np.eye(3)], atol=1e-14)


def test_a_quarter_turn_left_a_bow_forward_and_a_lean_to_the_right() -> None:
    quarter, zero = np.array(np.pi / 2), np.zeros(())
    assert_allclose(geometry.turned(np.pi / 2) @ FORWARD, -RIGHTWARDS, atol=1e-15)
    assert_allclose(geometry.from_yaw_pitch_roll(zero, quarter, zero) @ UP, FORWARD, atol=1e-15)
    assert_allclose(geometry.from_yaw_pitch_roll(zero, zero, quarter) @ UP, RIGHTWARDS, atol=1e-15)


def test_quaternions_of_all_turns_of_a_cube_and_near_half_turns() -> None:
    """Each of the four components is the largest one somewhere; half turns have no positive w."""
    signs = itertools.product((1.0, -1.0), repeat=3)
    cube = [np.diag(s)[list(p)] for s in signs for p in itertools.permutations(range(3))]
    turns = [turn for turn in cube if np.linalg.det(turn) > 0]
    turns += [Rotation.from_rotvec((np.pi - 0.01) * side * axis).as_matrix() for axis in (*np.eye(3), AXIS) for side in (1, -1)]
    found = geometry.quaternion(np.array(turns))
    assert len(turns) == 32
    assert (found[:, 3] >= 0).all()
    assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-15)
    assert_allclose(Rotation.from_quat(found).as_matrix(), turns, atol=1e-14)


@pytest.mark.parametrize("shape", [(), (5,), (2, 3)])
def test_quaternions_and_matrices_of_any_shape(shape: tuple[int, ...]) -> None:
    v = np.random.default_rng(0).normal(size=(*shape, 3))
    turn = Rotation.from_rotvec(v.reshape(-1, 3)).as_matrix().reshape(*shape, 3, 3)
    q = geometry.quaternion(turn)
    assert q.shape == (*shape, 4)
    assert (q[..., 3] >= 0).all()
    assert_allclose(geometry.matrix(q), turn, atol=1e-15)
    assert_allclose(geometry.matrix(2 * q), turn, atol=1e-15)
