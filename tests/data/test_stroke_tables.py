"""Parquet files of strokes: written, read back, refused; and the invariants, broken one by one."""

from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from shuttle_marl.data import DataError, clean_matches, load_account, load_strokes
from shuttle_marl.data.schema import STROKES, violations
from shuttle_marl.data.table import provenance_of, write_parquet
from tests.data.upstream_layout import Layout, plain_game


@pytest.fixture
def strokes(tmp_path: Path) -> pa.Table:
    """Two matches, one of them of two games, 32 strokes."""
    layout = Layout(tmp_path / "raw")
    layout.match("one", [plain_game(4), plain_game(2, a_below=False)])
    layout.match("two", [plain_game(4)], number=2, players=("CHEN Yufei", "HE Bingjiao"))
    return clean_matches(tmp_path / "raw").strokes


@pytest.fixture
def file(tmp_path: Path, strokes: pa.Table) -> Path:
    root, path = tmp_path / "raw", tmp_path / "strokes.parquet"
    cleaned = clean_matches(root)
    write_parquet(cleaned.strokes, path, account=cleaned.account, provenance=provenance_of(root, cleaned))
    return path


def test_round_trip(tmp_path: Path, strokes: pa.Table, file: Path) -> None:
    assert load_strokes(file).equals(strokes)
    assert load_strokes(str(tmp_path / "raw")).equals(strokes)
    assert load_account(file) == load_account(tmp_path / "raw") == clean_matches(tmp_path / "raw").account
    metadata = pq.read_schema(file).metadata
    assert b"39bbf3fd99b0b709ff6d1647383959b6fa5f5b74" in metadata[b"shuttle_marl.provenance"]
    assert b"2306.04948" in metadata[b"shuttle_marl.provenance"]
    assert pq.read_metadata(file).row_group(0).column(0).compression == "ZSTD"
    assert pq.read_schema(file).field("area").metadata[b"description"] == STROKES.field("area").metadata[b"description"]


def test_provenance_tells_the_input(tmp_path: Path, strokes: pa.Table) -> None:
    root = tmp_path / "raw"
    before = provenance_of(root, clean_matches(root))
    path = root / "ShuttleSet/set/one/set1.csv"
    path.write_bytes(path.read_bytes() + b"\n")
    after = provenance_of(root, clean_matches(root))
    assert before["files"] == 3
    assert before["sha256"] != after["sha256"]


def test_damaged_parquet(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[8:1500] = bytes(1492)
    file.write_bytes(content)
    with pytest.raises(DataError, match=r"strokes\.parquet: no readable Parquet file \(it was changed after it was written"):
        load_strokes(file)


@pytest.mark.parametrize(("change", "told"), [
    (lambda t: t.drop_columns(["area"]), "column 'area' is missing"),
    (lambda t: t.set_column(8, "shot", t["shot"].cast(pa.int64())), "column 'shot' is int64, expected int8 not null"),
    (lambda t: t.select(t.column_names[::-1]), "in this order"),
    (lambda t: t.replace_schema_metadata({"version": "2"}), "schema version b'2', expected b'1'"),
])  # fmt: skip
def test_another_schema(tmp_path: Path, strokes: pa.Table, change: Any, told: str) -> None:
    path = tmp_path / "other.parquet"
    pq.write_table(change(strokes), path)
    with pytest.raises(DataError) as caught:
        load_strokes(path)
    assert told in str(caught.value)


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
    rows = strokes.to_pylist()
    rows[row] |= values
    assert rule in {violation.rule for violation in violations(pa.Table.from_pylist(rows, schema=STROKES))}
