"""The experiment that fills the leaderboard, at a small size."""

import json
from pathlib import Path

import pytest

from docs.tools.suite_tables import task_boards
from experiments import suite_settings
from experiments.suite import QUICK, Suite, jobs_of, main, rows_of
from shuttle_marl.commands.suite import main as suite
from shuttle_marl.game import default_game, load_game
from shuttle_marl.game.shipped import variants
from shuttle_marl.suite import TASKS, SuiteRun, run_method, summarise
from shuttle_marl.suite.population import FAMILIES
from tests.reduced import reduced_model

RESULTS = Path(__file__).parents[2] / "experiments" / "results" / "suite.json"


def test_the_board_is_made_from_the_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, results = tmp_path / "runs", tmp_path / "suite.json"
    tasks = ("exploit-v0", "robust-v0", "text-v0")
    flags = ["--quick", "--game", reduced_model(), "--workers", "1", "--out", str(out), "--json", str(results)]
    assert main([*flags, "--tasks", *tasks, "--split", "test"]) == 0, capsys.readouterr().err
    rows = json.loads(results.read_text())["rows"]
    assert [row["task"] for row in rows] == list(tasks)
    for row in rows:
        assert {"task", "method", "split", "score", "low", "high", "seeds", "exploitability", "seconds"} <= set(row)
        assert row["verified"] is True
    first = results.read_text()
    assert main([*flags, "--tasks", *tasks, "--split", "test", "--resume"]) == 0
    assert [row["score"] for row in json.loads(results.read_text())["rows"]] == [
        row["score"] for row in json.loads(first)["rows"]
    ]
    capsys.readouterr()
    assert suite(("board", "--results", str(results))) == 0
    assert "## robust-v0, test" in capsys.readouterr().out


def test_all_baselines_are_run() -> None:
    jobs = jobs_of(Suite(data=Path("data"), game=reduced_model()), Path("runs"))
    assert {job.options.task for job in jobs} == set(TASKS) == set(QUICK)
    assert len({job.options.out for job in jobs}) == len(jobs)
    assert [job.seconds for job in jobs] == sorted(job.seconds for job in jobs)
    small = jobs_of(Suite(game=reduced_model(), budgets=(10**5,)), Path("runs"))
    assert {job.options.budget for job in small} == {None, 10**5}
    assert "imitate-v0" not in {job.options.task for job in small}


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


def test_figures_of_the_settings(capsys: pytest.CaptureFixture[str]) -> None:
    assert suite_settings.main(["--game", reduced_model(), "--tasks", "exploit-v0", "adapt-v0", "--opponents", "1"]) == 0
    printed = capsys.readouterr().out
    assert "objective of constant, bc/100,000" in printed
    assert all(f"regret of minimax, {family}" in printed for family in FAMILIES)


def test_methods_are_compared_with_the_best_in_the_same_units(tmp_path: Path) -> None:
    out = tmp_path / "runs"
    flags = ["--quick", "--game", reduced_model(), "--workers", "1", "--out", str(out), "--tasks", "robust-v0", "--split", "test"]
    assert main([*flags, "--methods", "human:0.1", "mean-game"]) == 0
    rows = {row["method"]: row for row in rows_of(out)}
    best, other = sorted(rows.values(), key=lambda row: -row["score"])
    assert other["behind"]["value"] == pytest.approx(best["score"] - other["score"], abs=1e-12)
    assert "behind" not in best
