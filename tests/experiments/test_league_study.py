"""The experiments that compare variants of training and win rates, at a small size."""

import json
from pathlib import Path
from typing import Any

import pytest

from experiments import win_rates
from experiments.league_training import HEADINGS, main, table_rows
from experiments.self_play import main as self_play_main
from shuttle_marl.game.shipped import refits_of
from shuttle_marl.training import PPOConfig
from tests.reduced import reduced_model


@pytest.mark.slow
def test_a_quick_study_is_resumed_and_says_what_it_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, saved = tmp_path / "study", tmp_path / "results.json"
    flags = ["--quick", "--variants", "plain", "psro-exact", "--game", reduced_model(), "--out", str(out), "--json", str(saved)]
    assert main(flags) == 0
    printed = capsys.readouterr().out
    result = json.loads(saved.read_text())
    assert [row["variant"] for row in result["rows"]] == ["plain", "psro-exact"]
    assert [row["seeds"] for row in result["rows"]] == [2, 1]
    for row, cells in zip(result["rows"], table_rows(result), strict=True):
        assert len(cells) == len(HEADINGS)
        assert row["variant"] in printed
        assert 0 < row["exploitability"]["mean"] < 1
        assert row["over_time"]["1.0"] == pytest.approx(row["exploitability"]["mean"])
    runs = sorted(path.name for path in (out / "training").iterdir())
    assert runs == ["plain-0", "plain-1", "psro-exact-0"]
    assert main([*flags, "--resume"]) == 0
    assert json.loads(saved.read_text())["rows"] == result["rows"]


SMALL: dict[str, Any] = {"batch": 256, "growth": 0.0, "width": 16, "strokes": 1024, "evaluate_every": 2, "checkpoint_every": 2}


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


@pytest.mark.slow
def test_a_study_is_resumed_with_more_variants_and_budgets(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flags = ["--seeds", "2", "--out", str(tmp_path / "study"), "--json"]
    assert self_play_main([*flags, "--variants", "plain", "--strokes", "20000"]) == 0
    first = json.loads(capsys.readouterr().out)["rows"]
    assert self_play_main([*flags, "--resume", "--variants", "plain", "pool", "--strokes", "20000", "40000"]) == 0
    result = json.loads(capsys.readouterr().out)
    asked = [(way, strokes) for way in ("plain", "pool") for strokes in (20_000, 40_000)]
    assert [(row["variant"], row["strokes"]) for row in result["rows"]] == asked
    assert [row["each"] for row in result["rows"][:1]] == [row["each"] for row in first]
    for row in result["rows"]:
        assert row["seeds"] == len(row["each"]) == 2
        assert 0 < row["exploitability_of_the_best"]["worst"] <= row["exploitability"]["worst"] == max(row["each"]) < 1
