"""Which results are made again together: parts of all of them, and other quick ones every day."""

from pathlib import Path

import pytest

from docs.tools.reproduce import ReproduceError, checkout, measured, part_of, within
from docs.tools.results import RESULTS


def test_parts_hold_every_result_once() -> None:
    whole = part_of("1/1")
    parts = [part_of(f"{k}/5") for k in range(1, 6)]
    assert sorted(name for part in parts for name in part) == sorted(whole)
    assert {name for name, result in RESULTS.items() if result.compared and result.tolerance < 1} <= set(whole)
    assert "throughput" not in whole
    for wrong in ("6/5", "0/5", "1", "a/b"):
        with pytest.raises(ReproduceError, match="expected K/N"):
            part_of(wrong)


def test_every_quick_result_has_its_day() -> None:
    days = [within(170, day) for day in range(30)]
    assert all(0 < sum(measured()[name]["seconds"] for name in chosen) <= 170 for chosen in days)
    assert {"depth", "depth_recovery"} <= {name for chosen in days for name in chosen}


def test_finished_studies_run_at_their_commit(tmp_path: Path) -> None:
    assert (checkout("HEAD", tmp_path / "head") / "docs" / "tools" / "reproduce.py").is_file()
    with pytest.raises(ReproduceError, match="no commit 0000000 here"):
        checkout("0000000", tmp_path / "none")
