"""The commands of experiments, each at a small size."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from shuttle_marl.data.schema import Account
from shuttle_marl.data.simulated import simulate
from shuttle_marl.data.table import write_parquet
from shuttle_marl.data.upstream import matches_of
from shuttle_marl.policy import baselines
from tests.experiments.commands import result_of, run
from tests.reduced import reduced_game, reduced_model

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "datasets" / "sample" / "strokes.parquet"
NAMES = ("viktor-axelsen", "kento-momota")


def write_published(path: Path, matches: Sequence[str], seed: int) -> None:
    """Simulated matches of average players under the names of two with skill, and of published matches."""
    game = reduced_game()
    played = baselines.load(None, game)
    table = simulate(game, dict.fromkeys(NAMES, played), matches=len(matches), seed=seed)
    named = dict(zip(table["match"].unique().to_pylist(), matches, strict=True))
    at = table.schema.get_field_index("match")
    table = table.set_column(at, table.schema.field(at), [[named[name] for name in table["match"].to_pylist()]])
    none = Account(matches=0, rallies=0, rallies_kept=0, strokes=0, strokes_kept=0, dropped={}, area_agreement=None)
    write_parquet(table, path, account=none, provenance={})


def test_next_stroke_names_a_split_that_the_data_lack() -> None:
    assert "no match of the split" in run("experiments.next_stroke", "--data", SAMPLE, status=1)


@pytest.mark.slow
def test_next_stroke_scores_all_predictors(tmp_path: Path) -> None:
    data = tmp_path / "strokes.parquet"
    write_published(data, matches_of("validation")[:1], seed=2)
    settings = ("--data", data, "--model", reduced_model(), "--out", tmp_path / "next_stroke.json")
    result = result_of("experiments.next_stroke", *settings)
    assert list(result["rows"]) == ["all strokes", "rally strokes"]
    for scores in result["rows"].values():
        assert list(scores) == ["own clone", "average clone"]
        assert all(np.diff(of["shot_type"]).min() >= 0 for of in scores.values())
    # The strokes are those of the average player.
    own, average = (result["rows"]["all strokes"][name]["cross_entropy"] for name in ("own clone", "average clone"))
    assert average <= own
    assert json.loads((tmp_path / "next_stroke.json").read_text())["rows"] == result["rows"]


@pytest.mark.slow
def test_same_results_names_what_differs(tmp_path: Path) -> None:
    saved = tmp_path / "saved.json"
    found = result_of("experiments.same_results", ROOT, ROOT, "--only", "game", "--save", saved)
    assert found["different"] == []
    found["items"]["game"]["default safe"] = "another table"
    saved.write_text(json.dumps(found))
    assert "game/default safe" in run("experiments.same_results", saved, ROOT, "--only", "game", status=1)


@pytest.mark.slow
def test_no_report_of_the_sample_contradicts_its_matches() -> None:
    found = result_of("experiments.reports", "--data", SAMPLE, "--pairs", 1)
    assert (found["matches"], found["pairs"], found["languages"]) == (8, 1, 3)
    assert (found["contradictions"], found["insignificant_dos"], found["raw_names"]) == (0, 0, 0), found["found"]
    assert found["statements"]["habit"] > 0
    assert all(0 < share <= 1 for part in found["sections"].values() for share in part.values())
    assert min(found["seconds"].values()) > 0


def test_pairs_refuses_a_single_part(tmp_path: Path) -> None:
    assert "expected 2 or more parts" in run("experiments.pairs", "--data", SAMPLE, "--cross", 1, status=1)


@pytest.mark.slow
def test_truth_finds_that_promises_come_true_in_the_game_itself(tmp_path: Path) -> None:
    data = tmp_path / "strokes.parquet"
    write_published(data, (*matches_of("validation"), *matches_of("train")[:4]), seed=0)
    settings = ("--game", reduced_model(), "--halvings", 0, "--seed", 1)  # not the draws of the data
    result = result_of("experiments.truth", "--data", data, "--split", "validation", *settings)

    def is_near(found: dict[str, float], value: float, truth: float) -> bool:  # of thirty, one errs by over three in 2 of 5 seeds
        return abs(value - truth) < 4 * (found["high"] - found["low"]) / 3.92

    slopes = result["decision_slope"]
    assert all(is_near(slope, slope["value"], 1.0) for slope in slopes.values()), slopes
    assert result["value_log_loss"] < np.log(2)
    assert is_near(result["two_sample_auc"], result["two_sample_auc"]["value"], 0.5)
    errors = [error for error in result["value_error"].values() if error["n"] >= 300]
    assert [error for error in errors if not is_near(error, error["points"], 0.0)] == []
    assert result["illegal"] == 0
