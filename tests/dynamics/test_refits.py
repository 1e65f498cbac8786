"""A whole model made by the command: profiles, refits, card; and resampled matches."""

from pathlib import Path

import numpy as np
import pytest

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.data import load_strokes
from shuttle_marl.dynamics import make
from shuttle_marl.dynamics.card import add_truth, as_markdown
from shuttle_marl.dynamics.features import rows_from_strokes
from shuttle_marl.dynamics.make import make_model, resampled
from shuttle_marl.dynamics.network import EnsembleConfig, fold_of_match
from shuttle_marl.exact import evaluate
from shuttle_marl.game.shipped import VARIANTS, load_game, read_model_card, refits_of, variants
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.policy import baselines
from tests.dynamics.test_fitting import SAMPLE

TRUTH = {
    "split": None,
    "train_only": False,
    "cross": 4,
    "matches": 40,
    "strokes": 1000,
    "decision_slope": {"end": {"value": 0.9, "low": 0.7, "high": 1.1, "n": 900}},
    "promised_realised": {"smash": {"promised": 1.25, "realised": {"points": -0.5, "low": -1.0, "high": 0.1, "n": 321}}},
}


def test_a_resample_has_as_many_matches_of_each_discipline_and_copies_share_a_fold() -> None:
    rows = rows_from_strokes(load_strokes(SAMPLE))
    again = resampled(rows, [0, 1])
    first = [np.unique(part.match, return_index=True)[1] for part in (rows, again)]
    number = len(first[0])
    drawn = np.unique(again.match)
    assert 0.4 * number < len(drawn) < 0.85 * number, "about 63 % of the matches, some of them more than once"
    lengths = np.bincount(rows.match)
    assert (np.bincount(again.match, minlength=len(lengths))[drawn] % lengths[drawn] == 0).all(), "matches are whole"
    women = [np.bincount(part.match[part.codes["discipline"] == 1]) for part in (rows, again)]
    copies = [count[count > 0] / lengths[np.flatnonzero(count)] for count in women]
    assert copies[0].sum() == copies[1].sum()
    fold = fold_of_match(again.match, 5)
    assert all(len(np.unique(fold[again.match == match])) == 1 for match in drawn)
    assert np.array_equal(resampled(rows, [0, 1]).match, again.match)
    assert not np.array_equal(np.unique(resampled(rows, [0, 2]).match), drawn)


@pytest.mark.slow(minutes=True)
def test_a_model_with_profiles_and_refits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = rows_from_strokes(load_strokes(SAMPLE)).matches
    parts = {"train": names[: len(names) // 4 * 3], "validation": names[len(names) // 4 * 3 :]}
    monkeypatch.setattr(make, "matches_of", parts.get)
    monkeypatch.setattr(make, "split_of", lambda name: "train")
    # Trees take minutes, and others test them.
    monkeypatch.setattr(
        "shuttle_marl.dynamics.evaluate.tree_predictions",
        lambda names, train, label, match, test: np.full(len(test["shot"]), label.mean()),
    )
    lines: list[str] = []
    config = EnsembleConfig(epochs=1, batch=256, folds=5)
    card = make_model(SAMPLE, tmp_path / "model", seed=1, refits=2, config=config, report=lines.append)
    name = str(tmp_path / "model")
    assert card["variants"] == variants(name) == ["men", "women", "1", "2"]
    assert "refit 2 of 2 is fitted" in lines
    game = load_game(name)
    assert len({game.hash, *(load_game(f"{name}:{variant}").hash for variant in card["variants"])}) == 5
    assert len(refits_of(game)) == 2
    # What is sure to be worse in one game is so in its refits: their tables are of the same layout and of the same world.
    average = baselines.load(None, game)
    for refit in refits_of(game):
        away = TabulatedPolicy(game=refit, cumulative=average.cumulative)
        assert evaluate(away, baselines.load(None, refit)).odds().rally == pytest.approx(0.5, abs=0.01)
    assert (tmp_path / "model" / VARIANTS).stat().st_size < 3 * game.n_base_pairs * len(card["variants"])
    add_truth(tmp_path / "model", TRUTH)
    text = as_markdown(read_model_card(tmp_path / "model"))
    assert "| smash | +1.25 | -0.50 | -1.00 to +0.10 | 321 |" in text
    assert "4 games, each evaluated on held-out matches" in text
    assert load_game(f"{name}:men").hash
    with pytest.raises(ShuttleError, match="decision_slope missing"):
        add_truth(tmp_path / "model", {key: value for key, value in TRUTH.items() if key != "decision_slope"})
