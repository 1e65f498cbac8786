"""The depth table of a small game."""

import json
from typing import Any

import pytest

from shuttle_marl.commands import exact
from shuttle_marl.policy import scorecard
from tests.reduced import reduced_model


def test_depth_of_a_small_game_as_json_and_tables(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    assert exact.main(["depth", "bc", "minimax", "--game", reduced_model(), "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert set(found) == {"game", "impossible", "policies", "lists"}
    assert list(found["policies"]) == ["bc", "minimax"]
    for against in found["policies"].values():
        assert set(against) == {"self", "bc"}
    assert found["policies"]["bc"]["self"] == found["policies"]["bc"]["bc"]
    classes = found["lists"]
    assert list(classes) == list(scorecard.LISTS)
    for name, figures in classes.items():
        assert 0 < figures["score"] <= 1 + 1e-6, name
        assert figures["exploitability"] >= -1e-9, name
        assert figures["against_minimax"] <= 0.5 + 1e-6, name
    assert classes["nothing"]["score"] < classes["incoming_stroke"]["score"]
    monkeypatch.setattr(scorecard, "depth", lambda *_, **__: found)  # computed once: it takes seconds
    assert exact.main(["depth", "bc", "minimax", "--game", reduced_model()]) == 0
    assert "Best policies that read" in capsys.readouterr().out
