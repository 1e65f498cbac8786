"""Context of a hit: everything that is visible before a stroke is chosen, as codes and numbers.

It holds the positions of both players and of the shuttle, their movement since the previous strokes, the tempo, the four previous
strokes, and the players. It depends on nothing after the hit: neither on the stroke, its outcome and its landing, nor on later
rows. The landing of a returned stroke is the receiver's contact point, so that of the incoming stroke is known at the hit.
"""

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shuttle_marl.base.arrays import F32, F64, I16, I64
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


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class HitContexts:
    """Contexts of N hits.

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
