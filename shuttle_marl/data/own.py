"""Import of a user's matches from a table of strokes, by a :class:`~shuttle_marl.data.column_map.ColumnMap`.

Nothing is repaired: every invalid value and every broken rule of the schema is reported with its line. What is improbable is a
warning (:mod:`shuttle_marl.data.inference`). What the file lacks is inferred where other values tell it, and marked.
"""

import dataclasses
import itertools
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from shuttle_marl import __version__
from shuttle_marl.base.arrays import F64, I64
from shuttle_marl.base.files import content_hash
from shuttle_marl.data import inference, readers
from shuttle_marl.data.column_map import COLUMNS, ColumnMap
from shuttle_marl.data.copies import copies
from shuttle_marl.data.hands import area_inferred, hands_of, unknown_hands, with_hands
from shuttle_marl.data.people import disciplines, end_of, hands_given
from shuttle_marl.data.problems import DataError, Problem, grouped
from shuttle_marl.data.rallies import Rallies, results
from shuttle_marl.data.schema import Account, Cleaned, Outcome, stroke_table, violations
from shuttle_marl.data.sheet import Sheet
from shuttle_marl.data.words import Words
from shuttle_marl.game import court
from shuttle_marl.game.stroke import N_SERVES, SHOTS

_ABOVE: Final = [SHOTS.index(name) for name in ("clear", "drop", "smash", "half-smash", "net-kill")]
_COUNTED: Final = "rally (counted)"
INFERRED: Final = {
    "shot": "whether serves are short, from the replies",
    "height": "contact heights, from the shot types",
    "technique": "techniques, taken as forehand",
    "area": "areas, from the next strokes; their confidence is a column",
    "outcome": "who won the rallies, from who serves next",
}
"""What may be inferred of a stroke, and from what."""
_SHOWN: Final = 30
"""Headers that a message shows."""


def import_matches(path: Path, columns: Path | None = None) -> Cleaned:
    """Import matches.

    Args:
        path: file of a format of :mod:`shuttle_marl.data.readers`.
        columns: column map, a TOML file; None: the columns are those that the words of the header mean.

    Raises:
        DataError: an unreadable file, invalid values, or broken rules; with the number of rows that were read.
    """
    given = ColumnMap() if columns is None else ColumnMap.read(columns)
    sheet = readers.read(path, given)
    try:
        return clean(sheet, given)
    except DataError as error:
        error.rows = sheet.total
        raise


def clean(sheet: Sheet, given: ColumnMap) -> Cleaned:
    """Check and convert the table of a reader.

    Rallies that were replayed are dropped; of a file that users cannot correct also those with a problem, which is a warning.

    Raises:
        DataError: invalid values or broken rules; of a file that users cannot correct, if no rally is left.
    """
    path, total = sheet.path, sheet.total
    sheet.map = _mapped(sheet, given)
    sheet.require(sheet.map.columns.values())
    told, sheet.warnings = sheet.warnings, []
    read = {"source": sheet.map.source, "format": sheet.format, "file": path.name, "sha256": content_hash(sheet.content)}
    if unread := [repr(name) for name in sheet.header if name and name not in sheet.map.columns.values()]:
        told.append(Problem(path, f"columns that the map does not name are not read: {', '.join(unread)}"))
    broken, most, lets, notes = 0, 0, 0, list[str]()
    while True:
        rallies = Rallies(sheet)
        if (played := rallies.without_lets()) is not None:
            lets += len(sheet) - len(played)
            sheet = played
            continue
        strokes = _strokes_of(sheet, rallies)
        most = max(most, len(rallies))
        if not sheet.problems:
            break
        wrong = rallies.wrong()
        of_file = any(problem.line is None for problem in sheet.problems)
        if sheet.strict or of_file or wrong.all() or not wrong.any():
            advice = (str(path),) if given.file is None else (str(path), "--columns", str(given.file))
            raise DataError.of(sorted(sheet.problems, key=lambda found: found.line or 0), advice=advice)
        told += sheet.problems
        broken += int(wrong.sum())
        if "rally" not in sheet:  # the others keep their numbers
            sheet.columns[_COUNTED] = tuple(map(str, rallies.rally.tolist()))
            sheet.map = dataclasses.replace(sheet.map, columns={**sheet.map.columns, "rally": _COUNTED})
            notes = sheet.notes
        sheet = sheet.take(~wrong)
    strokes, hands = with_hands(strokes, path)
    strokes = _seen_by_left_handers(strokes)
    dropped = {
        "empty row": sheet.empty,
        "no stroke": sheet.others,
        "let": lets,
        "broken rally": broken,
        "unknown shot type": len(sheet) - strokes.num_rows,
    }
    lost = [*sheet.lost]
    unknown = int((strokes["area"].is_null().to_numpy() & (strokes["outcome"].to_numpy() != Outcome.FAULT)).sum())
    if unknown:
        lost.append(f"areas of strokes without a known reply: {unknown:,} of {strokes.num_rows:,}")
    if all(end_of(name) for name in strokes["player"].unique().to_pylist()):
        lost.append("names of the players: those of the ends, which they change between games and at 11 points of a third one")
    told += [Problem(path, copy) for copy in copies(strokes)]
    found = sorted([*told, *sheet.warnings], key=lambda problem: problem.line or 0)
    return Cleaned(
        strokes=strokes,
        account=Account.of(strokes, total=total, rallies=most, dropped=dropped),
        files=(path,),
        warnings=tuple(str(problem) for problem in grouped(found)),
        provenance={
            **read,
            "inferred": [*sheet.inferred, *notes, *sheet.notes, *_inferred(strokes), *hands],
            "lost": [*lost, *unknown_hands(strokes)],
            "imported_by": f"shuttle_marl {__version__}",
        },
    )


def _mapped(sheet: Sheet, given: ColumnMap) -> ColumnMap:
    """The map of a sheet: the one of the user; without columns, with those that the words of its header mean.

    Raises:
        DataError: a required column is missing.
    """
    given = dataclasses.replace(given, source=given.source or sheet.source)
    if given.columns:
        return given
    words = Words("column", sheet.header)
    found: dict[str, str] = {name: name for name in sheet.header if name in COLUMNS}
    for name in sheet.header:
        meaning = words.meaning(name)
        if meaning is not None and name not in COLUMNS:
            found.setdefault(meaning, name)
    if "shot" not in found and "stroke" in found and not any(map(str.isdigit, sheet.columns[found["stroke"]])):
        found["shot"] = found.pop("stroke")
    if "technique" not in found and "hand" in found:
        told = set(sheet.columns[found["hand"]])
        if any(map(Words("technique", told).meaning, told)):
            found["technique"] = found.pop("hand")
    try:
        return dataclasses.replace(given.with_columns(found), guessed=True)
    except ValueError as error:
        header = ", ".join(map(repr, sheet.header[:_SHOWN]))
        raise DataError(sheet.path, f"{error}, or map your headers with --columns; the header is {header}") from error


def _seen_by_left_handers(strokes: pa.Table) -> pa.Table:
    """The table with the inferred areas, which are where right-handers meet the shuttle, mirrored for left-handed receivers."""
    left = [name for name, player in hands_of(strokes).items() if player.hand == court.HANDS.index("left")]
    mirrored = area_inferred(strokes) & pc.is_in(strokes["opponent"], pa.array(left, pa.string())).to_numpy()
    area, position = strokes["area"].combine_chunks(), strokes.schema.get_field_index("area")
    filled = pa.array(court.mirrored(area.fill_null(0).to_numpy(zero_copy_only=False)))
    return strokes.set_column(position, strokes.schema.field("area"), pc.if_else(mirrored, filled, area))


def _strokes_of(sheet: Sheet, rallies: Rallies) -> pa.Table:
    """The strokes of known types of the rallies without unreadable rows."""
    shot, point = rallies.shot, _points(sheet)
    technique, height = sheet.words("technique"), sheet.words("height")
    landed = _areas(sheet, point["landing"])
    met, share = inference.areas_met(rallies.following(shot), rallies.following(technique))
    guessed = (landed < 0) & (met >= 0)
    result, won_by_server = results(rallies)
    marks = {
        "shot": rallies.inferred_serve,
        "height": (height < 0) & ~((shot >= 0) & (shot < N_SERVES)),
        "technique": technique < 0,
        "area": guessed,
        "outcome": won_by_server,
    }
    sure = sheet.probabilities("confidence")
    landing_x, landing_y = point["landing"].T.astype(np.float32)
    values: dict[str, Any] = {
        "source": np.full(len(sheet), sheet.map.source),
        "discipline": disciplines(sheet, rallies.player, rallies.opponent),
        **{name: getattr(rallies, name) for name in ("match", "game", "rally", "stroke", "player", "opponent", "shot")},
        "hand": np.ma.masked_less(hands_given(sheet, rallies.player), 0),
        "height": np.where(height >= 0, height, np.isin(shot, _ABOVE)),
        "technique": np.maximum(technique, 0),
        "area": np.ma.masked_less(np.where(guessed, met, landed), 0),
        "in_court": np.ma.masked_where(np.isnan(landing_y), court.in_court(landing_x, landing_y)),
        "clock": sheet.whole("seconds", "clock"),
        "frame": sheet.whole("frame"),
        **result,
        "confidence": np.where(guessed, np.where(np.isnan(sure), 1.0, sure) * share, sure),
        "inferred": [" ".join(itertools.compress(marks, row)) or None for row in zip(*marks.values(), strict=True)],
    }
    inference.compare(sheet, values, point, sheet.words("side", 0))
    # An unreadable row would cause false problems of the other rows of its rally.
    known = np.flatnonzero((shot < len(SHOTS)) & ~rallies.wrong())
    if not len(known) and not sheet.problems:
        raise DataError(sheet.path, "no stroke of a known shot type")
    strokes = stroke_table(values, point).take(pa.array(known))
    for violation in violations(strokes):
        sheet.mark(known[violation.rows], f"expected: {violation.rule}")
    return strokes


def _points(sheet: Sheet) -> dict[str, F64]:
    """``[n, 2]`` points in the striker's frame, NaN missing."""
    sign = np.where(sheet.words("side") == 1, -1.0, 1.0) if sheet.map.coordinates == "court" else np.ones(len(sheet))
    found = {}
    for name in inference.POINTS:
        found[name] = np.stack([sheet.numbers(f"{name}_{axis}") for axis in "xy"], axis=1) * sign[:, None]
        inference.check_scale(sheet, name, found[name])
    return found


def _areas(sheet: Sheet, landing: F64) -> I64:
    """``[n]`` areas of the landing points, or of the column where there is none."""
    computed = court.area_of(*landing.astype(np.float32).T).astype(np.int64)
    if "area" not in sheet:
        return computed
    named = sheet.words("area")
    if sheet.map.areas_seen_by == "striker":
        named = np.where(named < 0, -1, named + 2 - 2 * (named % 3))
    differ = (computed >= 0) & (named >= 0) & (computed != named)
    sheet.warn(differ, f"{sheet.named('area')} is not the area of the landing point, which is used")
    return np.where(computed >= 0, computed, named)


def _inferred(strokes: pa.Table) -> list[str]:
    """Sentences on what was inferred, with the numbers of kept strokes."""
    words = strokes["inferred"].fill_null("").to_pylist()
    counts = {text: sum(name in word.split() for word in words) for name, text in INFERRED.items()}
    return [f"{text}: {n:,} of {strokes.num_rows:,} strokes" for text, n in counts.items() if n]
