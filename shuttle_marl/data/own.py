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
from shuttle_marl.base.arrays import I64
from shuttle_marl.base.files import content_hash
from shuttle_marl.data import inference, readers
from shuttle_marl.data.column_map import ColumnMap
from shuttle_marl.data.columns import Columns
from shuttle_marl.data.copies import copies
from shuttle_marl.data.ends import end_of
from shuttle_marl.data.hands import area_inferred, hands_of, unknown_hands, with_hands
from shuttle_marl.data.people import People
from shuttle_marl.data.rallies import Rallies
from shuttle_marl.data.results import Results
from shuttle_marl.data.schema import Account, Cleaned, Outcome, stroke_table, violations
from shuttle_marl.data.strict_csv import DataError, Problem, grouped
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


def import_matches(path: Path, columns: Path | None = None) -> Cleaned:
    """Import matches.

    Args:
        path: file of a format of :mod:`shuttle_marl.data.readers`.
        columns: column map, a TOML file; None: the columns are those that the words of the header mean.

    Raises:
        DataError: an unreadable file, invalid values, or broken rules; with the number of rows that were read.
    """
    given = ColumnMap() if columns is None else ColumnMap.read(columns)
    reading = readers.read(path, given)
    try:
        return _imported(path, columns, given, reading)
    except DataError as error:
        error.rows = reading.sheet.total
        raise


def _imported(path: Path, map_file: Path | None, given: ColumnMap, reading: readers.Reading) -> Cleaned:
    sheet = reading.sheet
    mapped = dataclasses.replace(given.filled(sheet), source=given.source or reading.source)
    sheet.require(mapped.columns.values())
    told = list(sheet.warnings)  # of the reader
    sheet.warnings.clear()
    if unread := [repr(name) for name in sheet.header if name and name not in mapped.columns.values()]:
        told.append(Problem(path, f"columns that the map does not name are not read: {', '.join(unread)}"))
    broken, most, lets, notes = 0, 0, 0, list[str]()
    while True:
        columns = Columns(sheet, mapped, strict=reading.strict)
        rallies = Rallies(columns)
        ending = columns.codes("ending", 0)
        if (played := rallies.without_lets(ending)) is not None:
            lets += len(sheet) - len(played)
            sheet = played
            continue
        strokes = _strokes_of(columns, rallies, ending)
        most = max(most, len(rallies))
        if not sheet.problems:
            break
        wrong = rallies.wrong()
        of_file = any(problem.line is None for problem in sheet.problems)
        if reading.strict or of_file or wrong.all() or not wrong.any():
            advice = (str(path),) if map_file is None else (str(path), "--columns", str(map_file))
            raise DataError.of(sorted(sheet.problems, key=lambda found: found.line or 0), advice=advice)
        told += sheet.problems
        broken += int(wrong.sum())
        if "rally" not in mapped.columns:  # the others keep their numbers
            sheet.add_column(_COUNTED, rallies.rally)
            mapped, notes = dataclasses.replace(mapped, columns={**mapped.columns, "rally": _COUNTED}), columns.notes
        sheet = sheet.without(wrong)
    columns.notes[:0] = notes
    strokes, hands = with_hands(strokes, path)
    strokes = _seen_by_left_handers(strokes)
    dropped = {
        "empty row": sheet.empty,
        "no stroke": sheet.others,
        "let": lets,
        "broken rally": broken,
        "unknown shot type": len(sheet) - strokes.num_rows,
    }
    unknown = int((strokes["area"].is_null().to_numpy() & (strokes["outcome"].to_numpy() != Outcome.FAULT)).sum())
    lost = [f"areas of strokes without a known reply: {unknown:,} of {strokes.num_rows:,}"] if unknown else []
    if all(end_of(name) for name in strokes["player"].unique().to_pylist()):
        lost.append("names of the players: those of the ends, which they change between games and at 11 points of a third one")
    told += [Problem(path, copy) for copy in copies(strokes)]
    found = sorted([*told, *sheet.warnings], key=lambda problem: problem.line or 0)
    return Cleaned(
        strokes=strokes,
        account=Account.of(strokes, total=reading.sheet.total, rallies=most, dropped=dropped),
        files=(path,),
        warnings=tuple(str(problem) for problem in grouped(found)),
        provenance={
            "source": mapped.source,
            "format": reading.format,
            "file": path.name,
            "sha256": content_hash(sheet.content),
            "inferred": [*reading.inferred, *_inferred(columns, strokes), *hands],
            "lost": [*reading.lost, *lost, *unknown_hands(strokes)],
            "imported_by": f"shuttle_marl {__version__}",
        },
    )


def _seen_by_left_handers(strokes: pa.Table) -> pa.Table:
    """The table with the inferred areas, which are where right-handers meet the shuttle, mirrored for left-handed receivers."""
    left = [name for name, player in hands_of(strokes).items() if player.hand == court.HANDS.index("left")]
    mirrored = area_inferred(strokes) & pc.is_in(strokes["opponent"], pa.array(left, pa.string())).to_numpy()
    area, position = strokes["area"].combine_chunks(), strokes.schema.get_field_index("area")
    filled = pa.array(court.mirrored(area.fill_null(0).to_numpy(zero_copy_only=False)))
    return strokes.set_column(position, strokes.schema.field("area"), pc.if_else(mirrored, filled, area))


def _strokes_of(columns: Columns, rallies: Rallies, ending: I64) -> pa.Table:
    """The strokes of known types of the rallies without unreadable rows."""
    sheet, shot = columns.sheet, rallies.shot
    people = People(columns, rallies.match, rallies.game)
    points = columns.points()
    technique, height = columns.codes("technique", -1), columns.codes("height", -1)
    landed = columns.areas(points["landing"])
    met, share = inference.areas_met(rallies.following(shot), rallies.following(technique))
    guessed = (landed < 0) & (met >= 0)
    results = Results(columns, rallies, people, ending)
    marks = {
        "shot": rallies.inferred_serve,
        "height": (height < 0) & ~((shot >= 0) & (shot < N_SERVES)),
        "technique": technique < 0,
        "area": guessed,
        "outcome": results.inferred,
    }
    sure = columns.probabilities("confidence")
    landing_x, landing_y = points["landing"].T.astype(np.float32)
    values: dict[str, Any] = {
        "match": rallies.match,
        "source": np.full(len(columns), columns.map.source),
        "discipline": people.disciplines(),
        "game": rallies.game,
        "rally": rallies.rally,
        "stroke": rallies.stroke,
        "player": people.player,
        "opponent": people.opponent,
        "hand": np.ma.masked_less(people.hands(), 0),
        "shot": shot,
        "height": np.where(height >= 0, height, np.isin(shot, _ABOVE)),
        "technique": np.maximum(technique, 0),
        "area": np.ma.masked_less(np.where(guessed, met, landed), 0),
        "in_court": np.ma.masked_where(np.isnan(landing_y), court.in_court(landing_x, landing_y)),
        "clock": columns.whole("seconds", "clock"),
        "frame": columns.whole("frame", "frame"),
        "outcome": results.outcome,
        "reason": results.reason,
        **results.points,
        "forced": np.ma.masked_where(results.forced < 0, results.forced == 1),
        "confidence": np.where(guessed, np.where(np.isnan(sure), 1.0, sure) * share, sure),
        "inferred": [" ".join(itertools.compress(marks, row)) or None for row in zip(*marks.values(), strict=True)],
    }
    inference.compare(sheet, columns.map.columns, values, points, columns.codes("side", 0))
    # An unreadable row would cause false problems of the other rows of its rally.
    known = np.flatnonzero((shot < len(SHOTS)) & ~rallies.wrong())
    if not len(known) and not sheet.problems:
        raise DataError(sheet.path, "no stroke of a known shot type")
    strokes = stroke_table(values, points).take(pa.array(known))
    for violation in violations(strokes):
        sheet.mark(known[violation.rows], f"expected: {violation.rule}")
    return strokes


def _inferred(columns: Columns, strokes: pa.Table) -> list[str]:
    """Sentences on what was inferred, with the numbers of kept strokes."""
    words = strokes["inferred"].fill_null("").to_pylist()
    counts = {text: sum(name in word.split() for word in words) for name, text in INFERRED.items()}
    return [*columns.notes, *(f"{text}: {n:,} of {strokes.num_rows:,} strokes" for text, n in counts.items() if n)]
