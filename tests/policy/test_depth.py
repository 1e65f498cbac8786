"""The depth table of a small game."""

import json

import pytest

from shuttle_marl.commands import exact
from shuttle_marl.policy.depth import LISTS, depth
from tests.reduced import reduced_game, reduced_model


def test_depth_of_a_small_game() -> None:
    found = depth(reduced_game(), ("bc", "minimax"), report=lambda line: None)
    assert list(found["policies"]) == ["bc", "minimax"]
    for against in found["policies"].values():
        assert set(against) == {"self", "bc"}
    assert found["policies"]["bc"]["self"] == found["policies"]["bc"]["bc"]
    classes = found["lists"]
    assert list(classes) == list(LISTS)
    for name, figures in classes.items():
        assert 0 < figures["score"] <= 1 + 1e-6, name
        assert figures["exploitability"] >= -1e-9, name
        assert figures["against_minimax"] <= 0.5 + 1e-6, name
    assert classes["nothing"]["score"] < classes["incoming_stroke"]["score"]


def test_the_command_prints_json_and_tables(capsys: pytest.CaptureFixture[str]) -> None:
    assert exact.main(["depth", "bc", "--game", reduced_model(), "--json"]) == 0
    assert set(json.loads(capsys.readouterr().out)) == {"game", "impossible", "policies", "lists"}
    assert exact.main(["depth", "bc", "--game", reduced_model()]) == 0
    assert "Best policies that read" in capsys.readouterr().out
