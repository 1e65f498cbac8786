"""Values where it matters whether the striker is hurried: by hand, and over the six outcomes of a stroke."""

import dataclasses

import numpy as np
import pytest

from shuttle_marl.exact import best_response, evaluate, solve
from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.game.thresholds import ONE
from tests.exact.exact_games import THREE_STROKES, hand_made, random_game, random_policy

Floats = np.ndarray


def test_three_strokes_that_hurried_strikers_miss() -> None:
    """One receiver in four is hurried after a return from below, one in two from above, and then half of all strokes are faults.

    A, L are the values above and below, H of a hurried striker from either height; X = 3/4 L + H/4 and Y = A/2 + H/2 are those of
    a return from below and from above: A = 1/4 - X/4 - Y/4, L = -1/4 - X/4 - Y/2, and H = -1/2 - X/4 - Y/4.
    """
    game = hand_made(THREE_STROKES)
    threshold = game.threshold.copy()
    threshold[game.hurried(game.base_pair_state) == 1] = np.array([8, 8, 12]) * (ONE // 16)
    hurry = np.tile(np.array([64, 128], np.uint8), (game.n_base_pairs, 1))
    found = solve(dataclasses.replace(game, threshold=threshold, hurry=hurry), tolerance=1e-12)
    # Unknowns A, L, H, X, Y.
    stroke = [[1, 0, 0, 1 / 4, 1 / 4], [0, 1, 0, 1 / 4, 1 / 2], [0, 0, 1, 1 / 4, 1 / 4]]
    matrix = [*stroke, [0, -3 / 4, -1 / 4, 1, 0], [-1 / 2, 0, -1 / 2, 0, 1]]
    above, below, hurried, *returned = np.linalg.solve(matrix, [1 / 4, -1 / 4, -1 / 2, 0, 0])
    for offset, value in enumerate((below, above, hurried, hurried)):
        assert found.value[0][4 + offset :: 4] == pytest.approx(value, abs=2e-12)
    assert found.value[0][ROOT] == pytest.approx(-1 / 8 - 7 / 16 * sum(returned), abs=2e-12)


def one_stroke_ahead(game: Game) -> tuple[Floats, Floats, Floats]:
    """``[P]`` reward, ``[P, 4]`` probabilities and states of the four returns, from the parts of the states alone."""
    state, stroke = game.pair_state, game.pair_stroke
    _, incoming, contact, duel, effort, other, _ = game.observation(state).T.astype(np.int64)
    assert (game.catalogue.height[stroke] == contact).all()
    fault, winner, below = game.limits[effort, np.arange(game.n_pairs) % game.n_base_pairs].T / ONE
    late = np.tile(game.hurry, (game.n_blocks, 1)).T / 256
    chance = [(below - winner) * (1 - late[0]), (1 - below) * (1 - late[1]), (below - winner) * late[0], (1 - below) * late[1]]
    following = np.zeros_like(stroke)
    if game.counts_duels:
        net = game.catalogue.is_net_shot[stroke]
        begun = incoming < game.n_strokes
        on = begun & game.catalogue.is_net_shot[np.where(begun, incoming, 0)]
        following = np.where(net, np.where(on, np.minimum(duel + 1, 3), 1), 0)
    tired = np.minimum(effort + game.catalogue.is_attack[stroke], game.levels - 1)
    after = [game.state_of(incoming, stroke, above, following, other, tired, hurried) for hurried in (0, 1) for above in (0, 1)]
    return winner - 2 * fault, np.stack(chance, axis=1), np.stack(after, axis=1)


def iterated(game: Game, weight: Floats | None) -> Floats:
    """``[S]`` values of a policy of both players, ``[P]``; of perfect play without one."""
    reward, chance, after = one_stroke_ahead(game)
    assert after.min() >= 0
    assert np.array_equal(after, game.arrivals())
    value, before = np.zeros(game.n_states), np.full(game.n_states, np.inf)
    while np.abs(value - before).max() > 1e-13:
        quality, before = reward - (chance * value[after]).sum(axis=1), value
        value = np.zeros(game.n_states)
        if weight is None:
            value[game.playable] = np.maximum.reduceat(quality, game.first_pairs)
        else:
            value[game.playable] = np.add.reduceat(weight * quality, game.first_pairs)
    return value


def test_sixty_games_against_value_iteration() -> None:
    for seed in range(60):
        game = random_game(seed, 2 + seed % 5)
        rally = game.base(np.arange(game.n_states)) >= 4
        found = solve(game, tolerance=1e-11)
        assert np.abs(found.value[0] - iterated(game, None))[rally].max() < 1e-10
        policy = random_policy(game, seed)
        value = evaluate(policy, policy, tolerance=1e-11).striking[0]
        assert np.abs(value - iterated(game, policy.pair_probabilities()))[rally].max() < 1e-10
        hurried = game.hurried(np.arange(game.n_states)) == 1
        assert np.abs(value[hurried & rally] - value[np.roll(hurried, -2) & rally]).max() > 1e-3, "the bit matters"
        assert best_response(policy).value.odds().value > -1e-9
