"""The command line: solve, evaluate, best-response, crossplay."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from shuttle_marl.commands import exact as commands
from shuttle_marl.commands.exact import main
from shuttle_marl.game import default_game
from shuttle_marl.game.policy import TabulatedPolicy
from tests import golden
from tests.reduced import reduced_game, reduced_model

GAME = reduced_game()
SMASH = next(name for name in GAME.catalogue.names if name.startswith("smash:"))


@pytest.fixture(autouse=True)
def at_home(monkeypatch: pytest.MonkeyPatch) -> None:
    """No refits: figures away from home have their own tests."""
    monkeypatch.setattr(commands, "refits_of", lambda game: ())


def output(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main((*arguments, "--game", reduced_model())) == 0, capsys.readouterr().err
    return capsys.readouterr().out


def failure(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(arguments) == 1
    return capsys.readouterr().err


def test_commands_play_the_shipped_game_unless_told_otherwise(capsys: pytest.CaptureFixture[str]) -> None:
    def told(*arguments: str) -> Any:
        assert main((*arguments, "--json")) == 0
        return json.loads(capsys.readouterr().out)

    game = default_game()
    solved = told("solve")
    assert (solved["states"], solved["legal_pairs"]) == (game.n_states, game.n_pairs)
    answer, odds, (card,) = told("best-response", "random"), told("crossplay", "bc", "random"), told("evaluate", "random")
    assert card["exploitability"] == pytest.approx(answer["exploitability"], abs=1e-9)
    assert card["rally_win_vs_bc"] == pytest.approx(odds["rally_win"][1][0], abs=1e-8)
    assert card["match_win_vs_bc"] == pytest.approx(odds["match_win"][1][0], abs=1e-6)
    golden.check("exact", {"best_response": answer, "crossplay": odds, "evaluate": card})


def test_evaluate_prints_what_it_promises(capsys: pytest.CaptureFixture[str]) -> None:
    (card,) = json.loads(output(capsys, "evaluate", "random", "--json"))
    assert {"policy", "rally_win_vs_bc", "match_win_vs_bc", "exploitability", "normalised_score"} <= set(card)
    text = output(capsys, "evaluate", "random")
    assert "fault of the opponent" in text
    assert "every figure is within" in text


def test_one_hole_may_be_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    assert len(json.loads(output(capsys, "holes", "random", "--top", "1", "--json"))["holes"]) == 1


def test_a_best_response_is_saved_and_plays(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "answer.safetensors"
    found = json.loads(output(capsys, "best-response", "random", "--save", str(path), "--json"))
    assert found["rally_win"] == pytest.approx((1 + found["exploitability"]) / 2)
    assert found["saved"] == str(path)
    assert TabulatedPolicy.load(path, GAME).game is GAME
    table = json.loads(output(capsys, "crossplay", f"table:{path}", "random", "--json"))
    assert table["rally_win"][0][1] == pytest.approx(found["rally_win"], abs=1e-8)
    assert table["match_win"][0][1] == pytest.approx(found["match_win"], abs=1e-6)
    text = output(capsys, "best-response", "random")
    assert re.search(r"match win +\d+\.\d %", text)
    assert "player 0 is the response, player 1 random" in text


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["evaluate"], "no policy given"),
        (["evaluate", "stranger"], "no policy 'stranger'"),
        (["evaluate", "program:cat"], "has no table over states; a league plays it"),
        (["solve", "--game", "nothing"], "no model 'nothing'"),
    ],
)
def test_mistakes_are_explained(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], says: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert says in failure(capsys, *arguments)
    assert list(tmp_path.iterdir()) == []
