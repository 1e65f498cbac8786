"""The command line of the data, stroke tables as Parquet files, and the invariants, broken one by one."""

import hashlib
import json
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from shuttle_marl.base.errors import command
from shuttle_marl.commands.data import main
from shuttle_marl.data import DataError, clean_matches, matches_of, read_matches, upstream, validate
from shuttle_marl.data.hands import telling_hands
from shuttle_marl.data.schema import STROKES, violations
from shuttle_marl.data.table import load_counted, provenance_of, write_parquet
from shuttle_marl.game.court import AREAS, HANDS
from shuttle_marl.game.stroke import SHOTS
from tests.data.upstream_layout import Layout, plain_game

NAME = matches_of("train")[0]


@pytest.fixture
def root(tmp_path: Path) -> Path:
    layout = Layout(tmp_path / "raw")
    rows = plain_game(4)
    rows[0]["type"] = "未知球種"
    layout.match(NAME, [rows])
    return tmp_path / "raw"


def publish(root: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Take the data set for the published one."""
    manifest = {
        path.relative_to(root).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(root.rglob("*.csv"))
    }
    monkeypatch.setattr(upstream, "manifest", lambda: manifest)
    return root


@pytest.fixture
def published(root: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return publish(root, monkeypatch)


SUMMARY = {
    "matches": 1,
    "rallies": {"total": 4, "kept": 4},
    "strokes": {"total": 13, "kept": 12},
    "dropped": {"unknown shot type": 1},
    "area_agreement": 1.0,
    "hands": {name: {"hand": "unknown", "n": 0, "share": None} for name in ("chen-long", "viktor-axelsen")},
}


def test_convert_and_summary_of_the_file(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new folder" / "strokes.parquet"
    assert main(["convert", str(root), "--out", str(out)]) == 0
    told = capsys.readouterr().out
    assert "unknown shot type" in told
    assert "Please cite" in told
    assert read_matches(out).num_rows == 12
    for source in (root, out):
        assert main(["summary", str(source), "--json"]) == 0
        assert json.loads(capsys.readouterr().out) == SUMMARY
    assert main(["validate", str(out)]) == 0
    assert "no problems" in capsys.readouterr().out


def test_validate_a_whole_folder(published: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (published / "ShuttleSet/set/Stranger").mkdir()
    assert main(["validate", str(published)]) == 0
    out = capsys.readouterr().out
    assert "train: 1 of 1 files as published, complete" in out
    assert "Stranger: not in match.csv, so it is not read" in out
    assert "no problems" in out


def test_validate_names_missing_and_altered_files(published: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = published / "ShuttleSet/set"
    (folder / NAME / "set1.csv").unlink()
    with (folder / "match.csv").open("a") as file:
        file.write("\n")
    assert main(["validate", str(published)]) == 1
    out = capsys.readouterr().out
    assert f"{folder / NAME}: missing set1.csv (train split); download them with `{command('data', 'download')}`" in out
    assert f"{folder / 'match.csv'}: altered: SHA-256 is " in out
    assert "train: 0 of 1 files as published, incomplete" in out


def test_validate_tells_every_problem(published: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = published / "ShuttleSet/set" / NAME / "set1.csv"
    text = path.read_text(encoding="utf-8").replace("殺球", "飛球").replace(",8,", ",88,", 1)
    path.write_text(text, encoding="utf-8")
    assert main(["validate", str(published), "--json"]) == 1
    captured = capsys.readouterr()
    report = json.loads(captured.out)
    assert len([p for p in report["problems"] if "unknown type '飛球'" in p]) == 2
    assert any("altered: SHA-256" in p for p in report["problems"])
    assert report["splits"]["train"] == {"whole": 0, "files": 1}
    assert f"{len(report['problems'])} problems" in captured.err


def test_wrong_values_of_a_published_file_are_notes(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = root / "ShuttleSet/set" / NAME / "set1.csv"
    path.write_text(path.read_text(encoding="utf-8").replace("殺球", "飛球", 1), encoding="utf-8")
    report = validate(publish(root, monkeypatch))
    assert report.problems == ()
    assert [note.endswith("(in the published file: the row is dropped)") for note in report.notes] == [True]
    assert clean_matches(root).account.dropped == {"unknown shot type": 1, "unreadable value": 1}


def test_validate_an_empty_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["validate", str(tmp_path), "--json"]) == 1
    report = json.loads(capsys.readouterr().out)
    assert any("contains none of the published data sets" in problem for problem in report["problems"])
    assert report["splits"]["test"] == {"whole": 0, "files": 30}


def test_validate_a_bad_table(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = read_matches(root).to_pylist()
    rows[3]["technique"] = 9
    rows[4]["height"] = 7
    path = tmp_path / "bad.parquet"
    account = {b"shuttle_marl.account": json.dumps(load_counted(root)[1].as_json())}
    schema = STROKES.with_metadata({**STROKES.metadata, **account})
    pq.write_table(pa.Table.from_pylist(rows[1:], schema=schema), path)  # codes without a name cannot be written as names
    assert main(["validate", str(path), "--json"]) == 1
    problems = json.loads(capsys.readouterr().out)["problems"]
    assert any("technique lies between 0 and 2: 1 rows break it, first row 2" in problem for problem in problems)
    assert any("height lies between 0 and 1" in problem for problem in problems)
    assert any("account has 12 strokes in" in problem and "the table 11 strokes in" in problem for problem in problems)


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two matches, one of them of two games, 32 strokes."""
    layout = Layout(tmp_path_factory.mktemp("raw"))
    layout.match("one", [plain_game(4), plain_game(2, a_below=False)])
    layout.match("two", [plain_game(4)], number=2, players=("CHEN Yufei", "HE Bingjiao"))
    return layout.root


@pytest.fixture(scope="module")
def strokes(raw: Path) -> pa.Table:
    return clean_matches(raw).strokes


@pytest.fixture
def file(tmp_path: Path, raw: Path) -> Path:
    path, cleaned = tmp_path / "strokes.parquet", clean_matches(raw)
    write_parquet(cleaned.strokes, path, account=cleaned.account, provenance=provenance_of(raw, cleaned))
    return path


def test_round_trip(raw: Path, strokes: pa.Table, file: Path) -> None:
    assert read_matches(file).equals(strokes)
    assert read_matches(str(raw)).equals(strokes)
    again = read_matches(raw)  # from the cache
    assert again.equals(strokes)
    assert again.schema.equals(strokes.schema, check_metadata=True)
    with telling_hands(["chen-yufei=left"]):
        told = read_matches(raw)
    assert told.filter(pc.equal(told["player"], "chen-yufei"))["hand"].unique().to_pylist() == [HANDS.index("left")]
    assert load_counted(file)[1] == load_counted(raw)[1] == clean_matches(raw).account
    metadata = pq.read_schema(file).metadata
    assert b"39bbf3fd99b0b709ff6d1647383959b6fa5f5b74" in metadata[b"shuttle_marl.provenance"]
    assert b"2306.04948" in metadata[b"shuttle_marl.provenance"]
    assert pq.read_metadata(file).row_group(0).column(0).compression == "ZSTD"
    assert pq.read_schema(file).field("area").metadata[b"description"] == STROKES.field("area").metadata[b"description"]


def test_other_programs_read_names(file: Path, strokes: pa.Table) -> None:
    """And what they write is read again, with names or codes."""
    import pandas as pd

    table = pd.read_parquet(file)
    assert set(table["shot"]) <= set(SHOTS)
    assert table["shot"].dtype == "category"
    assert table[table["outcome"] == "winner"]["area"].isin(AREAS).all()
    for form in (table, table.assign(shot=table["shot"].astype(str)), table.assign(shot=table["shot"].cat.codes)):
        form.to_parquet(file)
        assert read_matches(file).equals(strokes)
    table.assign(shot="dropshot").to_parquet(file)
    with pytest.raises(DataError, match=r"column 'shot' is no int8 .*'dropshot'; expected short-serve, long-serve"):
        read_matches(file)


def test_polars_and_duckdb_read_names(file: Path, strokes: pa.Table) -> None:
    import duckdb
    import polars

    counted = polars.read_parquet(file).group_by("shot").len().rows()
    assert {str(shot) for shot, _ in counted} <= set(SHOTS)
    query = f"select shot, count(*) from '{file}' where outcome = 'returned' group by shot"
    assert sum(n for _, n in duckdb.sql(query).fetchall()) == pc.sum(pc.equal(strokes["outcome"], 0)).as_py()


def test_damaged_parquet(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[8:1500] = bytes(1492)
    file.write_bytes(content)
    with pytest.raises(DataError, match=r"strokes\.parquet: cannot be read \(it was changed after it was written"):
        read_matches(file)


@pytest.mark.parametrize(("change", "told"), [
    (lambda t: t.drop_columns(["area"]), "column 'area' is missing"),
    (lambda t: t.set_column(9, "shot", t["shot"].cast(pa.int64())), "column 'shot' is int64, expected dictionary<"),
    (lambda t: t.select(t.column_names[::-1]), "in this order"),
    (lambda t: t.replace_schema_metadata({"version": "1"}), "schema version b'1', expected b'2'"),
])  # fmt: skip
def test_another_schema(tmp_path: Path, strokes: pa.Table, change: Any, told: str) -> None:
    path = tmp_path / "other.parquet"
    pq.write_table(change(strokes), path)
    with pytest.raises(DataError) as caught:
        read_matches(path)
    assert told in str(caught.value)


@pytest.mark.parametrize("order", [[("player", "ascending")], [("rally", "descending")]], ids=["by player", "reversed"])
def test_rows_in_another_order_are_refused(file: Path, order: Any, capsys: pytest.CaptureFixture[str]) -> None:
    pq.write_table(pq.read_table(file).sort_by(order), file)  # with its account
    with pytest.raises(DataError, match=r"rows break it, first row \d+ .*; sort by game, rally and stroke in each match, or"):
        read_matches(file)
    assert main(["summary", str(file)]) == 1
    assert "sort by game" in capsys.readouterr().err


def test_sound_tables_break_no_rule(strokes: pa.Table) -> None:
    assert list(violations(strokes)) == []
    assert list(violations(strokes.slice(0, 0))) == []
    assert list(violations(strokes.filter(pa.compute.greater(strokes["stroke"], 1)))) == []


@pytest.mark.parametrize(("row", "values", "rule"), [
    (4, {"source": ""}, "source is named"),
    (4, {"discipline": "XD"}, "discipline is one of MS, WS"),
    (4, {"discipline": "WS"}, "discipline is the same in all rows of a match"),
    (4, {"source": "simulated"}, "source is the same in all rows of a match"),
    (4, {"shot": 13}, "shot lies between 0 and 12"),
    (4, {"shot": 0}, "the first stroke of a rally, and no other, is a serve"),
    (0, {"shot": 4}, "the first stroke of a rally, and no other, is a serve"),
    (0, {"height": 1}, "serves are struck below the net"),
    (0, {"hurried": True}, "no serve is hurried"),
    (4, {"technique": -1}, "technique lies between 0 and 2"),
    (4, {"points": 31}, "points lies between 0 and 30"),
    (4, {"points": 9}, "the score is the same in all rows of a rally"),
    (4, {"stroke": 1}, "strokes of a rally rise"),
    (4, {"stroke": 3}, "players alternate in a rally"),
    (4, {"game": 2}, "games of a match are in order"),
    (4, {"rally": 7}, "rallies of a game are in order"),
    (4, {"match": "two"}, "the rows of a match stand together"),
    (4, {"player": "stranger"}, "a match has two players"),
    (4, {"player": "viktor-axelsen"}, "player and opponent differ"),
    (4, {"clock": 0}, "clock never falls in a rally"),
    (4, {"frame": 2000}, "frame rises in a rally"),
    (4, {"outcome": 1, "reason": 1}, "only the last stroke of a rally ends it"),
    (4, {"reason": 7}, "a returned stroke, and no other, has the reason returned"),
    (2, {"reason": 1}, "a winner landed, was misjudged or is unknown"),
    (5, {"reason": 5}, "a fault is out, net, short, foul or unknown"),
    (5, {"outcome": 3}, "an unknown outcome has no reason"),
    (4, {"area": 0}, "area is the area of the landing"),
    (4, {"area": None}, "area is the area of the landing"),
    (4, {"in_court": False}, "in_court tells whether the landing lies in court"),
    (4, {"landing_x": None}, "landing: both coordinates or none"),
    (4, {"forced": True}, "only faults are forced or unforced"),
    (4, {"confidence": 1.5}, "confidence lies between 0 and 1"),
    (4, {"landing_x": 9.0}, "landing lies on or near the court"),
    (4, {"landing_y": -0.6}, "only faults land over 0.5 m in the striker's half"),
    (4, {"contact_y": 0.6}, "the contact lies at most 0.5 m beyond the net"),
    (3, {"contact_x": 0.0, "contact_y": -2.0}, "serves have no contact point"),
    (4, {"striker_y": 1.0}, "the striker stands in the own half (striker_y <= 0)"),
    (4, {"receiver_y": -1.0}, "the receiver stands in the other half (receiver_y >= 0)"),
    (4, {"receiver_x": float("inf")}, "receiver lies on or near the court"),
])  # fmt: skip
def test_each_rule_is_checked(strokes: pa.Table, row: int, values: dict[str, Any], rule: str) -> None:
    # Where a row is compared with the one before it, the next row differs again.
    compared = {
        "source is the same in all rows of a match": [4, 5],
        "discipline is the same in all rows of a match": [4, 5],
        "the score is the same in all rows of a rally": [4, 5],
        "players alternate in a rally": [4, 5],
        "a match has two players": [4, 5],
        "games of a match are in order": [5],
        "rallies of a game are in order": [5],
        "the rows of a match stand together": [5, 19],
    }
    assert broken(strokes, {row: values})[rule] == compared.get(rule, [row])


def broken(strokes: pa.Table, changes: dict[int, dict[str, Any]]) -> dict[str, list[int]]:
    """Rows that break each rule after changes of some rows."""
    rows = strokes.to_pylist()
    for row, values in changes.items():
        rows[row] |= values
    return {found.rule: found.rows.tolist() for found in violations(pa.Table.from_pylist(rows, schema=STROKES))}


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("hand", 0, 1), ("shot", 0, 12), ("height", 0, 1), ("technique", 0, 2), ("area", 0, 8), ("label_area", 0, 8),
        ("outcome", 0, 3), ("reason", 0, 8), ("game", 1, 9), ("rally", 1, 9999), ("stroke", 1, 9999), ("points", 0, 30),
        ("points_opponent", 0, 30), ("clock", 0, 100_000), ("frame", 0, 10_000_000),
    ],
)  # fmt: skip
def test_ranges_of_numbers(strokes: pa.Table, name: str, low: int, high: int) -> None:
    found = broken(strokes, {row: {name: value} for row, value in ((4, low - 1), (5, low), (6, high), (7, high + 1))})
    assert found[f"{name} lies between {low} and {high}"] == [4, 7]


@pytest.mark.parametrize("name", ["landing", "contact", "striker", "receiver"])
def test_points_lie_at_most_5_m_outside_the_lines(strokes: pa.Table, name: str) -> None:
    values: dict[str, tuple[float, float]] = {"x": (3.05 + 5, 3.05 + 5.01), "y": (6.7 + 5, 6.7 + 5.01)}
    for axis, (near, far) in values.items():
        numbers = {4: near - 1e-5, 5: far, 7: 1e-5 - near, 8: -far, 9: float("-inf")}
        found = broken(strokes, {row: {f"{name}_{axis}": number} for row, number in numbers.items()})
        assert found[f"{name} lies on or near the court"] == [5, 8, 9]
    assert broken(strokes, {4: {f"{name}_x": None}, 5: {f"{name}_y": None}})[f"{name}: both coordinates or none"] == [4, 5]


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({1: {"clock": 33}, 2: {"clock": 33}}, {}),
        ({2: {"clock": 33}}, {"clock never falls in a rally": [2]}),
        ({1: {"clock": None}, 2: {"clock": 32}}, {"clock never falls in a rally": [2]}),
        ({0: {"clock": 0, "frame": 5}, 1: {"clock": 0, "frame": 6}, 2: {"clock": 0, "frame": 7}, 3: {"frame": 1}}, {}),
        ({2: {"frame": 1030}}, {"frame rises in a rally": [2]}),
        ({1: {"frame": None}, 2: {"frame": 1000}}, {"frame rises in a rally": [2]}),
        ({1: {"stroke": 2}, 2: {"stroke": 5}}, {}),
        ({2: {"stroke": 4}}, {"players alternate in a rally": [2]}),
        ({1: {"stroke": 3}, 2: {"stroke": 4}}, {"players alternate in a rally": [1]}),
        ({2: {"stroke": 2}}, {"strokes of a rally rise": [2], "players alternate in a rally": [2]}),
        ({1: {"points_opponent": None}}, {"the score is the same in all rows of a rally": [1, 2]}),
        ({row: {"points": None, "points_opponent": None} for row in range(3)}, {}),
        ({1: {"points": 1, "points_opponent": 0}}, {"the score is the same in all rows of a rally": [1, 2]}),
        ({0: {"hand": 0}, 2: {"hand": 1}, 1: {"hand": 1}}, {"all known hands of a player are the same": [2]}),
        ({5: {"forced": False}, 2: {"forced": False}}, {"only faults are forced or unforced": [2]}),
        ({4: {"confidence": -0.001}, 5: {"confidence": 1.001}}, {"confidence lies between 0 and 1": [4, 5]}),
        ({3: {"hurried": False}, 4: {"hurried": True}}, {}),
        ({5: {"landing_x": None, "landing_y": None, "area": None, "in_court": None}}, {}),
        ({4: {"landing_x": None, "landing_y": None, "area": None}}, {"in_court tells whether the landing lies in court": [4]}),
        ({5: {"landing_x": None, "landing_y": None, "in_court": None}}, {}),
        ({5: {"in_court": None}}, {"in_court tells whether the landing lies in court": [5]}),
        ({5: {"landing_y": -3.0, "landing_x": 0.5, "area": 1, "in_court": False}}, {}),
        ({4: {"contact_y": 0.5}, 5: {"striker_y": 0.0}, 7: {"receiver_y": 0.0}}, {}),
        ({3: {"contact_x": 0.0, "contact_y": -2.0}}, {"serves have no contact point": [3]}),
        ({2: {"reason": 6}, 5: {"reason": 4}, 9: {"reason": 7}, 12: {"reason": 7}}, {}),
        ({2: {"reason": 4}, 5: {"reason": 6}},
         {"a winner landed, was misjudged or is unknown": [2], "a fault is out, net, short, foul or unknown": [5]}),
        ({2: {"outcome": 3, "reason": 7}, 5: {"outcome": 0, "reason": 0}}, {}),
        ({2: {"outcome": 3}, 5: {"outcome": 0}},
         {"an unknown outcome has no reason": [2], "a returned stroke, and no other, has the reason returned": [5]}),
    ],
)  # fmt: skip
def test_rules_of_neighbouring_and_missing_values(
    strokes: pa.Table, changes: dict[int, dict[str, Any]], expected: dict[str, list[int]]
) -> None:
    assert broken(strokes, changes) == expected


def test_agents_of_a_simulation_have_a_hand_in_each_match(strokes: pa.Table) -> None:
    second, rule = strokes["match"].to_pylist().index("two"), "all known hands of a player are the same"
    hands = {0: 0, second: 1, second + 2: 1, second + 5: 0}
    changes = {row: {"player": "viktor-axelsen", "hand": hand} for row, hand in hands.items()}
    assert broken(strokes, changes)[rule] == [second, second + 2]
    simulated = {row: {"source": "simulated"} | changes.get(row, {}) for row in range(len(strokes))}
    assert broken(strokes, simulated)[rule] == [second + 5]
