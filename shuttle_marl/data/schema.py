"""Schema of annotated strokes, rules that every stroke table satisfies, and problems of files.

One row is one stroke that passed cleaning. Coordinates are egocentric metres (see :mod:`shuttle_marl.game.court`): origin
on the floor under the middle of the net, ``y`` from the striker towards the opponent, ``x`` to the striker's right.
"""

import dataclasses
import enum
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final, Literal

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from shuttle_marl.base.arrays import I64, Array, Bools, Floats
from shuttle_marl.base.errors import ShuttleError, command, printable
from shuttle_marl.base.extras import hinted
from shuttle_marl.base.files import Fraction, StoredCount
from shuttle_marl.game import court
from shuttle_marl.game.stroke import HEIGHTS, N_SERVES, SHOTS, TECHNIQUES


class Outcome(enum.IntEnum):
    """Outcome of an annotated stroke, codes of the column ``outcome``; others than :data:`shuttle_marl.game.rules.OUTCOMES`."""

    RETURNED = 0  # the opponent struck it
    FAULT = 1  # the striker lost the rally
    WINNER = 2  # the striker won the rally
    UNKNOWN = 3  # not recorded


OUTCOMES: Final = tuple(outcome.name.lower() for outcome in Outcome)

REASONS: Final = ("returned", "out", "net", "short", "foul", "landed", "misjudged", "unknown", "stopped")
"""Reasons of an outcome: out of court, into the net, short of the net, a foul; landed in court, left by a misjudging opponent; of
an unknown one, that the match was stopped: nobody won the rally."""

DISCIPLINES: Final = ("MS", "WS")  # men's singles, women's singles

REACH_OVER: Final = 0.5  # largest distance of a contact point beyond the net [m]: players may reach over it, marks are imprecise
FAR_OFF: Final = 5.0  # a point more than this far outside the lines [m] cannot be real: the file or its homography is broken

_FIELDS: Final[tuple[tuple[str, pa.DataType, bool, str], ...]] = (
    ("match", pa.string(), False, "Name of the match, the folder name of the data set."),
    ("source", pa.string(), False, "Data set: ShuttleSet, ShuttleSet22, simulated, or one's own."),
    ("discipline", pa.string(), False, "MS (men's singles) or WS (women's singles)."),
    ("game", pa.int8(), False, "Game within the match, from 1."),
    ("rally", pa.int16(), False, "Rally within the game, as numbered by the annotators."),
    ("stroke", pa.int16(), False, "Stroke within the rally, the serve is 1. Dropped strokes leave a gap."),
    ("player", pa.string(), False, "The striker's identifier, e.g. viktor-axelsen."),
    ("opponent", pa.string(), False, "The receiver's identifier."),
    ("hand", pa.int8(), True, "Hand of the striker, of shuttle_marl.game.court.HANDS; null: unknown. "
     "Where nobody gave it, the side on which the player strikes around the head tells it."),
    ("shot", pa.int8(), False, "Shot type, of shuttle_marl.game.stroke.SHOTS."),
    ("height", pa.int8(), False, "Contact height: below or above the net."),
    ("technique", pa.int8(), False, "Forehand, backhand, or around the head."),
    ("hurried", pa.bool_(), True, "Whether the striker was hurried; null: not known, the index of the model decides. Files "
     "without this column have no known ones."),
    ("area", pa.int8(), True, "Area of the landing point recomputed from it (nearest area if outside the court), of "
     "shuttle_marl.game.court.AREAS. Of a returned stroke the landing is where the receiver met the shuttle. Of a "
     "fault it is where the shuttle came down, NOT the target. Null if no landing was recorded or inferred."),
    ("in_court", pa.bool_(), True, "Whether the landing point lies in the opponent's singles court."),
    ("landing_x", pa.float32(), True, "Landing point [m]."),
    ("landing_y", pa.float32(), True, "Landing point [m], positive beyond the net."),
    ("contact_x", pa.float32(), True, "Where the striker met the shuttle [m]; null for serves."),
    ("contact_y", pa.float32(), True, "Where the striker met the shuttle [m], negative."),
    ("striker_x", pa.float32(), True, "Position of the striker at contact [m]."),
    ("striker_y", pa.float32(), True, "Position of the striker at contact [m], negative."),
    ("receiver_x", pa.float32(), True, "Position of the receiver at contact [m]."),
    ("receiver_y", pa.float32(), True, "Position of the receiver at contact [m], positive."),
    ("clock", pa.int32(), True, "Time in the video [s], never falling in a rally; null where it does not fit."),
    ("frame", pa.int32(), True, "Frame in the video, rising in a rally; null where it does not fit."),
    ("outcome", pa.int8(), False, "Outcome, of OUTCOMES."),
    ("reason", pa.int8(), False, "Reason of the outcome, of REASONS."),
    ("points", pa.int8(), True, "Points of the striker in this game AFTER the rally."),
    ("points_opponent", pa.int8(), True, "Points of the receiver in this game AFTER the rally."),
    ("label_area", pa.int8(), True, "The annotators' area label of the landing, corrected for the mirrored matches; "
     "of the same areas, null where they put it outside the court, and in simulated tables."),
    ("forced", pa.bool_(), True, "Whether the opponent forced the fault; null: not recorded, or no fault."),
    ("confidence", pa.float32(), True, "Probability that the row is right: that of the program that recognised the stroke, times "
     "the share of the inferred area; null: written by a person."),
    ("inferred", pa.string(), True, "Values that the file did not contain and that were inferred: names of columns, separated by "
     "spaces; null: none."),
    ("rules", pa.string(), True, "Rules of the match, of shuttle_marl.game.scoring.RULES, such as 21, 15, or 11x3 (best of three "
     "to 11); null: not known, the scores tell."),
)  # fmt: skip

STROKES: Final = pa.schema(  # Arrow schema of a stroke table in memory; files and `named` have names for the codes of `NAMES`
    [pa.field(name, kind, nullable, metadata={"description": text}) for name, kind, nullable, text in _FIELDS],
    metadata={"schema": "shuttle_marl.strokes", "version": "2"},
)

OPTIONAL: Final = ("hand", "hurried", "forced", "confidence", "inferred", "rules")  # columns that files may lack

NAMES: Final = {
    "hand": court.HANDS,
    "shot": SHOTS,
    "height": HEIGHTS,
    "technique": TECHNIQUES,
    "area": court.AREAS,
    "label_area": court.AREAS,
    "outcome": OUTCOMES,
    "reason": REASONS,
}


def named(strokes: pa.Table) -> pa.Table:
    """A stroke table with names instead of codes: the columns of :data:`NAMES` become dictionaries of text. pandas reads them as
    categories, polars and DuckDB as text."""
    for name, names in NAMES.items():
        strokes = changed(strokes, name, pa.DictionaryArray.from_arrays(strokes[name].combine_chunks(), pa.array(names)))
    return strokes


def changed(table: pa.Table, name: str, values: pa.Array) -> pa.Table:
    """The table with other values in a column."""
    at = table.schema.get_field_index(name)
    return table.set_column(at, table.schema.field(at).with_type(values.type), values)


def to_df(table: pa.Table, library: Literal["pandas", "polars"] = "pandas") -> Any:
    """A data frame of a table: of strokes with names instead of codes, of a rally log as it is. Raises ModuleNotFoundError: the
    library is not installed."""
    if set(NAMES) <= set(table.column_names):
        table = named(table)
    with hinted():
        if library == "pandas":
            return table.to_pandas()
        import polars  # noqa: PLC0415  an extra
    return polars.from_arrow(table)


def unnamed(name: str, column: pa.ChunkedArray) -> pa.ChunkedArray:
    """Codes of a column of :data:`NAMES`, from names or codes."""
    kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
    if not (pa.types.is_string(kind) or pa.types.is_large_string(kind)):
        return column.cast(STROKES.field(name).type)
    text = column.cast(pa.string())
    codes = pc.index_in(text, value_set=pa.array(NAMES[name])).cast(STROKES.field(name).type)
    if unknown := pc.unique(text.filter(pc.and_(pc.is_null(codes), pc.is_valid(text)))).to_pylist():
        raise pa.ArrowInvalid(f"{printable(unknown[0])!r:.60}; expected {', '.join(NAMES[name])}")
    return codes


RANGES: Final = {name: (0, len(names) - 1) for name, names in NAMES.items()} | {  # minimum and maximum of integer columns
    "game": (1, 9),
    "rally": (1, 9999),
    "stroke": (1, 9999),
    "points": (0, 30),
    "points_opponent": (0, 30),
    "clock": (0, 100_000),
    "frame": (0, 10_000_000),
}

_FAULT_REASONS: Final = [REASONS.index(name) for name in ("out", "net", "short", "foul", "unknown")]
_WINNER_REASONS: Final = [REASONS.index(name) for name in ("landed", "misjudged", "unknown")]


def rally_starts(strokes: pa.Table) -> I64:
    """``[R + 1]`` first row of each of the R rallies of a table, and the number of its rows."""
    numbers = [strokes[name].combine_chunks().dictionary_encode().indices.to_numpy() for name in ("match", "game", "rally")]
    return np.unique(np.r_[0, 1 + np.flatnonzero(np.any(np.diff(numbers, axis=1) != 0, axis=0)), len(strokes)])


def rally_numbers(strokes: pa.Table) -> I64:
    """``[N]`` index of the rally of each stroke."""
    sizes = np.diff(rally_starts(strokes))
    return np.repeat(np.arange(len(sizes)), sizes)


def stroke_table(columns: Mapping[str, Any], points: Mapping[str, Floats]) -> pa.Table:
    """The table of n strokes; ``columns``: ``[n]`` values by column; null where they are NaN or masked, and in columns that are
    not there; ``points``: ``[n, 2]`` coordinates, ``NAME`` of the columns ``NAME_x`` and ``NAME_y``."""
    columns = {**columns, **{f"{name}_{axis}": xy[:, i] for name, xy in points.items() for i, axis in enumerate("xy")}}
    missing = pa.nulls(len(columns["match"]))
    given = [(columns.get(field.name, missing), field.type) for field in STROKES]
    arrays = [v.cast(kind) if isinstance(v, pa.Array) else pa.array(v, kind, from_pandas=True) for v, kind in given]
    return pa.table(arrays, schema=STROKES)


DROP_REASONS: Final = {  # reasons to drop a row, in the order in which they are tested
    "empty row": "No value at all.",
    "no stroke": "An entry of another kind in the file of another program, such as a rally or a pause.",
    "repeated row": "The same stroke of the same player stands there twice.",
    "unreadable value": "A value that cannot be what it should be, in a published file.",
    "broken homography": "More than a fifth of the rows of the game put both players in one half.",
    "contact heights unreliable": "Those of the whole game contradict each other, or the shot types.",
    "broken rally": "Strokes are not numbered 1, 2, …, players do not alternate, or the rally's number is taken; in files of "
    "other programs, any problem.",
    "unknown shot type": "Nearly always a serve that the camera missed; the rest of the rally is kept.",
    "serve type inside a rally": "A serve that is not the first stroke.",
    "first stroke is no serve": "A rally that starts with another shot type.",
    "contact height missing": "Above or below the net is not known.",
    "side of the court unknown": "No coordinate tells the striker's half, or they contradict the rest of the rally.",
    "landing missing": "No landing point, of a stroke that is no fault.",
    "landing on the striker's side": "A returned or winning stroke that seems to have landed in the striker's own half.",
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Account:
    """Counts of a stroke table, totals after deduplication of matches.

    Attributes:
        rallies, strokes: numbers before dropping.
        dropped: dropped rows by reason, keys of :data:`DROP_REASONS`; reasons without rows are omitted.
        area_agreement: fraction of the labels of kept strokes in court that equal the computed area; None without labels.
    """

    matches: StoredCount
    rallies: StoredCount
    rallies_kept: StoredCount
    strokes: StoredCount
    strokes_kept: StoredCount
    dropped: dict[str, StoredCount]
    area_agreement: Fraction | None

    @classmethod
    def of(cls, table: pa.Table, **before: Any) -> "Account":
        """Account of a table; ``before``: fields that are not the counts of the table, because rows were dropped."""
        rallies, n = table.group_by(["match", "game", "rally"]).aggregate([]).num_rows, table.num_rows
        counts = {"matches": len(table["match"].unique()), "rallies": rallies, "strokes": n}
        fields: dict[str, Any] = {**counts, "rallies_kept": rallies, "strokes_kept": n, "area_agreement": None, **before}
        fields["dropped"] = {reason: count for reason, count in fields.get("dropped", {}).items() if count}
        return cls(**fields)

    def as_json(self) -> dict[str, Any]:
        """The account as plain values."""
        both = {name: {"total": getattr(self, name), "kept": getattr(self, f"{name}_kept")} for name in ("rallies", "strokes")}
        return {"matches": self.matches, **both, "dropped": self.dropped, "area_agreement": self.area_agreement}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> "Account":
        """Inverse of :meth:`as_json`; a KeyError, TypeError or ValueError for invalid values."""
        both = {name: values[name]["total"] for name in ("rallies", "strokes")}
        kept = {f"{name}_kept": values[name]["kept"] for name in both}
        return msgspec.convert({**values, **both, **kept}, cls)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Cleaned:
    """Clean strokes in playing order, with their account.

    Attributes:
        strokes: table of schema :data:`STROKES`.
        warnings: what is strange and not wrong, with file and line.
        provenance: JSON object with sentences on what was ``inferred``, and what the files do not have (``lost``), and others.
    """

    strokes: pa.Table
    account: Account
    files: tuple[Path, ...]
    warnings: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Violation:
    """A broken rule, the rows that break it, and the first of them with the values concerned."""

    rule: str
    rows: I64
    example: str

    def __str__(self) -> str:
        return f"{self.rule}: {len(self.rows)} rows break it, first {self.example}"


def violations(strokes: pa.Table, *, of_order: bool = False) -> Iterator[Violation]:
    """Every broken rule of a table of schema :data:`STROKES`, or every one of the order of its rows."""
    for rule, columns, bad in _order(_numbers(strokes), len(strokes)) if of_order else _rules(strokes):
        rows = np.flatnonzero(bad)
        if len(rows):
            values = strokes.slice(int(rows[0]), 1).to_pylist()[0]
            where = f"{values['match']}, game {values['game']}, rally {values['rally']}, stroke {values['stroke']}"
            about = ", ".join(f"{name} {values[name]!r}" for name in columns if name not in _PLACE)
            yield Violation(rule=rule, rows=rows, example=f"row {rows[0]} ({where})" + (f": {about}" if about else ""))


_PLACE: Final = ("match", "game", "rally", "stroke")
_Rule = tuple[str, tuple[str, ...], Bools]  # a rule, the columns concerned, and the rows that break it


def _numbers(strokes: pa.Table) -> dict[str, Array]:
    """Columns as numbers, NaN where they are missing, and texts as codes; players and opponents have the same."""
    found = {}
    for name in strokes.column_names:
        column = strokes[name].combine_chunks()
        if pa.types.is_string(column.type):
            column = column.dictionary_encode().indices
        found[name] = (column if pa.types.is_floating(column.type) else column.cast(pa.float64())).to_numpy(zero_copy_only=False)
    both = pa.concat_arrays([strokes[name].combine_chunks() for name in ("player", "opponent")]).dictionary_encode().indices
    found["player"], found["opponent"] = both.to_numpy(zero_copy_only=False).reshape(2, -1)
    return found


def _rules(strokes: pa.Table) -> Iterator[_Rule]:
    t, n = _numbers(strokes), len(strokes)
    yield "source is named", ("source",), pc.equal(strokes["source"], "").to_numpy()
    known = pc.is_in(strokes["discipline"], value_set=pa.array(DISCIPLINES)).to_numpy()
    yield f"discipline is one of {', '.join(DISCIPLINES)}", ("discipline",), ~known
    for name, (low, high) in RANGES.items():
        yield f"{name} lies between {low} and {high}", (name,), (t[name] < low) | (t[name] > high)
    simulated = pc.equal(strokes["source"], "simulated").to_numpy()
    player = t["player"] + np.where(simulated, (1 + t["match"]) * 2.0**32, 0)  # of a simulated match alone
    yield "all known hands of a player are the same", ("player", "hand"), _differs(t["hand"], player)
    yield "all known rules of a match are the same", ("rules",), _differs(t["rules"], t["match"])
    yield from _order(t, n)
    yield from _endings(t, n)
    yield from _points(t)


def _differs(values: Array, owner: Array) -> Bools:
    """``[n]`` rows with another value than the first known one of their owner."""
    known = np.flatnonzero(~np.isnan(values))
    _, first, number = np.unique(owner[known], return_index=True, return_inverse=True)
    bad = np.zeros(len(values), dtype=bool)
    bad[known] = values[known] != values[known][first][number]
    return bad


def _order(t: Mapping[str, Array], n: int) -> Iterator[_Rule]:
    def beside(column: Array) -> Bools:
        """Rows with the value of the row before."""
        return np.r_[False, column[1:] == column[:-1]][:n]

    def falls(column: Array, by: int = 1) -> Bools:
        return np.r_[False, column[:-1] - column[1:] >= by][:n]

    match, stroke, player, opponent = (t[name] for name in ("match", "stroke", "player", "opponent"))
    same_match = beside(match)
    same_game = same_match & beside(t["game"])
    same_rally = same_game & beside(t["rally"])
    again = ~same_match
    again[np.unique(match, return_index=True)[1]] = False
    yield "the rows of a match stand together", ("match",), again
    yield "games of a match are in order", ("game",), same_match & falls(t["game"])
    yield "rallies of a game are in order", ("rally",), same_game & falls(t["rally"])
    yield "strokes of a rally rise", ("stroke",), same_rally & falls(stroke, 0)
    for name, rule, by in (("clock", "never falls", 1), ("frame", "rises", 0)):
        rows = np.flatnonzero(~np.isnan(t[name]))
        together = np.cumsum(~same_rally)[rows]
        bad = np.zeros(n, dtype=bool)
        bad[rows[1:][(np.diff(together) == 0) & (-np.diff(t[name][rows]) >= by)]] = True
        yield f"{name} {rule} in a rally", (name,), bad
    yield "player and opponent differ", ("player", "opponent"), player == opponent
    low, high = np.minimum(player, opponent), np.maximum(player, opponent)
    yield "a match has two players", ("player", "opponent"), same_match & ~(beside(low) & beside(high))
    # With an even gap between two strokes the striker is the same, with an odd one the other player.
    even = np.r_[False, np.diff(stroke) % 2 == 0][:n]
    yield "players alternate in a rally", ("player",), same_rally & (beside(player) != even)
    points = np.nan_to_num(np.stack([t["points"], t["points_opponent"]]), nan=-1)
    of_low, of_high = np.where(player == low, points, points[::-1])
    changes = same_rally & ~(beside(of_low) & beside(of_high))
    yield "the score is the same in all rows of a rally", ("points", "points_opponent"), changes
    for name in ("source", "discipline"):
        yield f"{name} is the same in all rows of a match", (name,), same_match & ~beside(t[name])


def _endings(t: Mapping[str, Array], n: int) -> Iterator[_Rule]:
    outcome, reason, first, serve = t["outcome"], t["reason"], t["stroke"] == 1, t["shot"] < N_SERVES
    same = np.r_[np.all([np.diff(t[name]) == 0 for name in ("match", "game", "rally")], axis=0), False][:n]
    fault, winner, unknown = outcome == Outcome.FAULT, outcome == Outcome.WINNER, reason == REASONS.index("unknown")
    both = ("outcome", "reason")
    yield "only the last stroke of a rally ends it", ("outcome",), same & (outcome != Outcome.RETURNED)
    returned = reason == REASONS.index("returned")
    yield "a returned stroke, and no other, has the reason returned", both, (outcome == Outcome.RETURNED) != returned
    yield "a fault is out, net, short, foul or unknown", both, fault & ~np.isin(reason, _FAULT_REASONS)
    yield "a winner landed, was misjudged or is unknown", both, winner & ~np.isin(reason, _WINNER_REASONS)
    unsaid = unknown | (reason == REASONS.index("stopped"))
    yield "an unknown outcome has no reason", both, (outcome == Outcome.UNKNOWN) & ~unsaid
    yield "the first stroke of a rally, and no other, is a serve", ("shot",), serve != first
    yield "serves are struck below the net", ("shot", "height"), serve & (t["height"] != 0)
    yield "no serve is hurried", ("shot", "hurried"), serve & (t["hurried"] == 1)
    yield "only faults are forced or unforced", ("forced", "outcome"), ~np.isnan(t["forced"]) & ~fault
    yield "confidence lies between 0 and 1", ("confidence",), (t["confidence"] < 0) | (t["confidence"] > 1)


def _points(t: Mapping[str, Array]) -> Iterator[_Rule]:
    for name in ("landing", "contact", "striker", "receiver"):
        columns = (f"{name}_x", f"{name}_y")
        x, y = (t[column] for column in columns)
        yield f"{name}: both coordinates or none", columns, np.isnan(x) != np.isnan(y)
        far = (np.abs(x) > court.WIDTH / 2 + FAR_OFF) | (np.abs(y) > court.HALF_LENGTH + FAR_OFF)
        yield f"{name} lies on or near the court", columns, far
    yield "the striker stands in the own half (striker_y <= 0)", ("striker_y",), t["striker_y"] > 0
    yield "the receiver stands in the other half (receiver_y >= 0)", ("receiver_y",), t["receiver_y"] < 0
    yield f"the contact lies at most {REACH_OVER} m beyond the net", ("contact_y",), t["contact_y"] > REACH_OVER
    serve, over = t["shot"] < N_SERVES, t["outcome"] != Outcome.FAULT
    yield "serves have no contact point", ("contact_x", "contact_y"), serve & ~np.isnan(t["contact_y"])
    own_half = f"only faults land over {REACH_OVER} m in the striker's half"
    yield own_half, ("landing_y", "outcome"), over & (t["landing_y"] < -REACH_OVER)
    x, y = t["landing_x"], t["landing_y"]  # in the precision of the file: a point on a line must fall on the same side of it
    unknown, area = np.isnan(y), np.nan_to_num(t["area"], nan=-1)
    yield "area is the area of the landing", ("area", "landing_x", "landing_y"), ~unknown & (area != court.area_of(x, y))
    inside = np.where(np.isnan(t["in_court"]), unknown, t["in_court"] == court.in_court(x, y))
    yield "in_court tells whether the landing lies in court", ("in_court", "landing_x", "landing_y"), ~inside


@dataclasses.dataclass(frozen=True)
class Problem:
    """A problem of a file, or of a line of it, from 1."""

    path: Path
    message: str
    line: int | None = None

    def __str__(self) -> str:
        where = f"{self.path}" if self.line is None else f"{self.path}, line {self.line}"
        return f"{where}: {self.message}"


class DataError(ShuttleError):
    """Match data that cannot be read; the message is the first of its ``problems``, with file, line and value.

    Attributes:
        rows: number of rows of the file, as far as they could be read.
    """

    rows = 0

    def __init__(self, path: Path, message: str, *, line: int | None = None) -> None:
        self.problems: tuple[Problem, ...] = (Problem(path, message, line),)
        super().__init__(str(self.problems[0]))

    @classmethod
    def of(cls, problems: Iterable[Problem], advice: tuple[str, ...] = ()) -> "DataError":
        """One error for several problems; ``advice``: arguments with which ``validate`` lists them."""
        first, *others = grouped(problems)
        error = cls(first.path, first.message)
        listed = f" (and {len(others)} more; `{command('data', 'validate', *advice)}` lists them all)" if others else ""
        error.problems, error.args = (first, *others), (f"{first}{listed}",)
        return error


def grouped(problems: Iterable[Problem]) -> list[Problem]:
    """Problems with equal messages as one, with their number, at the line of the first."""
    groups: dict[tuple[Path, str], list[Problem]] = {}
    for found in problems:
        groups.setdefault((found.path, found.message), []).append(found)
    return [
        first if not others else dataclasses.replace(first, message=f"{first.message} ({len(others) + 1:,} times, first here)")
        for first, *others in groups.values()
    ]


def shown(value: str) -> str:
    """A value in a message, quoted and cut."""
    return repr(value if len(value) <= 100 else f"{value[:100]}…")
