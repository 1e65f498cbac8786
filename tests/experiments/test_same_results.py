"""Two checkouts compared by what they compute."""

from pathlib import Path

import pytest

from experiments import same_results

ROOT = Path(__file__).parents[2]


def test_a_checkout_equals_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    same_results.main(ROOT, ROOT, out=tmp_path / "out", only=("solve",))
    assert "the same: 1 commands, 1 files" in capsys.readouterr().out
    assert "value" in (tmp_path / "out" / "before" / "solve" / "printed.txt").read_text(encoding="utf-8")
