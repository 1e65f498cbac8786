"""The hidden recovery position: where the receiver waits while the striker strikes, who does not know it (``docs/recovery.md``).

A position is a cell of the receiver's half, three in depth and three across, named as a right-handed player sees it. It is
**feasible** in a state where people choose it there (:attr:`Recovery.people`). It decides one stroke and is not carried on.

**Tables.** A position multiplies the odds of an outcome by a factor of the stroke's shot type and target area, and by one of
the legal pair, which is chosen so that the mean over people's positions is the probability of the game without, up to rounding.
All is computed in a fixed order, so the tables are the same on every machine.
"""

import dataclasses
import functools
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64, I8, I16, I32, I64, U8, U16, Bools, Ints
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import content_hash
from shuttle_marl.base.tensor_files import Tensors, checked
from shuttle_marl.game.court import AREAS, HALF_LENGTH, HALF_WIDTH, N_AREAS, N_SIDES
from shuttle_marl.game.draws import CHOICE_ONE, HURRY_ONE, ONE, odds_of_steps, with_fault_odds
from shuttle_marl.game.stroke import N_SHOTS, frozen

if TYPE_CHECKING:
    from shuttle_marl.game.tables import Game

POSITIONS: Final = tuple(area.replace("right", "forehand").replace("left", "backhand") for area in AREAS)
N_POSITIONS: Final = len(POSITIONS)
CENTRE: Final = N_POSITIONS // 2  # the position from which serves are received
ACROSS: Final = 0.55  # distance from the middle line beyond which a position is a side position [m]
DEPTHS: Final = (3.2, 4.4)  # distances from the net that divide front, middle and back positions [m]
EFFECTS: Final = ("winner", "above", "hurried")
"""Outcomes whose odds a position changes: a winner given a good stroke, a return from above given a return, a hurried receiver
given the contact of a return."""
STEP: Final = 2.0**-10  # difference of log-odds of one step of an effect
_MOST_STEPS: Final = round(4 / STEP)
PARTS: Final = {"incoming_shot": N_SHOTS + 1, "own_area": N_AREAS + 1, "incoming_area": N_AREAS + 1, "contact": 2, "hurried": 2}
"""What people's positions depend on, and the number of its values; the last one of a previous stroke: none."""
_ROUNDS: Final = 6  # rounds of the fixed point; more change no table of the shipped model


def position_of(x: F64, y: F64) -> I64:
    """Positions of points of any shape; ``x``: from the middle line to the forehand side, ``y``: from the net [m]."""
    side = np.where(x > ACROSS, 0, np.where(x < -ACROSS, 2, 1))
    return np.asarray(N_SIDES * np.searchsorted(DEPTHS, y, side="right") + side, dtype=np.int64)


def position_box(position: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """Extent of a position in the frame of a right-handed player, who looks along y with the net at 0 [m]."""
    depth, side = divmod(position, N_SIDES)
    across, along = (HALF_WIDTH, ACROSS, -ACROSS, -HALF_WIDTH), (0.0, *DEPTHS, HALF_LENGTH)
    return (across[side + 1], across[side]), (-along[depth + 1], -along[depth])


class Waiting(NamedTuple):
    """Probabilities of outcomes by position: R rows, those of a base pair next to each other, one for each feasible position."""

    choices: I32  # ``[base states]`` number of feasible positions of the receiver
    position: I8  # ``[base states, 9]`` the feasible positions in rising order, then -1
    start: I64  # [base states + 1] first row of each state; the i-th position against the k-th stroke: `start + k choices + i`
    limits: U16  # ``[L, R, 3]`` thresholds as in `Game.limits`
    hurry: U8  # ``[R, 2]`` chances of a hurried receiver as in `Game.hurry`

    place: I8  # ``[base states, 9]`` number of each position among the feasible ones, else -1

    def row(self, base: Ints, k: Ints, position: Ints) -> I64:
        """Row of the k-th legal stroke of base states against feasible positions, which are not checked; any shape."""
        return np.asarray(self.start[base] + k * self.choices[base] + self.place[base, position], dtype=np.int64)

    def mask(self, base: Ints) -> Bools:
        """``[..., 9]`` feasible positions of the receiver in base states."""
        return np.asarray(self.place[base] >= 0)


@dataclasses.dataclass(frozen=True, eq=False)
class Recovery:
    """Where people wait, and what a position changes.

    Attributes:
        people: ``[14, 10, 10, 2, 2, 9]`` uint16, probability of each position by incoming shot type, own area, incoming area (the
            last of each: none), contact and hurried of the striker, in units of 1/65535; 0 where it is not feasible.
        effect: ``[3, 13, 9, 9]`` int16, by how many :data:`STEP` a position changes the log-odds of each of :data:`EFFECTS` in a
            stroke of a shot type and target area.
    """

    people: U16
    effect: I16

    def __repr__(self) -> str:
        return f"Recovery(hash={self.hash[:12]!r})"

    def __post_init__(self) -> None:
        for name in ("people", "effect"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        if self.people.shape != (*PARTS.values(), N_POSITIONS) or (self.people.sum(axis=-1, dtype=np.int64) != CHOICE_ONE).any():
            raise ShuttleError("positions of people: expected probabilities of nine positions in every cell")
        if self.effect.shape != (len(EFFECTS), N_SHOTS, N_AREAS, N_POSITIONS) or (np.abs(self.effect) > _MOST_STEPS).any():
            raise ShuttleError(f"effects of positions: expected at most {_MOST_STEPS} steps by shot type, area and position")

    @functools.cached_property
    def hash(self) -> str:
        """SHA-256 of the tables, hexadecimal."""
        return content_hash(self.people.tobytes() + self.effect.tobytes())

    @functools.cached_property
    def hides(self) -> bool:
        """Whether receivers have a choice in some states."""
        return bool((self.people > 0).sum(axis=-1).max() > 1)

    @functools.cached_property
    def chosen(self) -> F64:
        """:attr:`people` as probabilities, and the middle for who receives a serve."""
        found = self.people / np.float64(CHOICE_ONE)
        found[-1] = np.arange(N_POSITIONS) == CENTRE
        return frozen(found)

    @property
    def arrays(self) -> dict[str, U16 | I16]:
        """The tables by name, as in a file."""
        return {"people": self.people, "effect": self.effect}

    @classmethod
    def checked(cls, tensors: Tensors) -> "Recovery":
        """From the content of a file. Raises KeyError, TypeError, ValueError, ShuttleError: a part is missing or invalid."""
        _, arrays = tensors
        return cls(
            checked(arrays["people"], np.uint16, (*PARTS.values(), N_POSITIONS)),
            checked(arrays["effect"], np.int16, (len(EFFECTS), N_SHOTS, N_AREAS, N_POSITIONS)),
        )


NO_CHOICE: Final = Recovery(  # that of the game without recovery: all receivers wait in the middle, which changes nothing
    people=np.broadcast_to(CHOICE_ONE * (np.arange(N_POSITIONS) == CENTRE), (*PARTS.values(), N_POSITIONS)).astype(np.uint16),
    effect=np.zeros((len(EFFECTS), N_SHOTS, N_AREAS, N_POSITIONS), np.int16),
)


def waiting_of(game: "Game") -> Waiting:
    """The tables of a game by position (see the head of this module)."""
    people = game.people_positions(np.arange(game.n_base_states))
    feasible = people > 0
    count = feasible.sum(axis=1, dtype=np.int32)
    position = np.where(np.arange(N_POSITIONS) < count[:, None], np.argsort(~feasible, axis=1, kind="stable"), -1).astype(np.int8)
    of_pair = count[game.base_pair_state]
    first = np.r_[0, np.cumsum(of_pair, dtype=np.int64)]
    limits, hurry = game.limits, game.hurry
    if game.hides:  # else they are the same, and only took time
        pair = np.repeat(np.arange(len(of_pair)), of_pair)
        place = position[game.base_pair_state[pair], np.arange(len(pair)) - first[pair]]
        met, hurry = _met(game, pair, place, people[game.base_pair_state[pair], place])
        limits = frozen(np.stack([with_fault_odds(met, odds) for odds in game.fault_odds.tolist()]))
    return Waiting(
        choices=frozen(count),
        position=frozen(position),
        start=frozen(first[game.base_pair_start]),
        limits=limits,
        hurry=frozen(hurry),
        place=frozen(np.where(feasible, feasible.cumsum(axis=1) - 1, -1).astype(np.int8)),
    )


def _met(game: "Game", pair: I64, place: I8, weight: F64) -> tuple[U16, U8]:
    """Thresholds and chances of a hurried receiver of ``[R]`` base pairs met at positions that people choose with a weight."""
    stroke = game.base_pair_stroke[pair]
    up, down = odds_of_steps(game.recovery.effect.astype(np.int64), step=STEP)
    factor = (up.astype(np.float64) / down.astype(np.float64))[:, game.catalogue.shot[stroke], game.catalogue.area[stroke], place]
    ratio = np.where(game.catalogue.is_serve[stroke], 1.0, factor)
    fault, winner, below = game.threshold.astype(np.float64).T
    old, one = game.threshold.astype(np.int64)[pair], ONE - 1
    wins = _spread(pair, (winner - fault) / (ONE - fault), ratio[0], weight)
    returned = weight * (1 - wins)
    above = _spread(pair, (ONE - below) / (ONE - winner), ratio[1], returned)
    late = [
        _spread(pair, game.hurry[:, contact] / np.float64(HURRY_ONE), ratio[2], returned * (above if contact else 1 - above))
        for contact in (0, 1)
    ]
    faults = old[:, 0]
    # A stroke that may end the rally in the game without recovery always may: values need a bound.
    ends = np.maximum(faults + np.rint(wins * (ONE - faults)).astype(np.int64), np.minimum(old[:, 1], 1))
    ends = np.minimum(ends, one)
    low = np.clip(ends + np.rint((1 - above) * (ONE - ends)).astype(np.int64), ends, one)
    hurry = np.stack([np.minimum(np.rint(p * HURRY_ONE), HURRY_ONE - 1) for p in late], axis=1)
    return np.stack([faults, ends, low], axis=1).astype(np.uint16), hurry.astype(np.uint8)


@np.errstate(invalid="ignore", divide="ignore")
def _spread(pair: I64, p: F64, ratio: F64, weight: F64) -> F64:
    """``[R]`` probabilities with odds moved by ratios, whose weighted mean is ``p`` of the base pair; ``p`` without weight."""
    odds, scale = (p / (1 - p))[pair] * ratio, np.ones(len(p))
    total = np.bincount(pair, weight, len(p))  # which adds in the order of the rows
    inside = (p > 0) & (p < 1) & (total > 0)
    spread = np.where(inside[pair], odds / (1 + odds), p[pair])
    for _ in range(_ROUNDS):
        mean = np.bincount(pair, weight * spread, len(p)) / total
        scale = np.where(inside, scale * (p * (1 - mean)) / ((1 - p) * mean), 1.0)
        scaled = odds * scale[pair]
        spread = np.where(inside[pair], scaled / (1 + scaled), p[pair])
    return spread
