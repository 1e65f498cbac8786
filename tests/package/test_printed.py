"""The console output of commands on a small game, compared with a golden file."""

import re
from pathlib import Path

import pytest

from shuttle_marl.__main__ import main
from tests import golden
from tests.reduced import reduced_model

ROOT = Path(__file__).parents[2]
SAMPLE = str(ROOT / "datasets" / "sample" / "strokes.parquet")
COMMANDS = {
    "solve": ["exact", "solve", "--game", "GAME"],
    "evaluate": ["exact", "evaluate", "bc", "safe", "--game", "GAME"],
    "best response": ["exact", "best-response", "bc", "--game", "GAME"],
    "crossplay": ["exact", "crossplay", "bc", "random", "minimax", "--game", "GAME"],
    "holes": ["exact", "holes", "bc", "--game", "GAME"],
    "policies": ["policies", "--game", "GAME"],
    "summary of data": ["data", "summary", SAMPLE],
    "validation of data": ["data", "validate", SAMPLE],
    "model card": ["dynamics", "card", "--model", "GAME"],
    "tasks": ["suite", "list"],
}


@pytest.mark.parametrize("name", COMMANDS)
def test_what_commands_print_is_what_somebody_looked_at(
    name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    model = reduced_model()
    assert main([model if word == "GAME" else word for word in COMMANDS[name]]) == 0
    printed = capsys.readouterr().out.replace(model, "MODEL").replace(str(ROOT), "ROOT")
    printed = re.sub(r"seconds +\d[\d.]* *|\d[\d.,]* (s|seconds|ms)\b|\d+ sweeps|\d\.\d+e-\d+", "…", printed)
    golden.check("printed", {name: printed.splitlines()})
