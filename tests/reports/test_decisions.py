"""Quality of decisions, and the rating by them."""

import numpy as np
import pytest

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.game import default_game
from shuttle_marl.game.shipped import RELIABLE
from shuttle_marl.reports.rating import PAR, Rating, rater_of


def test_glicko_2_gives_the_worked_example_of_the_paper() -> None:
    opponents = [Rating(points=points, deviation=deviation) for points, deviation in ((1400, 30), (1550, 100), (1700, 300))]
    found = Rating(points=1500, deviation=200, volatility=0.06).after([1, 0, 0], opponents)
    assert found.points == pytest.approx(1464.06, abs=0.01)
    assert found.deviation == pytest.approx(151.52, abs=0.01)
    assert found.volatility == pytest.approx(0.05999, abs=1e-5)


def test_who_plays_nothing_becomes_less_certain_and_surprises_raise_volatility() -> None:
    known = Rating(points=1700, deviation=50)
    idle, surprised = known.after([]), known.after([0.0] * 200)
    assert idle.points == known.points
    assert idle.deviation == pytest.approx(np.hypot(50, 0.06 * 400 / np.log(10)))
    assert idle.volatility == known.volatility < surprised.volatility


def test_a_rating_converges_to_the_strength_of_its_scores() -> None:
    rng, strength, rating = np.random.default_rng(1), 1500.0, Rating()
    expected = 1 / (1 + 10 ** ((PAR.points - strength) / 400))
    for _ in range(100):
        rating = rating.after((rng.random(30) < expected).astype(float).tolist())
    low, high = rating.interval
    assert low < strength < high
    assert rating.deviation < 40


@pytest.mark.parametrize("wrong", [{"points": float("nan")}, {"deviation": -1.0}, {"volatility": 0.0}])
def test_impossible_ratings_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ShuttleError, match="expected finite points"):
        Rating(**wrong)
    with pytest.raises(ShuttleError, match="from 0 to 1"):
        Rating().after([1.5])


def test_the_best_stroke_has_quality_one_and_strokes_that_are_not_judged_have_none() -> None:
    game = default_game()
    judged = rater_of(game).rated(np.flatnonzero(game.playable)[:200])
    found = judged.quality
    assert (np.isnan(found) == ~judged.known).all()
    assert (found[judged.best[judged.best >= 0]] == 1).all()
    assert (judged.behind[~np.isnan(found)] >= RELIABLE).all()
    worse = judged.known & (judged.change < judged.change[judged.best[judged.row]])
    assert ((found[worse] > 0) & (found[worse] < 1)).all()
