"""The KL-regularised equilibrium against a hand-solved game, plain value iteration, and its two limits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.exact import ExactError, PairPolicy, solve, solve_soft
from shuttle_marl.exact.profile import StatePolicy
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import ROOT, Game
from tests.exact.exact_games import THREE_STROKES, games, hand_made, random_policy, seeds, with_probabilities

Floats = np.ndarray


def uniform(game: Game) -> PairPolicy:
    return PairPolicy(game=game, probability=game.normalized(np.ones(game.n_pairs)))


def by_value_iteration(priors: tuple[StatePolicy, StatePolicy], tau: float) -> tuple[Floats, Floats]:
    """Regularised values of both players by plain sweeps in numpy."""

    def sweep(prior: StatePolicy, following: Floats) -> Floats:
        game = prior.game
        weights = prior.pair_probabilities() * np.exp(game.stroke_values(following) / tau)
        return np.where(game.playable, tau * np.log(np.where(game.playable, game.sum_by_state(weights), 1.0)), 0.0)

    first = np.zeros(priors[0].game.n_states)
    for _ in range(5000):
        second = sweep(priors[1], first)
        before, first = first, sweep(priors[0], second)
        if np.abs(first - before).max() < 1e-13:
            return first, second
    raise ArithmeticError("value iteration did not converge")


@settings(max_examples=20, deadline=None)
@given(games, seeds, st.floats(0.02, 5.0))
def test_equal_to_value_iteration(game: Game, seed: int, tau: float) -> None:
    prior = random_policy(game, seed)
    found = solve_soft(prior, tau=tau, tolerance=1e-10)
    expected, _ = by_value_iteration((prior, prior), tau)
    assert np.abs(found.value[0] - expected).max() <= 2e-10
    assert found.error_bound <= 1e-10
    assert found.policy[0] is found.policy[1]
    assert game.sum_by_state(found.policy[0].probability)[game.playable] == pytest.approx(1)


@settings(max_examples=15, deadline=None)
@given(games, seeds, st.floats(0.02, 5.0))
def test_players_with_priors_and_tables_of_their_own(game: Game, seed: int, tau: float) -> None:
    priors = random_policy(game, seed), random_policy(with_probabilities(game, seed), seed + 1)
    found = solve_soft(*priors, tau=tau, tolerance=1e-10)
    for value, expected in zip(found.value, by_value_iteration(priors, tau), strict=True):
        assert np.abs(value - expected).max() <= 2e-10
    again = solve_soft(*priors[::-1], tau=tau, tolerance=1e-10)
    assert again.value[1] == pytest.approx(found.value[0], abs=1e-9)


@settings(max_examples=15, deadline=None)
@given(games, seeds)
def test_tau_leads_from_perfect_play_to_the_prior(game: Game, seed: int) -> None:
    prior, perfect = uniform(game), solve(game)
    cheap = solve_soft(prior, tau=1e-5)
    # A soft maximum over K strokes lies up to tau log K below the maximum, and the gaps of a rally add up.
    assert np.abs(cheap.value[0] - perfect.value[0]).max() < 1e-2
    values = game.stroke_values(perfect.value[1])
    loss = perfect.value[0] - game.sum_by_state(cheap.policy[0].probability * values)
    assert loss[game.playable].max() < 1e-2
    dear = solve_soft(random_policy(game, seed), tau=1e9)
    assert np.abs(dear.policy[0].probability - random_policy(game, seed).pair_probabilities()).max() < 1e-8


def test_what_the_prior_never_plays_stays_unplayed() -> None:
    game = hand_made((*THREE_STROKES, "clear:back-centre:above:forehand"))
    clears = game.catalogue.shot[game.pair_stroke] == SHOTS.index("clear")
    prior = PairPolicy(game=game, probability=game.normalized(np.where(clears, 0.0, 1.0)))
    found = solve_soft(prior, tau=0.01)
    assert (found.policy[0].probability[clears] == 0).all()
    assert found.value[0][ROOT] == pytest.approx(-39 / 368, abs=1e-8)


@pytest.mark.parametrize("tau", [0.0, -1.0, float("inf"), float("nan")])
def test_tau_is_a_positive_number(tau: float) -> None:
    with pytest.raises(ExactError, match="expected a finite number above 0"):
        solve_soft(uniform(hand_made()), tau=tau)
