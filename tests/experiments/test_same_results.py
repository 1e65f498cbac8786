"""Two checkouts compared by what they compute."""

import json
from pathlib import Path

import pytest

from experiments import same_results

ROOT = Path(__file__).parents[2]
CHECKOUTS = (ROOT, ROOT)


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    """Two folders with the same results, but for their times."""
    for name, seconds in (("before", 1.0), ("after", 2.0)):
        run = tmp_path / name / "ppo" / "run"
        (run / "tensorboard").mkdir(parents=True)
        (run / "tensorboard" / "events").write_text(name, encoding="utf-8")
        (run / "manifest.json").write_text(name, encoding="utf-8")
        (run / "results.json").write_text(json.dumps({"won": 0.5, "runs": [{"seconds": seconds}]}), encoding="utf-8")
        (run / "metrics.jsonl").write_text(f'{{"loss": 1, "seconds": {seconds}}}\n{{"loss": 2}}\n', encoding="utf-8")
        (run / "agent.safetensors").write_bytes(b"\xff\x00")
    return tmp_path / "before", tmp_path / "after"


def found(folders: tuple[Path, Path]) -> list[str]:
    return list(same_results.differences(*folders, CHECKOUTS))


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("results.json", b'{"won": 0.4, "runs": [{"seconds": 1.0}]}'),
        ("metrics.jsonl", b'{"loss": 1, "seconds": 1.0}\n'),
        ("agent.safetensors", b"\xff\x01"),
    ],
)
def test_another_number_is_found(folders: tuple[Path, Path], name: str, data: bytes) -> None:
    assert found(folders) == [], "times and manifests may differ"
    (folders[1] / "ppo" / "run" / name).write_bytes(data)
    (difference,) = found(folders)
    assert difference.startswith(f"ppo/run/{name}: differs")


def test_a_checkout_equals_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    same_results.main(ROOT, ROOT, out=tmp_path / "out", only=("solve",))
    assert "the same: 1 commands, 1 files" in capsys.readouterr().out
    assert "value" in (tmp_path / "out" / "before" / "solve" / "printed.txt").read_text(encoding="utf-8")
