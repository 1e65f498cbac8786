"""Human-like play: the KL-regularised equilibrium (piKL: Jacob et al., ICML 2022; arXiv 2112.07544).

Each player i has a prior b_i, a model of human play, and pays tau KL(pi_i(. | s) || b_i(. | s)) to the other player in every
state, so the game stays zero-sum. With Q(s, a) the value of a stroke as in :mod:`shuttle_marl.exact.fixed_point`, the value of
a state to its striker and the policy are

    V(s) = tau log sum_a b(a | s) exp(Q(s, a) / tau),        pi(a | s) = b(a | s) exp((Q(s, a) - V(s)) / tau).

The limits are minimax over the support of the prior for tau = 0, and the prior for infinite tau. A soft maximum changes by at
most the largest change of its terms, so its operator contracts as the maximum does, values lie between -1 and 1, the
equilibrium is unique, and the bound of :mod:`shuttle_marl.exact.fixed_point` holds. The error of a log-probability of the
policy is at most 2 / tau times the bound.
"""

import dataclasses

import numpy as np

from shuttle_marl.arrays import F32, F64
from shuttle_marl.exact.fixed_point import TOLERANCE, ExactError, Linear, largest_continuation, newton
from shuttle_marl.exact.profile import PairPolicy, StatePolicy, check_same_layout
from shuttle_marl.exact.sweeps import Replies, gathered, probabilities, replies
from shuttle_marl.game.tables import ROOT
from shuttle_marl.kernel.compiling import compiled


@compiled
def _soften(
    rewards: F32,
    continuation: F32,
    replies: Replies,
    prior: F64,
    tau: float,
    following: F64,
    out: F64,
    policy: F64,
) -> None:
    pair_start, first_reply = replies.pair_start, replies.first_reply
    for s in range(out.size):
        first, count = pair_start[s], pair_start[s + 1] - pair_start[s]
        reward, weight = rewards[first : first + count], continuation[2 * first : 2 * (first + count)]
        after = following[2 * first_reply[s] : 2 * (first_reply[s] + count)]
        before, played = prior[first : first + count], policy[first : first + count]
        best = -1e300
        for i in range(count):
            played[i] = (reward[i] - weight[2 * i] * after[2 * i] - weight[2 * i + 1] * after[2 * i + 1]) / 65536.0
            if before[i] > 0.0:
                best = max(best, played[i])
        # For a large tau all terms are close to 1, so their differences are summed separately.
        total = change = 0.0
        for i in range(count):
            x = min((played[i] - best) / tau, 0.0)
            if tau > 1.0:
                change += before[i] * np.expm1(x)
            played[i] = before[i] * np.exp(x)
            total += played[i]
        for i in range(count):
            played[i] /= total
        out[s] = 0.0
        if count > 0:
            out[s] = best + tau * (np.log1p(change) if tau > 1.0 else np.log(total))


@compiled
def _continue(continuation: F32, replies: Replies, policy: F64, following: F64, out: F64) -> None:
    pair_start, first_reply = replies.pair_start, replies.first_reply
    for s in range(out.size):
        first, count = pair_start[s], pair_start[s + 1] - pair_start[s]
        weight, played = continuation[2 * first : 2 * (first + count)], policy[first : first + count]
        after = following[2 * first_reply[s] : 2 * (first_reply[s] + count)]
        total = 0.0
        for i in range(count):
            total += played[i] * (weight[2 * i] * after[2 * i] + weight[2 * i + 1] * after[2 * i + 1])
        out[s] = -total / 65536.0


class _SoftPlayer:
    """A player of the regularised game; ``policy`` is that of the last call of :meth:`values`."""

    def __init__(self, prior: StatePolicy, tau: float) -> None:
        self.game, self._tau = prior.game, tau
        self._prior = tuple(shared_blocks(prior))
        self.policy = np.empty(self.game.n_pairs)

    def values(self, following: F64) -> F64:
        """``[S]`` soft maxima, with ``following`` the value of the next states to the receiver."""
        game, table = self.game, probabilities(self.game)
        out, values = np.empty(game.n_states), np.empty(2 * len(game.reply_edge))
        for block, prior in enumerate(self._prior):
            level = block // game.levels
            gathered(game, following, block, values)
            block_out = out[game.block_states(block)], self.policy[game.block_pairs(block)]
            _soften(table.reward[level], table.continuation[level], replies(game), prior, self._tau, values, *block_out)
        return out

    def linear(self, following: F64) -> F64:
        """``[S]`` linear part of the last call of :meth:`values`: minus the mean value of the successors under the policy."""
        game, table = self.game, probabilities(self.game)
        out, values = np.empty(game.n_states), np.empty(2 * len(game.reply_edge))
        for block in range(game.n_blocks):
            gathered(game, following, block, values)
            policy, block_out = self.policy[game.block_pairs(block)], out[game.block_states(block)]
            _continue(table.continuation[block // game.levels], replies(game), policy, values, block_out)
        return out


def shared_blocks(policy: StatePolicy) -> list[F64]:
    """``[base pairs]`` probabilities of each block; equal blocks share an array, because most policies ignore the efforts."""
    arrays: list[F64] = []
    for block in range(policy.game.n_blocks):
        probability = policy.block_probabilities(block)
        arrays.append(next((seen for seen in arrays if np.array_equal(seen, probability)), probability))
    return arrays


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SoftSolution:
    """The KL-regularised equilibrium.

    Attributes:
        tau: cost of a nat of divergence from the prior, on the scale of values.
        value: ``[S]`` each: value of the regularised game to player 0 where player 0 strikes, and to player 1 where player 1
            strikes.
        policy: of each player.
        sweeps: number of sweeps over all legal pairs of a game.
        residual: largest change of a value in the last sweep.
        contraction: factor by which a sweep (a pair of sweeps, if the players differ) reduces an error.
        error_bound: absolute error bound of all values.
    """

    tau: float
    value: tuple[F64, F64]
    policy: tuple[PairPolicy, PairPolicy]
    sweeps: int
    residual: float
    contraction: float
    error_bound: float


def solve_soft(
    prior: StatePolicy, opponent: StatePolicy | None = None, *, tau: float, tolerance: float = TOLERANCE
) -> SoftSolution:
    """The KL-regularised equilibrium.

    Args:
        prior: of player 0; strokes with probability 0 keep it.
        opponent: prior of player 1; None: the same.
        tau: cost of a nat; finite and positive.
        tolerance: largest acceptable error bound of a value.

    Raises:
        ExactError: ``tau`` is not finite and positive, the layouts differ, or some stroke never ends a rally.
    """
    if not 0 < tau < float("inf"):
        raise ExactError(f"tau {tau!r}: expected a finite number above 0; towards 0 is minimax, towards infinity the prior")
    own = _SoftPlayer(prior, tau)
    start = np.zeros(own.game.n_states)
    if opponent is None or opponent is prior:
        contraction = largest_continuation(own.game)
        z, sweeps, residual, bound = newton(lambda x: (own.values(x), own.linear), start, contraction, tolerance)
        z[ROOT] = own.values(z)[ROOT]
        values, players, sweeps = (z, z), (own, own), sweeps + 1
    else:
        check_same_layout(prior.game, opponent.game)
        other = _SoftPlayer(opponent, tau)
        contraction = largest_continuation(own.game) * largest_continuation(other.game)

        def operator(x: F64) -> tuple[F64, Linear]:
            return own.values(other.values(x)), lambda change: own.linear(other.linear(change))

        z, sweeps, residual, bound = newton(operator, start, contraction, tolerance)
        y = other.values(z)
        z[ROOT] = own.values(y)[ROOT]
        values, players, sweeps = (z, y), (own, other), 2 * sweeps + 2
    first, second = (PairPolicy(game=player.game, probability=player.policy) for player in players)
    return SoftSolution(
        tau=tau,
        value=values,
        policy=(first, first if players[0] is players[1] else second),
        sweeps=sweeps,
        residual=residual,
        contraction=contraction,
        error_bound=bound,
    )
