"""Files that must not hang or mislead a reader: FIFOs, devices, flipped bits, deeply nested JSON, odd numbers."""

import os
from pathlib import Path

import pytest

from shuttle_marl.data import DataError, clean_matches, load_strokes
from tests.data.upstream_layout import Layout, plain_game


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """One match of one game."""
    Layout(tmp_path / "raw").match("one", [plain_game(4)])
    return tmp_path / "raw"


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
