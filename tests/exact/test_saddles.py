"""One sweep over states with hidden positions, state by state, against matrices that are written out."""

import dataclasses
import functools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from shuttle_marl.exact.fixed_point import ExactError
from shuttle_marl.exact.saddles import Saddle, SoftSaddle, largest_continuation_by_position
from shuttle_marl.exact.solver import successors
from shuttle_marl.game.tables import Game
from tests.exact.exact_games import random_game, random_policy
from tests.exact.test_hidden_positions_solved import entries, waiting, with_recovery

Floats = np.ndarray[Any, np.dtype[np.float64]]


@functools.cache
def game_of(seed: int) -> Game:
    """One with two serves, three strokes and duels for odd seeds; two levels of effort for 1, 4, …, three for 2, 5, …"""
    return with_recovery(random_game(seed, 3), seed)


@functools.cache
def sister(seed: int) -> Game:
    """The same states and positions with other outcomes."""
    game = game_of(seed)
    other = dataclasses.replace(
        game, recovery=None, threshold=np.sort(game.threshold[::-1], axis=1), hurry=game.hurry[::-1].copy()
    )
    return dataclasses.replace(other, recovery=game.recovery)


def following_of(game: Game, seed: int = 0) -> Floats:
    """Values of the next states, drawn at random."""
    return np.random.default_rng(seed).uniform(-1, 1, game.n_states)


def states_of(game: Game, block: int) -> list[tuple[int, int, slice, list[int]]]:
    """Of every fifth state of a block the number in the game and in the block, its pairs there, and the feasible positions."""
    start, table, first = game.base_pair_start.tolist(), game.waiting, game.block_states(block).start
    return [
        (first + s, s, slice(start[s], start[s + 1]), table.position[s, : table.choices[s]].tolist())
        for s in range(block % 5, game.n_base_states, 5)
    ]


def shares(game: Game, block: int, positions: Floats) -> None:
    """Check that positions are distributions over the feasible ones."""
    for _, s, _, those in states_of(game, block):
        assert positions[s, those].sum() == pytest.approx(1)
        assert positions[s].sum() == pytest.approx(1)
        assert positions[s].min() >= 0


def played(game: Game, player: Saddle, following: Floats) -> Iterator[tuple[Any, int, int, slice, list[int]]]:
    """Strategies of each block, and its states with strokes; a state without strokes has value 0 and one position."""
    for block in range(game.n_blocks):
        found = player.strategies(block, *successors(game, following, block))
        shares(game, block, found.positions)
        for state, s, pairs, those in states_of(game, block):
            if pairs.start == pairs.stop:
                assert (found.value[s], found.positions[s, those[0]]) == (0, 1)
            else:
                yield found, state, s, pairs, those


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("against", [None, True, False])
def test_free_players_mix_as_in_the_matrix_of_each_state(seed: int, against: bool | None) -> None:
    """Each guarantees the value. Of two games nature picks the worse entry for the striker, or the better one."""
    games = (game_of(seed),) if against is None else (game_of(seed), sister(seed))
    game, mixed, swaps = games[0], 0, 0
    player, following = Saddle(games, against=bool(against)), following_of(game)
    for found, state, s, pairs, those in played(game, player, following):
        each = np.stack([entries(one, state, following) for one in games])
        matrix = each[0] if against is None else each.min(axis=0) if against else each.max(axis=0)
        value = found.value[s]
        x, y = found.strokes[pairs], found.positions[s, those]
        assert x.sum() == pytest.approx(1)
        assert (x @ matrix).min() == pytest.approx(value, abs=1e-9)
        assert (matrix @ y).max() == pytest.approx(value, abs=1e-9)
        mixed += x.max() < 0.99
        rows = slice(game.waiting.start[s], game.waiting.start[s] + matrix.size)
        np.testing.assert_array_equal(found.picked[rows], (matrix != each[0]).ravel())
        swaps += found.picked[rows].sum()
    assert mixed > 1
    assert (swaps > 0) == (against is not None)
    assert 0 <= player.gap < 1e-12


@pytest.mark.parametrize("tau", [0.01, 0.2, 5.0])
def test_soft_strategies_answer_each_other_softly(tau: float) -> None:
    """x is b exp(M y / tau) and y is q exp(-x M / tau), normalised; the value is x M y - tau KL(x, b) + tau KL(y, q)."""
    game = with_recovery(random_game(0, 6), 0)
    following, policy = following_of(game), waiting(random_policy(game, 2), 2)
    before, usual = policy.pair_probabilities(), policy.position_probabilities()
    assert usual is not None
    never = game.base_pair_rank == 0  # strokes that people never play, where there are others
    several = np.diff(game.base_pair_start)[game.base_pair_state] > 2
    before = before * np.where(np.tile(never & several, game.n_blocks), 0.0, 1.0)
    before /= np.bincount(game.pair_state, before, game.n_states)[game.pair_state]
    blocks = tuple(before[game.block_pairs(block)] for block in range(game.n_blocks))
    player, mixed = SoftSaddle((game,), strokes=blocks, positions=usual, tau=tau), 0
    for block in range(game.n_blocks):
        here = successors(game, following, block)
        found = player.strategies(block, *here)
        shares(game, block, found.positions)
        assert np.array_equal(player.block_sweep(block, *here)[0], found.value)
        for state, s, pairs, those in states_of(game, block):
            if pairs.start == pairs.stop:
                continue
            matrix, b, q = entries(game, state, following), blocks[block][pairs], usual[state, those]
            x, y = found.strokes[pairs], found.positions[s, those]
            strokes, waits = b * np.exp(matrix @ y / tau), q * np.exp(-(x @ matrix) / tau)
            np.testing.assert_allclose(x, strokes / strokes.sum(), atol=1e-6)
            np.testing.assert_allclose(y, waits / waits.sum(), atol=1e-6)
            played = x > 0
            mixed += x[played].min() < 0.9
            cost = (x[played] * np.log(x[played] / b[played])).sum() - (y * np.log(y / q)).sum()
            assert found.value[s] == pytest.approx(x @ matrix @ y - tau * cost, abs=1e-9)
    assert 0 <= player.gap < 1e-8
    assert mixed > 5


def endless(game: Game, which: slice) -> Game:
    """The game in which some strokes never end the rally."""
    limits = game.waiting.limits.copy()
    limits[:, which, :2] = 0
    changed = dataclasses.replace(game)
    changed.__dict__["waiting"] = game.waiting._replace(limits=limits)
    return changed


def test_a_stroke_that_never_ends_the_rally_against_a_position_is_refused() -> None:
    game = game_of(1)
    first = int(game.waiting.start[4])
    with pytest.raises(ExactError, match="never ends the rally against some position"):
        largest_continuation_by_position(endless(game, slice(first, first + 1)))
    assert largest_continuation_by_position(endless(game, slice(first))) == largest_continuation_by_position(game), "a serve may"
