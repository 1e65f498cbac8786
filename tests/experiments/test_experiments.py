"""Each experiment at a small size; those on the annotated matches where SHUTTLESET names their folder."""

import dataclasses
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from experiments.imitation.networks import NetworksConfig
from experiments.imitation.trees import TreesConfig
from scipy.special import expit

from experiments import advice, human, next_stroke, realism, same_results, self_play, win_rates
from experiments.imitation.imitator import Imitator, ImitatorConfig
from experiments.league_training import HEADINGS, table_rows
from experiments.league_training import main as league_training
from experiments.pairs import strokes as of_pairs
from experiments.pairs.__main__ import main as pairs
from experiments.truth import recovery as truth_of_recovery
from experiments.truth.decisions import decision_slope, promises, value_error, value_log_loss
from experiments.truth.limits import slopes_if_true
from experiments.truth.matches import strokes_of
from experiments.truth.paired import differences, load_values, save_values
from experiments.truth.worlds import shipped_world
from shuttle_marl.analysis import advice as analysis_advice
from shuttle_marl.analysis.strokes import simulate
from shuttle_marl.data import load_strokes
from shuttle_marl.data.schema import Account
from shuttle_marl.data.table import write_parquet
from shuttle_marl.data.upstream import matches_of
from shuttle_marl.dynamics.features import Rows, rows_from_strokes
from shuttle_marl.dynamics.fitted import FittedModels
from shuttle_marl.dynamics.recovery import load_recovery
from shuttle_marl.dynamics.skill import VARIANCES
from shuttle_marl.exact import PairPolicy, solve_soft
from shuttle_marl.game import model_folder
from shuttle_marl.game.shipped import refits_of
from shuttle_marl.policy import baselines
from shuttle_marl.training import PPOConfig
from tests.reduced import REFITS, reduced_game, reduced_model

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "datasets" / "sample" / "strokes.parquet"
MATCHES = os.environ.get("SHUTTLESET")
GAME = reduced_game()
NAMES = ("viktor-axelsen", "kento-momota")


def write_published(path: Path, matches: Sequence[str], seed: int) -> None:
    """Simulated matches of average players under the names of two with skill, and of published matches."""
    table = simulate(GAME, dict.fromkeys(NAMES, baselines.load(None, GAME).pair_probabilities()), matches=len(matches), seed=seed)
    named = dict(zip(table["match"].unique().to_pylist(), matches, strict=True))
    at = table.schema.get_field_index("match")
    table = table.set_column(at, table.schema.field(at), [[named[name] for name in table["match"].to_pylist()]])
    none = Account(matches=0, rallies=0, rallies_kept=0, strokes=0, strokes_kept=0, dropped={}, area_agreement=None)
    write_parquet(table, path, account=none, provenance={})


@pytest.mark.parametrize("command", [next_stroke.main, realism.main])
def test_data_without_the_split_is_named(command, capsys: pytest.CaptureFixture[str]) -> None:
    assert command(["--data", str(SAMPLE)]) == 1
    assert "no match of the split" in capsys.readouterr().err


@pytest.mark.skipif(not MATCHES, reason="SHUTTLESET names no folder with the annotated matches")
def test_play_is_realistic(capsys: pytest.CaptureFixture[str]) -> None:
    assert realism.main(["--data", str(MATCHES), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)["figures"]
    assert figures["mean rally"]["simulated"] == pytest.approx(figures["mean rally"]["value"], rel=0.05)
    assert figures["fault share"]["simulated"] == pytest.approx(figures["fault share"]["value"], abs=0.02)


def test_a_checkout_equals_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    same_results.main(ROOT, ROOT, out=tmp_path / "out", only=("solve",))
    assert "the same: 1 commands, 1 files" in capsys.readouterr().out


def test_table_of_the_next_stroke() -> None:
    networks = NetworksConfig(members=2, epochs=8, batch=128, learning_rate=0.02, width=32, layers=2)
    config = ImitatorConfig(networks=networks, trees=TreesConfig(type_rounds=15, area_rounds=5, leaves=7, rate=0.3))
    strokes = load_strokes(SAMPLE).slice(0, 1000)
    part = strokes.slice(0, 300)
    result = next_stroke.table(Imitator.fit(strokes, config=config), FittedModels.load(model_folder()), part)
    assert list(result["rows"]) == ["all strokes", "rally strokes", "rally strokes, contact height not known"]
    assert result["rows"]["all strokes"]["imitator"]["rows"] == len(part)
    lines = next_stroke.table_rows(json.loads(json.dumps({**result, "paper": next_stroke.PAPER})))
    assert {len(line) for line in lines} == {len(next_stroke.HEADINGS)}


def test_advice(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    write_published(tmp_path / "strokes.parquet", matches_of("validation")[:2], seed=5)
    monkeypatch.setattr(analysis_advice, "LEAST_REFITS", len(REFITS))
    monkeypatch.setattr(advice, "date_of", lambda _: None)
    flags = ["--data", str(tmp_path / "strokes.parquet"), "--model", reduced_model(), "--out", str(tmp_path / "advice.json")]
    assert advice.main([*flags, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["matches"] == 2
    assert {"n", "promised", "realised", "low", "high"} == set(result["advised"]) == set(result["not_advised"])
    assert json.loads((tmp_path / "advice.json").read_text())["advised"] == result["advised"]


def test_pairs_of_players(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    data, out = tmp_path / "strokes.parquet", tmp_path / "pairs.json"
    write_published(data, (*matches_of("train")[:12], *matches_of("test")[:12]), seed=3)
    monkeypatch.setattr(of_pairs, "deviations_in", lambda card: np.full((3, len(VARIANCES)), 0.3))
    assert pairs(["--data", str(data), "--split", "test", "--model", reduced_model(), "--out", str(out)]) == 0
    assert "bradley terry" in capsys.readouterr().out
    result = json.loads(out.read_text())
    assert result["components"]["success"].keys() >= {"average", "pair", "difference", "low", "high"}
    assert pairs(["--data", str(data), "--cross", "1"]) == 1
    assert "expected 2 or more parts" in capsys.readouterr().err


def test_in_a_true_game_promises_come_true(tmp_path: Path) -> None:
    def is_near(found: dict[str, float], truth: float) -> bool:  # of thirty values, one is over three errors away in 2 of 5 seeds
        return abs(found["value"] - truth) < 4 * (found["high"] - found["low"]) / 3.92

    world = shipped_world(reduced_model())
    p = world.bc.pair_probabilities()
    strokes = strokes_of(simulate(world.game, {"one": p, "other": p}, matches=150, seed=0))
    promised = promises(world.bc, strokes)
    slopes = decision_slope(strokes, promised)
    assert all(is_near(slope, 1.0) for slope in slopes.values()), slopes
    assert value_log_loss(strokes, promised) < np.log(2)
    errors = [role for roles in value_error(strokes, promised).values() for role in roles.values()]
    assert [error for error in errors if not is_near({**error, "value": error["points"]}, 0.0)] == []
    some = strokes.take(strokes.in_matches(strokes.rows.matches[:40]))
    assert slopes_if_true(world, world, some) == pytest.approx(dict.fromkeys(slopes, 1.0), abs=1e-6)
    save_values(tmp_path / "values", strokes, promised)
    same = differences(strokes, promised, load_values(tmp_path / "values", strokes))
    assert all(change == {"value": 0.0, "low": 0.0, "high": 0.0} for change in same.values())


def test_effects_of_positions_are_worth_what_they_promise() -> None:
    """Outcomes are drawn as the game with recovery says, at the places of the sample."""
    recovery = load_recovery(model_folder())
    assert recovery is not None
    rows = rows_from_strokes(load_strokes(SAMPLE))
    everything = Rows.joined([rows.take(np.arange(len(rows)))] * 8)
    judged = truth_of_recovery.judged_by(FittedModels.load(model_folder()), recovery, everything)
    rng = np.random.default_rng(0)
    for found in judged:
        assert np.ptp(found.shift) > 0.1
        drawn = found._replace(label=rng.random(len(found.label)) < expit(found.logit + found.shift))
        summary = truth_of_recovery._summary(drawn, seed=0)
        assert summary["slope_low"] < 1 < summary["slope_high"]
        assert summary["low"] <= summary["log_loss_change"] < 0
    logit, effect, weight = rng.normal(-2, 1, 50), rng.normal(0, 1, (50, 9)), rng.random((50, 9))
    spread = truth_of_recovery._spread(logit, effect, weight)
    assert np.ptp(spread - effect, axis=1) == pytest.approx(0, abs=1e-12)
    assert np.average(expit(spread), weights=weight, axis=1) == pytest.approx(expit(logit), abs=1e-7)
    known = shipped_world("default")
    assert (
        truth_of_recovery.recovery_effects([(dataclasses.replace(known, recovery=None), strokes_of(load_strokes(SAMPLE)))])
        is None
    )


def test_a_known_tau_is_found_again() -> None:
    prior = PairPolicy(game=GAME, probability=baselines.probabilities(None, GAME))
    p = solve_soft(prior, tau=0.1).policy[0].pair_probabilities()
    real = human.answers(GAME, strokes_of(simulate(GAME, {"one": p, "other": p}, matches=8, seed=0)))
    policies = [solve_soft(prior, tau=tau, tolerance=1e-7).policy[0].probability for tau in human.TAUS]
    found = human.fit(np.stack([real.losses(p) for p in (*policies, prior.probability)]), real.strokes.rally)
    assert found["tau"] == 0.1
    assert found["gain"]["low"] > 0


@pytest.mark.slow
def test_variants_of_league_training(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, saved = tmp_path / "study", tmp_path / "results.json"
    flags = ["--quick", "--variants", "plain", "psro-exact", "--game", reduced_model(), "--out", str(out), "--json", str(saved)]
    assert league_training(flags) == 0
    result = json.loads(saved.read_text())
    assert [(row["variant"], row["seeds"]) for row in result["rows"]] == [("plain", 2), ("psro-exact", 1)]
    assert {len(cells) for cells in table_rows(result)} == {len(HEADINGS)}
    assert league_training([*flags, "--resume"]) == 0
    assert json.loads(saved.read_text())["rows"] == result["rows"]


@pytest.mark.slow(minutes=True)
def test_win_rates(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small: dict[str, Any] = {
        "batch": 256,
        "growth": 0.0,
        "width": 16,
        "strokes": 1024,
        "evaluate_every": 2,
        "checkpoint_every": 2,
    }
    agents = {"ppo, self-play": PPOConfig(**small, opponent=("self",))}  # `.ci/run` trains all
    monkeypatch.setattr(win_rates, "AGENTS", agents)
    monkeypatch.setattr(win_rates, "OPPONENTS", ("bc", "minimax"))
    # Two refits say as much of this program as eight.
    monkeypatch.setattr(win_rates, "refits_of", lambda game: refits_of(game)[:2])
    out, saved = tmp_path / "run", tmp_path / "results.json"
    flags = ["--agents", *agents, "--seeds", "2", "--matches", "4", "--jobs", "1", "--out", str(out), "--json", str(saved)]
    assert win_rates.main(flags) == 0
    result = json.loads(saved.read_text())
    rows = {row["agent"]: row for row in result["rows"]}
    assert list(rows) == ["bc", "best response", "minimax", "ppo, self-play"]
    assert rows["best response"]["normalised_score"]["mean"] == pytest.approx(1, abs=1e-3)
    assert rows["minimax"]["exploitability"]["mean"] == pytest.approx(0, abs=1e-4)
    assert win_rates.main([*flags, "--resume"]) == 0
    assert json.loads(saved.read_text())["rows"] == result["rows"]


@pytest.mark.slow
def test_a_study_of_self_play_is_resumed_with_more_variants(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flags = ["--seeds", "2", "--out", str(tmp_path / "study"), "--json"]
    assert self_play.main([*flags, "--variants", "plain", "--strokes", "20000"]) == 0
    first = json.loads(capsys.readouterr().out)["rows"]
    assert self_play.main([*flags, "--resume", "--variants", "plain", "pool", "--strokes", "20000"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert [row["variant"] for row in result["rows"]] == ["plain", "pool"]
    assert result["rows"][0]["each"] == first[0]["each"]
