"""The columns of a sheet by the names of this package; every invalid value is recorded in the sheet."""

from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64, I64
from shuttle_marl.data import inference
from shuttle_marl.data.column_map import WORDS, ColumnMap, plain, whole
from shuttle_marl.data.schema import RANGES
from shuttle_marl.data.strict_csv import Sheet, shown
from shuttle_marl.data.words import Words
from shuttle_marl.game import court

_MAY_BE_EMPTY: Final = ("area", "ending", "height", "technique", "forced", "hand")
_MOST_HINTS: Final = 50
"""Unknown words of a column for which a similar one is looked up."""


class Columns:
    """Values of the n rows of a sheet.

    Attributes:
        strict: whether users can correct the file, so that gaps in it are problems.
        notes: sentences on what was inferred.
    """

    def __init__(self, sheet: Sheet, mapped: ColumnMap, *, strict: bool) -> None:
        self.sheet, self.map, self.strict, self.notes = sheet, mapped, strict, list[str]()

    def __len__(self) -> int:
        return len(self.sheet)

    def __contains__(self, name: str) -> bool:
        return name in self.map.columns

    def header(self, name: str) -> str:
        """The header of a column."""
        return self.map.columns[name]

    def text(self, name: str) -> tuple[str, ...]:
        """``[n]`` values as they stand there."""
        return self.sheet.text(self.header(name))

    def numbers(self, name: str) -> F64:
        """``[n]`` numbers, NaN where there is none."""
        return self.sheet.numbers(self.header(name)) if name in self else np.full(len(self), np.nan)

    def integers(self, name: str, without: int) -> I64:
        """``[n]`` numbers of games, rallies or strokes; ``without`` if the column is not mapped."""
        if name not in self:
            return np.full(len(self), without)
        low, high = RANGES[name]
        return self.sheet.integers(self.header(name), low, high, missing=without)

    def whole(self, name: str, field: str) -> F64:
        """``[n]`` whole numbers for a field of the schema, NaN where there is none."""
        values = self.numbers(name)
        low, high = RANGES[field]
        # Times may have fractions, which the table does not keep.
        fine = (values >= low) & (values <= high) & ((name == "seconds") | (values == np.floor(values)))
        for row in np.flatnonzero(~fine & ~np.isnan(values)):
            self.sheet.mark(row, f"{self.header(name)} {values[row]:g}; expected a whole number from {low} to {high}")
        return np.where(fine, np.floor(values), np.nan)

    def probabilities(self, name: str) -> F64:
        """``[n]`` probabilities, NaN where there is none."""
        values = self.numbers(name)
        for row in np.flatnonzero((values < 0) | (values > 1)):
            self.sheet.mark(row, f"{self.header(name)} {values[row]:g}; expected 0 to 1")
        return values

    def codes(self, name: str, missing: int) -> I64:
        """``[n]`` codes of the words of a column; ``missing`` for empty values, and for all if the column is not mapped."""
        if name not in self:
            return np.full(len(self), missing)
        column, words = self.header(name), WORDS[name]
        own, texts = self.map.values.get(name, {}), set(self.text(name))
        vocabulary = Words(name, texts, self.sheet.header)
        codes: dict[str, int] = {}
        for text in texts:
            meant = own.get(plain(text)) or vocabulary.meaning(whole(text))
            if meant is not None:
                codes[text] = words.index(meant)
            elif not text.strip() and name in _MAY_BE_EMPTY:
                codes[text] = missing
        self.notes += [told for text in sorted(texts) if plain(text) not in own and (told := vocabulary.ambiguous(text))]
        unknown = sorted(texts - codes.keys())
        hints = {text: vocabulary.meant(text, own) for text in unknown[:_MOST_HINTS]}
        for row, text in enumerate(self.text(name)) if unknown else ():
            if text not in codes:
                meant = hints.get(text)
                hint = f"did you mean {meant}?" if meant else f"map it in [values.{name}] to one of {', '.join(words)}"
                self.sheet.mark(row, f"unknown {column} {shown(text)}; {hint}")
        return np.array([codes.get(text, missing) for text in self.text(name)], dtype=np.int64)

    def points(self) -> dict[str, F64]:
        """``[n, 2]`` points in the striker's frame, NaN missing."""
        sign = np.ones(len(self))
        if self.map.coordinates == "court":
            sign = np.where(self.codes("side", 0) == 1, -1.0, 1.0)
        points = {}
        for name in inference.POINTS:
            points[name] = np.stack([self.numbers(f"{name}_{axis}") for axis in "xy"], axis=1) * sign[:, None]
            inference.check_scale(self.sheet, name, points[name])
        return points

    def areas(self, landing: F64) -> I64:
        """``[n]`` areas of the landing points, or of the column where there is none."""
        computed = court.area_of(*landing.astype(np.float32).T).astype(np.int64)
        if "area" not in self:
            return computed
        named = self.codes("area", -1)
        if self.map.areas_seen_by == "striker":
            named = np.where(named < 0, -1, named + 2 - 2 * (named % 3))
        differ = np.flatnonzero((computed >= 0) & (named >= 0) & (computed != named))
        self.sheet.warn(differ, f"{self.header('area')} is not the area of the landing point, which is used")
        return np.where(computed >= 0, computed, named)
