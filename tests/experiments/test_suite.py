"""The experiment that fills the leaderboard, at a small size."""

import json
from pathlib import Path

import pytest

from docs.tools.suite_tables import task_boards
from shuttle_marl.commands.suite import main as suite
from shuttle_marl.game import default_game, load_game
from shuttle_marl.game.shipped import variants
from shuttle_marl.suite import SuiteRun, run_method, summarise
from tests.experiments.commands import run
from tests.reduced import reduced_model

RESULTS = Path(__file__).parents[2] / "experiments" / "results" / "suite.json"


def test_the_board_is_made_from_the_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, results = tmp_path / "runs", tmp_path / "suite.json"
    tasks = ("exploit-v0", "robust-v0", "text-v0")
    flags = ["--quick", "--game", reduced_model(), "--workers", "1", "--out", str(out), "--json", str(results)]
    run("experiments.suite", *flags, "--tasks", *tasks, "--split", "test")
    rows = json.loads(results.read_text())["rows"]
    assert [row["task"] for row in rows] == list(tasks)
    for row in rows:
        assert {"task", "method", "split", "score", "low", "high", "seeds", "exploitability", "seconds"} <= set(row)
        assert row["verified"] is True
    run("experiments.suite", *flags, "--tasks", *tasks, "--split", "test", "--resume")
    assert [row["score"] for row in json.loads(results.read_text())["rows"]] == [row["score"] for row in rows]
    capsys.readouterr()
    assert suite(("board", "--results", str(results))) == 0
    assert "## robust-v0, test" in capsys.readouterr().out


def test_committed_results_are_of_this_game_and_reproduced(tmp_path: Path) -> None:
    rows = json.loads(RESULTS.read_text())["rows"]
    if not rows:
        assert "no results yet" in task_boards("robust-v0")
        pytest.skip("no results are committed")
    games = {default_game().hash, *(load_game(f"default:{name}").hash for name in variants())}
    assert [(row["task"], row["method"]) for row in rows if row["verified"] is not True] == []
    if not any(row["game"] in games for row in rows):
        assert "**Preliminary**" in task_boards("robust-v0")
        pytest.skip("the committed results are of the game before, and their boards say so")
    assert [(row["task"], row["method"]) for row in rows if row["game"] not in games] == []
    committed = next(row for row in rows if (row["task"], row["method"]) == ("robust-v0", "minimax"))
    options = SuiteRun(
        task="robust-v0", method="minimax", split="test", budget=committed["budget"], seeds=1, out=tmp_path / "run"
    )
    again = summarise(run_method(options))
    metric = committed["metric"]
    assert {name: each[metric] for name, each in again["strata"].items()} == pytest.approx(
        {name: each[metric] for name, each in committed["strata"].items()}, abs=1e-9
    )


def test_figures_of_the_settings() -> None:
    flags = ("--game", reduced_model(), "--tasks", "exploit-v0", "--opponents", "1")
    assert "objective of constant, bc/100,000" in run("experiments.suite_settings", *flags)
