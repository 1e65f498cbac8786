"""Strength against likeness: a TAU that is known is found again in simulated matches."""

import numpy as np
import pytest

from experiments import human
from experiments.truth.matches import Strokes, strokes_of
from shuttle_marl.analysis.strokes import simulate
from shuttle_marl.exact import PairPolicy, solve_soft
from shuttle_marl.policy import baselines
from tests.reduced import reduced_game

GAME = reduced_game()
PRIOR = PairPolicy(game=GAME, probability=baselines.probabilities(None, GAME))
TRUE_TAU = 0.1


@pytest.fixture(scope="module")
def strokes() -> Strokes:
    p = solve_soft(PRIOR, tau=TRUE_TAU).policy[0].pair_probabilities()
    return strokes_of(simulate(GAME, {"one": p, "other": p}, matches=8, seed=0))


def test_a_known_tau_is_found_again(strokes: Strokes) -> None:
    real = human.answers(GAME, strokes)
    assert len(real.strokes) > 0.99 * len(strokes)
    policies = [solve_soft(PRIOR, tau=tau, tolerance=1e-7).policy[0].probability for tau in human.TAUS]
    losses = np.stack([real.losses(p) for p in (*policies, PRIOR.probability)])
    found = human.fit(losses, real.strokes.rally)
    assert found["tau"] == TRUE_TAU
    assert found["low"] <= TRUE_TAU <= found["high"] <= 0.2
    assert 0 < found["gain"]["low"] < found["gain"]["value"] < found["gain"]["high"]
    assert found["cross_entropy"] - found["gain"]["value"] == pytest.approx(losses[human.TAUS.index(TRUE_TAU)].mean())
