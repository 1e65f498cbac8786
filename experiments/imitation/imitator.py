"""The imitator: predicts the next stroke of a player from everything that is visible at the hit.

The behaviour-cloned players of the game (``bc``) know the state of the game only. The imitator also reads positions, tempo, four
previous strokes and the players (:mod:`experiments.imitation.context`); it predicts people better and cannot play the game. It
consists of boosted trees (LightGBM, Ke et al., NIPS 2017). All their inputs are small integers with an order: codes, and each
number as its step on a quantile scale. One model predicts the shot type, another the area given the shot type. Contact heights
and players are hidden in part of the training strokes, so the same trees predict with and without them, and treat unknown players
as an average player.

    imitator = Imitator.fit(read_matches("train.parquet"))
    probability = imitator.predict(read_matches("new.parquet"))  # [N, 13, 9]
"""

import dataclasses
from typing import Final, Self

import lightgbm
import numpy as np
import pyarrow as pa
from scipy.special import softmax

from experiments.imitation.context import CODES, UNSEEN_HEIGHT, HitContexts, cuts_of, hit_contexts, steps_of
from shuttle_marl.base.arrays import F32, F64, I16, I64
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.boosting import PARAMETERS
from shuttle_marl.dynamics.features import mirrored_where, rows_from_strokes
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
class ImitatorConfig:
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
class Imitator:
    """A fitted imitator.

    Attributes:
        players: identifiers of the known players; all others are treated as the average player.
        config: settings of the fit.
        cuts: ``[F, 63]`` increasing cuts between the steps of the quantile scale of each number.
        types: predicts the shot type.
        areas: predicts the area; its last input is the shot type.
    """

    players: tuple[str, ...]
    config: ImitatorConfig
    cuts: F32
    types: lightgbm.Booster
    areas: lightgbm.Booster

    @classmethod
    def fit(cls, strokes: pa.Table, *, config: ImitatorConfig | None = None, seed: int = 0) -> Self:
        """Fit an imitator; half a minute of CPU time for 50,000 strokes.

        The intended area of a fault is unknown, so faults only teach the shot type. The area of a winner is the one in which a
        receiver would have met the shuttle (:mod:`shuttle_marl.dynamics.features`).

        Args:
            strokes: table of schema :data:`shuttle_marl.data.schema.STROKES`.
            config: settings.
            seed: random seed; equal seeds give equal trees.

        Raises:
            ShuttleError: no stroke in the table has a known area.
        """
        config = config or ImitatorConfig()
        rows = rows_from_strokes(strokes)
        known = (rows.outcome != Outcome.FAULT) & (rows.codes["area"] >= 0)
        if not known.any():
            raise ShuttleError("no stroke whose area is known to learn from; is the data complete?")
        contexts = hit_contexts(strokes)
        players = tuple(sorted({*contexts.striker.tolist(), *contexts.receiver.tolist()}))
        cuts = cuts_of(contexts.numbers, STEPS)
        columns = _columns(contexts, players, cuts)
        draws = np.random.default_rng(seed).random((len(columns), 3))
        columns[draws[:, 0] < config.hide_height, _HEIGHT] = UNSEEN_HEIGHT
        columns[:, _PLAYERS : _PLAYERS + 2][draws[:, 1:] < config.hide_player] = 0
        parameters = {
            **PARAMETERS, "objective": "multiclass", "num_leaves": config.leaves, "learning_rate": config.rate,
            "min_data_in_leaf": _MIN_ROWS_PER_LEAF, "feature_fraction": config.columns, "seed": seed,
        }  # fmt: skip

        def booster(inputs: I16, label: I16, classes: int, rounds: int) -> lightgbm.Booster:
            data = lightgbm.Dataset(inputs.astype(np.int32), label.astype(np.int64))
            return lightgbm.train({**parameters, "num_class": classes}, data, num_boost_round=rounds)

        shot, area = rows.codes["shot"], mirrored_where(rows.hand == 1, rows.codes["area"])  # as the receiver's positions are
        return cls(
            players=players,
            config=config,
            cuts=cuts,
            types=booster(columns, shot, N_SHOTS, config.type_rounds),
            areas=booster(np.column_stack([columns, shot])[known], area[known], N_AREAS, config.area_rounds),
        )

    def predict(self, strokes: pa.Table, *, height_known: bool = True, striker: str | None = None) -> F64:
        """``[N, 13, 9]`` probability of each shot type and area, for every stroke of a table; areas are those of its column.

        A prediction depends on nothing after the hit: neither on the stroke, its outcome and its landing, nor on later rows.

        Args:
            strokes: table of schema :data:`shuttle_marl.data.schema.STROKES`, whole rallies.
            height_known: whether predictions may depend on the contact height.
            striker: predict every stroke as if this player struck it; an unknown name means the average player.
        """
        contexts = hit_contexts(strokes)
        if not height_known:
            contexts = contexts.without_height()
        if striker is not None:
            contexts = dataclasses.replace(contexts, striker=np.full(len(contexts), striker))
        columns = _columns(contexts, self.players, self.cuts)
        out = np.empty((len(columns), N_SHOTS, N_AREAS))
        for start in range(0, len(columns), _CHUNK):
            part = columns[start : start + _CHUNK]
            every_shot = np.tile(np.arange(N_SHOTS, dtype=np.int16), len(part))
            areas = _probabilities(self.areas, np.column_stack([np.repeat(part, N_SHOTS, axis=0), every_shot]))
            out[start : start + _CHUNK] = _probabilities(self.types, part)[:, :, None] * areas.reshape(-1, N_SHOTS, N_AREAS)
        return out


def _probabilities(booster: lightgbm.Booster, columns: I16) -> F64:
    return softmax(np.asarray(booster.predict(columns, raw_score=True, num_threads=1)), axis=1)


def _columns(contexts: HitContexts, players: tuple[str, ...], cuts: F32) -> I16:
    """``[N, 20 + F]`` ordered codes; that of a player is the position among the players, from 1, and 0 for unknown players."""
    code = {player: i for i, player in enumerate(players, start=1)}
    known: I64 = np.array([[code.get(name, 0) for name in names] for names in (contexts.striker, contexts.receiver)])
    return np.concatenate([contexts.codes, known.reshape(2, -1).T, steps_of(contexts.numbers, cuts)], axis=1).astype(np.int16)
