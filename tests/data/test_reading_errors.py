"""Broken files: every message names file, line and value; random damage is told or harmless; odd files never hang a reader."""

import csv
import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.data import DataError, clean_matches, read_matches, upstream
from shuttle_marl.data.schema import violations
from shuttle_marl.data.strict_csv import StrictCsv
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
    ("rally", "", "rally '' is not an integer from 1"),
    ("ball_round", "1.5", "ball_round '1.5' is not an integer"),
    ("roundscore_A", "31", "roundscore_A '31' is not an integer from 0 to 30"),
    ("landing_area", "17", "landing_area '17'; expected nothing or 1 to 16"),
    ("backhand", "2", "backhand '2'; expected nothing or 1 to 1"),
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


def test_a_published_file_is_never_refused(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    edit(path, 4, "type", "飛球")
    edit(path, 5, "landing_x", "99999")
    edit(path, 11, "ball_round", "?")
    monkeypatch.setattr(upstream, "manifest", lambda: {"set1.csv": hashlib.sha256(path.read_bytes()).hexdigest()})
    account = clean_matches(path.parents[3]).account
    assert account.dropped == {"unreadable value": 3, "broken rally": 3}
    assert account.strokes == 13


def into_a_fifo(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def cut_in_a_row(path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: content.rindex(b",", 0, -40)])


@pytest.mark.parametrize(("change", "told"), [
    (lambda p: p.write_bytes(p.read_text(encoding="utf-8").encode("big5")), r"set1\.csv, line 2: byte 0xb5 is not UTF-8"),
    (lambda p: p.write_text(p.read_text().replace("flaw", "law")), "line 1: missing column flaw"),
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


def test_the_total_counts_rows_that_cannot_be_read(tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    path.write_text('a,b\n1,2\n3\n,\n"4,5\n6,7",8\n9,10\n')
    sheet = StrictCsv(path, ["a"])
    assert (sheet.columns["b"], sheet.line.tolist()) == (("2", "10"), [2, 7])
    assert (len(sheet), sheet.empty, sheet.others, sheet.total) == (2, 1, 2, 5)
    assert [problem.line for problem in sheet.problems] == [3, 6]
    assert sheet.unreadable.tolist() == [True, True]
    kept = sheet.without(np.array([True, False]))
    assert (kept.columns["b"], len(kept), kept.total) == (("10",), 1, 4)


def csv_of(folder: Path, text: str | bytes, required: list[str], **options: Any) -> StrictCsv:
    path = folder / "rows.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return StrictCsv(path, required, **options)


def told_of(folder: Path, text: str | bytes, required: list[str], **options: Any) -> str:
    with pytest.raises(DataError) as caught:
        csv_of(folder, text, required, **options)
    return str(caught.value).removeprefix(str(folder / "rows.csv"))


def test_values_of_a_table_of_text(tmp_path: Path) -> None:
    cells = ["5", "", "-.5", "5.", "+1e2", "999999999999999", "1e15", "-1e15", "x", "1e400", "7.5"]
    sheet = csv_of(tmp_path, "a,b\n" + "".join(f"{cell},1\n" for cell in cells), ["a"])
    assert sheet.numbers("a").tolist() == pytest.approx(
        [5, np.nan, -0.5, 5, 100, 999_999_999_999_999, *[np.nan] * 4, 7.5], nan_ok=True
    )
    assert [(found.line, found.message) for found in sheet.problems] == [
        (8, "a '1e15' is too large"), (9, "a '-1e15' is too large"), (10, "a 'x' is not a number"),
        (11, "a '1e400' is not a number"),
    ]  # fmt: skip
    assert np.flatnonzero(sheet.unreadable).tolist() == [6, 7, 8, 9]
    assert np.isnan(csv_of(tmp_path, "a,b\n,1\n,2\n", ["a"]).numbers("a")).all()
    sheet = csv_of(tmp_path, "a,b\n" + "".join(f"{cell},1\n" for cell in ("1", "2", "5", "6", "2.5", "", "x")), ["a"])
    assert sheet.integers("a", 2, 5, missing=-3).tolist() == [-3, 2, 5, -3, -3, -3, -3]
    assert [(found.line, found.message.partition(" is ")[2]) for found in sheet.problems] == [
        (8, "not a number"), (2, "not an integer from 2 to 5"), (5, "not an integer from 2 to 5"),
        (6, "not an integer from 2 to 5"), (7, "not an integer from 2 to 5"),
    ]  # fmt: skip
    sheet = csv_of(tmp_path, "a,b\n0,1\n1,1\n3,1\n4,1\n,1\n", ["a"])
    assert sheet.codes("a", 3).tolist() == [0, 1, 3, 0, 0]
    assert [(found.line, found.message) for found in sheet.problems] == [
        (2, "a '0'; expected nothing or 1 to 3"), (5, "a '4'; expected nothing or 1 to 3"),
    ]  # fmt: skip
    sheet = csv_of(tmp_path, "a,b\nx,1\n,1\nz,1\ny,1\n", ["a"])
    assert sheet.choices("a", {"x": 4, "y": 2, "": 7}).tolist() == [4, 7, -1, 2]
    assert [str(found) for found in sheet.problems] == [f"{sheet.path}, line 4: unknown a 'z'; expected one of x, y, nothing"]
    sheet = csv_of(tmp_path, "a,b\n1:01:02,1\n0:00:00,1\n0:60:00,1\n9999:59:59,1\n,1\n", ["a"])
    assert sheet.seconds("a").tolist() == [3662, 0, -1, 9999 * 3600 + 3599, -1]
    assert [(found.line, found.message) for found in sheet.problems] == [
        (4, "a '0:60:00'; expected h:mm:ss"), (6, "a ''; expected h:mm:ss"),
    ]  # fmt: skip


def test_values_in_messages_are_cut(tmp_path: Path) -> None:
    sheet = csv_of(tmp_path, f"a,b\n{'x' * 100},1\n{'y' * 101},1\n", ["a"])
    sheet.numbers("a")
    assert [found.message for found in sheet.problems] == [
        f"a '{'x' * 100}' is not a number",
        f"a '{'y' * 100}…' is not a number",
    ]


@pytest.mark.parametrize(
    ("text", "delimiter", "columns", "lines"),
    [
        ("a;b,c;d\n1;2,5;3\n4;5;6\n", None, {"a": ("1", "4"), "b,c": ("2,5", "5"), "d": ("3", "6")}, [2, 3]),
        ("a,b;c,d\n1,2,3\n", None, {"a": ("1",), "b;c": ("2",), "d": ("3",)}, [2]),
        ("a\tb\n1\t2\n", None, {"a": ("1",), "b": ("2",)}, [2]),
        ("a|b\n1|2\n", None, {"a": ("1",), "b": ("2",)}, [2]),
        ("ab\n1\n", None, {"ab": ("1",)}, [2]),
        ("sep=;\na;b,c,d\n1;2\n\n3;4\n", None, {"a": ("1", "3"), "b,c,d": ("2", "4")}, [3, 5]),
        ('"sep=;"\r\na;b\r\n"1\r\n2";3\r\n4;5\r\n', ";", {"a": ("1\r\n2", "4"), "b": ("3", "5")}, [4, 5]),
        ("a,b\n1,2\n3,4\n", ",", {"a": ("1", "3"), "b": ("2", "4")}, [2, 3]),
    ],
)
def test_delimiters(
    tmp_path: Path, text: str, delimiter: str | None, columns: dict[str, tuple[str, ...]], lines: list[int]
) -> None:
    sheet = csv_of(tmp_path, text, [], delimiter=delimiter)
    assert (sheet.columns, sheet.line.tolist()) == (columns, lines)


def test_decimal_marks_follow_the_delimiter(tmp_path: Path) -> None:
    assert csv_of(tmp_path, "a;b\n1,5;2\n", ["a"], delimiter=None).numbers("a").tolist() == [1.5]
    assert csv_of(tmp_path, 'a,b\n"1.5",2\n', ["a"], delimiter=None).numbers("a").tolist() == [1.5]
    assert csv_of(tmp_path, "a;b\n1.5;2\n", ["a"], delimiter=";").numbers("a").tolist() == [1.5]


@pytest.mark.parametrize(
    ("text", "options", "says"),
    [
        ("", {}, ": the file is empty"),
        ("a,b\n", {}, ": no rows below the header"),
        ("a,b\n,\n", {}, ": no rows below the header"),
        ("a,b\n1,2,3\n", {}, ", line 2: 3 fields instead of 2, ending in '3': is the file truncated?"),
        ("a,a\n1,2\n", {}, ", line 1: several columns a; rename or remove all but one"),
        ("b,c\n1,2\n", {}, ", line 1: missing column a; the header is 'b,c'"),
        ("sep=,\nb,c\n1,2\n", {}, ", line 2: missing column a; the header is 'b,c'"),
        ("sep=;\na,c\n1,2\n", {}, ", line 1: the delimiter is ';' here, and ',' in the map of its columns"),
        ('a,b\n1,"2\n', {}, ", line 2: unexpected end of data: is a quotation mark missing?"),
        ('sep=,\na,b\n1,"2\n', {}, ", line 3: unexpected end of data: is a quotation mark missing?"),
        ('a,b\n1,"2\n3,4\n5,6"\n', {}, ", line 4: a value contains lines that look like rows: is a quotation mark missing?"),
        (b"a,b\n1,2\n3,\xff\n", {}, ", line 3: byte 0xff is not UTF-8; save the file as UTF-8"),
        (b"\xfe,b\n1,2\n", {}, ", line 1: byte 0xfe is not UTF-8; save the file as UTF-8"),
    ],
)
def test_files_that_are_no_tables(tmp_path: Path, text: str | bytes, options: dict[str, Any], says: str) -> None:
    assert told_of(tmp_path, text, ["a"], **options) == says


def test_rows_and_problems_are_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shuttle_marl.data.strict_csv._MOST_ROWS", 3)
    assert len(csv_of(tmp_path, "a,b\n1,2\n3,4\n5,6\n", ["a"])) == 3
    assert csv_of(tmp_path, "a,b\n1,2\n,\n5,6\n", ["a"]).empty == 1
    for rows in ("1,2\n3,4\n5,6\n7,8\n", "1,2\n,\n,\n7,8\n"):
        assert told_of(tmp_path, f"a,b\n{rows}", ["a"]) == ": more than 3 rows; divide the file"
    sheet = csv_of(tmp_path, "a,b\n1,2\n", ["a"])
    sheet.fill(["a"], [["1"]] * 3, [2, 3, 4])
    with pytest.raises(DataError, match="more than 3 rows; divide the file"):
        sheet.fill(["a"], [["1"]] * 4, [2, 3, 4, 5])
    with pytest.raises(DataError, match="no strokes"):
        sheet.fill(["a"], [], [])
    monkeypatch.setattr("shuttle_marl.data.strict_csv._MOST_PROBLEMS", 3)
    sheet.add(2, "one")
    sheet.add(2, "one")
    sheet.add(2, "two")
    assert len(sheet.problems) == 2
    with pytest.raises(DataError, match=r"one .2 times, first here. .and 2 more; ") as caught:
        sheet.add(3, "one")
    assert [found.message for found in caught.value.problems] == [
        "one (2 times, first here)", "two", "too many problems; the rest is not listed",
    ]  # fmt: skip
