"""Advantages to expect in real matches: factors of a model card, and where they are stated."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.commands.exact import main
from shuttle_marl.data import read_matches
from shuttle_marl.dynamics.evaluate import add_truth, write_card
from shuttle_marl.game.layout import GameError
from shuttle_marl.game.shipped import Estimate, factor_of, factors_of, load_game, read_model_card
from shuttle_marl.policy import baselines
from shuttle_marl.reports import add_values
from tests.reduced import reduced_model

SAMPLE = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"
SLOPES = {"1": {"value": 1.0, "low": 0.9, "high": 1.1, "n": 9}, "end": {"value": 0.75, "low": 0.5, "high": 0.9, "n": 9}}
TRUTH: dict[str, Any] = {
    "split": None,
    "cross": 4,
    "train_only": True,
    "matches": 68,
    "strokes": 55_000,
    "decision_slope": SLOPES,
    "promised_realised": {},
}


@pytest.fixture
def model(tmp_path: Path) -> Iterator[Path]:
    folder = tmp_path / "model"
    shutil.copytree(reduced_model(), folder)
    write_card(folder, {name: value for name, value in read_model_card(folder).items() if name != "truth"})
    yield folder
    load_game.cache_clear()


def test_factors_come_from_training_matches_only(model: Path) -> None:
    assert factors_of(model) is None
    add_truth(model, {**TRUTH, "train_only": False})
    assert factors_of(model) is None
    add_truth(model, TRUTH)
    assert factors_of(model) == {"1": Estimate(1.0, 0.9, 1.1), "end": Estimate(0.75, 0.5, 0.9)}
    assert factor_of(load_game(str(model))) == Estimate(0.75, 0.5, 0.9)
    write_card(model, {**read_model_card(model), "truth": {**TRUTH, "decision_slope": {"end": {"value": "x"}}}})
    with pytest.raises(GameError, match="invalid factors"):
        factors_of(model)


def test_best_responses_and_holes_state_the_part_to_expect(model: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def printed(*command: str) -> Any:
        assert main([*command, "--game", str(model), "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    assert printed("best-response", "bc", "--no-away")["expected_rally_win"] is None
    assert printed("holes", "bc", "--top", "2")["holes"][0]["expected"] is None
    add_truth(model, TRUTH)
    load_game.cache_clear()
    found = printed("best-response", "bc", "--no-away")
    edge = found["rally_win"] - 0.5
    assert found["expected_rally_win"] == pytest.approx(
        {"value": 0.5 + 0.75 * edge, "low": 0.5 + 0.5 * edge, "high": 0.5 + 0.9 * edge}
    )
    for hole in printed("holes", "bc", "--top", "2")["holes"]:
        assert hole["expected"]["value"] == pytest.approx(0.75 * hole["regret"])
    assert main(["holes", "bc", "--top", "1", "--game", str(model)]) == 0
    assert "75.0 % (50.0 % to 90.0 %) of a predicted advantage was realised" in " ".join(capsys.readouterr().out.split())


def test_decisions_have_a_part_to_expect(model: Path) -> None:
    strokes = read_matches(SAMPLE).slice(0, 400)
    unknown = add_values(strokes, baselines.load(None, load_game(str(model))))
    assert unknown["decision_expected"].null_count == 400
    add_truth(model, TRUTH)
    valued = add_values(strokes, baselines.load(None, load_game(str(model))))
    decision, expected = (valued[name].to_numpy(zero_copy_only=False) for name in ("decision", "decision_expected"))
    np.testing.assert_allclose(expected, 0.75 * decision)
    assert np.isfinite(expected).sum() > 100
