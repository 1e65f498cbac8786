"""Annotated strokes as rallies, and the state of the game before each stroke."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import pyarrow as pa
import tyro
from rich.console import Console

from docs.tools.results import show
from shuttle_marl.base.arrays import F64, I64, Bools, Ints
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.runs import describe
from shuttle_marl.data import Split, matches_of
from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.features import Hurry, Rows, rows_from_strokes
from shuttle_marl.game.tables import Game
from shuttle_marl.reports import value
from shuttle_marl.reports.value import strokes_before

RESAMPLES: Final = 2000  # bootstrap resamples of matches behind every interval


@dataclasses.dataclass(frozen=True, kw_only=True)
class Comparison:
    """Options of a comparison with matches that no fit used."""

    data: Path
    """Folder of the download, or a Parquet file of `data convert`."""
    split: Split | None = None
    """Matches to compare with the game, which was fitted to the training matches."""
    cross: int | None = None
    """Instead of one split, fit so many models, each without one part of the training and validation matches, and compare every
    match with the model that was fitted without it."""
    game: str = "default"
    """With --split, the shipped model or model folder to compare."""
    seed: int = 0
    """Random seed of parts, fits and draws."""
    fits: Path = Path("runs/fits")
    """Cache folder of fitted models."""
    out: Path | None = None
    """JSON file for the result, with its provenance."""
    as_json: Annotated[bool, tyro.conf.arg(name="json")] = False
    """Print JSON."""

    def __post_init__(self) -> None:
        if (self.split is None) == (self.cross is None):
            raise ShuttleError("expected either --split NAME or --cross NUMBER")
        if self.cross is not None and self.cross < 2:
            raise ShuttleError(f"--cross {self.cross}: expected 2 or more parts")

    def show(self, result: dict[str, Any], *tables: str) -> None:
        """Print a result as tables, or as JSON."""
        about = {**describe(("numpy", "torch")), "split": self.split, "cross": self.cross}
        show({**about, **result}, *tables, as_json=self.as_json, out=self.out)


def report(line: str) -> None:
    """Print a line before a stage of a fit."""
    Console(stderr=True, highlight=False).print(line, markup=False)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Strokes:
    """N annotated strokes in R rallies, in playing order."""

    rows: Rows  # the strokes in context
    rally: I64  # [N] index of the rally
    number: I64  # [N] number of the stroke in its rally, from 1
    last: I64  # [N] row of the last stroke of the rally
    result: I64  # [N] +1 where the striker went on to win the rally, -1 where they lost it, 0 where that is not known

    def __len__(self) -> int:
        return len(self.rally)

    @property
    def matches(self) -> list[str]:
        """Names of the matches that strokes were played in."""
        return [self.rows.matches[i] for i in np.unique(self.rows.match)]

    def in_matches(self, names: Sequence[str]) -> Bools:
        """``[N]`` whether a stroke was played in one of the matches."""
        wanted = np.isin(np.array(self.rows.matches), np.array(list(names)))
        return np.asarray(wanted[self.rows.match])

    def marked(self, hurry: Hurry | None) -> "Strokes":
        """The strokes with whether their strikers were hurried, by the index of a model, if it has one."""
        return self if hurry is None else dataclasses.replace(self, rows=hurry.marked(self.rows))

    def take(self, which: Bools) -> "Strokes":
        """The strokes of whole matches, or the ends of their rallies."""
        rally = np.unique(self.rally[which], return_inverse=True)[1]
        row = np.cumsum(which) - 1
        return Strokes(
            rows=self.rows.take(which),
            rally=rally,
            number=self.number[which],
            last=row[self.last[which]],
            result=self.result[which],
        )

    @classmethod
    def joined(cls, parts: Sequence["Strokes"]) -> "Strokes":
        """Strokes of several lists of matches, no match in two of them, as one list."""
        starts = np.cumsum([0, *(len(part) for part in parts)])
        rallies = np.cumsum([0, *(int(part.rally[-1]) + 1 for part in parts)])
        return cls(
            rows=Rows.joined([part.rows for part in parts]),
            rally=np.concatenate([part.rally + first for part, first in zip(parts, rallies, strict=False)]),
            number=np.concatenate([part.number for part in parts]),
            last=np.concatenate([part.last + first for part, first in zip(parts, starts, strict=False)]),
            result=np.concatenate([part.result for part in parts]),
        )


def strokes_of(table: pa.Table) -> Strokes:
    """Strokes of a cleaned table (:data:`shuttle_marl.data.schema.STROKES`)."""
    rows = rows_from_strokes(table)
    key = np.stack([rows.match, *(table[name].to_numpy(zero_copy_only=False) for name in ("game", "rally"))])
    begins = np.r_[True, (np.diff(key, axis=1) != 0).any(axis=0)]
    rally = np.cumsum(begins) - 1
    last = np.flatnonzero(np.r_[begins[1:], True])[rally]
    number = rows.stroke.astype(np.int64)
    ending = np.where(rows.outcome == Outcome.WINNER, 1, np.where(rows.outcome == Outcome.FAULT, -1, 0))
    same_striker = (number[last] - number) % 2 == 0
    return Strokes(rows=rows, rally=rally, number=number, last=last, result=np.where(same_striker, 1, -1) * ending[last])


def of_splits(strokes: Strokes, *splits: Split) -> Strokes:
    """The strokes of some splits.

    Raises:
        ShuttleError: the data has none of one of them.
    """
    which = [strokes.in_matches(matches_of(split)) for split in splits]
    for split, found in zip(splits, which, strict=True):
        if not found.any():
            raise ShuttleError(f"no match of the split {split!r} in the data; is the download complete?")
    return strokes.take(np.logical_or.reduce(which))


def states_of(game: Game, rows: Rows) -> I64:
    """``[N]`` state in which each stroke was struck, -1 where the game has no such state or what decides it is not known."""
    before = (strokes_before(rows, name, game.catalogue.by_parts, game.n_strokes) for name in ("own", "incoming"))
    state = value.states_of(game, rows, *before)
    return np.where((state >= 0) & (game.legal_count(np.maximum(state, 0)) > 0), state, -1)


def ratio_by_match(top: F64, bottom: F64, match: Ints, seed: int = 0) -> dict[str, float]:
    """A ratio of two sums over strokes, with a 95 % interval by a bootstrap over matches.

    Args:
        top, bottom: ``[N]`` what each stroke adds to the numerator and to the denominator.
        match: ``[N]`` match of each stroke.
        seed: of the resamples.
    """
    names, index = np.unique(match, return_inverse=True)
    sums = np.stack([np.bincount(index, weights, len(names)) for weights in (top, bottom)])
    drawn = np.random.default_rng(seed).integers(0, len(names), (RESAMPLES, len(names)))
    a, b = sums[:, drawn].sum(axis=2)
    low, high = np.quantile(a[b > 0] / b[b > 0], [0.025, 0.975])
    return {"value": float(top.sum() / bottom.sum()), "low": float(low), "high": float(high)}


def folds_of(strokes: Strokes, count: int, seed: int) -> I64:
    """``[N]`` fold of each stroke's match, dealt at random and as evenly as can be within each discipline."""
    rows = strokes.rows
    present, first = np.unique(rows.match, return_index=True)
    women = rows.codes["discipline"][first] == 1
    fold = np.zeros(int(present[-1]) + 1, dtype=np.int64)
    rng = np.random.default_rng(seed)
    for kind in (False, True):
        members = rng.permutation(present[women == kind])
        fold[members] = np.arange(len(members)) % count
    return fold[rows.match]
