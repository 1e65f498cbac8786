"""The measures of pairs of players, on simulated matches whose truth is known."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from experiments.pairs import strokes as of_strokes
from experiments.pairs.__main__ import main
from shuttle_marl.analysis.strokes import simulate
from shuttle_marl.data.schema import Account
from shuttle_marl.data.table import write_parquet
from shuttle_marl.data.upstream import matches_of
from shuttle_marl.dynamics.skill import VARIANCES
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


def test_the_command(
    table: pa.Table, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
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
