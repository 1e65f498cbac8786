"""Trajectory of a rally: times and places of all strokes, flights, and the path of the shuttle in every frame."""

import dataclasses
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import F64, I64
from shuttle_marl.game.court import NET_HEIGHT, NET_HEIGHT_CENTRE, WIDTH
from shuttle_marl.game.rally.record import Rally
from shuttle_marl.staging.flight import GRAVITY, Flights, fall, shoot
from shuttle_marl.staging.motions import HELD, Stance

LEAD_IN: Final = 1.2
"""Time before the serve [s]."""
RETURN, WIN, OUT, NET, OPEN = range(5)
ENDS: Final = ("returned", "winner", "out", "net", "open")
"""Ends of a stroke; *open*: it will be returned, but the reply is not chosen yet."""

RESTING: Final = 0.014
"""Height of a shuttle that lies on the floor [m]."""
_BY_STROKE: Final = ("time", "contact", "end", "end_time", "chosen_point", "end_point", "base")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Trajectory:
    """Times, places and flights of a rally of n strokes, in the frame of the court.

    Attributes:
        time: ``[n]`` time of each contact, on the grid of frames [s].
        contact: ``[n, 3]`` position of the shuttle at each contact [m].
        end: ``[n]`` index into :data:`ENDS`.
        end_time: ``[n]`` end of the flight at the receiver's racket, on the floor, or in the net [s].
        chosen_point: ``[n, 3]`` drawn end point of each flight [m].
        end_point: ``[n, 3]`` end point [m]: the chosen point, unless the receiver's racket does not reach it.
        stance: n stances, each in its striker's own frame.
        base: ``[n, 2, 2]`` base positions of seats 0 and 1 at each stroke, each in their own frame [m].
        before: ``[2, 2]`` positions of seats 0 and 1 before the serve, each in their own frame [m].
        reply: expected stance of the next striker in an open rally.
    """

    rally: Rally
    time: F64
    contact: F64
    end: I64
    end_time: F64
    chosen_point: F64
    end_point: F64
    flight: Flights
    stance: tuple[Stance, ...]
    base: F64
    before: F64
    reply: Stance | None = None


def with_contacts_moved(trajectory: Trajectory, by: dict[int, F64]) -> Trajectory:
    """Move some contacts, at the same times, and the flights to and from them.

    Args:
        by: displacement ``[3]`` in the frame of the court, by number of the stroke [m].
    """
    contact, end_point = trajectory.contact.copy(), trajectory.end_point.copy()
    for k, change in by.items():
        contact[k] += change
        if k:
            end_point[k - 1] += change
    rows = sorted({row for k in by for row in (k - 1, k) if row >= 0})
    flight = Flights(*(part.copy() for part in trajectory.flight))
    again = shoot(contact[rows], end_point[rows], (trajectory.end_time - trajectory.time)[rows])
    for part, new in zip(flight, again, strict=True):
        part[rows] = new
    return dataclasses.replace(trajectory, contact=contact, end_point=end_point, flight=flight)


def behind(old: Trajectory, new: Trajectory, first: int) -> Trajectory:
    """Concatenate the first strokes of one trajectory and another one."""

    def whole(a: F64, b: F64) -> F64:
        return np.concatenate([a[:first], b])

    rows: dict[str, Any] = {name: whole(getattr(old, name), getattr(new, name)) for name in _BY_STROKE}
    flight = Flights(*map(whole, old.flight, new.flight))
    return dataclasses.replace(new, **rows, flight=flight, stance=(*old.stance[:first], *new.stance))


def net_height(x: F64 | float) -> F64:
    """Height of the top of the net [m]: 1.524 m in the middle, 1.55 m over the doubles side lines."""
    return NET_HEIGHT_CENTRE + (NET_HEIGHT - NET_HEIGHT_CENTRE) * (2 * np.asarray(x, dtype=np.float64) / WIDTH) ** 2


def own_frame(facing: float, right_handed: bool = True) -> F64:
    """``[3]`` signs between the frame of the court and the player's own frame, mirrored for a left-hander.

    Args:
        facing: sign between both frames, see :meth:`~shuttle_marl.game.rally.record.Rally.facing`.
    """
    return np.array([facing if right_handed else -facing, facing, 1.0])


def shuttle_path(trajectory: Trajectory, frames: int, fps: int, first: int = 0) -> tuple[F64, F64]:
    """``[F, 3]`` position and ``[F, 3]`` velocity of the shuttle; before the serve it is at the contact of the serve.

    Args:
        first: number of the first stroke with a flight.
    """
    time = np.arange(frames) / fps
    position, velocity = np.zeros((frames, 3)), np.zeros((frames, 3))
    if not len(trajectory.time):
        # In front of the server.
        rally = trajectory.rally
        position[:] = (*(trajectory.before[rally.server] * rally.facing(rally.server)), 1.0)
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
        landed = np.flatnonzero(position[rows, 2] <= RESTING)
        if len(landed):
            first = rows[landed[0]]
            _roll(position, velocity, first, position[first], velocity[first], time)
    elif len(rows):
        _roll(position, velocity, int(rows[0]), trajectory.end_point[-1], hit, time)
    return position, velocity


def held(position: F64, palm: F64, contacts: I64, trajectory: Trajectory, fps: int) -> None:
    """Place the shuttle in the server's hand: at the palm until the release, then it drops to the racket.

    Args:
        position: ``[F, 3]`` path of the shuttle, changed in place.
        palm: ``[F, 3]`` the server's free palm [m].
        contacts: frames of the strokes; without any the shuttle stays in the hand.
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
    """One small bounce from frame ``first``, then a short slide to rest."""
    rows = slice(first, None)
    since = time[rows] - time[first] + 0.5 * (time[1] - time[0])
    up = min(0.18 * abs(float(into[2])), 1.0)
    stop = 0.25
    slide = 0.12 * into[:2] * stop * (1 - np.exp(-since / stop))[:, None]
    position[rows, :2] = start[:2] + slide
    position[rows, 2] = np.maximum(RESTING, RESTING + up * since - GRAVITY / 2 * since**2)
    velocity[rows] = np.gradient(position[rows], time[1] - time[0], axis=0) if len(since) > 1 else 0.0
