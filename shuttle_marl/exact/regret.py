"""Regret of a policy, and its holes: states in which it loses most to its best response.

The regret of a policy in a state s is regret(s) = V*(s) - sum_a pi(a | s) Q*(s, a), with V* and Q* the minimax values of states
and strokes. Weighted by how often the policy strikes in s, the regrets add up exactly to its loss against a perfect opponent (the
performance difference lemma: Kakade & Langford, ICML 2002):

    V* - V^pi = sum_s visits(s) regret(s),        visits: of the policy against the minimax policy.

The best response b to pi has regret wherever it leaves minimax play to win more against pi, so its gain is exactly

    exploitability = sum_s visits_pi(s) regret_pi(s) - sum_s visits_b(s) regret_b(s),        visits: of pi against b.

The first sum is the loss of pi by state. A state that is rare in self-play may occur in every rally against b, so both numbers of
visits are reported.

With recovery both players choose in every state, so a loss there is that of strokes against the positions of the opponent, and of
positions against the opponent's strokes; Q* is weighted by both. Over the states in which either strikes, these losses add up
exactly to V* - V, against any opponent: for the best response that is the exploitability.
"""

import dataclasses
from typing import Any

import numpy as np

from shuttle_marl.base.arrays import F64, Intp
from shuttle_marl.exact.fixed_point import TOLERANCE
from shuttle_marl.exact.occupancy import visits
from shuttle_marl.exact.optimal import Response, Solution, best_response, limited, solve
from shuttle_marl.exact.profile import StatePolicy, facing, induced
from shuttle_marl.exact.solver import sweep
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.shipped import Estimate, factor_of, real_strokes, supported


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Regret:
    """Value lost by a policy, on the scale of values from -1 to 1.

    Attributes:
        state: ``[S]`` loss of the stroke played in each state, on average over the policy.
        weight: ``[S]`` how often the policy strikes there in a rally, both players serving equally often.
        waiting: ``[S]`` the same of the position chosen where the opponent strikes; None without recovery.
        waiting_weight: ``[S]`` how often the opponent strikes there.
        per_rally: loss in a rally: the sum over all.
        error_bound: ``per_rally`` is within this of the true one.
    """

    state: F64
    weight: F64
    per_rally: float
    error_bound: float
    waiting: F64 | None = None
    waiting_weight: F64 | None = None

    def largest(self, count: int) -> Intp:
        """The states with the largest losses in a rally, largest first."""
        return np.argsort(-self.state * self.weight, kind="stable")[:count]


def policy_regret(
    policy: StatePolicy,
    opponent: StatePolicy | None = None,
    *,
    solution: Solution | None = None,
    tolerance: float = TOLERANCE,
) -> Regret:
    """The regret of a policy in seat 0, weighted by its visits.

    Args:
        opponent: of the visits; None: the minimax policy, for which the sum is V* - V^pi at the serve.

    Raises:
        ExactError: the layouts differ, or play may never end.
    """
    solution = solution or solve(policy.game, tolerance=tolerance)
    value, following = solution.value
    played, other = facing(policy, opponent or solution.policy[1])
    state = value - sweep(induced(played), following)[0]
    counted = visits(played, other, tolerance=tolerance)
    weight, theirs = counted.states
    hidden = policy.game.recovery is not None
    waiting = sweep(induced(other), value)[0] - following if hidden else np.zeros_like(state)
    # The regret of a state is at most 2, and its error that of two values.
    bound = 2 * solution.error_bound * float(weight.sum() + hidden * theirs.sum()) + 2 * counted.error_bound * (1 + hidden)
    return Regret(
        state=state,
        weight=weight,
        per_rally=float(weight @ state) + float(theirs @ waiting),
        error_bound=bound,
        waiting=waiting if hidden else None,
        waiting_weight=theirs if hidden else None,
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Hole:
    """A state in which a policy loses value.

    Attributes:
        state: index of the state.
        description: the state in words.
        played: most likely stroke of the policy there.
        played_share: its probability.
        best: the best stroke there.
        best_share: its probability under the policy.
        in_self_play: expected strokes of the policy in the state, in a rally against itself.
        against_best_response: the same against its best response.
        played_real: real strokes in the data behind ``played``; None: not known.
        best_real: the same behind ``best``.
        regret: mean loss of a stroke there, as a value from 0 to 2.
        loss: expected loss there in a rally against the best response: ``against_best_response * regret``.
        expected: the part of ``regret`` to expect in real matches (:func:`shuttle_marl.game.shipped.factor_of`); None: not known.
    """

    state: int
    description: str
    played: str
    played_share: float
    best: str
    best_share: float
    in_self_play: float
    against_best_response: float
    played_real: float | None
    best_real: float | None
    regret: float
    loss: float
    expected: Estimate | None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Holes:
    """Losses of a policy to its best response.

    Attributes:
        exploitability: gain of the best response, as a value from 0 to 1: ``loss - given_up``.
        loss: expected loss of the policy in a rally, over all states.
        given_up: expected loss of the best response, relative to minimax play.
        states: number of states with a loss.
        error_bound: absolute error bound of each of the three sums.
        holes: the states with the largest losses, largest first.
    """

    exploitability: float
    loss: float
    given_up: float
    states: int
    error_bound: float
    holes: tuple[Hole, ...]

    @property
    def share(self) -> float:
        """Fraction of the loss that :attr:`holes` account for; 1 without a loss."""
        return sum(hole.loss for hole in self.holes) / self.loss if self.states else 1.0

    def as_json(self) -> dict[str, Any]:
        """The figures as JSON."""
        listed = [
            {**dataclasses.asdict(hole), "expected": None if hole.expected is None else hole.expected._asdict()}
            for hole in self.holes
        ]
        return {**dataclasses.asdict(self), "holes": listed, "share": self.share}


def holes(
    policy: TabulatedPolicy,
    *,
    top: int = 10,
    at_least: float = 0,
    solution: Solution | None = None,
    response: Response | None = None,
    tolerance: float = TOLERANCE,
) -> Holes:
    """States in which a policy loses most to its best response.

    Args:
        at_least: real strokes behind the strokes of the best response and of the perfect play that regret compares with, see
            :func:`shuttle_marl.exact.best_response`.

    Raises:
        ExactError: play may never end.
    """
    game = policy.game
    solution = solution or solve(limited(game, at_least), tolerance=tolerance)
    response = response or best_response(policy, at_least=at_least, tolerance=tolerance)
    real, allowed, factor = real_strokes(game), supported(game, at_least), factor_of(game)
    mine = policy_regret(policy, response.policy, solution=solution, tolerance=tolerance)
    hidden = mine.waiting is not None  # then the losses add up to the exploitability
    theirs = mine if hidden else policy_regret(response.policy, policy, solution=solution, tolerance=tolerance)
    alone = visits(policy, policy, tolerance=tolerance).states[0]
    lost = mine.state * mine.weight
    found = []
    for state in mine.largest(top).tolist():
        if lost[state] <= tolerance:
            break
        strokes, pairs = game.legal_strokes(state), game.pairs_of(state)
        probability = policy.probability_of(np.arange(pairs.start, pairs.stop))
        base = np.arange(pairs.start, pairs.stop) % game.n_base_pairs
        best = int(np.where(allowed[base], game.stroke_values(solution.value[1], pairs), -np.inf).argmax())
        behind = [None] * len(base) if real is None else real[game.base_pair_edge[base]].tolist()
        most = int(probability.argmax())
        found.append(
            Hole(
                state=state,
                description=game.describe(state),
                played=game.catalogue.names[strokes[most]],
                played_share=float(probability[most]),
                best=game.catalogue.names[strokes[best]],
                best_share=float(probability[best]),
                in_self_play=float(alone[state]),
                against_best_response=float(mine.weight[state]),
                played_real=behind[most],
                best_real=behind[best],
                regret=float(mine.state[state]),
                loss=float(lost[state]),
                expected=None if factor is None else factor.scaled(float(mine.state[state])),
            )
        )
    return Holes(
        exploitability=response.value.odds().value,
        loss=mine.per_rally,
        given_up=0.0 if hidden else theirs.per_rally,
        states=int((lost > tolerance).sum()),
        error_bound=max(mine.error_bound, theirs.error_bound, response.value.error_bound),
        holes=tuple(found),
    )
