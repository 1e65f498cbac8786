"""The one basis of marks, changes, better strokes and questions; quality of decisions, and the rating by them."""

import copy

import numpy as np
import pytest

from shuttle_marl.base.arrays import I64
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.exact import evaluate, moved
from shuttle_marl.game.policy import tabulate
from shuttle_marl.game.shipped import REFITS, RELIABLE, factor_of, load_game, real_strokes, refits_of
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.registry import resolve
from shuttle_marl.reports.rating import PAR, RARE, Rater, Rating, rater_of
from shuttle_marl.reports.value import LEAST_REFITS, agree
from tests import golden
from tests.reduced import reduced_model


@pytest.fixture(scope="module")
def game() -> Game:
    """The small game with all refits."""
    return load_game(reduced_model(tuple(str(k + 1) for k in range(REFITS))))


@pytest.fixture(scope="module")
def basis(game: Game) -> Rater:
    return rater_of(game)


@pytest.fixture(scope="module")
def states(game: Game) -> I64:
    return np.random.default_rng(3).choice(np.flatnonzero(game.playable), 300, replace=False)


def test_a_change_is_that_of_strong_play_in_the_refits_against_the_choice_of_elite_players(basis: Rater, states: I64) -> None:
    game, real, factor = basis.game, real_strokes(basis.game), factor_of(basis.game)
    judged = basis.rated(states)
    strong, elite = (tabulate(resolve(name, game), game) for name in ("human:0.05", "bc"))
    last = refits_of(game)[-1]
    value = evaluate(moved(strong, last), moved(strong, last)).striking[0]
    for i in range(0, len(states), 20):
        pairs = np.arange(game.n_pairs)[game.pairs_of(int(states[i]))]
        mine = np.flatnonzero(judged.row == i)
        chance = elite.probability_of(pairs) * (real[game.base_pair_edge[pairs % game.n_base_pairs]] >= RELIABLE)
        if chance.sum() == 0:
            continue
        wins = last.stroke_values(value, pairs) / 2
        assert judged.refits[-1, mine] == pytest.approx(wins - chance @ wins / chance.sum(), abs=1e-5)
        assert judged.change[mine] == pytest.approx(factor.value * judged.refits[:, mine].mean(axis=0))
        assert judged.start[i] == mine[0]


def test_a_game_without_a_factor_takes_predicted_advantages_whole(basis: Rater, states: I64) -> None:
    unknown = copy.copy(basis)
    unknown.factor = None
    judged = unknown.rated(states)
    assert judged.change == pytest.approx(judged.refits.mean(axis=0))


def test_marks_need_real_strokes_agreement_and_a_rare_choice(basis: Rater, states: I64) -> None:
    judged = basis.rated(states)
    marks = np.array(judged.marks)
    marked = marks != ""
    assert marked.sum() > 20
    assert judged.behind[marked].min() >= RELIABLE
    assert judged.behind[judged.best[judged.row[marked]]].min() >= RELIABLE
    assert judged.share[marked].max() < RARE
    assert agree(judged.refits)[marked].all()
    losses = -judged.change[np.char.find(marks, "?") >= 0]
    assert losses.min() >= 0.02
    assert judged.change[np.isin(marks, ("!", "!!"))].min() >= 0.04
    assert (judged.loss >= 0).all()
    best = judged.best[judged.best >= 0]
    assert (judged.loss[best] == 0).all()


def test_marks_and_questions_are_the_written_ones(basis: Rater, states: I64) -> None:
    judged = [basis.rated(state) for state in states[:100, None]]
    asked = [{k: found for k in range(len(one.row)) if (found := one.question(k))} for one in judged]
    assert sum(map(len, asked)) > 20
    for one, questions in zip(judged, asked, strict=True):
        assert all(one.behind[[right, *wrong]].min() >= RELIABLE for right, wrong in questions.values())
    figures = [[one.marks[int(one.loss.argmax())], one.best, one.change.max(), one.win.sum(), one.loss.sum()] for one in judged]
    golden.check("marks", {"questions": asked, "figures": figures})


def test_refits_that_differ_or_are_few_do_not_agree() -> None:
    values = np.array([[1.0, 1.0, -1.0]] * LEAST_REFITS) + np.linspace(-0.1, 0.1, LEAST_REFITS)[:, None] * [1, 12, 1]
    assert agree(values).tolist() == [True, False, True]
    assert not agree(values[1:]).any()


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


def test_the_best_stroke_has_quality_one_and_strokes_that_are_not_judged_have_none(basis: Rater, states: I64) -> None:
    judged = basis.rated(states)
    found = judged.quality
    assert judged.known.any()
    assert (np.isnan(found) == ~judged.known).all()
    assert (found[judged.best[judged.best >= 0]] == 1).all()
    assert (judged.behind[~np.isnan(found)] >= RELIABLE).all()
    worse = judged.known & (judged.change < judged.change[judged.best[judged.row]])
    assert ((found[worse] > 0) & (found[worse] < 1)).all()
