"""Promised and realised gains of advice, on simulated matches in which promises are true."""

import json
from pathlib import Path

import pytest

from experiments import advice as experiment
from experiments.advice import main
from shuttle_marl.analysis import advice
from shuttle_marl.analysis.strokes import simulate
from shuttle_marl.data.schema import Account
from shuttle_marl.data.table import write_parquet
from shuttle_marl.data.upstream import matches_of
from shuttle_marl.game.shipped import load_game
from shuttle_marl.policy import baselines
from tests.reduced import REFITS, reduced_model

NAMES = ("viktor-axelsen", "kento-momota")


@pytest.fixture(autouse=True)
def few_refits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(advice, "LEAST_REFITS", len(REFITS))


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    game = load_game(reduced_model())
    table = simulate(game, dict.fromkeys(NAMES, baselines.load(None, game).pair_probabilities()), matches=2, seed=5)
    named = dict(zip(table["match"].unique().to_pylist(), matches_of("validation"), strict=False))
    column = table["match"].to_pylist()
    table = table.set_column(0, table.schema.field(0), [[named[name] for name in column]])
    account = Account(matches=2, rallies=0, rallies_kept=0, strokes=0, strokes_kept=0, dropped={}, area_agreement=None)
    write_parquet(table, tmp_path / "strokes.parquet", account=account, provenance={})
    monkeypatch.setattr(experiment, "date_of", lambda _: None)
    out = tmp_path / "advice.json"
    assert main(["--data", str(tmp_path / "strokes.parquet"), "--model", reduced_model(), "--out", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["matches"] == 2
    assert {"n", "promised", "realised", "low", "high"} == set(result["advised"]) == set(result["not_advised"])
    assert json.loads(out.read_text())["advised"] == result["advised"]
