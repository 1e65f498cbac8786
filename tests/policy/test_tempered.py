"""Policies made sharper and flatter."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shuttle_marl.game import default_game
from shuttle_marl.game.policy import PolicyError, States, TemperedPolicy, checked_probabilities
from shuttle_marl.policy.foreign import FunctionPolicy
from shuttle_marl.policy.registry import resolve

GAME = default_game()
STATES = States(game=GAME, state=np.flatnonzero(GAME.legal_count(np.arange(GAME.n_states)))[::211].astype(np.int32))


@given(st.floats(0.01, 100))
def test_probabilities_are_powers(temperature: float) -> None:
    base = resolve("attacking", GAME).probabilities(STATES)
    p = checked_probabilities(TemperedPolicy(resolve("attacking", GAME), temperature), STATES, "tempered")
    a, b = np.argsort(base, axis=1)[:, -1], np.argsort(base, axis=1)[:, -2]
    rows = np.flatnonzero(base[np.arange(len(base)), b] > 0)
    ratio = np.log(base[rows, a[rows]] / base[rows, b[rows]]) / temperature
    assert np.allclose(p[rows, b[rows]] / p[rows, a[rows]], np.exp(-ratio), rtol=1e-9, atol=1e-300)


def test_temperature_one_changes_nothing_and_zero_takes_the_likeliest() -> None:
    base = resolve("defensive", GAME).probabilities(STATES)
    assert np.allclose(resolve("defensive@1", GAME).probabilities(STATES), base, atol=1e-15)
    greedy = resolve("defensive@greedy", GAME).probabilities(STATES)
    assert np.array_equal(greedy.argmax(axis=1), base.argmax(axis=1))
    assert np.array_equal(greedy.max(axis=1), np.ones(len(STATES)))
    cold = resolve("defensive@0.0001", GAME).probabilities(STATES)
    assert np.array_equal(cold > 0, np.isclose(base, base.max(axis=1, keepdims=True), rtol=0.05) & (cold > 0))


def test_faults_of_the_base_are_not_hidden() -> None:
    def twice(states: States) -> np.ndarray:
        return 2 * resolve("random", GAME).probabilities(states)

    with pytest.raises(PolicyError, match="no distribution"):
        TemperedPolicy(FunctionPolicy(twice), 0.5).probabilities(STATES)


@pytest.mark.parametrize("temperature", [-1.0, float("nan"), float("inf")])
def test_impossible_temperatures(temperature: float) -> None:
    with pytest.raises(PolicyError, match="expected a finite number"):
        TemperedPolicy(resolve("random", GAME), temperature)
