"""What players see in the pure functions for JAX, as decisions of a learner; ``tests/game/test_rules.py`` has the rules."""

import numpy as np
import pytest

from tests.recovery import small_recovery_game

pytestmark = pytest.mark.slow(minutes=True)


def test_decisions_are_seen_as_in_training() -> None:
    jax = pytest.importorskip("jax")
    from shuttle_marl.env import jax as rally
    from shuttle_marl.training.networks import decision_masks, decision_observations

    game, rng, count = small_recovery_game(), np.random.default_rng(0), 20_000
    state = np.flatnonzero(game.playable)[rng.integers(game.playable.sum(), size=count)].astype(np.int32)
    waits = rng.random(count) < 0.5
    seen, mask = jax.jit(jax.vmap(rally.observe, (None, 0, 0)))(rally.Tables.of(game), state, waits)
    decisions = state + game.n_states * waits
    assert np.array_equal(seen, decision_observations(game, decisions))
    assert np.array_equal(mask, decision_masks(game, decisions))
