"""Files that must not hang or mislead a reader: FIFOs, devices, flipped bits, deeply nested JSON, odd numbers."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from shuttle_marl.data import DataError, clean_matches, load_account, load_strokes, schema
from shuttle_marl.data.schema import Outcome, outcome_of
from shuttle_marl.data.table import provenance_of, write_parquet
from shuttle_marl.game import rules
from tests.data.upstream_layout import Layout, plain_game

SAMPLE = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """One match of one game."""
    Layout(tmp_path / "raw").match("one", [plain_game(4)])
    return tmp_path / "raw"


@pytest.fixture
def table(tmp_path: Path, root: Path) -> Path:
    cleaned = clean_matches(root)
    write_parquet(cleaned.strokes, tmp_path / "s.parquet", account=cleaned.account, provenance=provenance_of(root, cleaned))
    return tmp_path / "s.parquet"


def flipped(content: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(content)
    changed[rng.integers(len(changed))] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def test_every_flipped_bit_of_a_table_is_noticed_or_harmless(table: Path) -> None:
    content, strokes, account = table.read_bytes(), load_strokes(table), load_account(table)
    rng, noticed = np.random.default_rng(0), 0
    for _ in range(1000):
        table.write_bytes(flipped(content, rng))
        try:
            assert load_strokes(table).equals(strokes, check_metadata=True)
            assert load_account(table) == account
        except DataError:
            noticed += 1
    assert noticed > 990


def test_the_sample_is_sealed(tmp_path: Path) -> None:
    content, path = SAMPLE.read_bytes(), tmp_path / "strokes.parquet"
    rng = np.random.default_rng(1)
    for _ in range(20):
        path.write_bytes(flipped(content, rng))
        with pytest.raises(DataError):
            load_strokes(path)


@pytest.mark.parametrize("name", ["match.csv", "homography.csv", "one/set1.csv", "."])
def test_a_fifo_is_refused_at_once(root: Path, name: str) -> None:
    path = root / "ShuttleSet" / "set" / name if name != "." else root.with_name("fifo")
    path.unlink(missing_ok=True)
    os.mkfifo(path)
    command = [sys.executable, "-m", "shuttle_marl.data", "summary", str(path if name == "." else root)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    if name in ("homography.csv", "one/set1.csv", "."):
        assert "not a regular file" in " ".join(done.stderr.split())


def test_a_device_is_refused(root: Path) -> None:
    path = root / "ShuttleSet" / "set" / "one" / "set1.csv"
    path.unlink()
    path.symlink_to("/dev/zero")
    with pytest.raises(DataError, match="not a regular file"):
        clean_matches(root)
    with pytest.raises(DataError, match="not a regular file"):
        load_strokes("/dev/null")


@pytest.mark.parametrize(
    "matrix", ["[" * 20_000, "[[1e999,0,0],[0,1,0],[0,0,1]]", f"[[{10**400},0,0],[0,1,0],[0,0,1]]", "[[NaN]]"]
)
def test_a_homography_that_is_no_matrix(root: Path, matrix: str) -> None:
    (root / "ShuttleSet" / "set" / "homography.csv").write_text(f'video,homography_matrix\none,"{matrix}"\n')
    with pytest.raises(DataError, match="not a 3 x 3 matrix"):
        clean_matches(root)


@pytest.mark.parametrize("value", ["1_0", "\u0661", " 1", "0x1", "1j", "inf", "nan"])
def test_numbers_are_written_with_digits(root: Path, value: str) -> None:
    path = root / "ShuttleSet" / "set" / "one" / "set1.csv"
    header, first, *rest = path.read_text(encoding="utf-8").splitlines()
    fields = first.split(",")
    fields[header.split(",").index("frame_num")] = value
    path.write_text("\n".join([header, ",".join(fields), *rest]) + "\n", encoding="utf-8")
    with pytest.raises(DataError, match=r"frame_num .* is not a number"):
        clean_matches(root)


def test_the_codes_of_outcomes_cannot_be_taken_for_those_of_the_game() -> None:
    assert not {"FAULT", "WINNER", "RETURNED", "UNKNOWN"} & set(vars(schema)), "the game has constants of these names"
    played = np.array([rules.FAULT, rules.WINNER, rules.RETURNED_BELOW, rules.RETURNED_ABOVE])
    assert [Outcome(code) for code in outcome_of(played)] == [
        Outcome.FAULT,
        Outcome.WINNER,
        Outcome.RETURNED,
        Outcome.RETURNED,
    ]
    assert schema.OUTCOMES == ("returned", "fault", "winner", "unknown"), "the codes of the files"
    assert schema.STROKES.field("outcome").type == pa.int8()
