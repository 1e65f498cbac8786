"""Baselines of ``evaluate``: estimators of the fraction of rallies that a policy wins, from the log of another policy.

The only reward comes at the end of a rally: 1 for winning it. With rho_t the probability of the t-th own stroke of a rally under
the policy over that under the behaviour, and w the product over the rally:

- importance sampling: mean of w * won; weighted: sum of w * won over the sum of w;
- per decision (Precup, Sutton & Singh 2000): every reward is weighted by the strokes before it, so here it is the first one;
- doubly robust (Jiang & Li 2016, arXiv 1511.03722): V_t = v(s_t) + rho_t (r_t + V_{t+1} - q(s_t, a_t)), backwards in a rally,
  with rho_t of at most 10;
- weighted doubly robust (Thomas & Brunskill 2016, arXiv 1604.00923): the sum over t of w_t (r_t - q(s_t, a_t)) + w_{t-1} v(s_t),
  with w_t the product of the ratios up to t over its mean over the rallies, those that are over with their last one;
- density ratios (DICE; minimax weight learning, Uehara, Huang & Jiang 2020, arXiv 1910.12809): the ratio of visits is linear in
  indicators of incoming shot type, contact and own shot type, for which the equation of its flow has a solution in closed form;
- fitted Q evaluation (Le, Voloshin & Yue 2019, arXiv 1903.08738), and the exact value in an estimated model.
"""

import abc
from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.sparse import csr_matrix

from shuttle_marl.base.arrays import F64
from shuttle_marl.exact import evaluate
from shuttle_marl.exact.profile import PairPolicy
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.tables import Game
from shuttle_marl.recording.logs import Log, Transitions
from shuttle_marl.suite.methods.learned import boosted_game
from shuttle_marl.suite.tabular import SHRINK, by_state, cloned, estimated_game, expected_under, fitted_q, pair_cells

_TOLERANCE = 1e-6
_LARGEST = 10.0
"""Largest ratio of a stroke."""
_RIDGE: Final = 1.0
"""Observations of each cell that change nothing."""


def ratios(data: Transitions, policy: TabulatedPolicy) -> F64:
    """``[M]`` probability of each stroke under the policy over that under the behaviour."""
    return np.asarray(policy.probability_of(data.pair) / data.probability)


def rally_weights(data: Transitions, policy: TabulatedPolicy) -> F64:
    """``[R]`` product of the ratios of each rally with an own stroke."""
    return np.asarray(np.multiply.reduceat(ratios(data, policy), np.flatnonzero(data.first)))


class _EachPolicy(abc.ABC):
    """Estimates the value of each policy by itself."""

    def estimate(self, log: Log, policies: Sequence[TabulatedPolicy]) -> list[float]:
        """One number for each policy."""
        data = log.transitions
        return [float((self.wins(data, policy) + data.idle_wins) / data.n_rallies) for policy in policies]

    @abc.abstractmethod
    def wins(self, data: Transitions, policy: TabulatedPolicy) -> float:
        """Number of rallies with an own stroke that the policy would win."""


class Behaviour:
    """The win rate of the behaviour policy for every policy: a baseline that ignores the policies."""

    def estimate(self, log: Log, policies: Sequence[TabulatedPolicy]) -> list[float]:
        """One number for each policy."""
        return [float(log.won.mean())] * len(policies)


class ImportanceSampling(_EachPolicy):
    """Unbiased, with a variance that grows with the length of rallies."""

    def wins(self, data: Transitions, policy: TabulatedPolicy) -> float:
        """Sum of the weights of rallies that were won."""
        return float((rally_weights(data, policy) * data.won[data.first]).sum())


class WeightedImportanceSampling:
    """Biased, with a smaller variance."""

    def estimate(self, log: Log, policies: Sequence[TabulatedPolicy]) -> list[float]:
        """One number for each policy."""
        data, weights = log.transitions, [rally_weights(log.transitions, policy) for policy in policies]
        won, idle = data.won[data.first], data.n_rallies - int(data.first.sum())
        return [float(((weight * won).sum() + data.idle_wins) / (weight.sum() + idle)) for weight in weights]


class FittedQEvaluation(_EachPolicy):
    """Q-values of the policy, fitted to own transitions."""

    def wins(self, data: Transitions, policy: TabulatedPolicy) -> float:
        """Sum of the values of the first states."""
        return float(q_and_v(data, policy)[1][data.first].sum())


class DoublyRobust(_EachPolicy):
    """Fitted Q evaluation, corrected by importance sampling."""

    def wins(self, data: Transitions, policy: TabulatedPolicy) -> float:
        """Sum of :func:`doubly_robust`."""
        return float(doubly_robust(data, ratios(data, policy), *q_and_v(data, policy)).sum())


class WeightedDoublyRobust(_EachPolicy):
    """The same with weights that add up to 1 at each stroke."""

    def wins(self, data: Transitions, policy: TabulatedPolicy) -> float:
        """Sum of :func:`weighted_doubly_robust`."""
        return float(weighted_doubly_robust(data, ratios(data, policy), *q_and_v(data, policy)).sum())


class Dice(_EachPolicy):
    """Ratio of the visits under the policy and under the behaviour, linear in indicators of cells."""

    def wins(self, data: Transitions, policy: TabulatedPolicy) -> float:
        """Rewards, weighted by the ratio."""
        game = data.game
        cell = pair_cells(game)[1]
        size = int(cell.max()) + 1
        states, index = np.unique(game.base(data.state), return_inverse=True)
        row, pair = game.pairs(states)
        own = cell[data.pair % game.n_base_pairs]
        struck = csr_matrix((np.ones(len(data)), (np.arange(len(data)), own)), (len(data), size))
        chosen = csr_matrix((policy.block_probabilities(0)[pair], (row, cell[pair])), (len(states), size))[index]
        going = np.flatnonzero(~np.append(data.first[1:], True))
        flow = (struck.T @ struck - struck[going].T @ chosen[going + 1]).toarray().T + _RIDGE * np.eye(size)
        ratio = np.linalg.solve(flow, np.asarray(chosen[np.flatnonzero(data.first)].sum(axis=0))[0])
        return float((struck @ ratio) @ data.reward)


class Model:
    """Exact value in a game whose outcomes and opponent are estimated from the log."""

    def game_of(self, log: Log) -> Game:
        """The estimated game."""
        return estimated_game(log)

    def estimate(self, log: Log, policies: Sequence[TabulatedPolicy]) -> list[float]:
        """One number for each policy."""
        game = self.game_of(log)
        opponent = PairPolicy(game=game, probability=cloned(log.game, log.pair[~log.own]))
        players = [TabulatedPolicy(game=game, cumulative=policy.cumulative) for policy in policies]
        return [evaluate(player, opponent, tolerance=_TOLERANCE).odds().rally for player in players]


class ModelBoosted(Model):
    """The same with outcomes by boosted trees."""

    def game_of(self, log: Log) -> Game:
        """The estimated game."""
        return boosted_game(log, 150, 0)


def q_and_v(data: Transitions, policy: TabulatedPolicy, *, shrink: float = SHRINK) -> tuple[F64, F64]:
    """``[M]`` each: fitted value of the stroke played, and of its state."""
    game = data.game
    # Q-values do not depend on the efforts, and few policies do.
    chance = policy.block_probabilities(0)
    q = fitted_q(data, expected_under(game, chance), shrink=shrink)
    states, index = np.unique(game.base(data.state), return_inverse=True)
    return q[data.pair % game.n_base_pairs], by_state(game, chance * q, states, np.add)[index]


def doubly_robust(data: Transitions, rho: F64, q: F64, v: F64) -> F64:
    """``[R]`` doubly robust estimate of each rally with an own stroke.

    Args:
        rho: ``[M]`` ratios.
        q, v: ``[M]`` estimated values of the stroke played and of its state.
    """
    rho = np.minimum(rho, _LARGEST)
    length = np.diff(np.append(np.flatnonzero(data.first), len(data)))
    start, value = np.flatnonzero(data.first), np.zeros(len(length))
    # The t-th strokes of all rallies together, from the last one.
    for t in range(int(length.max()) - 1, -1, -1):
        rows = start[length > t] + t
        value[length > t] = v[rows] + rho[rows] * (data.reward[rows] + value[length > t] - q[rows])
    return value


def weighted_doubly_robust(data: Transitions, rho: F64, q: F64, v: F64) -> F64:
    """``[R]`` what each rally adds to the weighted doubly robust estimate of how many are won; arguments as above."""
    start = np.flatnonzero(data.first)
    length = np.diff(np.append(start, len(data)))
    weight, before, value = np.ones(len(start)), np.ones(len(start)), np.zeros(len(start))
    for t in range(int(length.max())):
        going = length > t
        rows = start[going] + t
        weight[going] *= rho[rows]
        share = weight / max(weight.mean(), np.finfo(np.float64).tiny)
        value[going] += share[going] * (data.reward[rows] - q[rows]) + before[going] * v[rows]
        before = share
    return value
