"""One stroke in plain Python: what it tells, and the draws by counter."""

import copy
import pickle

import numpy as np
import pytest

from shuttle_marl.game import Game, default_game, tabulate
from shuttle_marl.game.draws import choice_draw, draw, first_server, outcome_draw, position_draw, stream
from shuttle_marl.game.layout import SWAP, observations
from shuttle_marl.game.policy import UniformPolicy
from shuttle_marl.game.rally import RallyDraws, Stepper, choose, stepper_of
from shuttle_marl.game.rules import HURRIED_BELOW


@pytest.fixture(scope="module")
def game() -> Game:
    return default_game()


@pytest.fixture(scope="module")
def pairs(game: Game) -> np.ndarray:
    return np.random.default_rng(1).integers(0, game.n_pairs, 2000)


def test_strokes_tell_their_probabilities(game: Game, pairs: np.ndarray) -> None:
    stepper, state, stroke = stepper_of(game), game.pair_state[pairs], game.pair_stroke[pairs]
    good, returned, _ = game.stroke_probabilities(pairs)
    for i in range(len(pairs)):
        played, after = stepper.step(int(state[i]), i % 2, int(stroke[i]), (1 << 24) - 1)
        assert (played.player, played.stroke, played.p_succ, played.p_ret) == (i % 2, stroke[i], good[i], returned[i])
        assert after in game.arrivals(pairs[i : i + 1])
        assert stepper.is_hurried(after) == (played.outcome >= HURRIED_BELOW)


def test_observations_and_masks_equal_those_of_batches(game: Game, pairs: np.ndarray) -> None:
    stepper, states = stepper_of(game), game.pair_state[pairs[:200]]
    for state, seen, mask in zip(states.tolist(), observations(game, states), game.mask(states), strict=True):
        np.testing.assert_array_equal(stepper.observe(state), seen)
        np.testing.assert_array_equal(stepper.observe(state, receiver=True), seen[SWAP])
        np.testing.assert_array_equal(stepper.legal_action_mask(state), mask)
        assert [stepper.is_legal(state, stroke) for stroke in range(-1, game.n_strokes + 1)] == [False, *mask.tolist(), False]


def test_a_policy_chooses_the_same_stroke_with_and_without_a_table(game: Game, pairs: np.ndarray) -> None:
    policy, draws = UniformPolicy(), np.random.default_rng(3).integers(0, 65535, 50)
    table = tabulate(policy, game)
    for state, number in zip(game.pair_state[pairs[:50]].tolist(), draws.tolist(), strict=True):
        rank = int(table.choose(np.array([state]), np.array([number]))[0])
        expected = int(game.stroke_at(state, rank))
        assert choose(table, game, state, number) == choose(policy, game, state, number) == expected


@pytest.mark.parametrize("numbers", [(), (4,)])
def test_draws_equal_those_by_counter(numbers: tuple[int, ...]) -> None:
    draws = RallyDraws(7, *numbers)
    for rally in (0, 31, 32, 5):
        bits = draw(stream(7, *numbers, rally), np.arange(40))
        assert draws.first_server(rally) == first_server(bits)[0]
        assert [draws.outcome(rally, k) for k in range(40)] == outcome_draw(bits).tolist()
        assert [draws.choice(rally, k) for k in range(40)] == choice_draw(bits).tolist()
        assert [draws.position(rally, k) for k in range(40)] == position_draw(bits).tolist()


def test_copies_share_the_stepper_of_the_game(game: Game) -> None:
    stepper = stepper_of(game)
    assert copy.deepcopy(stepper) is stepper
    assert isinstance(pickle.loads(pickle.dumps(stepper)), Stepper)
