"""The experiment that fills the leaderboard, at a small size."""

import json
from pathlib import Path

import pytest

from docs.tools.results import RESULTS as LISTED
from experiments.suite import foreign
from experiments.suite import main as suite_experiment
from shuttle_marl.commands.suite import main as suite
from shuttle_marl.suite import TASKS
from shuttle_marl.suite.method import baseline_of
from shuttle_marl.suite.results import arena_of
from tests.experiments.commands import run
from tests.reduced import reduced_model
from tests.suite.test_boards import row

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
    drawn = tmp_path / "drawn.svg"
    given = ("--results", str(results), "--game", reduced_model(), "--out", str(drawn))
    assert suite(("figure", "exploit-entrance-v1", *given)) == 0
    assert all(words in drawn.read_text() for words in ("exact frontier, by restriction", "minimax"))
    assert suite(("figure", "adapt-v1", *given)) == 1


def test_rows_of_another_commit_or_game_are_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    results = tmp_path / "suite.json"
    flags = ["--again", "3", "--json", str(results), "--out"]
    rows = [{**row(commit="a" * 40), "game": arena_of(TASKS["exploit-entrance-v1"], "default", "test").base}]
    for number, (changes, told) in enumerate([({"game": "g" * 64}, "not the present one"), ({"commit": "b" * 40}, "2 commits")]):
        results.write_text(json.dumps({"rows": [*rows, {**rows[0], **changes}], "frontiers": {}}))
        assert suite_experiment([*flags, str(tmp_path / str(number))]) == 1
        assert told in capsys.readouterr().err


def test_committed_results_are_of_the_tasks_and_methods_and_of_one_game_and_commit() -> None:
    rows = json.loads(RESULTS.read_text())["rows"]
    assert all(baseline_of(row["task"], row["method"]) for row in rows)
    assert foreign(rows) == []
    assert not LISTED["suite"].earlier
