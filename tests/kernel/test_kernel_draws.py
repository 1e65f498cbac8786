"""The compiled draws and choices against the definitions in ``shuttle_marl.game.draws`` and ``shuttle_marl.game.policy``."""

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.base.compiling import compiled
from shuttle_marl.game import draws
from shuttle_marl.game.draws import CHOICE_ONE, ONE
from shuttle_marl.game.policy import States, drawn_strokes
from shuttle_marl.game.rally import choose
from shuttle_marl.kernel import Players, core, pack
from shuttle_marl.kernel import players as packed
from tests.exact.exact_games import random_game, random_policy

words = st.integers(0, 2**64 - 1)


@compiled
def _numbers(key: np.uint64, counter: int, count: int, limits: np.uint64) -> tuple[np.uint64, np.uint64, int, int, int]:
    bits = core.draw(key, counter)
    return (
        bits,
        core.extend(key, counter),
        core.first_server(bits),
        core.outcome_of(limits, bits),
        core.uniform_choice(count, bits),
    )


@settings(deadline=None)
@given(
    words,
    st.integers(0, 2**40),
    st.integers(1, 200),
    st.lists(st.integers(0, ONE - 1), min_size=3, max_size=3),
    st.tuples(st.integers(0, 255), st.integers(0, 255)),
    st.integers(0, 3),
)
def test_numbers_are_those_of_the_definitions(
    key: int, counter: int, count: int, limits: list[int], hurry: tuple[int, int], equal: int
) -> None:
    """Also where a draw equals a limit."""
    u = int(draws.draw(np.array([key], np.uint64), counter)[0]) & 0xFFFF
    fault, winner, below = sorted([*limits[:equal], *[min(u, ONE - 1)] * (equal < 3), *limits[equal + 1 :]])
    entry = np.uint64(fault | winner << 16 | below << 32 | hurry[0] << 48 | hurry[1] << 56)
    bits, extended, server, outcome, choice = _numbers(np.uint64(key), counter, count, entry)
    keys = np.array([key], np.uint64)
    expected = draws.draw(keys, counter)
    assert bits == expected[0]
    assert extended == draws.extend(keys, counter)[0]
    assert server == int(draws.first_server(expected)[0])
    lot = int(expected[0]) >> 16 & 0xFF
    four = int(u >= fault) + int(u >= winner) + int(u >= below)
    assert outcome == (four + 2 if four >= 2 and lot < hurry[four - 2] else four)
    assert choice == (int(expected[0]) >> 32) * count >> 32


@compiled
def _every_choice(players: Players, state: int, start: int, chosen: npt.NDArray[np.int64]) -> None:
    for u in range(len(chosen)):
        # The least upper half of a draw that gives u.
        upper = (np.uint64(u) << np.uint64(32)) // np.uint64(CHOICE_ONE) + np.uint64(u > 0)
        chosen[u] = packed.table_choice(players, 0, state, start, upper << np.uint64(32))


@pytest.mark.parametrize("sharpness", [0.05, 0.2, 1.0, 30.0])
def test_every_player_of_the_package_turns_a_draw_into_the_same_stroke(sharpness: float) -> None:
    game = random_game(11, 9, 0.9)
    policy = random_policy(game, 3, sharpness)
    players = pack([policy], game)
    draw = np.arange(CHOICE_ONE)
    for state in np.flatnonzero(game.legal_count(np.arange(game.n_states)) > 1)[:3].tolist():
        compiled_choice = np.empty(CHOICE_ONE, np.int64)
        _every_choice(players, state, int(game.pair_start[state]), compiled_choice)
        states = np.full(CHOICE_ONE, state)
        assert np.array_equal(policy.choose(states, draw), compiled_choice)
        p = policy.probabilities(States(game=game, state=states[:1].astype(np.int32)))
        asked = drawn_strokes(np.broadcast_to(p, (CHOICE_ONE, game.n_strokes)), draw)
        assert np.array_equal(asked, game.stroke_at(states, compiled_choice))
        assert [choose(policy, game, state, u) for u in draw[::97].tolist()] == asked[::97].tolist()
        # And each stroke is played as often as its table says.
        share = np.bincount(compiled_choice, minlength=int(game.legal_count(state))) / CHOICE_ONE
        assert np.array_equal(share, policy.pair_probabilities()[game.pairs_of(state)])
