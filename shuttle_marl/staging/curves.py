"""Curves over frames: cubics through key poses, moving means, and jumps."""

from typing import Final

import numpy as np

from shuttle_marl.arrays import F64, I64
from shuttle_marl.staging.flight import GRAVITY

_PUSH: Final = 15.0
"""Upward acceleration of a take-off [m/s²]."""
_ABSORB: Final = 17.0
"""Greatest upward acceleration of a landing [m/s²]."""
_DIP: Final = 12.0
"""Greatest acceleration while sinking into the crouch [m/s²]."""
_RISE: Final = 7.0
"""Greatest acceleration while rising again after a landing [m/s²]."""


def slopes_through(frame: I64, pose: F64) -> F64:
    """``[K, C]`` slopes for each frame at key poses such that cubics never overshoot (Fritsch & Butland 1984).

    Args:
        frame: ``[K]`` when each pose is taken, ascending.
        pose: ``[K, C]`` the poses.
    """
    from shuttle_marl.staging.compiled.paths import monotone_slopes  # noqa: PLC0415  numba is slow to import

    out = np.zeros_like(pose)
    if len(pose) > 1:
        monotone_slopes(frame, pose, out)
    return out


def curve(frame: I64, pose: F64, slope: F64, frames: int) -> F64:
    """``[F, C]`` key poses joined by cubics with the given slopes; held before the first and after the last.

    Args:
        frame: ``[K]`` when each pose is taken, ascending.
        pose: ``[K, C]`` the poses.
        slope: ``[K, C]`` for each frame.
        frames: F.
    """
    from shuttle_marl.staging.compiled.paths import run_between  # noqa: PLC0415  numba is slow to import

    out = np.empty((frames, pose.shape[1]))
    run_between(frame, np.ascontiguousarray(pose), np.ascontiguousarray(slope), out)
    return out


def curve_at(frame: I64, pose: F64, slope: F64, now: int) -> tuple[F64, F64]:
    """Pose ``[C]`` and slope ``[C]`` of that curve in one frame between the first and the last key pose."""
    k = int(np.searchsorted(frame, now, side="right")) - 1
    h = float(frame[k + 1] - frame[k])
    u, chord = (now - frame[k]) / h, pose[k + 1] - pose[k]
    a, b = h * slope[k] - chord, chord - h * slope[k + 1]
    bend = (1 - u) * a + u * b
    return pose[k] + u * chord + u * (1 - u) * bend, (chord + (1 - 2 * u) * bend + u * (1 - u) * (b - a)) / h


def held_ends(x: F64, by: int) -> F64:
    """``[F + 2 by]`` numbers whose first and last are held for ``by`` frames more."""
    return np.concatenate([np.full(by, x[0]), x, np.full(by, x[-1])])


def widen(x: F64, by: int) -> F64:
    """The greatest of ``[F]`` numbers within ``by`` frames."""
    return np.lib.stride_tricks.sliding_window_view(held_ends(x, by), 2 * by + 1).max(axis=1)


def smooth(x: F64, by: int) -> F64:
    """The mean of ``[F]`` numbers within ``by`` frames, near ones weighing more (a Hann window)."""
    kernel = np.hanning(2 * by + 3)[1:-1]
    return np.convolve(held_ends(x, by), kernel / kernel.sum(), mode="valid")


def half_time(height: float) -> float:
    """Seconds from take-off to the top of a jump [s]."""
    return float(np.sqrt(2 * height / GRAVITY))


def leap(since: F64, height: float, sink: float) -> tuple[F64, F64]:
    """A jump.

    Args:
        since: ``[F]`` seconds since its top.
        height: of the jump [m].
        sink: how far the hips sink after the landing at least [m].

    Returns:
        ``[F]`` height of the hips relative to standing, and ``[F]`` height of the feet over the floor [m].
    """
    half = half_time(height)
    speed = GRAVITY * half
    air = np.maximum(height - GRAVITY / 2 * since**2, 0.0)
    hips = np.where(np.abs(since) <= half, air, 0.0)
    down = max(speed**2 / (2 * _PUSH), 1e-3)
    hips += _bow(-half - since, speed, down, float(np.sqrt(6 * down / _DIP)))
    sink = max(sink, speed**2 / (2 * _ABSORB))
    hips += _bow(since - half, speed, sink, float(np.sqrt(6 * sink / _RISE)))
    return hips, air


def _bow(after: F64, speed: float, depth: float, seconds: float) -> F64:
    """From a downward speed at 0, evenly slowed down at a depth, then back to the start in ``seconds``; 0 before and behind."""
    stop = 2 * depth / speed
    slowed = -speed * after + 0.5 * speed / stop * after**2
    u = np.clip((after - stop) / seconds, 0, 1)
    back = -depth * (1 - u * u * (3 - 2 * u))
    return np.where(after <= 0, 0.0, np.where(after <= stop, slowed, back))
