"""Readers of files and tables accept values at their bounds and refuse values just beyond."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from shuttle_marl.base import table_files
from shuttle_marl.data import read_matches
from shuttle_marl.data.column_map import ColumnMap
from shuttle_marl.data.columns import Columns
from shuttle_marl.data.copies import copies
from shuttle_marl.data.ends import at_ends, end_of, ends_in
from shuttle_marl.data.hands import PlayerHand
from shuttle_marl.data.readers import pipeline, tree
from shuttle_marl.data.readers.reading import sheet_of, spans_around
from shuttle_marl.data.schema import RANGES, STROKES, Account, stroke_table, unnamed, violations
from shuttle_marl.data.strict_csv import DataError, Problem, Sheet, grouped
from shuttle_marl.data.table import load_counted, validate, write_parquet
from shuttle_marl.game import court
from shuttle_marl.game.stroke import SHOTS
from tests.data import written_matches as written
from tests.data.test_written_matches import import_text

HERE = Path("f")
SAMPLE = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"


def refused(call: Callable[[], object]) -> str:
    """Message of a refusal; empty if there is none."""
    try:
        call()
    except DataError as error:
        return str(error)
    return ""


def sheet(**columns: list[str]) -> Sheet:
    """Columns as a table whose first row is on line 2."""
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    return sheet_of(HERE, b"", rows, range(2, len(rows) + 2))


def messages(sheet: Sheet) -> list[tuple[int | None, str]]:
    return [(found.line, found.message) for found in sheet.problems]


def nested(levels: int) -> bytes:
    return b"<a>" * levels + b"</a>" * levels


def test_xml_is_as_deep_and_as_large_as_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    assert tree.parse_xml(HERE, nested(50)).tag == "a"
    assert refused(lambda: tree.parse_xml(HERE, b"\n" + nested(51))) == "f, line 2: the XML is too deep or too large"
    assert len(tree.parse_xml(HERE, b"<a>" + nested(49) * 3 + b"</a>")) == 3, "what is closed is not deep"
    monkeypatch.setattr(tree, "_MOST_ELEMENTS", 4)
    assert len(tree.parse_xml(HERE, b"<a><b/><b/><b/></a>")) == 3
    assert "too large" in refused(lambda: tree.parse_xml(HERE, b"<a><b/><b/><b/><b/></a>"))


def test_scalars_of_json_as_text() -> None:
    values = (True, False, None, 3, 2.5, 0.1 + 0.2, 1e15, " x ", [1], {"a": 1})
    assert [tree.text(value) for value in values] == ["true", "false", "", "3", "2.5", "0.3", "1e+15", "x", "", ""]


def test_values_are_as_long_as_allowed() -> None:
    assert len(sheet(shot=["x" * 1000])) == 1
    assert refused(lambda: sheet(shot=["x", "y" * 1001])) == "f: a value of more than 1,000 characters in line 3"
    assert sheet_of(HERE, b"", [{"a": "1"}, {"b": "2"}], [4, 5]).columns == {"a": ("1", ""), "b": ("", "2")}


@pytest.mark.parametrize(
    ("told", "rate"),
    [("", 0), ("1", 1), ("10000", 10_000), ("30000/1001", 30000 / 1001), ("25 fps", 25), ("0.99", None), ("10000.1", None),
     ("0", None), ("1/0", None), ("x", None), ("2" + "0" * 18, None), ("25." + "0" * 16, 25), ("25." + "0" * 17, None)],
)  # fmt: skip
def test_rates_of_frames_are_bounded(told: str, rate: float | None) -> None:
    if rate is None:
        assert "expected frames a second" in refused(lambda: pipeline._rate(HERE, told))
    else:
        assert pipeline._rate(HERE, told) == rate


def test_frames_become_seconds_only_where_they_are_numbers() -> None:
    rows: list[dict[str, Any]] = [{"stroke_type": "smash", "frame": frame} for frame in (45, "60", "x", "1" * 19, "1" * 20)]
    rows[1]["time"] = 7
    reading = pipeline.read(HERE, b"", {"strokes": rows})
    assert reading.sheet.columns["seconds"] == ("1.500", "7", "", f"{int('1' * 19) / 30:.3f}", "")
    assert reading.inferred == ("times from frames, at 30 frames a second, because the file has no fps",)
    assert reading.lost == ("scores and how rallies ended",)
    with_rate = pipeline.read(HERE, b"", {"fps": 25, "strokes": rows[:1]})
    assert (with_rate.sheet.columns["seconds"], with_rate.inferred) == (("1.800",), ())


def test_strokes_are_found_eight_levels_deep_and_others_counted() -> None:
    value: Any = {"stroke_type": "smash"}
    for _ in range(8):
        value = {"inside": value}
    assert len(pipeline.read(HERE, b"", value).sheet) == 1
    assert "JSON without strokes" in refused(lambda: pipeline.read(HERE, b"", {"inside": value}))
    found = pipeline.read(HERE, b"", [{"stroke_type": "smash"}, {"pause": 1}, {"stroke_type": "drop"}, 3])
    assert (len(found.sheet), found.sheet.others, found.sheet.unit) == (2, 2, "stroke")


def test_rallies_of_lists_are_numbered_and_a_result_is_of_the_last_stroke() -> None:
    rally = {"result": "out", "shots": [{"type": "smash", "player": "Ada"}, {"type": "lift", "player": "Bea"}]}
    columns = pipeline.read(HERE, b"", {"rallies": [rally, rally]}).sheet.columns
    assert columns["rally"] == ("1", "1", "2", "2")
    assert columns["ending"] == ("", "out", "", "out")


ROWS = written.entries(written.match(3, "final", ("Anna", "Berta"), rallies=3), ("player", "shot", "ending", "seconds"))


def test_elan_needs_strokes_and_players_or_points() -> None:
    tiers = [[{name: value for name, value in row.items() if name in kept} for row in ROWS]
             for kept in (("seconds", "player"), ("seconds", "shot"), ("seconds", "shot", "player", "ending"))]  # fmt: skip
    expected = "expected Strokes, and Points or Player, with annotations"
    assert f"tiers 'player'; {expected}" in refused(lambda: import_text(written.as_elan(tiers[0])))
    assert f"tiers 'strokes'; {expected}" in refused(lambda: import_text(written.as_elan(tiers[1])))
    assert import_text(written.as_elan(tiers[2])).strokes.num_rows == len(ROWS)
    hours = written.as_elan(tiers[2]).replace('"milliseconds"', '"hours"')
    assert "times in hours; expected milliseconds" in refused(lambda: import_text(hours))


def test_slots_of_elan_without_a_time_lie_between_equal_times_too() -> None:
    content = written.as_elan(ROWS, dependent=True, untimed=[1])
    start, end = (f'<TIME_SLOT TIME_SLOT_ID="ts{k}" TIME_VALUE=' for k in (2, 4))
    at = content.partition(start)[2].split('"')[1]
    assert import_text(content).strokes.num_rows == len(ROWS)
    later = content.partition(end)[2].split('"')[1]
    assert import_text(content.replace(f'{end}"{later}"', f'{end}"{at}"')).strokes.num_rows == len(ROWS)
    before = content.replace(f'{end}"{later}"', f'{end}"{int(at) - 1}"')
    assert "has a time slot without a time" in refused(lambda: import_text(before))


def test_a_moment_belongs_to_the_last_span_around_it() -> None:
    spans = [(0.0, 10.0), (2.0, 4.0), (3.0, 3.0), (6.0, 12.0)]
    assert spans_around(spans, [-1, 0, 2, 3, 3.5, 4, 5, 6, 11, 12, 12.5]) == [0, 1, 2, 3, 2, 2, 1, 4, 4, 4, 0]


def test_a_file_has_so_many_matches_and_a_known_stroke(monkeypatch: pytest.MonkeyPatch) -> None:
    csv = "match,player,shot,ending\n" + "".join(f"{name},Ada,short serve,\n{name},Bea,clear,out\n" for name in "ab")
    monkeypatch.setattr("shuttle_marl.data.rallies._MOST_MATCHES", 2)
    assert import_text(csv).account.matches == 2
    monkeypatch.setattr("shuttle_marl.data.rallies._MOST_MATCHES", 1)
    assert "2 matches, more than 1; divide the file" in refused(lambda: import_text(csv))
    unknown = csv.replace("short serve", "unknown").replace("clear", "unknown")
    monkeypatch.setattr("shuttle_marl.data.rallies._MOST_MATCHES", 2)
    assert "no stroke of a known shot type" in refused(lambda: import_text(unknown))


MAP = '[columns]\nplayer = "p"\nshot = "s"\n'


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        (MAP, ""),
        (f'source = "{"x" * 1989}"\n{MAP}', ""),  # a line of 2,000 characters
        (f'source = "{"x" * 1990}"\n{MAP}', "a line of more than 2,000 characters"),
        (MAP + 'points = "a"\n', "needs points and points_opponent, or neither"),
        (MAP + 'points_opponent = "a"\n', "needs points and points_opponent, or neither"),
        (MAP + 'points = "a"\npoints_opponent = "b"\n', ""),
        (MAP.replace('player = "p"', ""), "[columns] lacks player"),
        ("[columns]\ngame = 'g'\n", "[columns] lacks player, shot"),
        ('source = "a\\u0007"\n' + MAP, "expected a line of text"), ("source = 3\n" + MAP, "source = 3; expected a line of text"),
        ('source = " "\n' + MAP, "expected a line of text"), ('source = "x"\n' + MAP, ""),
        ('delimiter = ";;"\n' + MAP, "expected one character"), ('delimiter = ""\n' + MAP, "expected one character"),
        ('delimiter = "."\n' + MAP, "expected one character, another than decimal"), ('delimiter = ";"\n' + MAP, ""),
        ("delimiter = 3\n" + MAP, "delimiter = 3; expected one character"),
        ('decimal = ","\ndelimiter = ","\n' + MAP, "another than decimal"), ('decimal = ","\n' + MAP, ""),
        ('discipline = "XD"\n' + MAP, "discipline = 'XD'; expected one of '', 'MS', 'WS'"), ('discipline = "MS"\n' + MAP, ""),
        ('coordinates = "net"\n' + MAP, "expected one of 'striker', 'court'"), ('coordinates = "striker"\n' + MAP, ""),
        ('coordinates = "court"\n' + MAP, 'needs the column side'), ('coordinates = "court"\n' + MAP + 'side = "e"\n', ""),
        ('areas_seen_by = "umpire"\n' + MAP, "expected one of 'receiver', 'striker'"), ('areas_seen_by = "striker"\n' + MAP, ""),
        (MAP + '[values.player]\n"a" = "x\\u0007"\n', "expected a name"),
        (MAP + '[values.player]\n"a" = " "\n', "expected a name"),
        (MAP + '[values.player]\n"a" = 3\n', "'a' = 3; expected a name"), (MAP + '[values.player]\n"a" = "B"\n', ""),
        (MAP + '[values.shot]\n"a" = "smash"\n"A " = "smash"\n', ""),
        (MAP + '[values.side]\n"a" = "up"\n', "expected one of near, far"),
        (MAP + '[values.shot]\n"a" = "smash"\n"A " = "clear"\n', "stands there twice, with different meanings"),
        (MAP + '[values.seconds]\n"a" = "b"\n', "no column with words 'seconds'"),
        (MAP + "[values]\nshot = 3\n", "object has no"),
        (MAP + "x = 1\n", "no column 'x'; expected one of match, discipline"), ("wind = 1\n" + MAP, "no setting 'wind'"),
    ],
)  # fmt: skip
def test_settings_of_a_column_map(tmp_path: Path, fields: str, says: str) -> None:
    path = tmp_path / "map.toml"
    path.write_text(fields, encoding="utf-8")
    told = refused(lambda: ColumnMap.read(path))
    assert says in told
    assert bool(told) == bool(says)


def test_a_column_map_is_no_larger_than_allowed(tmp_path: Path) -> None:
    path = tmp_path / "map.toml"
    line = "#" + "x" * 1022 + "\n"
    path.write_text(line * 256)  # 2^18 bytes
    assert ColumnMap.read(path) == ColumnMap()
    path.write_text(line * 256 + "\n")
    assert "no readable TOML (larger than 0.25 MB)" in refused(lambda: ColumnMap.read(path))


def columns_of(table: Sheet, *names: str, **settings: Any) -> Columns:
    return Columns(table, ColumnMap(columns=dict.fromkeys(names) | {name: name for name in names}, **settings), strict=True)


def test_whole_numbers_and_probabilities_of_columns() -> None:
    table = sheet(frame=["0", "10000000", "10000001", "-1", "2.5", ""], seconds=["0.9", "100000", "100001", "2.5", "-0.1", ""])
    columns = columns_of(table, "frame", "seconds")
    nan = np.nan
    np.testing.assert_array_equal(columns.whole("frame", "frame"), [0, 1e7, nan, nan, nan, nan])
    np.testing.assert_array_equal(columns.whole("seconds", "clock"), [0, 100_000, nan, 2, nan, nan])
    low_high = {"frame": "expected a whole number from 0 to 10000000", "seconds": "expected a whole number from 0 to 100000"}
    assert messages(table) == [
        (4, f"frame 1e+07; {low_high['frame']}"), (5, f"frame -1; {low_high['frame']}"), (6, f"frame 2.5; {low_high['frame']}"),
        (4, f"seconds 100001; {low_high['seconds']}"), (6, f"seconds -0.1; {low_high['seconds']}"),
    ]  # fmt: skip
    np.testing.assert_array_equal(columns.whole("points", "points"), [nan] * 6)
    assert columns.integers("game", 1).tolist() == [1] * 6
    table = sheet(confidence=["0", "1", "1.01", "-0.01", "", "0.5"])
    np.testing.assert_array_equal(columns_of(table, "confidence").probabilities("confidence"), [0, 1, 1.01, -0.01, nan, 0.5])
    assert messages(table) == [(4, "confidence 1.01; expected 0 to 1"), (5, "confidence -0.01; expected 0 to 1")]


def test_points_and_areas_of_columns() -> None:
    table = sheet(landing_x=["1.5", "-2", ""], landing_y=["2", "6", ""], side=["near", "far", "far"], area=["front-left"] * 3)
    columns = columns_of(table, "landing_x", "landing_y", "side", coordinates="court")
    np.testing.assert_array_equal(columns.points()["landing"], [[1.5, 2], [2, -6], [np.nan] * 2])
    assert np.isnan(columns.points()["contact"]).all()
    landing = np.array([[2.0, 1.0], [-2.0, 6.0], [np.nan] * 2])
    named = columns_of(table, "area")
    computed = [court.AREAS.index(name) for name in ("front-left", "back-right")]
    assert named.areas(landing).tolist() == [*computed, court.AREAS.index("front-left")]
    assert [warning.line for warning in table.warnings] == [3]
    assert columns_of(table, "area", areas_seen_by="striker").areas(landing)[2] == court.AREAS.index("front-right")
    right = sheet(area=["front-right", "front-left", ""])
    assert columns_of(right, "area").areas(np.tile([2.0, 1.0], (3, 1))).tolist() == [computed[0]] * 3
    assert [warning.line for warning in right.warnings] == [2]
    centre = columns_of(sheet(area=["back-centre", ""]), "area", areas_seen_by="striker")
    assert centre.areas(np.full((2, 2), np.nan)).tolist() == [court.AREAS.index("back-centre"), -1]
    assert columns_of(table, "side").areas(landing).tolist() == [*computed, -1]


def test_copies_are_games_that_share_half_of_ten_strokes() -> None:
    def game(name: str, number: int, lengths: list[int], seed: int) -> list[tuple[str, int, int, int]]:
        rng = np.random.default_rng(seed)
        return [(name, number, rally, shot) for rally, n in enumerate(lengths, 1) for shot in rng.integers(2, 13, n).tolist()]

    def told(*games: list[tuple[str, int, int, int]]) -> list[str]:
        match, number, rally, shot = zip(*[row for rows in games for row in rows], strict=True)
        columns = {"match": list(match), "game": list(number), "rally": list(rally), "shot": list(shot)}
        table = pa.table(columns | {"technique": pa.nulls(len(match), pa.int8()), "area": pa.nulls(len(match), pa.int8())})
        return copies(table)

    one = game("a", 1, [5, 5], 1)
    same = [("b", 2, rally, shot) for _, _, rally, shot in one]
    sentence = "game 2 of 'b' has the strokes of game 1 of 'a': are they one?"
    assert told(one) == []
    assert told(one, same) == [sentence]
    assert told(one[:9], same[:9]) == [], "nine strokes"
    more = game("b", 2, [4, 6, 9], 2)[4:]
    assert told(one, [*same, *[(*row[:2], row[2] + 1, row[3]) for row in more][:10]]) == [sentence], "all of the shorter game"
    assert told([*one, *game("a", 1, [1, 1, 11], 3)[2:]], [*same, *game("b", 2, [1, 1, 11], 4)[2:]]) == [], "10 of 21"
    assert told([*one, *game("a", 1, [1, 1, 10], 3)[2:]], [*same, *game("b", 2, [1, 1, 10], 4)[2:]]) == [sentence], "10 of 20"


def test_ends_change_between_games() -> None:
    assert [end_of(word) for word in ("top", "player_near", "Far side", "left", "RIGHT court", "middle", "Ada", "")] == [
        "far", "near", "far", "left", "right", "", "", ""
    ]  # fmt: skip
    ends = ends_in({"top": "Ada", "bottom": "Bea", "x": "Cleo"})
    assert ends == {"far": "Ada", "near": "Bea"}
    assert at_ends(ends, ["top", "bottom", "top", "bottom", "top", "x"], [1, 1, 2, 2, 3, 1], 1) == [
        "Ada", "Bea", "Bea", "Ada", "", ""
    ]  # fmt: skip
    assert at_ends(ends, ["top", "left"], [2, 2], 2) == ["Ada", ""], "the part of a file may begin with the second game"


@pytest.mark.parametrize(("n", "share", "shown"), [
    (10, 0.7, 1), (10, 0.69, None), (10, 0.3, 0), (10, 0.31, None), (9, 1.0, None), (10, 1.0, 1), (10, 0.0, 0), (0, None, None),
])  # fmt: skip
def test_the_hand_that_strokes_show(n: int, share: float | None, shown: int | None) -> None:
    hand = PlayerHand(hand=shown, n=n, share=share)
    assert hand.shown == shown
    assert hand.name == ("unknown" if shown is None else ("right", "left")[shown])


def test_problems_with_equal_messages_are_one() -> None:
    first, other, again = Problem(HERE, "a", 3), Problem(HERE, "b", 4), Problem(HERE, "a", 9)
    assert grouped([first, other, again]) == [Problem(HERE, "a (2 times, first here)", 3), other]
    error = DataError.of([first, other, again], advice=("f",))
    assert str(error).startswith("f, line 3: a (2 times, first here) (and 1 more; `")
    assert error.problems == tuple(grouped([first, other, again]))
    assert str(DataError.of([other])) == "f, line 4: b"
    assert DataError(HERE, "c", line=2).problems == (Problem(HERE, "c", 2),)


# Tables of strokes.


def test_codes_of_names() -> None:
    names = pa.chunked_array([["smash", None, "clear"]])
    assert unnamed("shot", names).to_pylist() == [SHOTS.index("smash"), None, SHOTS.index("clear")]
    assert unnamed("shot", names.dictionary_encode()).to_pylist() == [SHOTS.index("smash"), None, SHOTS.index("clear")]
    assert unnamed("shot", names.cast(pa.large_string())).type == pa.int8()
    assert unnamed("shot", pa.chunked_array([[3, None]])).to_pylist() == [3, None]
    for wrong, says in ((["smash", "smsh"], "'smsh'; expected short-serve, "), (["\x1b"], r"'\\x1b'")):
        with pytest.raises(pa.ArrowInvalid) as caught:
            unnamed("shot", pa.chunked_array([wrong]))
        assert says in str(caught.value)


def stored(folder: Path, change: Callable[[pa.Table], pa.Table]) -> Path:
    """The first strokes of the sample as a file, after a change of the table as it is stored."""
    few = read_matches(SAMPLE).slice(0, 40)
    write_parquet(few, folder / "a.parquet", account=Account.of(few), provenance={})
    table_files.write_parquet(folder / "b.parquet", change(table_files.read_parquet(folder / "a.parquet")))
    return folder / "b.parquet"


def with_metadata(name: bytes, value: bytes | None) -> Callable[[pa.Table], pa.Table]:
    def change(table: pa.Table) -> pa.Table:
        told = {key: text for key, text in table.schema.metadata.items() if key != name}
        return table.replace_schema_metadata(told if value is None else {**told, name: value})

    return change


def with_column(name: str, column: Any) -> Callable[[pa.Table], pa.Table]:
    def change(table: pa.Table) -> pa.Table:
        values = column(table) if callable(column) else column
        return table.set_column(table.schema.get_field_index(name), name, values)

    return change


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda table: table, ""),
        (with_metadata(b"version", b"9"), "schema version b'9', expected b'2'; create it again with"),
        (lambda table: table.drop_columns(["shot"]), "column 'shot' is missing; create it again with"),
        (lambda table: table.drop_columns(["hurried", "forced", "inferred", "confidence"]), ""),
        (lambda table: table.append_column("more", pa.nulls(40)), "confidence, inferred, more; expected match, source"),
        (lambda table: table.select([*table.column_names[1:], "match"]), "in this order; create it again with"),
        (with_column("game", lambda table: table["game"].cast(pa.int64())), "column 'game' is int64, expected int8 not null"),
        (with_column("points", pa.array([1.5] * 40)), "column 'points' is double, expected int8"),
        (with_metadata(b"shuttle_marl.account", b"3"), "contains no account of its strokes"),
        (with_metadata(b"shuttle_marl.account", None), "contains no account of its strokes"),
    ],
)  # fmt: skip
def test_tables_of_another_schema(tmp_path: Path, change: Callable[[pa.Table], pa.Table], says: str) -> None:
    path = stored(tmp_path, change)
    told = refused(lambda: load_counted(path))
    assert says in told
    assert bool(told) == bool(says)


def test_tables_of_other_programs_need_no_account_and_keep_the_rules(tmp_path: Path) -> None:
    few = read_matches(SAMPLE).slice(0, 40)
    plain = few.replace_schema_metadata(None)
    pq.write_table(plain, tmp_path / "c.parquet")
    strokes, account = load_counted(tmp_path / "c.parquet")
    assert (strokes.num_rows, account) == (40, Account.of(few))
    assert strokes.schema.metadata == STROKES.metadata
    column = pa.array([None, *few["player"].to_pylist()[1:]])
    pq.write_table(plain.set_column(plain.schema.get_field_index("player"), "player", column), tmp_path / "c.parquet")
    assert "column 'player' lacks 1 values" in refused(lambda: load_counted(tmp_path / "c.parquet"))


@pytest.mark.parametrize(
    ("strokes", "matches", "says"),
    [(0, 0, []), (1, 0, ["41 strokes, the table 40", "do not add up"]), (-1, 0, ["39 strokes, the table 40", "do not add up"]),
     (0, 1, []), (0, -1, ["0 matches, the table 1"])],
)  # fmt: skip
def test_an_account_is_that_of_its_table(tmp_path: Path, strokes: int, matches: int, says: list[str]) -> None:
    few = read_matches(SAMPLE).slice(0, 40)
    account = Account.of(few, total=45, dropped={"let": 5}, matches=1 + matches).as_json()
    account["strokes"]["kept"] += strokes
    path = stored(tmp_path, with_metadata(b"shuttle_marl.account", json.dumps(account).encode()))
    report = validate(path)
    assert [part in problem.message for part, problem in zip(says, report.problems, strict=True)] == [True] * len(says)
    assert report.notes == ()
    assert report.account == Account.from_json(account)


def test_an_account_is_read_as_it_was_written() -> None:
    few = read_matches(SAMPLE).slice(0, 40)
    account = Account.of(
        few, matches=3, total=50, rallies=9, dropped={"let": 4, "empty row": 0, "no stroke": 6}, area_agreement=0.5
    )
    rallies = len({(row["match"], row["game"], row["rally"]) for row in few.select(["match", "game", "rally"]).to_pylist()})
    assert account.as_json() == {
        "matches": 3, "rallies": {"total": 9, "kept": rallies}, "strokes": {"total": 50, "kept": 40},
        "dropped": {"let": 4, "no stroke": 6}, "area_agreement": 0.5,
    }  # fmt: skip
    assert Account.from_json(account.as_json()) == account
    whole = Account.of(few)
    assert (whole.matches, whole.rallies, whole.strokes, whole.dropped, whole.area_agreement) == (1, rallies, 40, {}, None)


# Rules of strokes.

SOUND: list[dict[str, Any]] = [
    {"stroke": 1, "player": "a", "opponent": "b", "shot": 0, "points": 1, "points_opponent": 0, "clock": 5, "frame": 150},
    {"stroke": 2, "player": "b", "opponent": "a", "shot": 3, "points": 0, "points_opponent": 1, "clock": 5, "frame": 151},
    {"stroke": 3, "player": "a", "opponent": "b", "shot": 4, "points": 1, "points_opponent": 0, "clock": 6, "frame": 180,
     "outcome": 2, "reason": 5},
    {"stroke": 1, "rally": 2, "player": "a", "opponent": "b", "shot": 1, "points": 1, "points_opponent": 1, "outcome": 1,
     "reason": 1},
]  # fmt: skip


def broken(changes: dict[int, dict[str, Any]]) -> list[str]:
    """Rules that sound strokes break after changes of some rows."""
    usual = {"match": "m", "source": "s", "discipline": "MS", "game": 1, "rally": 1, "height": 0, "technique": 0, "outcome": 0,
             "reason": 0}  # fmt: skip
    rows = [{**usual, **row, **changes.get(i, {})} for i, row in enumerate(SOUND)]
    rows = [row for row in rows if not row.get("gone")]
    columns = {name: pa.array([row.get(name) for row in rows], STROKES.field(name).type) for name in STROKES.names}
    return [found.rule for found in violations(stroke_table(columns, {}))]


@pytest.mark.parametrize(
    ("changes", "rule"),
    [
        ({}, ""),
        ({3: {"source": ""}}, "source is named"), ({3: {"discipline": "XD"}}, "discipline is one of MS, WS"),
        *(({1: {name: value}}, f"{name} lies between {low} and {high}")
          for name, (low, high) in RANGES.items() if name != "hand" for value in (low - 1, high + 1) if -128 <= value < 128),
        ({0: {"hand": 0}, 2: {"hand": 0}, 1: {"hand": 1}}, ""), ({0: {"hand": 0}, 3: {"hand": 1}}, "all known hands of a player"),
        ({0: {"hand": 0, "source": "simulated"}, 3: {"hand": 1, "source": "simulated"}}, "all known hands of a player"),
        ({3: {"match": "n"}}, ""), ({1: {"match": "n"}}, "the rows of a match stand together"),
        ({3: {"game": 2, "rally": 1}}, ""), ({0: {"game": 2}}, "games of a match are in order"),
        ({0: {"rally": 3}}, "rallies of a game are in order"),
        ({1: {"stroke": 1}}, "strokes of a rally rise"), ({1: {"stroke": 4}}, "strokes of a rally rise"),
        ({1: {"clock": 4}}, "clock never falls in a rally"), ({1: {"clock": None}, 2: {"clock": 4}}, "clock never falls"),
        ({1: {"frame": 150}}, "frame rises in a rally"), ({1: {"frame": None}, 2: {"frame": 150}}, "frame rises in a rally"),
        ({3: {"clock": 0, "frame": 0}}, ""),
        ({3: {"opponent": "a"}}, "player and opponent differ"), ({3: {"opponent": "c"}}, "a match has two players"),
        ({3: {"opponent": "c", "match": "n"}}, ""),
        ({1: {"player": "a", "opponent": "b", "points": 1, "points_opponent": 0}}, "players alternate in a rally"),
        ({1: {"gone": True}}, ""), ({0: {"gone": True}, 1: {"gone": True}}, ""),
        ({1: {"points": 1}}, "the score is the same in all rows of a rally"),
        ({1: {"points": None}}, "the score is the same in all rows of a rally"),
        ({1: {"discipline": "WS"}}, "discipline is the same in all rows of a match"),
        ({1: {"outcome": 3, "reason": 7}}, "only the last stroke of a rally ends it"),
        ({2: {"outcome": 0}}, "a returned stroke, and no other"), ({2: {"reason": 0}}, "a returned stroke, and no other"),
        *(({3: {"reason": reason}}, "a fault is out, net, short" if reason in (5, 6) else "") for reason in range(1, 8)),
        *(({2: {"reason": reason}}, "" if reason > 4 else "a winner landed, was misjudged") for reason in range(1, 8)),
        *(({3: {"outcome": 3, "reason": reason}}, "an unknown outcome has no reason" if reason < 7 else "")
          for reason in range(1, 8)),
        ({1: {"shot": 1}}, "the first stroke of a rally, and no other"), ({0: {"shot": 2}}, "the first stroke of a rally"),
        ({0: {"height": 1}}, "serves are struck below the net"), ({1: {"height": 1}}, ""),
        ({0: {"hurried": True}}, "no serve is hurried"), ({0: {"hurried": False}, 1: {"hurried": True}}, ""),
        ({3: {"forced": True}}, ""), ({2: {"forced": False}}, "only faults are forced or unforced"),
        ({1: {"confidence": 1.0}, 2: {"confidence": 0.0}}, ""), ({1: {"confidence": 1.01}}, "confidence lies between 0 and 1"),
        ({1: {"confidence": -0.01}}, "confidence lies between 0 and 1"),
        ({1: {"contact_x": 1.0}}, "contact: both coordinates or none"),
        *(({1: {f"{name}_x": x, f"{name}_y": y}}, rule)
          for name, sign in (("contact", -1), ("striker", -1), ("receiver", 1))
          for x, y, rule in ((8.04, 11.69 * sign, ""), (8.06, sign, f"{name} lies on or near"),
                             (0.0, 11.71 * sign, f"{name} lies"),
                             (-8.06, sign, f"{name} lies"), (np.inf, sign, f"{name} lies"),
                             (0.0, np.inf * sign, f"{name} lies"))),
        ({1: {"striker_x": 0.0, "striker_y": 0.0, "receiver_x": 0.0, "receiver_y": 0.0}}, ""),
        ({1: {"striker_x": 0.0, "striker_y": 0.01}}, "the striker stands in the own half"),
        ({1: {"receiver_x": 0.0, "receiver_y": -0.01}}, "the receiver stands in the other half"),
        ({1: {"contact_x": 0.0, "contact_y": 0.5}}, ""),
        ({1: {"contact_x": 0.0, "contact_y": 0.51}}, "the contact lies at most 0.5 m"),
        ({0: {"contact_x": 0.0, "contact_y": -1.0}}, "serves have no contact point"),
        ({1: {"landing_x": 0.0, "landing_y": -0.5, "area": 1, "in_court": False}}, ""),
        ({1: {"landing_x": 0.0, "landing_y": -0.51, "area": 1, "in_court": False}}, "only faults land over 0.5 m"),
        ({3: {"landing_x": 0.0, "landing_y": -0.51, "area": 1, "in_court": False}}, ""),
        ({1: {"landing_x": 0.0, "landing_y": 6.0, "area": 7, "in_court": True}}, ""),
        ({1: {"landing_x": 0.0, "landing_y": 6.0, "area": 8, "in_court": True}}, "area is the area of the landing"),
        ({1: {"landing_x": 0.0, "landing_y": 6.0, "in_court": True}}, "area is the area of the landing"),
        ({1: {"landing_x": 0.0, "landing_y": 6.0, "area": 7, "in_court": False}}, "in_court tells whether"),
        ({1: {"landing_x": 0.0, "landing_y": 6.0, "area": 7}}, "in_court tells whether"),
        ({1: {"area": 7}}, ""),
    ],
)  # fmt: skip
def test_the_rules_of_strokes(changes: dict[int, dict[str, Any]], rule: str) -> None:
    found = broken(changes)
    assert any(text.startswith(rule) for text in found) if rule else found == []
