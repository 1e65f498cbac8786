"""The imitator: predicts the next stroke of a player from everything that is visible at the hit.

The behaviour-cloned players of the game (``bc``) know the state of the game only. The imitator also reads positions, tempo, four
previous strokes and the players (:class:`HitContexts`); it predicts people better and cannot play the game. It
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
import numpy.typing as npt
import pyarrow as pa
from scipy.special import softmax

from shuttle_marl.base.arrays import F32, F64, I16, I64
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.boosting import PARAMETERS
from shuttle_marl.dynamics.features import mirrored_where, rows_from_strokes
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.stroke import N_SHOTS, N_TECHNIQUES

HISTORY: Final = 4
"""Number of previous strokes."""
UNSEEN_HEIGHT: Final = 2
"""Code of a hidden contact height."""
_BEFORE: Final = {"shot": N_SHOTS, "area": N_AREAS, "height": 2, "technique": N_TECHNIQUES}
CODES: Final[dict[str, int]] = {
    "height": UNSEEN_HEIGHT + 1,
    "discipline": 2,
    # Two more codes of a previous stroke: "none" (before the serve) and "unknown" (the row was dropped).
    **{f"{name}_{lag}": size + 2 for lag in range(1, HISTORY + 1) for name, size in _BEFORE.items()},
}
"""Number of values of each code; ``_1`` is the incoming stroke, ``_2`` the striker's previous one."""
MAX_SECONDS: Final = 5.0
"""A longer time between two strokes [s] is treated as an annotation error."""
_USUAL_FRAME_RATE: Final = 30.0
STEPS: Final = 64
"""Steps of the quantile scale of each number."""
_HEIGHT: Final = list(CODES).index("height")
_PLAYERS: Final = len(CODES)
"""Column of the striker; followed by the receiver and the steps."""
_MIN_ROWS_PER_LEAF: Final = 40
_CHUNK: Final = 4096


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class HitContexts:
    """Contexts of N hits: everything that is visible before a stroke is chosen.

    They depend on nothing after the hit: neither on the stroke, its outcome and its landing, nor on later rows. The landing of a
    returned stroke is the receiver's contact point, so that of the incoming stroke is known at the hit.

    Attributes:
        codes: ``[N, 18]`` codes, columns as in :data:`CODES`.
        numbers: ``[N, F]`` positions in the striker's frame [m], distances [m], times [s], speeds [m/s], and the phase of the
            rally; NaN where unknown.
        striker, receiver: ``[N]`` identifiers of the players.
    """

    codes: I16
    numbers: F32
    striker: npt.NDArray[np.str_]
    receiver: npt.NDArray[np.str_]

    def __len__(self) -> int:
        return len(self.codes)

    def without_height(self) -> "HitContexts":
        """The contexts with the contact height hidden."""
        codes = self.codes.copy()
        codes[:, list(CODES).index("height")] = UNSEEN_HEIGHT
        return dataclasses.replace(self, codes=codes)


def hit_contexts(strokes: pa.Table) -> HitContexts:
    """Context of every stroke of a cleaned table, in its order (schema: :mod:`shuttle_marl.data.schema`)."""
    before, number = _rows_before(strokes)
    codes = {
        "height": strokes["height"].to_numpy(zero_copy_only=False).astype(np.int16),
        "discipline": (strokes["discipline"].to_numpy(zero_copy_only=False) == "WS").astype(np.int16),
    }
    for name, size in _BEFORE.items():
        values = strokes[name].fill_null(-1).to_numpy().astype(np.int64)
        for lag in range(1, HISTORY + 1):
            known = (before[lag] >= 0) & (values[before[lag]] >= 0)
            code = np.where(known, values[before[lag]], np.where(number <= lag, size, size + 1))
            codes[f"{name}_{lag}"] = code.astype(np.int16)
    return HitContexts(
        codes=np.stack([codes[name] for name in CODES], axis=1),
        numbers=_numbers(strokes, before, number).astype(np.float32),
        striker=strokes["player"].to_numpy(zero_copy_only=False).astype(str),
        receiver=strokes["opponent"].to_numpy(zero_copy_only=False).astype(str),
    )


def cuts_of(numbers: F32, steps: int) -> F32:
    """``[F, steps - 1]`` quantiles of numbers ``[N, F]``, NaN ignored: the cuts between the steps of a scale."""
    shares = np.linspace(0, 1, steps + 1)[1:-1]
    known = [column[np.isfinite(column)].astype(np.float64) for column in numbers.T]
    return np.array([np.quantile(column if len(column) else np.zeros(1), shares) for column in known], dtype=np.float32)


def steps_of(numbers: F32, cuts: F32) -> I64:
    """``[N, F]`` step of each number ``[N, F]`` on its scale; NaN has a step of its own after the last."""
    steps = np.stack([np.searchsorted(cut, column) for cut, column in zip(cuts, numbers.T, strict=True)], axis=1)
    steps[np.isnan(numbers)] = cuts.shape[1] + 1
    return steps


def _rows_before(strokes: pa.Table) -> tuple[I64, I64]:
    """``[5, N]`` row of the stroke k = 0 … 4 before each in its rally, -1 without one; ``[N]`` number in the rally."""
    match = strokes["match"].combine_chunks().dictionary_encode().indices.to_numpy(zero_copy_only=False)
    rally = np.stack([match, *(strokes[name].to_numpy(zero_copy_only=False).astype(np.int64) for name in ("game", "rally"))])
    number = strokes["stroke"].to_numpy(zero_copy_only=False).astype(np.int64)
    rows = np.arange(len(number))
    before = np.full((HISTORY + 1, len(rows)), -1)
    before[0] = rows
    for back in range(1, HISTORY + 1):
        earlier = np.maximum(rows - back, 0)
        lag = number - number[earlier]
        # Dropped rows leave gaps, so the stroke `lag` before stands at most `lag` rows before.
        same_rally = (rows >= back) & (rally[:, earlier] == rally).all(axis=0) & (lag >= back) & (lag <= HISTORY)
        before[lag[same_rally], rows[same_rally]] = earlier[same_rally]
    return before, number


def _numbers(strokes: pa.Table, before: I64, number: I64) -> F64:
    position = {
        name: np.stack([_column(strokes, f"{name}_x"), _column(strokes, f"{name}_y")], axis=1)
        for name in ("striker", "receiver", "contact")
    }
    # Striker and receiver change with every stroke, and with them the frame of the coordinates.
    own, other, shuttle = ([position[name]] for name in ("striker", "receiver", "contact"))
    for lag in range(1, HISTORY + 1):
        sign, mine, theirs = (1, "striker", "receiver") if lag % 2 == 0 else (-1, "receiver", "striker")
        for positions, name in ((own, mine), (other, theirs), (shuttle, "contact")):
            positions.append(sign * _at(position[name], before[lag]))
    frame, rate = _column(strokes, "frame"), _frame_rate(strokes)
    step = [(_at(frame, before[lag - 1]) - _at(frame, before[lag])) / rate for lag in range(1, HISTORY + 1)]
    step = [np.where((time > 0) & (time < MAX_SECONDS), time, np.nan)[:, None] for time in step]
    tempo = np.maximum(step[0], 0.1)
    moves = [own[0] - own[1], other[0] - other[1], shuttle[0] - shuttle[1]]
    reach = shuttle[0] - own[0]
    distances = [np.linalg.norm(vector, axis=1, keepdims=True) for vector in (*moves, reach)]
    phase = np.stack([np.log(number), np.minimum(number, 30) / 10, number % 2], axis=1)
    columns = [
        *own, *other, *shuttle, *step, *moves, reach, *distances, phase,
        own[1] - own[2], other[1] - other[2],
        *(vector / tempo for vector in moves), *(length / tempo for length in distances[:3]),
    ]  # fmt: skip
    return np.concatenate(columns, axis=1)


def _column(strokes: pa.Table, name: str) -> F64:
    return np.asarray(strokes[name].cast(pa.float64()).to_numpy(), dtype=np.float64)


def _at(values: F64, rows: I64) -> F64:
    """Values of rows, NaN for row -1."""
    exists = rows >= 0
    return np.where(exists.reshape(-1, *(1,) * (values.ndim - 1)), values[rows], np.nan)


def _frame_rate(strokes: pa.Table) -> F64:
    """``[N]`` frames per second of the video, from frame and clock of the same row."""
    frame, clock = _column(strokes, "frame"), _column(strokes, "clock")
    # The clock has whole seconds, too coarse early in a video.
    rate = np.where(clock > 100, frame / np.maximum(clock, 1), _USUAL_FRAME_RATE)
    return np.asarray(np.clip(np.round(rate), 20, 120))


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
