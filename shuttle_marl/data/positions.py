"""Random coordinates and times of simulated strokes, given shot, target area and outcome.

Flight times and the mix of faults are medians and frequencies of the training matches of ShuttleSet and ShuttleSet22.
"""

import dataclasses
from typing import Final

import numpy as np

from shuttle_marl.arrays import F64, I64, Bools
from shuttle_marl.data.schema import REASONS, Outcome
from shuttle_marl.game import court
from shuttle_marl.game.stroke import N_SERVES

FLIGHT: Final = np.array([0.73, 1.90, 1.17, 1.27, 0.80, 0.47, 0.53, 0.53, 1.00, 0.37, 0.87, 0.90, 0.92])
"""Median time from a stroke to the next [s], by shot type."""
FAULT_MIX: Final = np.array([
    [0.25, 0.67, 0.08], [1.00, 0.00, 0.00], [1.00, 0.00, 0.00], [0.88, 0.10, 0.02], [0.33, 0.58, 0.09],
    [0.63, 0.37, 0.00], [0.57, 0.40, 0.03], [0.49, 0.35, 0.16], [0.84, 0.16, 0.00], [0.40, 0.59, 0.01],
    [0.09, 0.59, 0.32], [0.14, 0.43, 0.43], [0.28, 0.43, 0.29],
])  # fmt: skip
"""``[13, 3]`` probabilities of out, net and short, by shot type of the fault."""
FRAME_RATE: Final = 30
BREAK: Final = 23.0
"""Median time between two rallies [s]."""
INTERVAL: Final = 120.0
"""Time between two games [s]."""

_BASE: Final = np.array([0.0, -3.7])
"""Mean base position of a player between strokes, in the own frame [m]."""
_BASE_SPREAD: Final = 0.35
"""Standard deviation of the base position [m]."""
_RECOVERY: Final = 1.5
"""Speed of recovery to the base position [m/s]."""
_NEAR_NET: Final = 0.3
"""Minimum distance of players and of the landings of good strokes from the net [m]."""
_OUT, _NET, _SHORT, _LANDED = (REASONS.index(name) for name in ("out", "net", "short", "landed"))


@dataclasses.dataclass(frozen=True, kw_only=True)
class SimulatedStrokes:
    """n strokes of simulated rallies, in playing order, without coordinates and times.

    Attributes:
        shot, area: ``[n]`` shot type and target area.
        outcome: ``[n]`` index into ``schema.OUTCOMES``.
        stroke: ``[n]`` number of the stroke in its rally; the strokes of a rally are consecutive.
        new_game: ``[n]`` whether the stroke is the first of a game.
        right: ``[n]`` whether the server of the rally serves from the right service court (an even score).
    """

    shot: I64
    area: I64
    outcome: I64
    stroke: I64
    new_game: Bools
    right: Bools


@dataclasses.dataclass(frozen=True, kw_only=True)
class Positions:
    """Coordinates and times; points are in the striker's frame [m], NaN for none.

    Attributes:
        landing, contact, striker, receiver: ``[n, 2]``, as in the schema.
        reason: ``[n]`` index into ``schema.REASONS``.
        frame: ``[n]`` video frame, at :data:`FRAME_RATE` per second.
    """

    landing: F64
    contact: F64
    striker: F64
    receiver: F64
    reason: I64
    frame: I64


def sample_positions(strokes: SimulatedStrokes, rng: np.random.Generator) -> Positions:
    """Sample coordinates and times of strokes.

    A good stroke lands in its target area, an out fault just beyond the line next to it, a net or short fault on the
    striker's side of the net. The contact point of a returned stroke is the landing of the stroke before.
    """
    n = len(strokes.stroke)
    flight = np.maximum(FLIGHT[strokes.shot] * rng.lognormal(0.0, 0.15, n), 0.2)
    reason = _reasons(strokes, rng)
    landing = _inside(strokes, rng)
    out = reason == _OUT
    landing[out] = _beyond_the_line(strokes.area[out], landing[out], rng)
    contact = np.full((n, 2), np.nan)
    replies = np.flatnonzero(strokes.stroke > 1)
    contact[replies] = -landing[replies - 1]
    striker, receiver = _positions(strokes, contact, flight, rng)
    _fall_short(landing, np.where(np.isnan(contact), striker, contact), reason, rng)
    pause = np.where(strokes.new_game, INTERVAL, BREAK) * rng.lognormal(0.0, 0.3, n)
    step = np.where(strokes.stroke == 1, pause, np.r_[0.0, flight[:-1]])
    return Positions(
        landing=landing,
        contact=contact,
        striker=striker,
        receiver=receiver,
        reason=reason,
        frame=np.rint(np.cumsum(step) * FRAME_RATE).astype(np.int64),
    )


def _reasons(strokes: SimulatedStrokes, rng: np.random.Generator) -> I64:
    mix = FAULT_MIX[strokes.shot]
    no_line = np.isin(strokes.area, (1, 4))  # front and middle centre are not next to a line
    mix = np.where(no_line[:, None] & (np.arange(3) == 0), 0.0, mix)
    mix[mix.sum(axis=1) == 0] = [0.0, 1.0, 0.0]
    cumulative = np.cumsum(mix / mix.sum(axis=1, keepdims=True), axis=1)
    index = (rng.random(len(mix))[:, None] >= cumulative[:, :2]).sum(axis=1)
    fault = np.array([_OUT, _NET, _SHORT])[index]
    ended = np.where(strokes.outcome == Outcome.FAULT, fault, _LANDED)
    return np.where(strokes.outcome == Outcome.RETURNED, REASONS.index("returned"), ended)


def _inside(strokes: SimulatedStrokes, rng: np.random.Generator) -> F64:
    """Points in the target areas, denser towards their centre, at least 5 cm from the lines."""
    side, depth = strokes.area % 3, strokes.area // 3
    x_cuts = np.array([-court.HALF_WIDTH, -court.SIDE_CUT, court.SIDE_CUT, court.HALF_WIDTH])
    y_cuts = np.array([_NEAR_NET, court.MIDDLE_CUT, court.BACK_CUT, court.HALF_LENGTH])
    low = np.stack([x_cuts[side], y_cuts[depth]], axis=1) + 0.05
    high = np.stack([x_cuts[side + 1], y_cuts[depth + 1]], axis=1) - 0.05
    is_serve = strokes.shot < N_SERVES
    low[is_serve, 1] = np.maximum(low[is_serve, 1], court.SHORT_SERVICE)
    return low + (high - low) * rng.random((2, len(side), 2)).mean(axis=0)


def _beyond_the_line(area: I64, inside: F64, rng: np.random.Generator) -> F64:
    """Points moved across the line next to the target area; for a corner, across one of its two lines."""
    side, depth = area % 3, area // 3
    by = np.minimum(0.03 + rng.exponential(0.2, len(area)), 1.0)
    behind = (depth == 2) & ((side == 1) | (rng.random(len(area)) < 0.5))
    outwards = np.where(side == 0, -1.0, 1.0)
    x = np.where(behind, inside[:, 0], outwards * (court.HALF_WIDTH + by))
    y = np.where(behind, court.HALF_LENGTH + by, inside[:, 1])
    return np.stack([x, y], axis=1)


def _fall_short(landing: F64, start: F64, reason: I64, rng: np.random.Generator) -> None:
    """Move net and short faults to the striker's side, on the line from the contact to the target."""
    share = start[:, 1] / (start[:, 1] - landing[:, 1])
    across = start[:, 0] + share * (landing[:, 0] - start[:, 0])
    for kind, mean in ((_NET, 0.25), (_SHORT, 0.6)):
        rows = reason == kind
        fallen = np.minimum(0.02 + rng.exponential(mean, len(landing)), 3.0)
        landing[rows] = np.stack([across, -fallen], axis=1)[rows]


def _positions(strokes: SimulatedStrokes, contact: F64, flight: F64, rng: np.random.Generator) -> tuple[F64, F64]:
    """``[n, 2]`` positions of striker and receiver at the hit."""
    n = len(flight)
    striker, receiver = np.empty((n, 2)), np.empty((n, 2))
    serves = np.flatnonzero(strokes.stroke == 1)
    from_right = np.where(strokes.area[serves] % 3 == 1, strokes.right[serves], strokes.area[serves] % 3 == 0)
    right = np.where(from_right, 1.0, -1.0)[:, None]
    noise = rng.normal(0.0, 0.12, (2, len(serves), 2))
    striker[serves] = right * [0.3, 0.0] + [0.0, -3.1] + noise[0]
    receiver[serves] = right * [-0.95, 0.0] + [0.0, 4.0] + noise[1]
    reach = np.clip(rng.normal(0.7, 0.15, n), 0.3, 1.1)
    base = _BASE + rng.normal(0.0, _BASE_SPREAD, (n, 2))
    for number in range(2, int(strokes.stroke.max(initial=1)) + 1):
        rows = np.flatnonzero(strokes.stroke == number)
        striker[rows] = _towards(contact[rows], base[rows], reach[rows])
        # The previous striker is the receiver, on the way back to the base; coordinates change to the other frame.
        receiver[rows] = -_towards(striker[rows - 1], base[rows - 1], _RECOVERY * flight[rows - 1])
    striker[:, 1] = np.minimum(striker[:, 1], -_NEAR_NET)
    return striker, receiver


def _towards(points: F64, goal: F64, distance: F64) -> F64:
    offset = goal - points
    length = np.linalg.norm(offset, axis=1)
    return points + offset * np.minimum(1.0, distance / np.maximum(length, 1e-9))[:, None]
