"""Files that must not hang or mislead a reader: FIFOs, devices, flipped bits, deeply nested JSON, odd numbers."""

import os
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from shuttle_marl.data import DataError, clean_matches, load_account, load_strokes, schema
from shuttle_marl.data.schema import Outcome, outcome_of
from shuttle_marl.data.table import provenance_of, write_parquet
from shuttle_marl.game import rules
from tests.data.upstream_layout import Layout, plain_game


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


def test_every_flipped_bit_of_a_table_is_noticed_or_harmless(table: Path) -> None:
    content, strokes, account = table.read_bytes(), load_strokes(table), load_account(table)
    rng, noticed = np.random.default_rng(0), 0
    for _ in range(300):
        changed = bytearray(content)
        changed[rng.integers(len(changed))] ^= 1 << int(rng.integers(8))
        table.write_bytes(changed)
        try:
            assert load_strokes(table).equals(strokes, check_metadata=True)
            assert load_account(table) == account
        except DataError:
            noticed += 1
    assert noticed > 295


@pytest.mark.parametrize("name", ["homography.csv", "one/set1.csv", "."])
def test_a_fifo_is_refused_at_once(root: Path, name: str) -> None:
    path = root / "ShuttleSet" / "set" / name if name != "." else root.with_name("fifo")
    path.unlink(missing_ok=True)
    os.mkfifo(path)
    with pytest.raises(DataError, match="not a regular file"):
        load_strokes(path if name == "." else root)


@pytest.mark.parametrize(
    "matrix", ["[" * 20_000, "[[1e999,0,0],[0,1,0],[0,0,1]]", f"[[{10**400},0,0],[0,1,0],[0,0,1]]", "[[NaN]]"]
)
def test_a_homography_that_is_no_matrix(root: Path, matrix: str) -> None:
    (root / "ShuttleSet" / "set" / "homography.csv").write_text(f'video,homography_matrix\none,"{matrix}"\n')
    with pytest.raises(DataError, match="not a 3 x 3 matrix"):
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
