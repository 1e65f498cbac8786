"""The experiment that fills the leaderboard, at a small size."""

import json
from pathlib import Path

import pytest

from shuttle_marl.commands.suite import main as suite
from shuttle_marl.suite import TASKS, SuiteRun, run_method, summarise
from shuttle_marl.suite.registry import arena_of
from tests.experiments.commands import run
from tests.reduced import reduced_model

RESULTS = Path(__file__).parents[2] / "experiments" / "results" / "suite.json"


def test_the_board_is_made_from_the_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, results = tmp_path / "runs", tmp_path / "suite.json"
    tasks = ("equilibrium-entrance-v0", "exploit-entrance-v0", "text-v0")
    flags = ["--quick", "--game", reduced_model(), "--workers", "1", "--out", str(out), "--json", str(results)]
    run("experiments.suite", *flags, "--tasks", *tasks, "--split", "test")
    rows = json.loads(results.read_text())["rows"]
    assert [row["task"] for row in rows] == list(tasks)
    for row in rows:
        assert {"task", "method", "split", "score", "low", "high", "seeds", "exploitability", "seconds"} <= set(row)
        assert row["recomputed"] is True
    run("experiments.suite", *flags, "--tasks", *tasks, "--split", "test", "--resume")
    assert [row["score"] for row in json.loads(results.read_text())["rows"]] == [row["score"] for row in rows]
    capsys.readouterr()
    assert suite(("board", "--results", str(results))) == 0
    assert "## equilibrium-entrance-v0, test" in capsys.readouterr().out


def test_committed_results_are_of_this_game_and_reproduced(tmp_path: Path) -> None:
    rows = json.loads(RESULTS.read_text())["rows"]
    games = {arena_of(task, "default", split).base for task in TASKS.values() for split in ("dev", "test")}
    assert [(row["task"], row["method"]) for row in rows if row["recomputed"] is not True] == []
    assert [(row["task"], row["method"]) for row in rows if row["game"] not in games] == []
    task, method = "equilibrium-entrance-v0", "bc"
    committed = next(row for row in rows if (row["task"], row["method"]) == (task, method))
    options = SuiteRun(task=task, method=method, split="test", budget=committed["budget"], seeds=1, out=tmp_path / "run")
    again = summarise(run_method(options))
    assert again["score"] == pytest.approx(committed["score"], abs=1e-6)
    assert again["cases"] == committed["cases"]


def test_figures_of_the_settings() -> None:
    flags = ("--game", reduced_model(), "--tasks", "exploit-entrance-v0", "--opponents", "1")
    assert "gain of constant, bc/100,000, as a share" in run("experiments.suite_settings", *flags)
