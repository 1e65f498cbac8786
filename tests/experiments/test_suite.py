"""The experiment that fills the leaderboard, at a small size."""

import json
from pathlib import Path

import pytest

from docs.tools import suite_tables
from docs.tools.results import RESULTS as LISTED
from shuttle_marl.commands.suite import main as suite
from shuttle_marl.suite import TASKS
from shuttle_marl.suite.method import baseline_of
from shuttle_marl.suite.results import arena_of
from tests.experiments.commands import run
from tests.reduced import reduced_model

RESULTS = Path(__file__).parents[2] / "experiments" / "results" / "suite.json"


def test_the_board_is_made_from_the_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, results = tmp_path / "runs", tmp_path / "suite.json"
    tasks = ("equilibrium-v1", "exploit-entrance-v1")
    flags = ["--quick", "--game", reduced_model(), "--workers", "1", "--json", str(results)]
    run("experiments.suite", *flags, "--out", str(out), "--tasks", *tasks)
    rows = json.loads(results.read_text())["rows"]
    assert [(row["task"], row["method"], row["author"]) for row in rows] == [(task, "minimax", "") for task in tasks]
    run("experiments.suite", *flags, "--out", str(out), "--tasks", *tasks, "--resume")
    assert json.loads(results.read_text())["rows"] == rows
    # Another method joins its board, and the others stay.
    run("experiments.suite", *flags, "--out", str(tmp_path / "more"), "--tasks", tasks[0], "--methods", "random")
    added = json.loads(results.read_text())["rows"]
    assert [(row["task"], row["method"]) for row in added[2:]] == [(tasks[0], "random")]
    assert added[:2] == rows
    capsys.readouterr()
    assert suite(("board", "--results", str(results))) == 0
    assert "### equilibrium-v1, test" in capsys.readouterr().out


def test_committed_results_are_of_the_tasks_and_methods_and_of_one_game() -> None:
    rows = json.loads(RESULTS.read_text())["rows"]
    assert all(baseline_of(row["task"], row["method"]) for row in rows if row["task"] in TASKS)
    assert {row["task"] for row in rows} <= {*TASKS}
    games = {arena_of(task, "default", split).base for task in TASKS.values() for split in ("dev", "test")}
    assert {row["game"] in games for row in rows} == {not LISTED["suite"].earlier}
    assert ("no results in the present game" in suite_tables.task_boards("exploit")) == LISTED["suite"].earlier
