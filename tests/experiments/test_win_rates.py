"""The win-rate experiment with tiny training runs, and the statistics over seeds."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import trim_mean

from experiments import win_rates
from experiments.spread import IQM, mean_and_deviation
from shuttle_marl.game.shipped import refits_of
from shuttle_marl.training import PPOConfig

SMALL: dict[str, Any] = {"batch": 256, "growth": 0.0, "width": 16, "strokes": 1024, "evaluate_every": 2, "checkpoint_every": 2}


def test_interquartile_mean_and_its_interval() -> None:
    rng = np.random.default_rng(0)
    tasks = rng.normal([[0.0], [10.0]], 1.0, (2, 40))
    found = IQM.of(tasks.tolist())
    assert found.value == pytest.approx(trim_mean(tasks.ravel(), 0.25))
    assert found.low < found.value < found.high
    assert found.high - found.low < 2
    # Were the tasks mixed in the resampling, the middle half would wander between 0 and 10.
    assert IQM.of(tasks.tolist()) == found
    same = IQM.of([[0.5, 0.5]])
    assert (same.value, same.low, same.high) == (0.5, 0.5, 0.5)
    assert mean_and_deviation([1.0, 3.0]) == {"mean": 2.0, "deviation": pytest.approx(np.sqrt(2))}


@pytest.mark.slow(minutes=True)
def test_a_run_ends_in_a_table_and_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    agents = {"ppo, self-play": PPOConfig(**SMALL, opponent=("self",))}  # `.ci/run` trains all
    monkeypatch.setattr(win_rates, "AGENTS", agents)
    monkeypatch.setattr(win_rates, "OPPONENTS", ("bc", "minimax"))
    # Two refits say as much of this program as eight.
    monkeypatch.setattr(win_rates, "refits_of", lambda game: refits_of(game)[:2])
    out, saved = tmp_path / "run", tmp_path / "results.json"
    flags = ["--agents", *agents, "--seeds", "2", "--matches", "4", "--jobs", "1", "--out", str(out), "--json", str(saved)]
    assert win_rates.main(flags) == 0
    assert "not directly comparable" in capsys.readouterr().out
    result = json.loads(saved.read_text())
    rows = {row["agent"]: row for row in result["rows"]}
    assert list(rows) == ["bc", "best response", "minimax", "ppo, self-play"]
    assert rows["bc"]["matches_won"]["mean"] == 0.5
    assert rows["best response"]["normalised_score"]["mean"] == pytest.approx(1, abs=1e-3)
    assert rows["minimax"]["exploitability"]["mean"] == pytest.approx(0, abs=1e-4)
    # The rallies of the last iteration are played to their end.
    assert 1024 <= rows["ppo, self-play"]["strokes"] < 3 * 1024
    for row in rows.values():
        assert len(row["seeds"]) == 2
    assert [len(curve) for curve in result["curves"]["ppo, self-play"]] == [2, 2]
    assert result["exact_match_win_against"]["minimax"]["minimax"] == pytest.approx(0.5)
    assert (out / "matches" / "minimax-0" / "rallies.mcap").is_file()
    again = tmp_path / "again.json"
    assert win_rates.main([*flags[:-1], str(again), "--resume"]) == 0
    assert json.loads(again.read_text())["rows"] == result["rows"]
