"""The experiment that fills the leaderboard, at a small size."""

import json
from pathlib import Path
from typing import Any

import pytest

from docs.tools import suite_tables
from docs.tools.results import RESULTS as LISTED
from shuttle_marl.commands.suite import main as suite
from shuttle_marl.game import default_game
from shuttle_marl.suite import TASKS
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
        assert {"task", "method", "split", "score", "low", "high", "seeds", "seconds"} <= set(row)
        assert row["recomputed"] is True
    run("experiments.suite", *flags, "--tasks", *tasks, "--split", "test", "--resume")
    assert [row["score"] for row in json.loads(results.read_text())["rows"]] == [row["score"] for row in rows]
    # Another method joins its board, and the others stay.
    more = [*flags[:-3], str(tmp_path / "more"), *flags[-2:], "--tasks", tasks[0], "--methods", "random"]
    run("experiments.suite", *more, "--split", "test")
    added = json.loads(results.read_text())["rows"]
    assert [(row["task"], row["method"]) for row in added] == [
        *((row["task"], row["method"]) for row in rows),
        (tasks[0], "random"),
    ]
    assert [row["score"] for row in added[:-1]] == [row["score"] for row in rows]
    capsys.readouterr()
    assert suite(("board", "--results", str(results))) == 0
    assert "## equilibrium-entrance-v0, test" in capsys.readouterr().out


def test_committed_results_are_recomputed_and_of_one_game() -> None:
    rows = json.loads(RESULTS.read_text())["rows"]
    games = {arena_of(task, "default", split).base for task in TASKS.values() for split in ("dev", "test")}
    assert [(row["task"], row["method"]) for row in rows if row["recomputed"] is not True] == []
    of_this_game = {row["game"] in games for row in rows}
    assert of_this_game == {not LISTED["suite"].earlier}
    assert ("no results in the present game" in suite_tables.task_boards("exploit")) == LISTED["suite"].earlier


def test_depth_compares_anchors_with_the_best_method(monkeypatch: pytest.MonkeyPatch) -> None:
    def row(method: str, kind: str, gain: float) -> dict[str, Any]:
        scores = {name: {"value": value, "low": None, "high": None} for name, value in {"gain": gain, "best": 4.0}.items()}
        strata = {"bc": {"gain": gain, "best": 4.0}}
        about = {
            "task": "exploit-v0",
            "split": "test",
            "budget": 100_000,
            "game": default_game().hash,
            "cases": "c",
            "access": "tables",
        }
        return {**about, "method": method, "author": "", "kind": kind, "score": gain, "scores": scores, "strata": strata}

    rows = [row("constant-by-incoming", "reference", 3.0), row("ppo-self-play", "method", 1.0), row("ppo", "method", 0.5)]
    monkeypatch.setattr(suite_tables, "saved", lambda *_: {"rows": rows})
    lines = suite_tables.depth().splitlines()[2:]
    assert [line.split(" | ")[1:] for line in lines] == [
        ["highest share of the largest gain of a list, of any opponent", "0.750", "at most 0.9", "yes |"],
        ["`ppo-self-play`, blind to the opponent, above the best other method", "0.500", "below 0", "no |"],
    ]
