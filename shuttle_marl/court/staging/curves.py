"""Curves over frames: cubics through key poses, moving means, and jumps."""

from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64, I64
from shuttle_marl.base.compiling import compiled
from shuttle_marl.court.staging.flight import GRAVITY

_PUSH: Final = 15.0
"""Upward acceleration of a take-off [m/s²]."""
_ABSORB: Final = 17.0
"""Greatest upward acceleration of a landing [m/s²]."""
_DIP: Final = 12.0
"""Greatest acceleration while sinking into the crouch [m/s²]."""
_RISE: Final = 7.0
"""Greatest acceleration while rising again after a landing [m/s²]."""


@compiled
def _at_end(near: float, far: float, chord: float, next_chord: float) -> float:
    """Slope at an end of a curve, from the lengths and the chords of the two intervals next to it."""
    slope = ((2 * near + far) * chord - near * next_chord) / (near + far)
    if slope * chord <= 0:
        return 0.0
    if chord * next_chord <= 0 and abs(slope) > 3 * abs(chord):
        return 3 * chord
    return slope


@compiled
def slopes_through(frame: I64, pose: F64) -> F64:
    """``[K, C]`` slopes per frame of monotone cubics through key poses (Fritsch & Butland 1984).

    Args:
        frame: ``[K]`` frame of each pose, ascending.
        pose: ``[K, C]`` the poses.
    """
    out = np.zeros_like(pose)
    k, c = pose.shape
    for j in range(c if k > 1 else 0):
        for i in range(k):
            left = float(frame[i] - frame[i - 1]) if i else 0.0
            right = float(frame[i + 1] - frame[i]) if i + 1 < k else 0.0
            before = (pose[i, j] - pose[i - 1, j]) / left if i else 0.0
            after = (pose[i + 1, j] - pose[i, j]) / right if i + 1 < k else 0.0
            if k == 2:
                out[i, j] = after if i == 0 else before
            elif i == 0:
                further = float(frame[2] - frame[1])
                out[i, j] = _at_end(right, further, after, (pose[2, j] - pose[1, j]) / further)
            elif i == k - 1:
                further = float(frame[i - 1] - frame[i - 2])
                out[i, j] = _at_end(left, further, before, (pose[i - 1, j] - pose[i - 2, j]) / further)
            elif before * after <= 0:
                out[i, j] = 0.0
            else:
                first, second = 2 * right + left, right + 2 * left
                out[i, j] = (first + second) / (first / before + second / after)
    return out


@compiled
def curve(frame: I64, pose: F64, slope: F64, frames: int) -> F64:
    """``[F, C]`` cubic Hermite interpolation of key poses, constant before the first and after the last.

    Args:
        frame: ``[K]`` frame of each pose, ascending.
        pose: ``[K, C]`` the poses.
        slope: ``[K, C]`` slopes per frame.
    """
    out = np.empty((frames, pose.shape[1]))
    last, c = len(frame) - 1, pose.shape[1]
    k = 0
    for f in range(len(out)):
        if f <= frame[0] or f >= frame[last]:
            row = 0 if f <= frame[0] else last
            for j in range(c):
                out[f, j] = pose[row, j]
            continue
        while frame[k + 1] <= f:
            k += 1
        h = float(frame[k + 1] - frame[k])
        u = (f - frame[k]) / h
        for j in range(c):
            chord = pose[k + 1, j] - pose[k, j]
            a, b = h * slope[k, j] - chord, chord - h * slope[k + 1, j]
            out[f, j] = pose[k, j] + u * chord + u * (1 - u) * ((1 - u) * a + u * b)
    return out


def curve_at(frame: I64, pose: F64, slope: F64, now: int) -> tuple[F64, F64]:
    """Value ``[C]`` and slope ``[C]`` of :func:`curve` in one frame between the first and the last key pose."""
    k = int(np.searchsorted(frame, now, side="right")) - 1
    h = float(frame[k + 1] - frame[k])
    u, chord = (now - frame[k]) / h, pose[k + 1] - pose[k]
    a, b = h * slope[k] - chord, chord - h * slope[k + 1]
    bend = (1 - u) * a + u * b
    return pose[k] + u * chord + u * (1 - u) * bend, (chord + (1 - 2 * u) * bend + u * (1 - u) * (b - a)) / h


def held_ends(x: F64, by: int) -> F64:
    """``[F + 2 by]`` values, padded with the first and the last one."""
    return np.concatenate([np.full(by, x[0]), x, np.full(by, x[-1])])


def widen(x: F64, by: int) -> F64:
    """``[F]`` moving maximum of ``[F]`` values within ``by`` frames."""
    return np.lib.stride_tricks.sliding_window_view(held_ends(x, by), 2 * by + 1).max(axis=1)


def smooth(x: F64, by: int) -> F64:
    """``[F]`` moving mean of ``[F]`` values within ``by`` frames, with a Hann window."""
    kernel = np.hanning(2 * by + 3)[1:-1]
    return np.convolve(held_ends(x, by), kernel / kernel.sum(), mode="valid")


def half_time(height: float) -> float:
    """Time from take-off to the top of a jump of a height [s]."""
    return float(np.sqrt(2 * height / GRAVITY))


def leap(since: F64, height: float, sink: float) -> tuple[F64, F64]:
    """Heights of hips and feet in a jump.

    Args:
        since: ``[F]`` time since the top [s].
        height: of the jump [m].
        sink: least depth to which the hips sink after the landing [m].

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
    """Decelerate evenly from a downward speed to a depth, then return within ``seconds``; 0 before and after."""
    stop = 2 * depth / speed
    slowed = -speed * after + 0.5 * speed / stop * after**2
    back = -depth * (1 - ease((after - stop) / seconds))
    return np.where(after <= 0, 0.0, np.where(after <= stop, slowed, back))


def ease(u: F64) -> F64:
    """Smooth step from 0 at ``u`` = 0 to 1 at ``u`` = 1."""
    u = np.clip(u, 0, 1)
    return u * u * (3 - 2 * u)
