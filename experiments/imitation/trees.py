"""Boosted trees of the imitator (LightGBM, Ke et al., NIPS 2017), over the same contexts as its networks.

All inputs are small integers with an order: codes, and each number as its step on a quantile scale. One model predicts the shot
type, another the area given the shot type. During the fit the contact height and each player are hidden in a fraction of the
strokes, as for the networks.
"""

import dataclasses
from typing import Final, Self

import lightgbm
import numpy as np
from scipy.special import softmax

from experiments.imitation.context import CODES, UNSEEN_HEIGHT, HitContexts, cuts_of, steps_of
from shuttle_marl.base.arrays import F32, F64, I16, I64
from shuttle_marl.dynamics.trees import PARAMETERS
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.stroke import N_SHOTS

STEPS: Final = 64
"""Steps of the quantile scale of each number."""
_HEIGHT: Final = list(CODES).index("height")
_PLAYERS: Final = len(CODES)
"""Column of the striker; followed by the receiver and the steps."""
_MIN_ROWS_PER_LEAF: Final = 40
_CHUNK: Final = 4096


@dataclasses.dataclass(frozen=True, kw_only=True)
class TreesConfig:
    """Settings of the fit; chosen on held-out matches of the training split.

    Attributes:
        type_rounds: boosting rounds of the shot type.
        area_rounds: boosting rounds of the area.
        leaves: maximum number of leaves of a tree.
        rate: learning rate.
        columns: fraction of the columns sampled for each tree.
        hide_height: fraction of strokes whose contact height is hidden during the fit.
        hide_player: fraction of strokes whose striker is hidden during the fit, and of those whose receiver is.
    """

    type_rounds: int = 130
    area_rounds: int = 130
    leaves: int = 15
    rate: float = 0.08
    columns: float = 0.5
    hide_height: float = 0.5
    hide_player: float = 0.1


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ImitatorTrees:
    """Fitted trees.

    Attributes:
        cuts: ``[F, 63]`` increasing cuts between the steps of the quantile scale of each number.
        types: predicts the shot type.
        areas: predicts the area; its last input is the shot type.
    """

    cuts: F32
    types: lightgbm.Booster
    areas: lightgbm.Booster

    @classmethod
    def fit(cls, contexts: HitContexts, players: I64, shot: I64, area: I64, *, config: TreesConfig, seed: int) -> Self:
        """Fit trees.

        Args:
            contexts: of N strokes.
            players: ``[N, 2]`` codes of striker and receiver, 0 for the average player.
            shot: ``[N]`` shot types.
            area: ``[N]`` areas, -1 where unknown.
            config: settings.
            seed: random seed.
        """
        cuts = cuts_of(contexts.numbers, STEPS)
        columns = _columns(contexts, players, cuts)
        draws = np.random.default_rng(seed).random((len(columns), 3))
        columns[draws[:, 0] < config.hide_height, _HEIGHT] = UNSEEN_HEIGHT
        columns[:, _PLAYERS : _PLAYERS + 2][draws[:, 1:] < config.hide_player] = 0

        def booster(inputs: I16, label: I64, classes: int, rounds: int) -> lightgbm.Booster:
            parameters = {
                **PARAMETERS, "objective": "multiclass", "num_class": classes, "num_leaves": config.leaves,
                "learning_rate": config.rate, "min_data_in_leaf": _MIN_ROWS_PER_LEAF, "feature_fraction": config.columns,
                "seed": seed,
            }  # fmt: skip
            return lightgbm.train(parameters, lightgbm.Dataset(inputs.astype(np.int32), label), num_boost_round=rounds)

        known = area >= 0
        with_shot = np.column_stack([columns, shot.astype(np.int16)])[known]
        return cls(
            cuts=cuts,
            types=booster(columns, shot, N_SHOTS, config.type_rounds),
            areas=booster(with_shot, area[known], N_AREAS, config.area_rounds),
        )

    def predict(self, contexts: HitContexts, players: I64) -> F64:
        """``[N, 13, 9]`` probability of each shot type and area; ``players`` as in :meth:`fit`."""
        columns = _columns(contexts, players, self.cuts)
        out = np.empty((len(columns), N_SHOTS, N_AREAS))
        for start in range(0, len(columns), _CHUNK):
            part = columns[start : start + _CHUNK]
            every_shot = np.tile(np.arange(N_SHOTS, dtype=np.int16), len(part))
            areas = _probabilities(self.areas, np.column_stack([np.repeat(part, N_SHOTS, axis=0), every_shot]))
            out[start : start + _CHUNK] = _probabilities(self.types, part)[:, :, None] * areas.reshape(-1, N_SHOTS, N_AREAS)
        return out


def _probabilities(booster: lightgbm.Booster, columns: I16) -> F64:
    return softmax(np.asarray(booster.predict(columns, raw_score=True, num_threads=1)), axis=1)


def _columns(contexts: HitContexts, players: I64, cuts: F32) -> I16:
    """``[N, 20 + F]`` ordered codes."""
    return np.concatenate([contexts.codes, players, steps_of(contexts.numbers, cuts)], axis=1).astype(np.int16)
