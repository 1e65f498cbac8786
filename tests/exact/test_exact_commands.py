"""The command line: solve, evaluate, best-response, crossplay."""

import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.commands import exact as commands
from shuttle_marl.commands.exact import main
from shuttle_marl.commands.recording import main as recording
from shuttle_marl.game import default_game
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording import Rallies, RallyLog, replay
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


@pytest.fixture
def reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Name of a policy that reads the score: it plays at random, and in the second game not at all well."""
    (tmp_path / "my_reader.py").write_text(
        "def player(states):\n"
        "    assert states.score is not None\n"
        "    last = states.mask.shape[1] - 1 - states.mask[:, ::-1].argmax(axis=1)\n"
        "    p = states.mask / states.mask.sum(axis=1, keepdims=True)\n"
        "    late = states.score[:, 2:].sum(axis=1) > 0\n"
        "    p[late] = 0\n"
        "    p[late, last[late]] = 1\n"
        "    return p\n"
        "player.reads_score = True\n"
        "def other(states):\n"
        "    return player(states)\n"
        "other.reads_score = True\n"
    )
    monkeypatch.chdir(tmp_path)
    return "my_reader:player"


def test_evaluate_prints_what_it_promises(capsys: pytest.CaptureFixture[str], reader: str) -> None:
    cards = json.loads(output(capsys, "evaluate", "random", reader, "--matches", "40", "--json"))
    assert [card["policy"] for card in cards] == ["random", reader]
    for card in cards:
        assert {"rally_win_vs_bc", "match_win_vs_bc", "exploitability", "normalised_score", "sampled"} <= set(card)
    exact, sampled = cards
    assert (exact["sampled"], sampled["sampled"]) == (False, True)
    assert sampled["exploitability"] is None
    low, high = sampled["rally_interval"]
    assert low < sampled["rally_win_vs_bc"] < high
    assert high - low < 0.1 < exact["rally_win_vs_bc"]
    text = output(capsys, "evaluate", "random", reader, "--matches", "4")
    assert f"{reader} reads the score: sampled in 4 matches" in text
    assert "fault of the opponent" in text


def test_sampled_rallies_are_recorded(capsys: pytest.CaptureFixture[str], reader: str) -> None:
    names = (reader, "safe", "my_reader:other", reader)
    cards = json.loads(output(capsys, "evaluate", *names, "--matches", "9", "--seed", "5", "--json"))
    assert cards[0] == cards[3]
    log = RallyLog(Path("runs/evaluate-5.mcap"))
    again = replay(log, GAME, {"bc": tabulate(resolve("bc", GAME), GAME)})
    assert again.wrong == ()
    assert [player.name for player in log.policies] == ["bc", reader, "my_reader:other"]
    rallies = Rallies.concatenate([batch for _, batch in log.batches()])
    for card, player in ((cards[0], 1), (cards[2], 2)):
        mine = rallies.select((rallies.policy == player).any(axis=1))
        seat = (mine.policy[:, 1] == player).astype(int)
        assert len(np.unique(mine.match)) == card["matches"] == 9
        assert (mine.policy[np.arange(len(mine)), 1 - seat] == 0).all()
        assert (seat == mine.match % 2).all()
        assert np.mean(mine.winner == seat) == pytest.approx(card["rally_win_vs_bc"], abs=1e-12)
        assert mine.length.mean() == pytest.approx(card["rally_length_vs_bc"], abs=1e-12)
    log.close()
    assert recording(["check", "runs/evaluate-5.mcap", "--game", reduced_model()]) == 0
    capsys.readouterr()


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
        (["evaluate", "bc", "--matches", "0"], "--matches 0: expected `int` >= 1"),
        (["evaluate", "bc", "--seed", "-1"], "--seed -1: expected `int` >= 0"),
        (["solve", "--game", "nothing"], "no model 'nothing'"),
    ],
)
def test_mistakes_are_explained(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], says: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert says in failure(capsys, *arguments)
    assert list(tmp_path.iterdir()) == []


def test_programs_that_hang(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # the log of the matches before stays there
    name, game = f"program:{sys.executable} -S -c 'import sys; sys.stdin.read()'", ("--game", reduced_model())
    assert "no answer within 0.2 s" in failure(capsys, "evaluate", name, "--policy-timeout", "0.2", *game)
    assert "--policy-timeout -1" in failure(capsys, "evaluate", name, "--policy-timeout", "-1", *game)
