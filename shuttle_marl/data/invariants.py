"""What must hold in every stroke table, whoever made it."""

import dataclasses
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from shuttle_marl.data.schema import (
    DISCIPLINES,
    FAULT,
    OUTCOMES,
    REACH_OVER,
    REASONS,
    RETURNED,
    SOURCES,
    UNKNOWN,
    WINNER,
)
from shuttle_marl.data.shuttleset import FAR_OFF
from shuttle_marl.game import court
from shuttle_marl.game.stroke import HEIGHTS, N_SERVES, SHOTS, TECHNIQUES

Bools = npt.NDArray[np.bool_]

RANGES: Final = {
    "game": (1, 9),
    "rally": (1, 9999),
    "stroke": (1, 9999),
    "shot": (0, len(SHOTS) - 1),
    "height": (0, len(HEIGHTS) - 1),
    "technique": (0, len(TECHNIQUES) - 1),
    "area": (0, court.N_AREAS - 1),
    "label_area": (0, court.N_AREAS - 1),
    "outcome": (0, len(OUTCOMES) - 1),
    "reason": (0, len(REASONS) - 1),
    "points": (0, 30),
    "points_opponent": (0, 30),
    "clock": (0, 100_000),
    "frame": (0, 10_000_000),
}
"""Least and greatest value of the whole numbers."""

_FAULT_REASONS: Final = [REASONS.index(name) for name in ("out", "net", "short", "foul", "unknown")]
_WINNER_REASONS: Final = [REASONS.index(name) for name in ("landed", "misjudged", "unknown")]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Violation:
    """A rule that does not hold.

    Attributes:
        rule: the rule in words.
        rows: indices of the rows that break it, at least one.
        example: the first such row: where it stands, and the values that the rule is about.
    """

    rule: str
    rows: npt.NDArray[np.int64]
    example: str

    def __str__(self) -> str:
        return f"{self.rule}: {len(self.rows)} rows break it, first {self.example}"


def violations(strokes: pa.Table) -> Iterator[Violation]:
    """Yield every rule of a stroke table that does not hold; the table must have the schema of strokes."""
    table = _Columns(strokes)
    for rule, columns, bad in _rules(table):
        rows = np.flatnonzero(bad)
        if len(rows):
            yield Violation(rule=rule, rows=rows, example=table.describe(int(rows[0]), columns))


class _Columns:
    """Columns of a table as numpy arrays; numbers that are missing are NaN."""

    def __init__(self, strokes: pa.Table) -> None:
        self._strokes = strokes
        self._arrays: dict[str, npt.NDArray[Any]] = {}

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        if name not in self._arrays:
            column = self._strokes[name]
            if pa.types.is_string(column.type):
                encoded = column.combine_chunks().dictionary_encode()
                self._arrays[name] = encoded.indices.to_numpy(zero_copy_only=False)
            elif pa.types.is_floating(column.type):
                self._arrays[name] = column.to_numpy()
            else:
                self._arrays[name] = column.cast(pa.float64()).to_numpy()
        return self._arrays[name]

    def one_of(self, name: str, words: tuple[str, ...]) -> Bools:
        column = self._strokes[name].combine_chunks()
        return np.asarray(pc.is_in(column, value_set=pa.array(words)).to_numpy(zero_copy_only=False))

    def describe(self, row: int, columns: tuple[str, ...]) -> str:
        place = ("match", "game", "rally", "stroke")
        values = self._strokes.select(list(dict.fromkeys((*place, *columns)))).slice(row, 1).to_pylist()[0]
        where = f"{values['match']}, game {values['game']}, rally {values['rally']}, stroke {values['stroke']}"
        about = ", ".join(f"{name} {values[name]!r}" for name in columns if name not in place)
        return f"row {row} ({where})" + (f": {about}" if about else "")


def _rules(t: _Columns) -> Iterator[tuple[str, tuple[str, ...], Bools]]:
    """Yield (rule, columns it is about, rows that break it)."""
    yield f"source is one of {', '.join(SOURCES)}", ("source",), ~t.one_of("source", SOURCES)
    yield f"discipline is one of {', '.join(DISCIPLINES)}", ("discipline",), ~t.one_of("discipline", DISCIPLINES)
    for name, (low, high) in RANGES.items():
        yield f"{name} lies between {low} and {high}", (name,), (t[name] < low) | (t[name] > high)
    yield from _order(t)
    yield from _endings(t)
    yield from _points(t)


def _order(t: _Columns) -> Iterator[tuple[str, tuple[str, ...], Bools]]:
    match, game, rally, stroke = (t[name] for name in ("match", "game", "rally", "stroke"))
    if not len(match):
        return

    def beside(column: npt.NDArray[Any]) -> Bools:
        return np.r_[False, column[1:] == column[:-1]]

    def falls(column: npt.NDArray[Any]) -> Bools:
        return np.r_[False, column[1:] < column[:-1]]

    same_match = beside(match)
    same_game = same_match & beside(game)
    same_rally = same_game & beside(rally)
    starts = np.flatnonzero(~same_match)
    seen_before = np.ones(len(starts), dtype=bool)
    seen_before[np.unique(match[starts], return_index=True)[1]] = False
    again = np.zeros(len(match), dtype=bool)
    again[starts[seen_before]] = True
    yield "the rows of a match stand together", ("match",), again
    yield "games of a match are in order", ("game",), same_match & falls(game)
    yield "rallies of a game are in order", ("rally",), same_game & falls(rally)
    yield "strokes of a rally rise", ("stroke",), same_rally & np.r_[False, stroke[1:] <= stroke[:-1]]
    for name in ("clock", "frame"):
        known = ~np.isnan(t[name])
        rows = np.flatnonzero(known)
        together = np.cumsum(~same_rally)[rows]
        back = np.diff(t[name][rows]) < (1 if name == "frame" else 0)
        bad = np.zeros(len(match), dtype=bool)
        bad[rows[1:][(np.diff(together) == 0) & back]] = True
        yield f"{name} {'rises' if name == 'frame' else 'never falls'} in a rally", (name,), bad
    player, opponent = _shared_codes(t)
    yield "player and opponent differ", ("player", "opponent"), player == opponent
    pair_low, pair_high = np.minimum(player, opponent), np.maximum(player, opponent)
    yield "a match has two players", ("player", "opponent"), same_match & ~(beside(pair_low) & beside(pair_high))
    # With an even gap between two strokes the striker is the same, with an odd one the other player.
    even = np.r_[False, np.diff(stroke) % 2 == 0]
    yield "players alternate in a rally", ("player",), same_rally & (beside(player) != even)
    a_points = np.where(player == pair_low, t["points"], t["points_opponent"])
    b_points = np.where(player == pair_low, t["points_opponent"], t["points"])
    changes = same_rally & ~(beside(np.nan_to_num(a_points, nan=-1)) & beside(np.nan_to_num(b_points, nan=-1)))
    yield "the score is the same in all rows of a rally", ("points", "points_opponent"), changes
    for name in ("source", "discipline"):
        yield f"{name} is the same in all rows of a match", (name,), same_match & ~beside(t[name])


def _shared_codes(t: _Columns) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Players and opponents as numbers with one meaning."""
    both = pa.concat_arrays([t._strokes[name].combine_chunks() for name in ("player", "opponent")])
    codes = both.dictionary_encode().indices.to_numpy(zero_copy_only=False)
    return codes[: len(codes) // 2], codes[len(codes) // 2 :]


def _endings(t: _Columns) -> Iterator[tuple[str, tuple[str, ...], Bools]]:
    outcome, reason, first = t["outcome"], t["reason"], t["stroke"] == 1
    same = np.r_[(np.diff(t["match"]) == 0) & (np.diff(t["game"]) == 0) & (np.diff(t["rally"]) == 0), False][: len(first)]
    yield "only the last stroke of a rally ends it", ("outcome",), same & (outcome != RETURNED)
    both = ("outcome", "reason")
    returned = reason == REASONS.index("returned")
    yield "a returned stroke, and no other, has the reason returned", both, (outcome == RETURNED) != returned
    yield "a fault is out, net, short, foul or unknown", both, (outcome == FAULT) & ~np.isin(reason, _FAULT_REASONS)
    yield "a winner landed, was misjudged or is unknown", both, (outcome == WINNER) & ~np.isin(reason, _WINNER_REASONS)
    unknown = reason == REASONS.index("unknown")
    yield "an unknown outcome has no reason", both, (outcome == UNKNOWN) & ~unknown
    serve = t["shot"] < N_SERVES
    yield "the first stroke of a rally, and no other, is a serve", ("shot",), serve != first
    yield "serves are struck below the net", ("shot", "height"), serve & (t["height"] != 0)


def _points(t: _Columns) -> Iterator[tuple[str, tuple[str, ...], Bools]]:
    for name in ("landing", "contact", "striker", "receiver"):
        x, y = t[f"{name}_x"], t[f"{name}_y"]
        columns = (f"{name}_x", f"{name}_y")
        yield f"{name}: both coordinates or none", columns, np.isnan(x) != np.isnan(y)
        far = (np.abs(x) > court.WIDTH / 2 + FAR_OFF) | (np.abs(y) > court.HALF_LENGTH + FAR_OFF) | np.isinf(x) | np.isinf(y)
        yield f"{name} lies on or near the court", columns, far
    yield "the striker stands in the own half (striker_y <= 0)", ("striker_y",), t["striker_y"] > 0
    yield "the receiver stands in the other half (receiver_y >= 0)", ("receiver_y",), t["receiver_y"] < 0
    yield f"the contact lies at most {REACH_OVER} m beyond the net", ("contact_y",), t["contact_y"] > REACH_OVER
    serve = t["shot"] < N_SERVES
    yield "serves have no contact point", ("contact_x", "contact_y"), serve & ~np.isnan(t["contact_y"])
    lands = t["landing_y"]
    over = t["outcome"] != FAULT
    yield (
        f"only faults land over {REACH_OVER} m in the striker's half",
        ("landing_y", "outcome"),
        over & (lands < -REACH_OVER),
    )
    yield "only faults have no landing", ("landing_y", "outcome"), over & np.isnan(lands)
    # In the precision of the file: a point on a line must fall on the same side of it.
    x, y = t["landing_x"].astype(np.float32), lands.astype(np.float32)
    area = np.where(np.isnan(t["area"]), -1, t["area"])
    yield "area is the area of the landing", ("area", "landing_x", "landing_y"), area != court.area_of(x, y)
    inside = np.where(np.isnan(t["in_court"]), np.isnan(lands), t["in_court"] == court.in_court(x, y))
    yield "in_court tells whether the landing lies in court", ("in_court", "landing_x", "landing_y"), ~inside.astype(bool)
