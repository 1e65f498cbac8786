"""The measures of truth and of likeness, on simulated matches whose truth is known."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from experiments import human
from experiments.truth.decisions import decision_slope, promises, value_error, value_log_loss
from experiments.truth.limits import slopes_if_true
from experiments.truth.matches import Strokes, strokes_of
from experiments.truth.paired import differences, load_values, save_values
from experiments.truth.worlds import World, shipped_world
from shuttle_marl.analysis.strokes import simulate
from shuttle_marl.exact import PairPolicy, solve_soft
from shuttle_marl.policy import baselines
from tests.reduced import reduced_game, reduced_model


@pytest.fixture(scope="module")
def world() -> World:
    return shipped_world(reduced_model())


def played(world: World, matches: int, seed: int) -> pa.Table:
    """Matches between two average players of a world: the world is the truth."""
    p = world.bc.pair_probabilities()
    return simulate(world.game, {"one": p, "other": p}, matches=matches, seed=seed)


@pytest.fixture(scope="module")
def table(world: World) -> pa.Table:
    return played(world, 150, seed=0)


@pytest.fixture(scope="module")
def strokes(table: pa.Table) -> Strokes:
    return strokes_of(table)


def is_near(found: dict[str, float], truth: float) -> bool:
    """Whether a value is within four standard errors, as its 95 % interval gives them.

    Of some thirty values in a test, one is more than three away in two of five seeds.
    """
    return abs(found["value"] - truth) < 4 * (found["high"] - found["low"]) / 3.92


def test_in_a_true_game_promises_come_true(world: World, strokes: Strokes, tmp_path: Path) -> None:
    promised = promises(world.bc, strokes)
    slopes = decision_slope(strokes, promised)
    assert list(slopes) == ["1", "4", "8", "end"]
    assert all(is_near(slope, 1.0) for slope in slopes.values()), slopes
    assert slopes["end"]["high"] - slopes["end"]["low"] < 0.3
    assert value_log_loss(strokes, promised) < np.log(2)
    errors = [role for roles in value_error(strokes, promised).values() for role in roles.values()]
    far = [e for e in errors if not is_near({**e, "value": e["points"]}, 0.0)]
    assert len(errors) > 20
    assert far == []
    some = strokes.take(strokes.in_matches(strokes.rows.matches[:40]))
    assert slopes_if_true(world, world, some) == pytest.approx(dict.fromkeys(slopes, 1.0), abs=1e-6)
    save_values(tmp_path / "values", strokes, promised)
    same = differences(strokes, promised, load_values(tmp_path / "values", strokes))
    assert all(change == {"value": 0.0, "low": 0.0, "high": 0.0} for change in same.values())


GAME = reduced_game()
PRIOR = PairPolicy(game=GAME, probability=baselines.probabilities(None, GAME))
TRUE_TAU = 0.1


@pytest.fixture(scope="module")
def human_strokes() -> Strokes:
    p = solve_soft(PRIOR, tau=TRUE_TAU).policy[0].pair_probabilities()
    return strokes_of(simulate(GAME, {"one": p, "other": p}, matches=8, seed=0))


def test_a_known_tau_is_found_again(human_strokes: Strokes) -> None:
    real = human.answers(GAME, human_strokes)
    assert len(real.strokes) > 0.99 * len(human_strokes)
    policies = [solve_soft(PRIOR, tau=tau, tolerance=1e-7).policy[0].probability for tau in human.TAUS]
    losses = np.stack([real.losses(p) for p in (*policies, PRIOR.probability)])
    found = human.fit(losses, real.strokes.rally)
    assert found["tau"] == TRUE_TAU
    assert found["low"] <= TRUE_TAU <= found["high"] <= 0.2
    assert 0 < found["gain"]["low"] < found["gain"]["value"] < found["gain"]["high"]
    assert found["cross_entropy"] - found["gain"]["value"] == pytest.approx(losses[human.TAUS.index(TRUE_TAU)].mean())
