"""Index arithmetic of a game: states, legal pairs and numbers over them, against plain loops."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shuttle_marl.base.arrays import F64, Bools
from shuttle_marl.game import default_game
from shuttle_marl.game.draws import HURRY_ONE, ONE
from shuttle_marl.game.rally import states_of_rallies
from shuttle_marl.game.rules import FAULT, OUTCOMES, WINNER
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel import struck
from tests.game.test_rally_layout import games

GAME = default_game()
STATES = np.arange(GAME.n_states)


def test_a_state_and_its_observation_name_each_other() -> None:
    seen = GAME.observation(STATES)
    assert seen.shape == (GAME.n_states, 7)
    assert seen.dtype == np.int32
    assert (GAME.state_of(*seen.T) == STATES).all()
    assert GAME.observation(7).tolist() == [GAME.own(7), GAME.incoming(7), GAME.contact(7), GAME.duel(7), 0, 0, 1]


@given(games)
def test_only_what_can_occur_has_a_state(made: tuple[Game, Bools]) -> None:
    game, _ = made
    n = game.n_strokes
    levels = slice(-1, game.levels + 1)
    parts = np.mgrid[-1 : n + 2, -1 : n + 2, -1:3, -1:5, levels, levels, -1:3].reshape(7, -1)
    expected = np.full(parts.shape[1], -1)
    seen = game.observation(np.arange(game.n_states))
    # The place of each observation in the grid, whose parts all begin at -1.
    sizes = (n + 3, n + 3, 4, 6, game.levels + 2, game.levels + 2, 4)
    expected[np.ravel_multi_index(tuple((seen + 1).T), sizes)] = np.arange(game.n_states)
    assert (game.state_of(*parts) == expected).all()


def test_values_of_strokes_are_means_over_all_draws() -> None:
    rng = np.random.default_rng(3)
    following = rng.uniform(-1, 1, GAME.n_states)
    low = np.arange(ONE)
    every = GAME.stroke_values(following)
    assert every.shape == (GAME.n_pairs,)
    for pair in [0, GAME.n_pairs - 1, *rng.integers(GAME.n_pairs, size=1)]:
        state, k = np.full(ONE, GAME.pair_state[pair]), np.full(ONE, GAME.base_pair_rank[pair % GAME.n_base_pairs])
        total, count = 0.0, np.zeros(len(OUTCOMES), np.int64)
        for high in range(HURRY_ONE):
            outcome, after = struck(GAME, state, k, high * ONE + low)
            total += np.where(outcome == WINNER, 1.0, np.where(outcome == FAULT, -1.0, -following[after])).sum()
            count += np.bincount(outcome, minlength=len(OUTCOMES))
        assert every[pair] == pytest.approx(total / ONE / HURRY_ONE, abs=1e-12)
        assert GAME.outcome_probabilities(np.array(pair)).tolist() == (count / ONE / HURRY_ONE).tolist()
    some = np.array([5, 900, 3, GAME.n_pairs - 1])
    assert (GAME.stroke_values(following, some) == every[some]).all()
    assert (GAME.outcome_probabilities(slice(2, 9)) == GAME.outcome_probabilities(np.arange(2, 9))).all()


@given(games, st.integers(0, 1000))
def test_states_count_what_was_played(made: tuple[Game, Bools], seed: int) -> None:
    game, _ = made
    rng = np.random.default_rng(seed)
    names, strokes, position, hurried, visited = game.catalogue.names, [], [], [], []
    for _ in range(4):
        state = 0
        rally: list[int] = []
        for _ in range(12):
            net, attacks = 0, [0, 0]
            for number, stroke in enumerate(rally):
                net = net + 1 if "net-shot" in names[stroke] else 0
                attacks[number % 2] += "smash" in names[stroke]
            mine, theirs = (min(attacks[(len(rally) + seat) % 2], game.levels - 1) for seat in (0, 1))
            own, incoming = (rally[-back] if len(rally) >= back else game.n_strokes for back in (2, 1))
            counted = min(net, 3) if game.counts_duels else 0
            assert game.observation(state).tolist() == [own, incoming, state & 1, counted, mine, theirs, state >> 1 & 1]
            k = int(rng.integers(game.legal_count(state)))
            position.append(len(rally))
            hurried.append(bool(game.hurried(state)))
            rally.append(int(game.stroke_at(state, k)))
            visited.append(state)
            pair = game.pair_at(state, k)
            _, following = struck(game, np.array([state]), np.array([k]), rng.integers(1, 257, 1) * ONE - 1)
            assert following[0] in game.arrivals(pair)
            state = int(following[0])
        strokes += rally
    assert states_of_rallies(game, np.array(strokes), np.array(position), np.array(hurried)).tolist() == visited


def ends_of(game: Game, block: int) -> tuple[F64, F64]:
    """``[4, base pairs]`` faults, winners and returns by contact, and ``[2, base pairs]`` hurried receivers: probabilities."""
    parts = game.outcome_probabilities(game.block_pairs(block)).T
    returned = parts[2:4] + parts[4:]
    return np.concatenate([parts[:2], returned]), game.hurry_of(game.block_pairs(block))


@given(games)
def test_effort_multiplies_the_odds_of_a_fault_and_nothing_else(made: tuple[Game, Bools]) -> None:
    game, _ = made
    for block in range(game.n_blocks):
        (fault, winner, below, above), hurry = ends_of(game, block)
        before, rested = ends_of(game, 0)
        before = before.T
        assert np.abs(hurry - rested).max() < 1e-12
        odds = before[:, 0] / (1 - before[:, 0]) * game.fault_odds[block // game.levels] / ONE
        assert np.abs(fault - odds / (1 + odds)).max() <= 1.5 / ONE
        shares = np.stack([winner, below, above], axis=1) / (1 - fault)[:, None]
        expected = before[:, 1:] / (1 - before[:, :1])
        assert (np.abs(shares - expected) <= 3 / ONE / np.minimum(1 - fault, 1 - before[:, 0])[:, None]).all()
