"""Curves through key poses beside those of scipy, and jumps beside gravity."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from shuttle_marl.court.staging.geometry import curve, curve_at, slopes_through
from shuttle_marl.court.staging.timeline import half_time, leap

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


def test_a_jump_obeys_gravity_between_take_off_and_landing() -> None:
    """Hips sink before and after it, with speed and acceleration of a body: no jump of the speed, at most twice gravity."""
    height, dt = 0.3, 1e-3
    half = np.sqrt(2 * height / 9.81)
    assert half_time(height) == pytest.approx(half)
    since = np.arange(-1.2, 1.2, dt)
    for sink, depth in ((0.0, 9.81 * height / 17), (0.4, 0.4)):
        hips, air = leap(since, height, sink)
        flying = np.abs(since) < half
        assert_allclose(hips[flying], height - 9.81 / 2 * since[flying] ** 2, atol=1e-9)
        assert_allclose(air[flying], hips[flying], atol=1e-9)
        assert (air[~flying] == 0).all()
        speed = np.gradient(hips, dt)
        assert np.abs(np.diff(speed)).max() < 20 * dt
        assert hips[since < 0].min() == pytest.approx(-9.81 * height / 15, abs=1e-3), "the take-off pushes with 15 m/s²"
        assert hips[since > 0].min() == pytest.approx(-depth, abs=1e-3)
        rising = np.gradient(speed, dt)[since < -half - 2 * 9.81 * height / 15 / (9.81 * half) - 0.01]
        assert np.abs(rising).max() == pytest.approx(12, rel=0.03)
        back = np.gradient(speed, dt)[since > half + 2 * depth / (9.81 * half) + 0.01]
        assert np.abs(back).max() == pytest.approx(7, rel=0.03)
        assert hips[0] == hips[-1] == 0
