"""Names of folders are no markup of the console."""

from pathlib import Path

import pytest

from shuttle_marl.commands.dynamics import main
from shuttle_marl.dynamics import make


def test_a_folder_in_brackets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def make_model(data: Path, out: Path, **others: object) -> dict[str, object]:
        others["report"]("reading [/data]")
        game = {"strokes": 3, "legal_pairs": 4}
        return {"health": {"healthy": True}, "game": game, "game_hash": "0" * 64}

    monkeypatch.setattr(make, "make_model", make_model)
    assert main(["fit", "--data", str(tmp_path), "--out", "[/model]"]) == 0
    printed = capsys.readouterr()
    assert printed.out.startswith("[/model]: 3 strokes")
    assert printed.err == "reading [/data] …\n"
