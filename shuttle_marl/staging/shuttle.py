"""The path of the shuttle over a whole rally: in the server's hand, in flight, off the net, on the floor."""

from typing import Final

import numpy as np

from shuttle_marl.arrays import F64, I64
from shuttle_marl.staging.flight import GRAVITY, fall
from shuttle_marl.staging.meeting import HELD
from shuttle_marl.staging.trajectory import NET, Trajectory, facing

_REST: Final = 0.014
"""Height of a shuttle that lies on the floor [m]."""


def shuttle_path(trajectory: Trajectory, frames: int, fps: int, first: int = 0) -> tuple[F64, F64]:
    """``[F, 3]`` position and ``[F, 3]`` velocity; before the serve it waits where it will be struck.

    Args:
        trajectory: the rally.
        frames: F.
        fps: frames a second.
        first: number of the first stroke whose flight is wanted.
    """
    time = np.arange(frames) / fps
    position, velocity = np.zeros((frames, 3)), np.zeros((frames, 3))
    if not len(trajectory.time):
        # In front of the server, who holds it.
        position[:] = (*(trajectory.before[trajectory.rally.server] * facing(trajectory.rally.server)), 1.0)
        return position, velocity
    position[:] = trajectory.contact[0]
    for i in range(first, len(trajectory.time)):
        flown = slice(round(trajectory.time[i] * fps), round(trajectory.end_time[i] * fps) + 1)
        position[flown], velocity[flown] = trajectory.flight.at(i, time[flown] - trajectory.time[i])
    rows = np.flatnonzero(time > trajectory.end_time[-1] + 1e-6)
    hit = trajectory.flight.velocity(-1, -1)
    since = time[rows] - trajectory.end_time[-1]
    if trajectory.end[-1] == NET:
        start = trajectory.end_point[-1]
        back = np.array([-0.04 * hit[0], -0.05 * hit[1], min(0.0, 0.3 * hit[2])])
        drop = fall(start[None], back[None], np.array([2.5]), steps=32)
        position[rows], velocity[rows] = drop.at(0, since)
        landed = np.flatnonzero(position[rows, 2] <= _REST)
        if len(landed):
            first = rows[landed[0]]
            _roll(position, velocity, first, position[first], velocity[first], time)
    elif len(rows):
        _roll(position, velocity, int(rows[0]), trajectory.end_point[-1], hit, time)
    return position, velocity


def held(position: F64, palm: F64, contacts: I64, trajectory: Trajectory, fps: int) -> None:
    """Put the shuttle into the server's hand: until the hand opens it is at the palm, then it drops to the racket.

    Args:
        position: ``[F, 3]`` path of the shuttle, changed in place.
        palm: ``[F, 3]`` the server's free palm [m].
        contacts: frames of the strokes; without any the shuttle stays in the hand.
        trajectory: the rally.
        fps: frames a second.
    """
    if not len(contacts):
        position[:] = palm
        return
    contact = int(contacts[0])
    release = contact - round(HELD[trajectory.stance[0].motion][1] * fps)
    position[: release + 1] = palm[: release + 1]
    whole = (contact - release) / fps
    since = np.arange(1, contact - release)[:, None] / fps
    pull = np.array([0.0, 0.0, -GRAVITY])
    start = (position[contact] - palm[release] - pull / 2 * whole**2) / whole
    position[release + 1 : contact] = palm[release] + start * since + pull / 2 * since**2


def _roll(position: F64, velocity: F64, first: int, start: F64, into: F64, time: F64) -> None:
    """From frame ``first`` on: one small bounce, then a short slide to rest."""
    rows = slice(first, None)
    since = time[rows] - time[first] + 0.5 * (time[1] - time[0])
    up = min(0.18 * abs(float(into[2])), 1.0)
    stop = 0.25
    slide = 0.12 * into[:2] * stop * (1 - np.exp(-since / stop))[:, None]
    position[rows, :2] = start[:2] + slide
    position[rows, 2] = np.maximum(_REST, _REST + up * since - GRAVITY / 2 * since**2)
    velocity[rows] = np.gradient(position[rows], time[1] - time[0], axis=0) if len(since) > 1 else 0.0
