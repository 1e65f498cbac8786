"""Advice against an opponent: strokes that win more rallies than what a player usually plays, where the opponent leaves them.

Both players go on as they are imitated. States that a coach does not tell apart form a **situation**: the shot type and the area
of the incoming stroke, and the contact. The **gain** of a stroke in a situation is the sum of its advantages
(:mod:`shuttle_marl.reports.value`) over the states, each weighted by the expected visits in a rally: rallies won more if the
stroke is always played there.

Advice is given only where it can be trusted: enough real strokes behind the stroke and behind the situation, and a positive
gain in most of the refits of the game on resampled matches. It keeps the technique that the player uses most in a state, because
where the shuttle is met decides that. The best of many gains is an overestimate, so the gain that is reported is calibrated.
"""

import dataclasses
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64, I64, Bools
from shuttle_marl.base.cluster import in_threads
from shuttle_marl.exact import ProfileValue, Visits, moved, visits
from shuttle_marl.exact.profile import evaluate_chains, induced
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.layout import Layout
from shuttle_marl.game.pairs import people_of
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.shipped import RELIABLE, Estimate, factor_of, real_strokes
from shuttle_marl.game.stroke import N_SHOTS, N_TECHNIQUES
from shuttle_marl.game.tables import Game
from shuttle_marl.policy import baselines
from shuttle_marl.reports.value import LEAST_REFITS, Value, calibrated

TOLERANCE: Final = 1e-6
LEAST_STEADY: Final = 0.8  # least share of the refits in which the gain of an advised stroke is positive
LEAST_GAIN: Final = 0.0003  # least gain in rallies won per rally, in the mean over the refits
_ALIKE: Final = 2  # most pieces of advice for one shot type: five times the smash is one piece of advice
_LEAST_COVERED: Final = 0.5
"""Least part of a situation in which the advised stroke is legal and has enough real strokes behind it."""
N_SITUATIONS: Final = 2 * N_SHOTS * N_AREAS + 1
SERVE: Final = N_SITUATIONS - 1


class Situation(NamedTuple):
    """Situation in which a player chooses a stroke.

    Attributes:
        shot, area: of the incoming stroke, indices; -1 for the serve. The area is where the player strikes.
        contact: 0 below, 1 above the net.
    """

    shot: int
    area: int
    contact: int


def situation(number: int) -> Situation:
    """The situation with a number."""
    if number == SERVE:
        return Situation(-1, -1, 0)
    shot, rest = divmod(number, 2 * N_AREAS)
    return Situation(shot, *divmod(rest, 2))


def situations(game: Layout) -> I64:
    """``[base states]`` number of the situation of each state."""
    state = np.arange(game.n_base_states)
    shot, area = (
        np.append(part, 0).astype(np.int64)[game.incoming(state)] for part in (game.catalogue.shot, game.catalogue.area)
    )
    number = (shot * N_AREAS + area) * 2 + game.contact(state)
    return np.where(game.incoming(state) == game.n_strokes, SERVE, number)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Meeting:
    """Two policies against each other.

    Attributes:
        policies: of seats 0 and 1.
        value: exact values of seat 0 against seat 1.
        seen: expected visits in a rally, both serving equally often.
    """

    policies: tuple[TabulatedPolicy, TabulatedPolicy]
    value: ProfileValue
    seen: Visits

    def visits(self, seat: int) -> F64:
        """``[base states]`` expected strokes of a seat in a rally, over all efforts."""
        return np.asarray(self.seen.states[seat].reshape(-1, self.policies[seat].game.n_base_states).sum(axis=0))

    def advantages(self, seat: int) -> F64:
        """``[base pairs]`` advantage of each stroke times the visits to its state, over all efforts."""
        game, total = self.policies[seat].game, np.zeros(self.policies[seat].game.n_base_pairs)
        value = Value(game, self.value.striking, seat)
        for block in range(game.n_blocks):
            states = game.block_states(block).start + game.base_pair_state
            total += self.seen.states[seat][states] * value.advantage(game.block_pairs(block), states)
        return total


def meet(first: TabulatedPolicy, second: TabulatedPolicy) -> Meeting:
    """Values and visits of one policy against another."""
    chains = induced(first), induced(second)
    value = evaluate_chains(*chains, tolerance=TOLERANCE)
    return Meeting(policies=(first, second), value=value, seen=visits(first, second, tolerance=TOLERANCE, chains=chains))


def imitated(pair: Game) -> tuple[TabulatedPolicy, TabulatedPolicy]:
    """Both players of a pair as they are imitated: by their own choices where the model has them, else as the average player."""
    first, second = (
        baselines.load(player if player in baselines.players(game) else None, game)
        for player, game in zip(people_of(pair).players, pair.seats, strict=True)
    )
    return first, second


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Refitted:
    """A pair of players at home and in the refits of the game.

    Attributes:
        home: both imitated in it.
        refits: the same in each refit.
        factor: share of predicted advantages that real matches realise by the end of the rally; None: not known.
    """

    pair: Game
    home: Meeting
    refits: tuple[Meeting, ...]
    factor: Estimate | None


def refitted(pair: Game) -> Refitted:
    """Solve a pair of imitated players in the game and in its refits, on all cores."""
    home = imitated(pair)

    def solved(game: Game) -> Meeting:
        return meet(*(moved(policy, seat) for policy, seat in zip(home, game.seats, strict=True)))

    first, *others = in_threads(solved, (pair, *people_of(pair).refits()))
    return Refitted(pair=pair, home=first, refits=tuple(others), factor=factor_of(pair.seats[0]))


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Advice:
    """A stroke for a situation.

    Attributes:
        situation: what comes in.
        stroke: catalogue index of the advised stroke.
        usual, usual_share: stroke that the player plays most there, and its probability.
        often: how often the situation occurs in a rally.
        home: gain in rallies won per rally in the game; of the refits: ``steady``, the share with a positive gain, and
            ``refits``, the gain in each.
        expected: calibrated gain per rally.
        behind: least number of real strokes behind the advised stroke, over the incoming strokes of the situation.
        situation_behind: number of real strokes of the kind that makes the situation.
        states: base states of the situation in which the stroke is legal and has enough real strokes behind it.
    """

    situation: Situation
    stroke: int
    usual: int
    usual_share: float
    often: float
    home: float
    steady: float
    refits: F64
    expected: Estimate
    behind: float
    situation_behind: float
    states: I64


def _gains(meeting: Meeting, seat: int, allowed: Bools, key: I64, size: int) -> F64:
    return np.bincount(key[allowed], meeting.advantages(seat)[allowed], size).astype(np.float64)


def advise(found: Refitted, seat: int = 0, *, most: int = 5, at_least: float = RELIABLE) -> list[Advice]:
    """Strokes that a player should play against the other one, one for each situation, and of a shot type no more than two.

    The first ones gain most.

    Args:
        found: the pair, at home and in refits.
        most: largest number of situations.
        at_least: least number of real strokes behind a stroke and behind a situation.
    """
    game, home = found.pair.seats[seat], found.home
    real = real_strokes(game)
    if real is None or len(found.refits) < LEAST_REFITS:
        return []
    of_state, of_pair = situations(game), game.base_pair_state
    situation_behind = real[np.arange(game.n_base_states) >> 2]
    allowed, key = _reliable(game, real, at_least)
    allowed = allowed & _technique_kept(home.policies[seat])
    size = N_SITUATIONS * game.n_strokes
    weight = home.visits(seat)
    often = np.bincount(key[allowed], weight[of_pair][allowed], size)
    whole = np.repeat(np.bincount(of_state, weight, N_SITUATIONS), game.n_strokes)
    gain = _gains(home, seat, allowed, key, size)
    refits = np.stack([_gains(each, seat, allowed, key, size) for each in found.refits])
    mean, steady = refits.mean(axis=0), (refits > 0).mean(axis=0)
    score = np.where(
        (gain > 0) & (steady >= LEAST_STEADY) & (mean >= LEAST_GAIN) & (often >= _LEAST_COVERED * whole), mean, -np.inf
    ).reshape(N_SITUATIONS, game.n_strokes)
    best = score.argmax(axis=1)
    value = score[np.arange(N_SITUATIONS), best]
    advised: list[Advice] = []
    shots = game.catalogue.shot[best]
    for number in np.argsort(-value, kind="stable").tolist():
        if not np.isfinite(value[number]) or len(advised) == most:
            break
        if sum(game.catalogue.shot[one.stroke] == shots[number] for one in advised) == _ALIKE:
            continue
        chosen = number * game.n_strokes + int(best[number])
        pairs = np.flatnonzero(allowed & (key == chosen))
        states = of_pair[pairs].astype(np.int64)
        visited = weight[states] > 0
        usual, share = _usual(home, seat, states, weight[states])
        advised.append(
            Advice(
                situation=situation(number),
                stroke=int(best[number]),
                usual=usual,
                usual_share=share,
                often=float(often[chosen]),
                home=float(gain[chosen]),
                steady=float(steady[chosen]),
                refits=refits[:, chosen],
                expected=calibrated(refits[:, chosen], found.factor),
                behind=float(real[game.base_pair_edge[pairs[visited]]].min()),
                situation_behind=float("nan") if number == SERVE else float(situation_behind[states[visited]].min()),
                states=states,
            )
        )
    return advised


def _reliable(game: Game, real: F64, at_least: float) -> tuple[Bools, I64]:
    """``[base pairs]`` whether enough real strokes stand behind a stroke and its situation, and the number of both together."""
    of_state, of_pair = situations(game), game.base_pair_state
    situation = (real[np.arange(game.n_base_states) >> 2] >= at_least) | (of_state == SERVE)
    key = of_state[of_pair] * game.n_strokes + game.base_pair_stroke.astype(np.int64)
    return (real[game.base_pair_edge] >= at_least) & situation[of_pair], key


def _technique_kept(policy: TabulatedPolicy) -> Bools:
    """``[base pairs]`` whether a stroke has the technique that its striker uses most in the state."""
    game = policy.game
    technique = game.catalogue.technique[game.base_pair_stroke].astype(np.int64)
    kind = game.base_pair_state.astype(np.int64) * N_TECHNIQUES + technique
    share = np.bincount(kind, policy.block_probabilities(0), game.n_base_states * N_TECHNIQUES)
    return np.asarray(share.reshape(-1, N_TECHNIQUES).argmax(axis=1)[game.base_pair_state] == technique)


def _usual(home: Meeting, seat: int, states: I64, weight: F64) -> tuple[int, float]:
    """Stroke that a player plays most in some states, and its probability there."""
    policy = home.policies[seat]
    game, chance = policy.game, policy.block_probabilities(0)
    row, pairs = game.pairs(states)
    total = np.bincount(game.base_pair_stroke[pairs], weight[row] * chance[pairs], game.n_strokes)
    return int(total.argmax()), float(total.max() / weight.sum())
