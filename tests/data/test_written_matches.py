"""Imports give the strokes that were written, or refuse: never other ones."""

import random
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.data import DataError, Outcome
from shuttle_marl.data.own import import_matches
from shuttle_marl.data.schema import Cleaned
from shuttle_marl.data.upstream import player_id
from shuttle_marl.game.stroke import SHOTS
from tests.data import written_matches as written
from tests.data.written_matches import Written

PAIRS = (("Ada Alpha", "Bea Beta"), ("Cleo Gamma", "Dora Delta"), ("Ada Alpha", "Dora Delta"))


def import_text(content: str) -> Cleaned:
    with tempfile.TemporaryDirectory() as folder:
        path, columns = Path(folder) / "final", Path(folder) / "map.toml"
        path.write_text(content, encoding="utf-8")
        columns.write_text('discipline = "WS"\n', encoding="utf-8")
        return import_matches(path, columns)


def assert_as_written(cleaned: Cleaned, strokes: Sequence[Written], columns: Sequence[str]) -> None:
    """Every kept stroke is one that was written, in its order, with what was written of it."""
    rows = cleaned.strokes.to_pylist()
    assert cleaned.account.strokes == len(strokes)
    assert len(rows) + sum(cleaned.account.dropped.values()) == len(strokes)
    left = iter(strokes)
    for row in rows:
        assert any(is_written(row, stroke, columns) for stroke in left), row


def is_written(row: dict[str, Any], stroke: Written, columns: Sequence[str]) -> bool:
    numbers = [name for name in ("match", "game", "rally", "stroke") if name in columns]
    return (
        row["player"] == player_id(stroke.player)
        and SHOTS[row["shot"]] == stroke.shot
        and ("seconds" not in columns or row["clock"] == int(stroke.seconds))
        and all(row[name] == getattr(stroke, name) for name in numbers)
        and row["outcome"] in outcomes(stroke)
    )


def outcomes(stroke: Written) -> set[int]:
    if not stroke.ending:
        return {Outcome.RETURNED}
    return {Outcome.UNKNOWN, Outcome.WINNER if stroke.winner == stroke.who else Outcome.FAULT}


NUMBERS = (("game", "rally", "stroke"), ("game", "rally"), ("game",), ("rally",), ())
TOLD = ((), ("ending",), ("winner",), ("ending", "winner"), *((kind,) for kind in written.SCORES), ("ending", written.SCORES[0]))
FORMATS = ("csv", "sportscode")


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 10**6), form=st.sampled_from(FORMATS), matches=st.integers(1, 3), numbers=st.sampled_from(NUMBERS),
    told=st.sampled_from(TOLD), unit=st.sampled_from(sorted(written.UNITS)), timed=st.booleans(),
    order=st.sampled_from(["in order", "shuffled", "mixed"]), swapped=st.booleans(),
)  # fmt: skip
def test_any_table_of_two_games_is_read_as_it_was_written_or_refused(
    seed: int, form: str, matches: int, numbers: tuple[str, ...], told: tuple[str, ...], unit: str, timed: bool,
    order: str, swapped: bool,
) -> None:  # fmt: skip
    rng = random.Random(seed)
    of_video = form == "sportscode"
    matches = 1 if of_video else matches
    played = [
        written.match(seed + i, f"round {i + 1}{' away' if swapped and i == 1 else ''}", PAIRS[i], rallies=8)
        for i in range(matches)
    ]
    if order != "in order":
        rng.shuffle(played)
    strokes = [stroke for each in played for stroke in each]
    if order == "mixed" and not of_video and "rally" in numbers:  # else the order of the rows tells it
        parts = {(stroke.match, stroke.game, stroke.rally): list[Written]() for stroke in strokes}
        for stroke in strokes:
            parts[stroke.match, stroke.game, stroke.rally].append(stroke)
        rallies = list(parts.values())
        rng.shuffle(rallies)
        strokes = [stroke for rally in rallies for stroke in rally]
    timed = timed or of_video
    columns = (*(("match",) if matches > 1 else ()), *numbers, "player", "shot", *told, *(("seconds",) if timed else ()))
    rows = written.entries(strokes, columns, unit=unit)
    content = written.as_csv(rows) if form == "csv" else written.as_sportscode(rows)
    try:
        cleaned = import_text(content)
    except DataError:
        return
    assert_as_written(cleaned, strokes, columns)
