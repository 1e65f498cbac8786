"""Trajectory of a rally: times and places of all strokes, and the flights of the shuttle."""

import dataclasses
from typing import Any, Final

import numpy as np

from shuttle_marl.arrays import F64, I64
from shuttle_marl.game.court import NET_HEIGHT, NET_HEIGHT_CENTRE, WIDTH
from shuttle_marl.rally.record import Rally
from shuttle_marl.staging.flight import Flights, shoot
from shuttle_marl.staging.motions import Stance

LEAD_IN: Final = 1.2
"""Time before the serve [s]."""
RETURN, WIN, OUT, NET, OPEN = range(5)
ENDS: Final = ("returned", "winner", "out", "net", "open")
"""Ends of a stroke in the staging; *open*: it will be returned, but the reply is not chosen yet."""

_BY_STROKE: Final = ("time", "contact", "end", "end_time", "chosen_point", "end_point", "base")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Trajectory:
    """A rally in time and space; n strokes, in the frame of the court.

    Attributes:
        rally: what was played.
        time: ``[n]`` when each stroke is struck [s], on the grid of frames.
        contact: ``[n, 3]`` where the shuttle is then [m].
        end: ``[n]`` index into :data:`ENDS`.
        end_time: ``[n]`` when the flight ends: at the receiver's racket, on the floor, or in the net [s].
        chosen_point: ``[n, 3]`` where it shall end, as drawn [m].
        end_point: ``[n, 3]`` where it ends [m]: the chosen point, unless the receiver's racket does not get there.
        flight: the n flights.
        stance: n stances, each in its striker's own frame.
        base: ``[n, 2, 2]`` where seats 0 and 1 wait when each stroke is struck, each in their own frame [m].
        before: ``[2, 2]`` where seats 0 and 1 stand before the serve, each in their own frame [m].
        reply: while the rally is open, the stance in which the next striker is expected.
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
    """The same rally, in which some strokes are met elsewhere, at the same time; the flights to and from there follow.

    Args:
        trajectory: the rally.
        by: ``[3]`` in the frame of the court, by number of the stroke [m].
    """
    contact, end_point = trajectory.contact.copy(), trajectory.end_point.copy()
    for k, change in by.items():
        contact[k] += change
        if k:
            end_point[k - 1] += change
    rows = sorted({row for k in by for row in (k - 1, k) if row >= 0})
    again = shoot(contact[rows], end_point[rows], (trajectory.end_time - trajectory.time)[rows])
    fields = {f.name: getattr(trajectory.flight, f.name).copy() for f in dataclasses.fields(Flights)}
    for name, value in fields.items():
        value[rows] = getattr(again, name)
    return dataclasses.replace(trajectory, contact=contact, end_point=end_point, flight=Flights(**fields))


def behind(old: Trajectory, new: Trajectory, first: int) -> Trajectory:
    """The first strokes of one trajectory, and another one behind them."""

    def whole(a: F64, b: F64) -> F64:
        return np.concatenate([a[:first], b])

    names = [f.name for f in dataclasses.fields(Flights)]
    rows: dict[str, Any] = {name: whole(getattr(old, name), getattr(new, name)) for name in _BY_STROKE}
    return dataclasses.replace(
        new,
        **rows,
        flight=Flights(**{name: whole(getattr(old.flight, name), getattr(new.flight, name)) for name in names}),
        stance=(*old.stance[:first], *new.stance),
    )


def facing(seat: int) -> float:
    """+1 or -1: what turns x and y of a seat's own frame into those of the court, and back."""
    return 1.0 - 2.0 * seat


def net_height(x: F64 | float) -> F64:
    """Height of the top of the net [m]: 1.524 m in the middle, 1.55 m over the doubles side lines."""
    return NET_HEIGHT_CENTRE + (NET_HEIGHT - NET_HEIGHT_CENTRE) * (2 * np.asarray(x, dtype=np.float64) / WIDTH) ** 2
