"""Curves between key poses, beside those of scipy, and means over frames."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from shuttle_marl.staging.curves import curve, curve_at, slopes_through, smooth, widen

STEPS = st.lists(st.integers(1, 9), min_size=1, max_size=8)


def poses(steps: list[int], seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Key frames, and three curves of which one is flat in places."""
    frame = np.cumsum([4, *steps]).astype(np.int64)
    pose = np.random.default_rng(seed).normal(size=(len(frame), 3))
    pose[:, 1] = np.round(pose[:, 1])
    return frame, pose


@settings(max_examples=60, deadline=None)
@given(STEPS, st.integers(0, 1000))
def test_curves_are_those_of_scipy(steps: list[int], seed: int) -> None:
    frame, pose = poses(steps, seed)
    slope = slopes_through(frame, pose)
    np.testing.assert_allclose(slope, PchipInterpolator(frame, pose, axis=0)(frame, 1), atol=1e-12)
    spline, frames = CubicHermiteSpline(frame, pose, slope, axis=0), int(frame[-1]) + 5
    when = np.clip(np.arange(frames), frame[0], frame[-1])
    np.testing.assert_allclose(curve(frame, pose, slope, frames), spline(when), atol=1e-12)
    for now in range(int(frame[0]), int(frame[-1])):
        for found, order in zip(curve_at(frame, pose, slope, now), (0, 1), strict=True):
            np.testing.assert_allclose(found, spline(now, order), atol=1e-12)


@pytest.mark.parametrize("by", [1, 3, 8])
def test_a_mean_of_the_widened_is_nowhere_less_than_what_is_needed(by: int) -> None:
    x = np.random.default_rng(by).random(50)
    assert (smooth(widen(x, by), by) >= x - 1e-12).all()
    np.testing.assert_allclose(smooth(np.full(50, 2.0), by), 2.0)
