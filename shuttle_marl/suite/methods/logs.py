"""Baselines of ``offline`` and ``evaluate``.

Methods of ``offline`` are tabular, with estimates shrunk towards coarser cells (:mod:`shuttle_marl.suite.tabular`), or with
boosted trees (LightGBM, Ke et al., NeurIPS 2017) instead of shrunken means.

The argument of a name, as in ``fitted-q:8``, is the number of pseudo-observations of the coarser cell, or what the class says;
:data:`shuttle_marl.suite.method.BASELINES` has those of names without one.
Trees describe strokes by shot type, area, contact and technique of the stroke, of the incoming one and of the own last one, and
by whether the striker is hurried; their argument is the number of trees. LightGBM is part of the extra ``train``.

Methods of ``evaluate`` estimate the fraction of rallies that a policy wins, from the log of another policy.
The only reward comes at the end of a rally: 1 for winning it. With rho_t the probability of the t-th own stroke of a rally under
the policy over that under the behaviour, and w the product over the rally:

- importance sampling: mean of w * won; weighted: sum of w * won over the sum of w;
- per decision (Precup, Sutton & Singh 2000): every reward is weighted by the strokes before it, so here it is the first one;
- doubly robust (Jiang & Li 2016, arXiv 1511.03722): V_t = v(s_t) + rho_t (r_t + V_{t+1} - q(s_t, a_t)), backwards in a rally,
  with rho_t of at most 10;
- density ratios (DICE; minimax weight learning, Uehara, Huang & Jiang 2020, arXiv 1910.12809): the ratio of visits is linear in
  indicators of incoming shot type, contact and own shot type, for which the equation of its flow has a solution in closed form;
- fitted Q evaluation (Le, Voloshin & Yue 2019, arXiv 1903.08738), and the exact value in an estimated model.
"""

import abc
import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar, Final

import numpy as np
from scipy.sparse import csr_matrix

from shuttle_marl.base.arrays import F64, I16, Floats, Ints
from shuttle_marl.exact import best_response, evaluate
from shuttle_marl.exact.profile import PairPolicy
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.game.rules import OUTCOMES
from shuttle_marl.game.shipped import load_game
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording.logs import Log, Transitions
from shuttle_marl.suite import tabular
from shuttle_marl.suite.task import Setting

_TOLERANCE = 1e-6


@dataclasses.dataclass(frozen=True)
class _Method:
    setting: Setting
    argument: str = str(tabular.SHRINK)


class _OwnStrokes(_Method):
    track: ClassVar[str] = "own"


class Clone(_OwnStrokes):
    """Behaviour cloning: play as the log (Pomerleau 1991)."""

    def fit(self, data: Transitions) -> PairPolicy:
        """The behaviour policy."""
        return PairPolicy(game=data.game, probability=tabular.cloned(data.game, data.pair, shrink=float(self.argument)))


class OneStep(_OwnStrokes):
    """One step of policy improvement over the behaviour (Brandfonbrener et al. 2021, arXiv 2106.08909)."""

    def fit(self, data: Transitions) -> PairPolicy:
        """Greedy in the Q-values of the behaviour, estimated by the results of its rallies."""
        won = data.won.astype(np.float64)
        q = tabular.shrunk_means(data.game, data.pair, won, prior=float(won.mean()), shrink=float(self.argument))
        return tabular.greedy(data.game, q)


class FittedQ(_OwnStrokes):
    """Fitted Q iteration (Ernst, Geurts & Wehenkel, JMLR 2005)."""

    def fit(self, data: Transitions) -> PairPolicy:
        """Greedy in the fitted Q-values."""
        return tabular.greedy(data.game, tabular.fitted_q(data, tabular.best_of(data.game), shrink=float(self.argument)))


class Model(_Method):
    """Best response in an estimated model: outcomes of strokes and the opponent, both shrunk means."""

    def fit(self, log: Log) -> TabulatedPolicy:
        """The exact best response in the estimated game."""
        shrink = float(self.argument)
        return respond(log, tabular.estimated_game(log, shrink=shrink), shrink)


class ModelPessimistic(_Method):
    """The same with a penalty for strokes that are rare in the log (MOReL, Kidambi et al. 2020, arXiv 2005.05951).

    ``argument`` over the square root of the observations is added to the probability of a fault.
    """

    def fit(self, log: Log) -> TabulatedPolicy:
        """The exact best response in the pessimistic game."""
        penalty = float(self.argument) / np.sqrt(tabular.counts(log.game, log.pair[log.own]) + 1)
        return respond(log, tabular.estimated_game(log), tabular.SHRINK, penalty=penalty)


def respond(log: Log, game: Game, shrink: float, *, penalty: F64 | None = None) -> TabulatedPolicy:
    """Best response to the cloned opponent in an estimated game; ``penalty``: ``[base pairs]`` added to the player's faults."""
    opponent = PairPolicy(game=game, probability=tabular.cloned(log.game, log.pair[~log.own], shrink=shrink))
    own = game if penalty is None else tabular.with_faults(game, penalty)
    return TabulatedPolicy(game=log.game, cumulative=best_response(opponent, game=own, tolerance=_TOLERANCE).policy.cumulative)


class ModelBoosted(_Method):
    """Best response in an estimated game; outcomes by boosted trees, the opponent by shrunken counts."""

    def fit(self, log: Log) -> TabulatedPolicy:
        """The exact best response in the estimated game."""
        return respond(log, boosted_game(log, int(self.argument), self.setting.seed), tabular.SHRINK)


def boosted_game(log: Log, trees: int, seed: int) -> Game:
    """The game with outcomes estimated by boosted trees from the strokes of both players."""
    shares = boosted(log.game, log.pair, log.outcome, trees, seed, objective="multiclass", num_class=len(OUTCOMES))
    return tabular.game_of(log.game, shares)


class Shipped(_Method):
    """A policy of the shipped game, which reads no log: what is known before; the argument is its name."""

    def fit(self, log: Log) -> TabulatedPolicy:
        """The same strokes in the rules of the log."""
        shipped = load_game(self.setting.model)
        return TabulatedPolicy(game=log.game, cumulative=tabulate(resolve(self.argument, shipped), shipped).cumulative)


def boosted(
    game: Game, pair: Ints, target: Floats | Ints, trees: int, seed: int, columns: Sequence[int] = (), **objective: Any
) -> F64:
    """``[base pairs]`` or ``[base pairs, classes]`` predictions of ``[M]`` targets, by columns of :func:`described_pairs`."""
    import lightgbm  # noqa: PLC0415  an extra

    described = described_pairs(game)[:, list(columns) or slice(None)]
    key = np.ravel_multi_index(described.T.astype(np.int64), tuple(described.max(axis=0) + 1))
    _, first, index = np.unique(key, return_index=True, return_inverse=True)
    table = described[first]
    # Equal rows are one with a weight, which takes a fraction of the time.
    values, value = np.unique(target, return_inverse=True)
    cell, number = np.unique(index[pair % game.n_base_pairs] * len(values) + value, return_counts=True)
    row, of = np.divmod(cell, len(values))
    rows = lightgbm.Dataset(table[row], values[of], weight=number, categorical_feature=list(range(table.shape[1])))
    settings: dict[str, Any] = {"verbosity": -1, "seed": seed, "num_threads": 1, "deterministic": True, "force_row_wise": True}
    settings |= {"learning_rate": 0.07, "num_leaves": 31, "min_data_in_leaf": 30, "cat_smooth": 20, **objective}
    return np.asarray(lightgbm.train(settings, rows, num_boost_round=trees).predict(table), dtype=np.float64)[index]


def described_pairs(game: Game) -> I16:
    """``[base pairs, 14]`` categories that describe each legal pair."""
    catalogue, state = game.catalogue, game.base_pair_state
    parts = [np.append(part, part.max() + 1) for part in (catalogue.shot, catalogue.area, catalogue.height, catalogue.technique)]
    columns = [part[stroke] for stroke in (game.base_pair_stroke, game.incoming(state), game.own(state)) for part in parts]
    return np.stack([*columns, game.contact(state), game.hurried(state)], axis=1).astype(np.int16)


_LARGEST = 10.0  # largest ratio of a stroke
_RIDGE: Final = 1.0  # observations of each cell that change nothing


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


class Dice(_EachPolicy):
    """Ratio of the visits under the policy and under the behaviour, linear in indicators of cells."""

    def wins(self, data: Transitions, policy: TabulatedPolicy) -> float:
        """Rewards, weighted by the ratio."""
        game = data.game
        cell = tabular.pair_cells(game)[1]
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


class ModelValue:
    """Exact value in a game whose outcomes and opponent are estimated from the log."""

    def game_of(self, log: Log) -> Game:
        """The estimated game."""
        return tabular.estimated_game(log)

    def estimate(self, log: Log, policies: Sequence[TabulatedPolicy]) -> list[float]:
        """One number for each policy."""
        game = self.game_of(log)
        opponent = PairPolicy(game=game, probability=tabular.cloned(log.game, log.pair[~log.own]))
        players = [TabulatedPolicy(game=game, cumulative=policy.cumulative) for policy in policies]
        return [evaluate(player, opponent, tolerance=_TOLERANCE).odds().rally for player in players]


class ModelBoostedValue(ModelValue):
    """The same with outcomes by boosted trees."""

    def game_of(self, log: Log) -> Game:
        """The estimated game."""
        return boosted_game(log, 150, 0)


def q_and_v(data: Transitions, policy: TabulatedPolicy, *, shrink: float = tabular.SHRINK) -> tuple[F64, F64]:
    """``[M]`` each: fitted value of the stroke played, and of its state."""
    game = data.game
    # Q-values do not depend on the efforts, and few policies do.
    chance = policy.block_probabilities(0)
    q = tabular.fitted_q(data, tabular.expected_under(game, chance), shrink=shrink)
    states, index = np.unique(game.base(data.state), return_inverse=True)
    return q[data.pair % game.n_base_pairs], tabular.by_state(game, chance * q, states, np.add)[index]


def doubly_robust(data: Transitions, rho: F64, q: F64, v: F64) -> F64:
    """``[R]`` doubly robust estimate of each rally, by ``[M]`` ratios, and values ``q`` of the stroke and ``v`` of its state."""
    rho = np.minimum(rho, _LARGEST)
    length = np.diff(np.append(np.flatnonzero(data.first), len(data)))
    start, value = np.flatnonzero(data.first), np.zeros(len(length))
    # The t-th strokes of all rallies together, from the last one.
    for t in range(int(length.max()) - 1, -1, -1):
        rows = start[length > t] + t
        value[length > t] = v[rows] + rho[rows] * (data.reward[rows] + value[length > t] - q[rows])
    return value
