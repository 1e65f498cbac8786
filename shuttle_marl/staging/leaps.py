"""Jumps of the whole body: crouch, push, flight, absorbed landing, and up again."""

from typing import Final

import numpy as np

from shuttle_marl.arrays import F64
from shuttle_marl.staging.flight import GRAVITY

_PUSH: Final = 15.0
"""Upward acceleration of a take-off [m/s²]."""
_ABSORB: Final = 17.0
"""Greatest upward acceleration of a landing [m/s²]."""
_DIP: Final = 12.0
"""Greatest acceleration while sinking into the crouch [m/s²]."""
_RISE: Final = 7.0
"""Greatest acceleration while rising again after a landing [m/s²]."""


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
