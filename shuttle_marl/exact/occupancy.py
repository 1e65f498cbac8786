"""Expected visits of a profile to states and strokes, and what they weigh: regret, and the holes of a policy.

**Regret** of a policy in a state s is regret(s) = V*(s) - sum_a pi(a | s) Q*(s, a), with V* and Q* the minimax values of states
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
import functools
from typing import Any, Final, Literal

import numpy as np

from shuttle_marl.base.arrays import F64, Intp
from shuttle_marl.exact.fixed_point import ROUNDING, TOLERANCE, accelerated, sweep
from shuttle_marl.exact.optimal import Response, Solution, best_response, limited, solve
from shuttle_marl.exact.profile import StatePolicy, check_opponents, facing, induced
from shuttle_marl.exact.sweeps import propagate
from shuttle_marl.game.draws import ONE
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.shipped import Estimate, factor_of, real_strokes, supported
from shuttle_marl.game.stroke import N_SHOTS
from shuttle_marl.game.tables import ROOT

ENDINGS: Final = ("winner of player 0", "fault of player 1", "winner of player 1", "fault of player 0")
"""Endings of a rally; player 0 wins the first two."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Visits:
    """Expected numbers of visits in a rally of player 0 against player 1.

    Attributes:
        policies: of player 0 and player 1.
        states: ``[S]`` each: expected number of strokes of player 0 and of player 1 in a state.
        error_bound: bound of the summed absolute errors over all states.
    """

    policies: tuple[StatePolicy, StatePolicy]
    states: tuple[F64, F64]
    error_bound: float

    def base_pairs(self, player: int) -> F64:
        """``[L, base pairs]`` expected number of times that a player plays each base pair, by row of the limits of the game."""
        policy = self.policies[player]
        game = policy.game
        total = np.zeros(game.limits.shape[:2])
        for block in range(game.n_blocks):
            if self.states[player][game.block_states(block)].any():
                total[game.table_of(block)] += self.block_pairs(player, block)
        return total

    def block_pairs(self, player: int, block: int) -> F64:
        """``[base pairs]`` expected number of times that a player plays each legal pair of one block."""
        policy = self.policies[player]
        visited = self.states[player][policy.game.block_states(block)]
        return np.asarray(policy.block_probabilities(block) * visited[policy.game.base_pair_state])

    @property
    def rally_length(self) -> float:
        """Expected number of strokes of a rally."""
        return float(self.states[0].sum() + self.states[1].sum())

    def endings(self) -> dict[str, float]:
        """Fraction of rallies with each of :data:`ENDINGS`."""
        shares = dict.fromkeys(ENDINGS, 0.0)
        for player, policy in enumerate(self.policies):
            played = self.base_pairs(player)
            fault, winner = np.moveaxis(policy.game.limits[..., :2].astype(np.float64), -1, 0) / ONE
            # A sum of numpy, because the last bits of BLAS depend on the number of threads.
            shares[f"winner of player {player}"] = float((played * (winner - fault)).sum())
            shares[f"fault of player {player}"] = float((played * fault).sum())
        return shares

    def shot_mix(self, player: int) -> F64:
        """``[13]`` fraction of each shot type in a player's strokes, in the order of :data:`shuttle_marl.game.stroke.SHOTS`."""
        game = self.policies[player].game
        played = np.bincount(game.catalogue.shot[game.base_pair_stroke], self.base_pairs(player).sum(axis=0), N_SHOTS)
        return np.asarray(played / played.sum())


def visits(
    policy: StatePolicy, opponent: StatePolicy, *, server: Literal[0, 1] | None = None, tolerance: float = TOLERANCE
) -> Visits:
    """Expected visits when player 0 plays ``policy`` and player 1 plays ``opponent``.

    With b_i the start of a rally that player i serves, and C_i the probabilities of continuing where i strikes, the visits are
    x_0 = b_0 + w, w = C_1' (b_1 + C_0' (b_0 + w)), x_1 = b_1 + C_0' x_0. As w lies on rally states, whose rows in C_i sum to
    c_i at most, ``|C_i' w| <= c_i |w|`` in the 1-norm, and the bound of :mod:`shuttle_marl.exact.fixed_point` holds in that norm:
    the error of w is at most D residual / (1 - D), D = c_0 c_1, and that of x_1 no larger.

    Args:
        server: the server; None: each player half of the time.

    Raises:
        ExactError: the two games have different layouts, or play may never end.
    """
    check_opponents(policy.game, opponent.game)
    policy, opponent = facing(policy, opponent)
    chains = induced(policy), induced(opponent)
    backward = [functools.partial(propagate, chain.game, chain.chance) for chain in chains]
    size = len(chains[0].reward)
    start = np.zeros((2, size))
    start[:, ROOT] = 0.5 if server is None else np.eye(2)[server]
    contraction = chains[0].contraction * chains[1].contraction
    constant = backward[1](start[1] + backward[0](start[0]))

    def norm(w: F64) -> float:
        return float(np.abs(w).sum())

    def bound(residual: float, w: F64) -> float:
        rounding = ROUNDING * (1 + norm(w))  # all terms are positive, so rounding is relative to their sum
        return 2 * ((residual + rounding) * contraction / (1 - contraction) + rounding)

    w = accelerated(lambda w: backward[1](backward[0](w)), constant, lambda r: bound(norm(r), constant) <= tolerance / 2)
    while True:
        before, w = w, constant + backward[1](backward[0](w))
        residual = norm(w - before)
        error = bound(residual, w)
        if error <= tolerance or residual <= ROUNDING:  # rounding prevents further progress
            break
    first = start[0] + np.maximum(w, 0.0)  # conjugate residuals leave values of -1e-20
    return Visits(policies=(policy, opponent), states=(first, start[1] + backward[0](first)), error_bound=error)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Regret:
    """Value lost by a policy, on the scale of values from -1 to 1.

    Attributes:
        state: ``[S]`` loss of the stroke played in each state, on average over the policy.
        weight: ``[S]`` how often the policy strikes there in a rally, both players serving equally often.
        waiting: ``[S]`` loss of the position chosen where the opponent strikes; 0 without recovery.
        per_rally: loss in a rally: the sum over all.
        error_bound: ``per_rally`` is within this of the true one.
    """

    state: F64
    weight: F64
    per_rally: float
    error_bound: float
    waiting: F64

    def largest(self, count: int) -> Intp:
        """The states with the largest losses in a rally, largest first."""
        return np.argsort(-self.state * self.weight, kind="stable")[:count]


def policy_regret(
    policy: StatePolicy, opponent: StatePolicy | None = None, *, solution: Solution | None = None, tolerance: float = TOLERANCE
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
    hidden = policy.game.hides
    waiting = sweep(induced(other), value)[0] - following if hidden else np.zeros_like(state)
    # The regret of a state is at most 2, and its error that of two values.
    bound = 2 * solution.error_bound * float(weight.sum() + hidden * theirs.sum()) + 2 * counted.error_bound * (1 + hidden)
    return Regret(
        state=state, weight=weight, per_rally=float(weight @ state) + float(theirs @ waiting), error_bound=bound, waiting=waiting
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
    given_up, bound = 0.0, mine.error_bound
    if not game.hides:  # else the losses of the policy alone add up to the exploitability
        theirs = policy_regret(response.policy, policy, solution=solution, tolerance=tolerance)
        given_up, bound = theirs.per_rally, max(bound, theirs.error_bound)
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
        given_up=given_up,
        states=int((lost > tolerance).sum()),
        error_bound=max(bound, response.value.error_bound),
        holes=tuple(found),
    )
