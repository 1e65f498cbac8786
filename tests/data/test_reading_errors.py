"""Broken files: every message names file, line and value; random damage is told or harmless; odd files never hang a reader."""

import csv
import os
import re
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.data import DataError, clean_matches, read_matches
from shuttle_marl.data.schema import violations
from tests.data.upstream_layout import COLUMNS, HEADER, Layout, plain_game, write_rows

NAME = "Viktor_AXELSEN_CHEN_Long_ Finals"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """The file of the only game of a sound data set."""
    return Layout(tmp_path).match(NAME, [plain_game(4)]) / "set1.csv"


def edit(path: Path, line: int, column: str, value: str) -> None:
    """Put a value into a cell; line 2 is the first row."""
    lines = path.read_text(encoding="utf-8").splitlines()
    cells = lines[line - 1].split(",")
    cells[lines[0].split(",").index(column)] = value
    lines[line - 1] = ",".join(cells)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def refused(path: Path) -> DataError:
    with pytest.raises(DataError) as caught:
        clean_matches(path.parents[3])
    return caught.value


@pytest.mark.parametrize(("column", "value", "told"), [
    ("type", "飛球", "unknown type '飛球'"),
    ("player", "C", "unknown player 'C'; expected one of A, B"),
    ("lose_reason", "累了", "unknown lose_reason '累了'"),
    ("getpoint_player", "X", "unknown getpoint_player 'X'"),
    ("frame_num", "1_0", "frame_num '1_0' is not a number"),
    ("frame_num", "\u0661", "frame_num '\u0661' is not a number"),
    ("hit_y", "inf", "hit_y 'inf' is not a number"),
    ("rally", "", "rally is empty"),
    ("ball_round", "1.5", "ball_round 1.5; expected a whole number from 1"),
    ("roundscore_A", "31", "roundscore_A 31; expected a whole number from 0 to 30"),
    ("landing_area", "17", "landing_area 17; expected a whole number from 1 to 16"),
    ("backhand", "2", "backhand 2; expected a whole number from 1 to 1"),
    ("time", "12:61", "time '12:61'; expected h:mm:ss"),
    ("landing_x", "99999", "landing at pixel (99999, "),
])  # fmt: skip
def test_bad_value(path: Path, column: str, value: str, told: str) -> None:
    edit(path, 5, column, value)
    error = refused(path)
    assert str(error).startswith(f"{path}, line 5: ")
    assert told in str(error)
    assert error.problems[0].line == 5
    assert len(error.problems) == 1


def test_line_ends_and_the_byte_order_mark_are_no_error(path: Path) -> None:
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    assert clean_matches(path.parents[3]).account.strokes_kept == 13


def test_all_problems_are_found(path: Path) -> None:
    edit(path, 3, "type", "飛球")
    edit(path, 3, "landing_area", "99")
    edit(path, 7, "time", "soon")
    error = refused(path)
    assert [problem.line for problem in error.problems] == [3, 3, 7]
    assert "2 more" in str(error)


def into_a_fifo(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def cut_in_a_row(path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: content.rindex(b",", 0, -40)])


@pytest.mark.parametrize(("change", "told"), [
    (lambda p: p.write_bytes(p.read_text(encoding="utf-8").encode("big5")), r"set1\.csv, line 2: byte 0xb5 is not UTF-8"),
    (lambda p: p.write_text(p.read_text().replace("aroundhead", "round")), "line 1: missing column aroundhead"),
    (cut_in_a_row, r"set1\.csv, line 14: .* fields instead of 30.*truncated\?"),
    (lambda p: p.write_text(p.read_text(encoding="utf-8") + '1,"' + "x" * 200_000, encoding="utf-8"), r"set1\.csv, line 15: "),
    (lambda p: p.write_text(""), r"set1\.csv: the file is empty"),
    (lambda p: p.write_text(HEADER + "\n"), r"set1\.csv: no rows below the header"),
    (lambda p: p.rename(p.with_name("set2.csv")), r"match\.csv lists 1 games, files set1\.csv, set2\.csv, …; present: set2\.csv"),
    (lambda p: p.rename(p.parents[1] / "x"), "present: none"),
    (lambda p: shutil.rmtree(p.parents[3] / "ShuttleSet"), r"no match data here: expected .*data download"),
    (lambda p: shutil.rmtree(p.parent), "no files of any match.*data download"),
    (lambda p: (p.parents[1] / "homography.csv").unlink(), r"homography\.csv: cannot be read \(No such file or directory\)"),
    (lambda p: (p.unlink(), p.mkdir()), r"cannot be read \(not a regular file\)"),
    (into_a_fifo, r"cannot be read \(not a regular file\)"),
    (lambda p: into_a_fifo(p.parents[1] / "homography.csv"), "not a regular file"),
    (lambda p: (p.unlink(), p.symlink_to("/dev/zero")), r"cannot be read \(not a regular file\)"),
])  # fmt: skip
def test_bad_files(path: Path, change: Callable[[Path], object], told: str) -> None:
    change(path)
    assert re.search(told, str(refused(path)))


def test_a_fifo_in_the_place_of_the_data(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(DataError, match="not a regular file"):
        read_matches(tmp_path / "fifo")


def replace_in(file: str, old: str, new: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        (folder / file).write_text((folder / file).read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")

    return change


@pytest.mark.parametrize(("change", "told"), [
    (replace_in("homography.csv", "[[1.06", "[[x"), "line 2: homography_matrix '[[x"),
    (replace_in("homography.csv", "[[1.06, ", "[["), "is not a 3 x 3 matrix"),
    *((replace_in("homography.csv", "[[1.06", new), "not a 3 x 3 matrix") for new in ("[" * 20_000, f"[[{10**400}", "[[NaN")),
    (replace_in("homography.csv", NAME, "Other"), f"no homography for match '{NAME}'"),
    (replace_in("match.csv", "Viktor AXELSEN,CHEN Long", "Some BODY,Any BODY"), "line 2: players ('some-body', 'any-body')"),
    (lambda folder: (folder / "match.csv").write_text((folder / "match.csv").read_text() * 2), "line 3: "),
    (replace_in("match.csv", "\n1,", "\nfirst,"), "line 2: id 'first' is not a number"),
    (replace_in("match.csv", "video", "film"), "line 1: missing column video"),
])  # fmt: skip
def test_bad_lists(path: Path, change: Callable[[Path], None], told: str) -> None:
    change(path.parents[1])
    assert told in str(refused(path))


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
    path = Layout(tmp_path).match("m", [plain_game(4)]) / "set1.csv"
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    rows[2]["db"] = "one\ntwo, three"
    rows[5]["type"] = "飛球"
    write_rows(path, rows)
    with pytest.raises(DataError, match=r"set1\.csv, line 8: unknown type"):
        clean_matches(tmp_path)
