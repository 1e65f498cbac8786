"""Ratings: what people see of the value of strokes, of positions and of players. Page, reports and puzzles read them.

Both players go on like strong human players (``human:0.05``: perfect play that pays for leaving what people do, see
:func:`shuttle_marl.policy.computed.human_policy`). The **change** of a stroke is its value (:mod:`shuttle_marl.reports.value`)
minus the mean over the strokes that elite players choose there, calibrated.

A stroke is rated only if at least :data:`~shuttle_marl.game.shipped.RELIABLE` real strokes stand behind it and behind the best
one. It has a **mark** if its change is larger than the disagreement of the refits, and if elite players play its shot type there
in less than :data:`RARE` of the cases. Thresholds were chosen on the training matches (``experiments.marks``). Its **quality**
compares it with the best stroke: with the changes c of the stroke and b of the best one it is s(c) / s(b), where
s(x) = 1 / (1 + exp(-x / SCALE)).

Where a receiver waits, in the game with recovery, is rated by the **loss** of the position: how many more rallies the striker
wins, if they strike and both go on as perfect play does. Both players choose at the same time, so perfect play mixes, and several
positions may be as good as the best one.

Players have the ratings of Glicko-2 (M. E. Glickman, "Example of the Glicko-2 system", 2022,
https://www.glicko.net/glicko/glicko2.pdf). Every rated decision is a game against :data:`PAR` whose score is its quality, and
those of a match are a rating period.
"""

import dataclasses
import functools
import math
import threading
from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy import special

from shuttle_marl.base.arrays import F64, I64, Bools
from shuttle_marl.base.cluster import in_threads
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.exact import Solution, evaluate, moved
from shuttle_marl.game.pairs import without_recovery, without_skill
from shuttle_marl.game.policy import position_shares
from shuttle_marl.game.shipped import RELIABLE, Estimate, factor_of, real_strokes, refits_of
from shuttle_marl.game.stroke import N_SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.policy import baselines
from shuttle_marl.policy.computed import TYPICAL_TAU, human_policy
from shuttle_marl.reports.value import TOLERANCE, Value, agree

MARKS: Final = ("!!", "!", "?!", "?", "??")
RARE: Final = 0.25  # share of the shot type among the choices of elite players from which a stroke has no mark
_LEAST: Final = {"!!": 0.06, "!": 0.04, "?!": 0.02, "?": 0.04, "??": 0.07}  # least change, or loss, of each mark, in rallies won
_MASTERED: Final = 0.03  # least difference between the right answer of a question and the stroke played
_WRONG: Final = 0.02  # least difference between the right answer and the other ones
_ANSWERS: Final = 4
SCALE: Final = 0.02
"""Change at which a stroke has 0.73 of the logistic function, where elite players have a half: what separates players best."""
_UNIT: Final = 400 / math.log(10)
_CENTRE: Final = 1500.0
_TAU: Final = 0.5

GOOD: Final = 0.005  # loss up to which a position counts as good as the best one, in rallies
MATTERS: Final = 0.02  # loss of the position chosen from which it is asked where to wait


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Rated:
    """The P legal strokes of N states, one state after the other."""

    row: I64  # [P] number of the state
    start: I64  # [N] position of the first stroke of each state
    stroke: I64  # [P] catalogue index
    shot: I64  # [P] shot type
    behind: F64  # [P] real strokes behind it; NaN: unknown
    share: F64  # [P] probability that elite players choose its shot type there
    refits: F64  # [R, P] change in each refit, not calibrated
    change: F64  # [P] calibrated change
    win: F64  # [P] probability that the striker wins the rally

    @functools.cached_property
    def best(self) -> I64:
        """``[N]`` position of the best stroke with enough real strokes behind it; -1: none."""
        value = np.where(self.behind >= RELIABLE, self.change, -np.inf)
        best = self.largest(value)
        return np.where(value[best] > -np.inf, best, -1)

    def largest(self, value: F64) -> I64:
        """``[N]`` position of the stroke of each state with the largest of ``[P]`` values."""
        ends = [*self.start[1:].tolist(), len(value)]
        return np.array([s + value[s:e].argmax() for s, e in zip(self.start.tolist(), ends, strict=False)], dtype=np.int64)

    @property
    def known(self) -> Bools:
        """``[P]`` whether enough real strokes stand behind the stroke and the best one."""
        return np.asarray((self.behind >= RELIABLE) & (self.best[self.row] >= 0))

    @functools.cached_property
    def loss(self) -> F64:
        """``[P]`` what a stroke loses to the best one, in rallies won; 0 where that is not known or the refits disagree."""
        best = self.best[self.row]
        clear = self.known & agree(self.refits[:, best] - self.refits)
        return np.where(clear, np.maximum(0.0, self.change[best] - self.change), 0.0)

    @functools.cached_property
    def marks(self) -> list[str]:
        """``[P]`` marks; empty for most strokes."""
        out = np.full(len(self.row), "", dtype="<U2")
        marked = self.known & agree(self.refits) & (self.share < RARE)
        for mark in ("!", "!!", "?!", "?", "??"):
            bad = "?" in mark
            size = np.where(self.loss > 0, -self.change, 0.0) if bad else self.change
            out[marked & (size >= _LEAST[mark])] = mark
        return [str(mark) for mark in out]

    @property
    def quality(self) -> F64:
        """``[P]`` at most 1; NaN where a stroke is not rated."""
        found = special.expit(self.change / SCALE) / special.expit(self.change[self.best[self.row]] / SCALE)
        return np.where(self.known, found, np.nan)

    def question(self, played: int) -> tuple[int, list[int]] | None:
        """A question about the only state: position of the right answer, and of wrong ones, the stroke played first. The right
        answer is as good as what elite players choose, and clearly better than all others. Of several shot types that are right
        one is drawn, by the stroke played, so that no rule of thumb knows it."""
        if not self.known[played]:
            return None

        def below(right: int, least: float) -> Bools:
            worse = self.change[right] - self.change >= least
            return np.asarray(self.known & worse & agree(self.refits[:, [right]] - self.refits))

        good = [k for k in np.flatnonzero(self.known & (self.change >= 0)).tolist() if below(k, _MASTERED)[played]]
        order = np.random.default_rng(played).permutation(N_SHOTS)
        for right in sorted(good, key=lambda k: (order[self.shot[k]], -self.change[k])):
            wrong = [k for k in np.argsort(-self.behind, kind="stable").tolist() if k != played and below(right, _WRONG)[k]]
            if len(wrong) >= _ANSWERS - 2:
                return right, [played, *wrong[: _ANSWERS - 2]]
        return None


class Rater:
    """Values of the choices in a game.

    Args:
        game: of one player alone, without the skill of people and without recovery.

    Attributes:
        refits: number of refits.
        factor: share of predicted advantages that real matches realise; None: unknown, taken as 1.
    """

    def __init__(self, game: Game) -> None:
        self.game, self.factor = game, factor_of(game)
        self._usual, self._real = baselines.load(None, game), real_strokes(game)
        strong, refits = human_policy(TYPICAL_TAU, None, game), refits_of(game)
        self.refits = len(refits)

        def value(world: Game) -> Value:
            policy = moved(strong, world)
            return Value(world, evaluate(policy, policy, tolerance=TOLERANCE).striking)

        self._worlds = list(in_threads(value, (game, *refits)))

    def rated(self, states: I64) -> Rated:
        """The legal strokes of ``[N]`` states."""
        game = self.game
        row, pairs = game.pairs(states)
        behind = np.full(len(pairs), np.nan) if self._real is None else self._real[game.base_pair_edge[pairs % game.n_base_pairs]]
        chance = self._usual.probability_of(pairs)
        reliable = chance * (behind >= RELIABLE)
        weight = np.where((np.bincount(row, reliable, len(states)) > 0)[row], reliable, chance)
        total = np.bincount(row, weight, len(states))
        value = np.stack([world.win(pairs) for world in self._worlds])
        usual = np.stack([np.bincount(row, weight * each, len(states)) / total for each in value])
        refits = (value - usual[:, row])[min(1, self.refits) :]
        change = (Estimate(1.0, 1.0, 1.0) if self.factor is None else self.factor).value * refits.mean(axis=0)
        stroke = game.base_pair_stroke[pairs % game.n_base_pairs].astype(np.int64)
        shot = game.catalogue.shot[stroke].astype(np.int64)
        kind = row * N_SHOTS + shot
        return Rated(
            row=row,
            start=np.searchsorted(row, np.arange(len(states))),
            stroke=stroke,
            shot=shot,
            behind=behind,
            share=np.bincount(kind, chance, len(states) * N_SHOTS)[kind],
            refits=refits,
            change=change,
            win=np.clip(usual[0][row] + change, 0.0, 1.0),
        )


_LOCK: Final = threading.Lock()


def rater_of(game: Game) -> Rater:
    """The rater of a game: that without the skill of people, whose receivers wait as people do; computed once for all threads."""
    with _LOCK:
        return _computed(without_recovery(without_skill(game)))


@functools.lru_cache(maxsize=2)
def _computed(game: Game) -> Rater:
    return Rater(game)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Places:
    """The M feasible positions of a receiver, against the K legal strokes of the striker."""

    position: I64  # [M] positions, rising
    people: F64  # [M] probability of people's choice
    perfect: F64  # [M] that of perfect play
    win: F64  # [K, M] probability that the striker wins the rally with a stroke, under perfect play from then on
    struck: F64  # [K] probabilities of the strokes under perfect play

    @property
    def loss(self) -> F64:
        """``[M]`` rallies that a position loses to the best one, against perfect strokes."""
        lost = self.struck @ self.win
        return np.asarray(lost - lost.min())

    @property
    def gain(self) -> F64:
        """``[K, M]`` rallies that a stroke wins more than against a receiver who waits as people do."""
        return np.asarray(self.win - (self.win @ self.people)[:, None])

    def asks(self, waited: int) -> bool:
        """Whether a receiver at a position is asked where to wait: it loses clearly, and at least one more does."""
        loss = dict(zip(self.position.tolist(), self.loss.tolist(), strict=True))
        wrong = sum(lost > GOOD for lost in loss.values())
        return loss.get(waited, 0.0) >= MATTERS and wrong > 1  # the receiver of a recorded rally may wait where few do


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
    """A rating; a new player has the default."""

    points: float = _CENTRE  # the rating
    deviation: float = 350.0  # its standard deviation
    volatility: float = 0.06  # how much the player's strength varies

    def __post_init__(self) -> None:
        if not (math.isfinite(self.points) and 0 <= self.deviation <= 1000 and 0 < self.volatility <= 1):
            raise ShuttleError(f"{self}: expected finite points, a deviation from 0 to 1000 and a volatility above 0, at most 1")

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval."""
        return self.points - 1.96 * self.deviation, self.points + 1.96 * self.deviation

    def after(self, scores: Sequence[float], opponents: Sequence["Rating"] | None = None) -> "Rating":
        """The rating after a rating period; ``scores``: of its games, from 0 (lost) to 1 (won); ``opponents``: of each game
        (None: :data:`PAR`)."""
        if not all(0 <= score <= 1 for score in scores):
            raise ShuttleError(f"scores {list(scores)}: expected numbers from 0 to 1")
        met = [PAR] * len(scores) if opponents is None else opponents
        mu, phi = (self.points - _CENTRE) / _UNIT, self.deviation / _UNIT
        g = np.array([1 / math.sqrt(1 + 3 * (one.deviation / _UNIT / math.pi) ** 2) for one in met])
        expected = special.expit(g * (mu - np.array([(one.points - _CENTRE) / _UNIT for one in met])))
        information = float((g**2 * expected * (1 - expected)).sum())
        surplus = float((g * (np.array(scores) - expected)).sum())
        volatility = _volatility(self.volatility, phi, information, surplus) if information else self.volatility
        phi = 1 / math.sqrt(1 / (phi**2 + volatility**2) + information)
        return Rating(points=_CENTRE + _UNIT * (mu + phi**2 * surplus), deviation=_UNIT * phi, volatility=volatility)


def _volatility(sigma: float, phi: float, information: float, surplus: float) -> float:
    """Step 5: the root of f in x, the logarithm of the variance."""
    from scipy import optimize  # noqa: PLC0415  slow to import

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


PAR: Final = Rating(points=1400.0, deviation=0.0)  # opponent of all decisions; against it the average pro has about 1500
