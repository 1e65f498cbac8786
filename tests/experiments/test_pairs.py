"""The measures of pairs of players, on simulated matches whose truth is known."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest
from scipy.special import expit

from experiments.pairs import strokes as of_strokes
from experiments.pairs.__main__ import main
from experiments.pairs.parts import Annotated, Part
from experiments.pairs.results import Rallies, bradley_terry, pair_probabilities, rallies_of, results
from experiments.truth.matches import strokes_of
from shuttle_marl.analysis.strokes import simulate
from shuttle_marl.data.schema import Account
from shuttle_marl.data.table import write_parquet
from shuttle_marl.data.upstream import matches_of
from shuttle_marl.dynamics.skill import VARIANCES
from shuttle_marl.exact import evaluate
from shuttle_marl.game.pairs import pair_game
from shuttle_marl.game.shipped import load_game
from shuttle_marl.game.skill import load_skill
from shuttle_marl.policy import baselines
from tests.reduced import reduced_model

NO_ACCOUNT = Account(matches=0, rallies=0, rallies_kept=0, strokes=0, strokes_kept=0, dropped={}, area_agreement=None)


@pytest.fixture(scope="module")
def table() -> pa.Table:
    """Matches of average players under the names of two with skill."""
    game = load_game(reduced_model())
    men = [name for name in load_skill(Path(reduced_model())).players if name in ("viktor-axelsen", "kento-momota")]
    bc = baselines.load(None, game).pair_probabilities()
    return simulate(game, dict.fromkeys(men, bc), matches=24, seed=3)


def annotated(table: pa.Table) -> Annotated:
    return Annotated(strokes=strokes_of(table), game=table["game"].to_numpy().astype(np.int64))


@pytest.fixture(scope="module")
def part(table: pa.Table) -> Part:
    everything = annotated(table)
    first = everything.strokes.rows.match < 12
    return Part(folder=Path(reduced_model()), seen=everything.take(first), unseen=everything.take(~first))


def test_rallies_know_their_server_and_winner(table: pa.Table) -> None:
    rallies = rallies_of(strokes_of(table))
    first = pc.equal(table["stroke"], 1)
    assert rallies.server.tolist() == table.filter(first)["player"].to_pylist()
    assert (rallies.server != rallies.receiver).all()
    # Without the serves, too.
    later = rallies_of(strokes_of(table.filter(pc.invert(first))))
    longer = np.isin(np.arange(len(rallies.won)), strokes_of(table).rally[strokes_of(table).number == 2])
    assert (later.won == rallies.won[longer]).all()
    assert (later.server == rallies.server[longer]).all()


def simulated_rallies(seed: int, rating: dict[str, float]) -> Rallies:
    rng, names = np.random.default_rng(seed), np.array(list(rating))
    pair = np.stack([rng.choice(len(names), 2, replace=False) for _ in range(40)])
    match = np.repeat(np.arange(40), 80)
    serves = rng.integers(0, 2, len(match))
    server, receiver = names[pair[match, serves]], names[pair[match, 1 - serves]]
    odds = np.array([rating[a] - rating[b] for a, b in zip(server, receiver, strict=True)]) - 0.2
    return Rallies(
        server=server, receiver=receiver, won=rng.random(len(match)) < expit(odds), match=match.astype(np.int64),
        day=match.astype(np.int64), discipline=np.zeros(len(match), np.int64), matches=tuple(map(str, range(40))),
    )  # fmt: skip


def test_bradley_terry_finds_the_ratings() -> None:
    rating = {"a": 0.4, "b": 0.1, "c": -0.1, "d": -0.4}
    seen = simulated_rallies(1, rating)
    names = np.array(list(rating))
    asked = dataclasses.replace(
        seen, server=np.repeat(names, 4), receiver=np.tile(names, 4), won=np.ones(16, bool), match=np.zeros(16, np.int64),
        day=np.full(16, 99), discipline=np.zeros(16, np.int64),
    )  # fmt: skip
    p = bradley_terry(seen, asked)
    truth = np.array([expit(rating[a] - rating[b] - 0.2) for a in rating for b in rating])
    assert p == pytest.approx(truth, abs=0.04)
    strangers = dataclasses.replace(asked, server=np.full(16, "x"), receiver=np.full(16, "y"))
    assert np.ptp(bradley_terry(seen, strangers)) == 0


def test_the_pair_is_evaluated_exactly(part: Part) -> None:
    rallies = rallies_of(part.unseen.strokes)
    p, count = pair_probabilities(part, rallies)
    assert count == 12
    names = ["kento-momota", "viktor-axelsen"]
    pair = pair_game(*names, game=str(part.folder))
    odds = evaluate(*(baselines.load(name, seat) for name, seat in zip(names, pair.seats, strict=True))).odds(0)
    first = rallies.server == names[0]
    assert p[first] == pytest.approx(odds.serving)
    assert p[~first] == pytest.approx(1 - odds.receiving)


def test_results_are_scored(part: Part) -> None:
    found = results([part])
    assert set(found["results"]) == {"coin", "bradley_terry", "pair", "mean"}
    assert found["results"]["coin"] == pytest.approx(np.log(2))
    # These players are average, whatever their names: skill at random makes no better than a coin.
    assert found["results"]["pair"] > found["results"]["coin"]
    assert found["matches"] == 12
    assert found["calibration"]["low"] < 0.5
    json.dumps(found)


def test_the_command(
    table: pa.Table, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Simulated matches under the names of published ones."""
    matches = list(dict.fromkeys(table["match"].to_pylist()))
    published = dict(zip(matches, [*matches_of("train")[:12], *matches_of("test")[:12]], strict=True))
    renamed = pa.array([published[match] for match in table["match"].to_pylist()])
    data = tmp_path / "strokes.parquet"
    named = table.set_column(table.schema.get_field_index("match"), table.schema.field("match"), renamed)
    write_parquet(named, data, account=NO_ACCOUNT, provenance={})
    monkeypatch.setattr(of_strokes, "deviations_in", lambda card: np.full((3, len(VARIANCES)), 0.3))
    out = tmp_path / "pairs.json"
    assert main(["--data", str(data), "--split", "test", "--model", reduced_model(), "--out", str(out)]) == 0
    assert "bradley terry" in capsys.readouterr().out
    result = json.loads(out.read_text())
    assert result["components"]["success"].keys() >= {"average", "pair", "difference", "low", "high"}
    assert result["calibration"].keys() == {"slope", "low", "high"}
    assert main(["--data", str(data), "--split", "validation"]) == 1
    assert "no match of the split 'validation'" in capsys.readouterr().err
    assert main(["--data", str(data)]) == 1
    assert main(["--data", str(data), "--cross", "1"]) == 1
    assert "expected 2 or more parts" in capsys.readouterr().err
