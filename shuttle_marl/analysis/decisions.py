"""Quality of decisions on strokes, on the basis of marks, and on positions, and ratings of players by it.

The **quality** of a stroke compares it with the best one, both against what elite players choose there: with the changes c of the
stroke and b of the best one (:mod:`shuttle_marl.analysis.marks`) it is s(c) / s(b), s(x) = 1 / (1 + exp(-x / SCALE)). The best
stroke has 1. Strokes that marks do not judge have none.

Where a receiver waits, in the game with recovery, is judged by the **loss** of the position: how many more rallies the striker
wins, if they strike and both go on as perfect play does. Both players choose at the same time, so perfect play mixes, and several
positions may be as good as the best one.

Ratings are those of Glicko-2 (M. E. Glickman, "Example of the Glicko-2 system", 2022, https://www.glicko.net/glicko/glicko2.pdf).
Every judged decision is a game against :data:`PAR` whose score is its quality, and those of a match are a rating period.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy import optimize, special

from shuttle_marl.analysis.marks import Judged
from shuttle_marl.base.arrays import F64, I64
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.exact import Solution
from shuttle_marl.game.rally.record import Rally
from shuttle_marl.game.recovery import CENTRE
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import position_shares

SCALE: Final = 0.02
"""Change at which a stroke has 0.73 of the logistic function, where elite players have a half: what separates players best."""
_UNIT: Final = 400 / math.log(10)
"""Points of a unit of the Glicko-2 scale."""
_CENTRE: Final = 1500.0
_TAU: Final = 0.5
"""Constant of the system: how much volatility changes."""

THEMES: Final = ("return", "third", "defence", "attack", "net", "wait")
"""Situations of puzzles: return of serve, third stroke, after a hard stroke, above the net, other strokes, and where to wait."""
_HARD: Final = ("smash", "half-smash", "net-kill", "push", "drive")
USUAL: Final = ("drive", "lift", "drop", "block", "half-smash", "push", "cross-court-net-shot", "net-shot", "smash")
"""Right answers of questions, the rarest first."""
GOOD: Final = 0.005
"""Loss up to which a position counts as good as the best one, in rallies."""
MATTERS: Final = 0.02
"""Loss of the position chosen from which it is asked where to wait."""


def quality(judged: Judged) -> F64:
    """``[P]`` quality of strokes, at most 1; NaN: they are not judged."""
    best = judged.change[judged.best[judged.row]]
    found = special.expit(judged.change / SCALE) / special.expit(best / SCALE)
    return np.where(judged.known, found, np.nan)


def theme_of(rally: Rally, number: int, *, above: bool) -> str:
    """The theme of a stroke of a rally, with the contact above the net or below.

    Args:
        number: of the stroke, from 0.
    """
    if number < 3:
        return ("serve", *THEMES[:2])[number]
    came = SHOTS[rally.catalogue.shot[rally.stroke[number - 1]]]
    return "defence" if came in _HARD else "attack" if above else "net"


def usual_of(shot: str) -> int:
    """Position of a shot type in :data:`USUAL`; all others come last."""
    return USUAL.index(shot) if shot in USUAL else len(USUAL)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Places:
    """The M feasible positions of a receiver, against the K legal strokes of the striker.

    Attributes:
        position: ``[M]`` positions, rising.
        people, perfect: ``[M]`` probabilities of people's choices and of perfect play.
        win: ``[K, M]`` probability that the striker wins the rally with a stroke, under perfect play from then on.
        struck: ``[K]`` probabilities of the strokes under perfect play.
    """

    position: I64
    people: F64
    perfect: F64
    win: F64
    struck: F64

    @property
    def loss(self) -> F64:
        """``[M]`` rallies that a position loses to the best one, against perfect strokes."""
        lost = self.struck @ self.win
        return np.asarray(lost - lost.min())

    @property
    def gain(self) -> F64:
        """``[K, M]`` rallies that a stroke wins more than against a receiver who waits as people do."""
        return np.asarray(self.win - (self.win @ self.people)[:, None])

    def question(self, waited: int) -> int | None:
        """Rank of the right answer to the question where to wait, for a receiver at a position; None: it is not asked.

        It is asked where the position loses clearly and at least one more does. The middle of the court is the usual answer,
        the last rank, all others have rank 0, as in :func:`usual_of`.
        """
        loss = dict(zip(self.position.tolist(), self.loss.tolist(), strict=True))
        wrong = sum(lost > GOOD for lost in loss.values())
        if loss.get(waited, 0.0) < MATTERS or wrong < 2:  # the receiver of a recorded rally may wait where few do
            return None
        return 0 if loss.get(CENTRE, 1.0) > GOOD else len(USUAL)


def places_of(game: Game, state: int, seat: int, solution: Solution) -> Places | None:
    """The positions between which the receiver chooses while a seat strikes in a state; None: they have no choice."""
    tables = game.seats[seat]
    people = tables.people_positions(state)
    position = np.flatnonzero(people)
    if len(position) < 2:
        return None
    pairs = tables.pair_at(state, np.arange(len(tables.legal_strokes(state))))
    after = solution.value[1 - seat][tables.arrivals(pairs)]
    outcome = np.stack([tables.outcome_probabilities(pairs, int(one)) for one in position], axis=1)
    value = outcome[..., 1] - outcome[..., 0] - (outcome[..., 2:] * after[:, None]).sum(axis=-1)
    return Places(
        position=position,
        people=people[position],
        perfect=position_shares(solution.policy[1 - seat].waiting_table[state])[position],
        win=(1 + value) / 2,
        struck=solution.policy[seat].probability_of(pairs),
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Rating:
    """A rating; a new player has the default.

    Attributes:
        points: the rating.
        deviation: its standard deviation.
        volatility: how much the player's strength varies.
    """

    points: float = _CENTRE
    deviation: float = 350.0
    volatility: float = 0.06

    def __post_init__(self) -> None:
        if not (math.isfinite(self.points) and 0 <= self.deviation <= 1000 and 0 < self.volatility <= 1):
            raise ShuttleError(f"{self}: expected finite points, a deviation from 0 to 1000 and a volatility above 0, at most 1")

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval."""
        return self.points - 1.96 * self.deviation, self.points + 1.96 * self.deviation


PAR: Final = Rating(points=1400.0, deviation=0.0)
"""Opponent of all decisions: against it the average pro, whose mean quality is 0.63, has about 1500."""


def rated(rating: Rating, scores: Sequence[float], opponents: Sequence[Rating] | None = None) -> Rating:
    """The rating after a rating period.

    Args:
        scores: of its games, from 0 (lost) to 1 (won).
        opponents: of each game; None: :data:`PAR`.
    """
    if not all(0 <= score <= 1 for score in scores):
        raise ShuttleError(f"scores {list(scores)}: expected numbers from 0 to 1")
    met = [PAR] * len(scores) if opponents is None else opponents
    mu, phi = (rating.points - _CENTRE) / _UNIT, rating.deviation / _UNIT
    g = np.array([1 / math.sqrt(1 + 3 * (one.deviation / _UNIT / math.pi) ** 2) for one in met])
    expected = special.expit(g * (mu - np.array([(one.points - _CENTRE) / _UNIT for one in met])))
    information = float((g**2 * expected * (1 - expected)).sum())
    surplus = float((g * (np.array(scores) - expected)).sum())
    volatility = _volatility(rating.volatility, phi, information, surplus) if information else rating.volatility
    phi = 1 / math.sqrt(1 / (phi**2 + volatility**2) + information)
    return Rating(points=_CENTRE + _UNIT * (mu + phi**2 * surplus), deviation=_UNIT * phi, volatility=volatility)


def _volatility(sigma: float, phi: float, information: float, surplus: float) -> float:
    """Step 5: the root of f in x, the logarithm of the variance."""
    v, a = 1 / information, math.log(sigma**2)
    delta = v * surplus

    def f(x: float) -> float:
        variance = phi**2 + v + math.exp(x)
        return math.exp(x) * (delta**2 - variance) / (2 * variance**2) - (x - a) / _TAU**2

    low, high = a, a
    while f(low) < 0:
        low -= _TAU
    while f(high) > 0:
        high += _TAU
    return math.exp(optimize.brentq(f, low, high) / 2) if low < high else sigma
