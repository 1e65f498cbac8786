"""Baselines of ``offline``: tabular, with estimates shrunk towards coarser cells (:mod:`shuttle_marl.suite.tabular`), or with
boosted trees (LightGBM, Ke et al., NeurIPS 2017) instead of shrunken means.

The argument of a name, as in ``fitted-q:8``, is the number of pseudo-observations of the coarser cell, or what the class says;
:data:`shuttle_marl.suite.method.BASELINES` has those of names without one.
Trees describe strokes by shot type, area, contact and technique of the stroke, of the incoming one and of the own last one, and
by whether the striker is hurried; their argument is the number of trees. LightGBM is part of the extra ``train``.
"""

import dataclasses
from typing import Any, ClassVar

import numpy as np

from shuttle_marl.base.arrays import F64, I16, Floats, Ints
from shuttle_marl.exact import best_response
from shuttle_marl.exact.profile import PairPolicy
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.game.rules import OUTCOMES
from shuttle_marl.game.shipped import load_game
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording.logs import Log, Transitions
from shuttle_marl.suite import tabular
from shuttle_marl.suite.tabular import SHRINK, best_of, cloned, fitted_q, greedy, shrunk_means
from shuttle_marl.suite.task import Setting

_TOLERANCE = 1e-6


@dataclasses.dataclass(frozen=True)
class _Method:
    setting: Setting
    argument: str = str(SHRINK)


class _OwnStrokes(_Method):
    track: ClassVar[str] = "own"


class Clone(_OwnStrokes):
    """Behaviour cloning: play as the log (Pomerleau 1991)."""

    def fit(self, data: Transitions) -> PairPolicy:
        """The behaviour policy."""
        return PairPolicy(game=data.game, probability=cloned(data.game, data.pair, shrink=float(self.argument)))


class OneStep(_OwnStrokes):
    """One step of policy improvement over the behaviour (Brandfonbrener et al. 2021, arXiv 2106.08909)."""

    def fit(self, data: Transitions) -> PairPolicy:
        """Greedy in the Q-values of the behaviour, estimated by the results of its rallies."""
        won = data.won.astype(np.float64)
        q = shrunk_means(data.game, data.pair, won, prior=float(won.mean()), shrink=float(self.argument))
        return greedy(data.game, q)


class FittedQ(_OwnStrokes):
    """Fitted Q iteration (Ernst, Geurts & Wehenkel, JMLR 2005)."""

    def fit(self, data: Transitions) -> PairPolicy:
        """Greedy in the fitted Q-values."""
        return greedy(data.game, fitted_q(data, best_of(data.game), shrink=float(self.argument)))


class FittedQPessimistic(_OwnStrokes):
    """Fitted Q iteration with lower confidence bounds (VI-LCB, Rashidinejad et al. 2021, arXiv 2103.12021).

    ``argument`` over the square root of the observations is taken off the value of a stroke.
    """

    def fit(self, data: Transitions) -> PairPolicy:
        """Greedy in the lower bounds."""
        game, prior = data.game, float(data.won[data.first].mean())
        penalty = float(self.argument) / np.sqrt(tabular.counts(game, data.pair) + 1)
        bound = fitted_q(data, best_of(game), fit=lambda target: shrunk_means(game, data.pair, target, prior=prior) - penalty)
        return greedy(game, bound)


class Bcq(_OwnStrokes):
    """Discrete batch-constrained Q-learning (Fujimoto et al. 2019, arXiv 1910.01708).

    Only strokes are considered whose cloned probability is at least ``argument`` times that of the likeliest stroke.
    """

    def fit(self, data: Transitions) -> PairPolicy:
        """Greedy in the fitted Q-values, within the support of the behaviour."""
        game, chance = data.game, cloned(data.game, data.pair)
        states = np.flatnonzero(game.playable[: game.n_base_states])
        likeliest = np.zeros(game.n_base_states)
        likeliest[states] = tabular.by_state(game, chance, states, np.maximum)
        allowed = (chance >= float(self.argument) * likeliest[game.base_pair_state]).astype(np.float64)
        return greedy(game, fitted_q(data, best_of(game, allowed)), allowed)


class Iql(_OwnStrokes):
    """Implicit Q-learning by networks (Kostrikov et al. 2022, arXiv 2110.06169); the argument is the inverse temperature."""

    def fit(self, data: Transitions) -> PairPolicy:
        """The likeliest stroke of the policy."""
        from shuttle_marl.training import q_learning  # noqa: PLC0415  torch

        config = q_learning.QConfig(beta=float(self.argument))
        return greedy(data.game, q_learning.implicit_q(data, config, self.setting.seed))


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
        return respond(log, tabular.estimated_game(log), SHRINK, penalty=penalty)


def respond(log: Log, game: Game, shrink: float, *, penalty: F64 | None = None) -> TabulatedPolicy:
    """The best response to the cloned opponent in an estimated game, as a table of the rules.

    Args:
        shrink: pseudo-observations of the coarser cell in the model of the opponent.
        penalty: ``[base pairs]`` by which the probability of the player's faults is raised.
    """
    opponent = PairPolicy(game=game, probability=cloned(log.game, log.pair[~log.own], shrink=shrink))
    own = game if penalty is None else tabular.with_faults(game, penalty)
    return TabulatedPolicy(game=log.game, cumulative=best_response(opponent, game=own, tolerance=_TOLERANCE).policy.cumulative)


class ModelBoosted(_Method):
    """Best response in an estimated game; outcomes by boosted trees, the opponent by shrunken counts."""

    def fit(self, log: Log) -> TabulatedPolicy:
        """The exact best response in the estimated game."""
        return respond(log, boosted_game(log, int(self.argument), self.setting.seed), SHRINK)


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


class FittedQBoosted(_OwnStrokes):
    """Fitted Q iteration with boosted trees (Ernst, Geurts & Wehenkel, JMLR 2005)."""

    def fit(self, data: Transitions) -> PairPolicy:
        """Greedy in the fitted Q-values."""
        seed, trees = self.setting.seed, int(self.argument)

        def fit(target: F64) -> F64:
            return boosted(data.game, data.pair, target, trees, seed, objective="regression")

        return greedy(data.game, fitted_q(data, best_of(data.game), fit=fit, sweeps=6))


def boosted(game: Game, pair: Ints, target: Floats | Ints, trees: int, seed: int, **objective: Any) -> F64:
    """``[base pairs]`` or ``[base pairs, classes]`` predictions of boosted trees for the targets ``[M]`` of strokes."""
    import lightgbm  # noqa: PLC0415  an extra

    table = described_pairs(game)
    rows = lightgbm.Dataset(table[pair % game.n_base_pairs], target, categorical_feature=list(range(table.shape[1])))
    settings: dict[str, Any] = {"verbosity": -1, "seed": seed, "num_threads": 1, "deterministic": True, "force_row_wise": True}
    settings |= {"learning_rate": 0.07, "num_leaves": 31, "min_data_in_leaf": 30, "cat_smooth": 20, **objective}
    return np.asarray(lightgbm.train(settings, rows, num_boost_round=trees).predict(table), dtype=np.float64)


def described_pairs(game: Game) -> I16:
    """``[base pairs, 14]`` categories that describe each legal pair."""
    catalogue, state = game.catalogue, game.base_pair_state
    parts = [np.append(part, part.max() + 1) for part in (catalogue.shot, catalogue.area, catalogue.height, catalogue.technique)]
    columns = [part[stroke] for stroke in (game.base_pair_stroke, game.incoming(state), game.own(state)) for part in parts]
    return np.stack([*columns, game.contact(state), game.hurried(state)], axis=1).astype(np.int16)
