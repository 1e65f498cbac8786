"""Baselines of ``offline`` with boosted trees (LightGBM, Ke et al., NeurIPS 2017) instead of shrunken means.

Strokes are described by shot type, area, contact and technique of the stroke, of the incoming one and of the own last one, and by
whether the striker is hurried. The argument is the number of trees. LightGBM is part of the extra ``train``.
"""

import dataclasses
from typing import Any, ClassVar

import numpy as np

from shuttle_marl.analysis.tabular import SHRINK, best_of, fitted_q, game_of, greedy
from shuttle_marl.base.arrays import F64, I16, Floats, Ints
from shuttle_marl.exact.profile import PairPolicy
from shuttle_marl.game.rules import OUTCOMES
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.recording.logs import Log, Transitions
from shuttle_marl.suite.methods.learned import respond
from shuttle_marl.suite.offline import LogSetting


@dataclasses.dataclass(frozen=True)
class BoostedModel:
    """Best response in an estimated game; outcomes by boosted trees, the opponent by shrunken counts."""

    setting: LogSetting
    argument: str = "150"

    def fit(self, log: Log) -> TabulatedPolicy:
        """The exact best response in the estimated game."""
        objective = {"objective": "multiclass", "num_class": len(OUTCOMES)}
        shares = boosted(log.game, log.pair, log.outcome, int(self.argument), self.setting.seed, **objective)
        return respond(log, game_of(log.game, shares), SHRINK)


@dataclasses.dataclass(frozen=True)
class BoostedQ:
    """Fitted Q iteration with boosted trees (Ernst, Geurts & Wehenkel, JMLR 2005)."""

    setting: LogSetting
    argument: str = "100"
    track: ClassVar[str] = "own"

    def fit(self, data: Transitions) -> PairPolicy:
        """Greedy in the fitted Q-values."""
        seed, trees = self.setting.seed, int(self.argument)
        q = fitted_q(
            data,
            best_of(data.game),
            fit=lambda target: boosted(data.game, data.pair, target, trees, seed, objective="regression"),
            sweeps=6,
        )
        return greedy(data.game, q)


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
    columns = []
    for stroke in (game.base_pair_stroke, game.incoming(state), game.own(state)):
        for part in (catalogue.shot, catalogue.area, catalogue.height, catalogue.technique):
            columns.append(np.append(part, part.max() + 1)[stroke])
    return np.stack([*columns, game.contact(state), game.hurried(state)], axis=1).astype(np.int16)
