"""Random damage: a file is refused with its name and line, or gives a sound table; a published one is never refused."""

import csv
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.data import DataError, clean_matches
from shuttle_marl.data.schema import violations
from tests.data.upstream_layout import COLUMNS, LIFT, SERVE, SMASH, Layout, game, plain_game, rally, write_rows

USED = [c for c in COLUMNS if c not in ("server", "hit_area", "win_reason", "player_location_area", "opponent_location_area")]
VALUES = st.sampled_from(
    ["", "0", "1", "2", "-1", "7", "31", "300", "1e9", "nan", "inf", "A", "B", "C", "未知球種", "發短球", "殺球", "飛球",
     "出界", "掛網",
     "0:00:01", "25:61:00", "1.5", "99999999999999999999", " ", '"', "a\x00b"]
)  # fmt: skip
EDITS = st.lists(st.tuples(st.integers(0, 26), st.sampled_from(USED), VALUES), min_size=1, max_size=12)


def damaged(root: Path, edits: list[tuple[int, str, str]]) -> Path:
    rows = plain_game(8)
    for number, column, value in edits:
        rows[number % len(rows)][column] = value
    return Layout(root).match("m", [rows]) / "set1.csv"


@settings(max_examples=150, deadline=None)
@given(EDITS | st.just([]), st.none() | st.tuples(st.integers(0, 5000), st.binary(max_size=4)))
def test_damage_is_told_or_harmless(edits: list[tuple[int, str, str]], cut: tuple[int, bytes] | None) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = damaged(Path(folder), edits)
        if cut is not None:
            content = path.read_bytes()
            path.write_bytes(content[: cut[0] % len(content)] + cut[1])
        try:
            cleaned = clean_matches(Path(folder))
        except DataError as caught:
            error = caught
        else:
            error = None
        if error is not None:
            assert str(path) in str(error)
            assert error.problems[0].line is not None or cut
            return
        assert [str(v) for v in violations(cleaned.strokes)] == []
        kept = cleaned.account.strokes_kept + sum(cleaned.account.dropped.values())
        assert cleaned.account.strokes == kept == (27 if cut is None else kept)


def test_quoted_cells_with_commas_and_lines(tmp_path: Path) -> None:
    """Lines as a spreadsheet may write them: the line told is the one in the file."""
    path = Layout(tmp_path).match("m", [plain_game(4)]) / "set1.csv"
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    rows[2]["db"] = "one\ntwo, three"
    rows[5]["type"] = "飛球"
    write_rows(path, rows)
    with pytest.raises(DataError, match=r"set1\.csv, line 8: unknown type"):
        clean_matches(tmp_path)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 4), st.booleans(), st.booleans(), st.integers(0, 30)), min_size=1, max_size=6))
def test_any_order_of_rallies(chosen: list[tuple[int, bool, bool, int]]) -> None:
    """Rallies with repeated numbers, swapped ends and servers, and scores of all kinds still give a sound table."""
    hits = [SERVE, LIFT, SMASH]
    rows = game(
        rally(number, "A" if by_a else "B", hits, (points, 30 - points), a_below=below, frame=100 * i)
        for i, (number, by_a, below, points) in enumerate(chosen)
    )
    with tempfile.TemporaryDirectory() as folder:
        Layout(Path(folder)).match("m", [rows])
        cleaned = clean_matches(Path(folder))
        assert [str(v) for v in violations(cleaned.strokes)] == []
        assert cleaned.account.strokes == cleaned.account.strokes_kept + sum(cleaned.account.dropped.values())
