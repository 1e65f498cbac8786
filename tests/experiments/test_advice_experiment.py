"""Promised and realised gains of advice, on simulated matches in which promises are true."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from experiments import advice as experiment
from experiments.advice import Judged, judged, main, named
from experiments.truth.matches import strokes_of
from shuttle_marl.analysis import advice
from shuttle_marl.analysis.advice import advise, refitted
from shuttle_marl.analysis.strokes import simulate
from shuttle_marl.data.schema import Account
from shuttle_marl.data.table import write_parquet
from shuttle_marl.data.upstream import matches_of
from shuttle_marl.game.pairs import pair_game
from shuttle_marl.game.shipped import load_game
from shuttle_marl.game.skill import AVERAGE
from shuttle_marl.policy import baselines
from tests.reduced import REFITS, reduced_model

NAMES = ("viktor-axelsen", "kento-momota")


@pytest.fixture(autouse=True)
def few_refits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(advice, "LEAST_REFITS", len(REFITS))


def test_promises_are_kept_where_the_game_is_true() -> None:
    game = load_game(reduced_model())
    table = simulate(game, dict.fromkeys(NAMES, baselines.load(None, game).pair_probabilities()), matches=40, seed=5)
    found = dataclasses.replace(refitted(pair_game(AVERAGE, AVERAGE, game=reduced_model())), factor=None)
    found = named(found, NAMES)
    every = strokes_of(table)
    parts = []
    for number, name in enumerate(every.matches):
        match = every.take(every.in_matches([name]))
        parts += [judged(match, found, seat, advise(found, seat), number) for seat in (0, 1)]
    result = Judged.joined(parts)
    assert result.advised.any()
    assert (~result.advised).sum() > 1000
    for which in (result.advised, ~result.advised):
        error = result.realised[which].std() / np.sqrt(which.sum())
        assert abs(result.realised[which].mean() - result.promised[which].mean()) < 3.5 * error
    assert result.promised[result.advised].mean() > 0 > result.promised[~result.advised].mean()
    summary = result.summary()
    assert summary["advised"]["n"] == result.advised.sum()
    assert summary["advised"]["low"] < summary["advised"]["realised"] < summary["advised"]["high"]


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
