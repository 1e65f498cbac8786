"""The pure functions for JAX play by the rules of the kernel."""

import numpy as np
import pytest

from shuttle_marl.game import default_game
from shuttle_marl.game.rules import FAULT, WINNER, strike
from tests.recovery import small_recovery_game

pytestmark = pytest.mark.slow(minutes=True)


def test_a_hundred_thousand_strokes_are_those_of_the_rules() -> None:
    jax = pytest.importorskip("jax")
    from shuttle_marl.env import jax as rally

    game, rng, count = default_game(), np.random.default_rng(0), 100_000
    state = np.flatnonzero(game.playable)[rng.integers(game.playable.sum(), size=count)].astype(np.int32)
    k = (rng.random(count) * game.legal_count(state)).astype(np.int32)
    draw = np.asarray(rally.draws(jax.random.key(0), (count,)))
    outcome, following = strike(game, state, k, draw)
    tables = rally.Tables.of(game)
    found = jax.jit(jax.vmap(rally.step, (None, 0, 0, 0)))(tables, state, game.stroke_at(state, k), draw)
    assert np.array_equal(found.terminated, following < 0)
    assert np.array_equal(found.state, np.where(following < 0, rally.init(), following))
    assert np.array_equal(found.reward, (outcome == WINNER).astype(np.float32) - (outcome == FAULT))
    seen, mask = jax.jit(jax.vmap(rally.observe, (None, 0)))(tables, state)
    assert np.array_equal(seen, game.observation(state))
    assert np.array_equal(mask, game.mask(state))


def test_positions_are_those_of_the_rules() -> None:
    jax = pytest.importorskip("jax")
    from shuttle_marl.env import jax as rally
    from shuttle_marl.training.networks import decision_masks, decision_observations

    game, rng, count = small_recovery_game(), np.random.default_rng(0), 20_000
    state = np.flatnonzero(game.playable)[rng.integers(game.playable.sum(), size=count)].astype(np.int32)
    k = (rng.random(count) * game.legal_count(state)).astype(np.int32)
    feasible = game.waiting.mask(game.base(state))
    position = (rng.random(feasible.shape) * feasible).argmax(axis=1).astype(np.int32)
    draw = np.asarray(rally.draws(jax.random.key(0), (count,)))
    outcome, following = strike(game, state, k, draw, position=position)
    tables = rally.Tables.of(game)
    found = jax.jit(jax.vmap(rally.step, (None, 0, 0, 0, 0)))(tables, state, game.stroke_at(state, k), draw, position)
    assert np.array_equal(found.state, np.where(following < 0, rally.init(), following))
    assert np.array_equal(found.reward, (outcome == WINNER).astype(np.float32) - (outcome == FAULT))
    waits = rng.random(count) < 0.5
    seen, mask = jax.jit(jax.vmap(rally.observe, (None, 0, 0)))(tables, state, waits)
    decisions = state + game.n_states * waits
    assert np.array_equal(seen, decision_observations(game, decisions))
    assert np.array_equal(mask, decision_masks(game, decisions))
