"""Names of folders are no markup of the console."""

from collections.abc import Callable
from pathlib import Path

import pytest

from shuttle_marl.commands.dynamics import main
from shuttle_marl.dynamics import make


def test_a_folder_in_brackets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def make_model(data: Path, out: Path, *, report: Callable[[str], None], **others: object) -> dict[str, object]:
        report("reading [/data]")
        game = {"strokes": 3, "legal_pairs": 4}
        health = {"warnings": ["minimax thin: 0.4, expected 0 to 0.25"]}
        return {"health": health, "game": game, "game_hash": "0" * 64, "variants": ["men", "1"]}

    monkeypatch.setattr(make, "make_model", make_model)
    assert main(["fit", "--data", str(tmp_path), "--out", "[/model]"]) == 0
    printed = capsys.readouterr()
    assert printed.out.startswith("[/model]: 3 strokes")
    assert "variants men, 1\nwarning: minimax thin: 0.4" in printed.out
    assert printed.err == "reading [/data] …\n"
