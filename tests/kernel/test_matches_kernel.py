"""Compiled matches against the numpy lock-step of the league, which asks the policies stroke by stroke."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.game.scoring import BWF, Rules
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.kernel import Matches, MatchResults, pack, play_matches
from shuttle_marl.kernel.core import BLOCK
from shuttle_marl.kernel.lockstep import play
from shuttle_marl.league.entrants import Entrant, Strikers
from shuttle_marl.policy.registry import resolve
from tests.exact.exact_games import random_game, random_policy
from tests.reduced import reduced_game

GAME = reduced_game()
TABLES = [tabulate(resolve(name, GAME), GAME, name) for name in ("bc", "random", "attacking@greedy")]
RULES = {
    "bwf": BWF,
    "to five": Rules(points=5, clear=2, cap=7, games=2),
    "one point": Rules(points=1, clear=1, cap=1, games=1),
    "three games": Rules(points=3, clear=2, cap=30, games=3),
}


def by_numpy(
    game: Game, wanted: Matches, tables: list[TabulatedPolicy], rules: Rules, *, keep_strokes: bool = True
) -> MatchResults:
    strikers = Strikers(game, [Entrant(name=str(i), policy=table, table=table) for i, table in enumerate(tables)])
    return play(game, wanted, strikers.choose, rules=rules, keep_strokes=keep_strokes)


def some_matches(size: int, players: int, seed: int) -> Matches:
    rng = np.random.default_rng(seed)
    return Matches(
        entrant=rng.integers(0, players, (size, 2)).astype(np.int32),
        first_server=rng.integers(0, 2, size).astype(np.int8),
        key=rng.integers(0, 2**64, size, dtype=np.uint64),
    )


def assert_same(one: MatchResults, other: MatchResults) -> None:
    columns = zip([("games", one.games), *one.rallies.columns()], [("games", other.games), *other.rallies.columns()], strict=True)
    for (name, a), (_, b) in columns:
        assert a.dtype == b.dtype, name
        assert np.array_equal(a, b), name


@pytest.mark.parametrize("keep", [True, False])
@pytest.mark.parametrize("rules", RULES.values(), ids=RULES.keys())
def test_every_rule_and_field(rules: Rules, keep: bool) -> None:
    wanted = some_matches(60, 3, 1)
    expected = by_numpy(GAME, wanted, TABLES, rules, keep_strokes=keep)
    assert_same(play_matches(GAME, wanted, TABLES, rules=rules, keep_strokes=keep), expected)
    assert len(expected.rallies.stroke) == (expected.rallies.length.sum() if keep else 0)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.integers(2, 9), st.integers(1, 5), st.integers(0, 40), st.integers(0, 2**32))
def test_random_games_and_players(game_seed: int, rallies: int, players: int, size: int, seed: int) -> None:
    game = random_game(game_seed, rallies, 0.5)
    tables = [random_policy(game, seed + i, 1.0 + i) for i in range(players)]
    wanted = some_matches(size, players, seed)
    rules = RULES["to five"]
    assert_same(play_matches(game, wanted, tables, rules=rules), by_numpy(game, wanted, tables, rules))


@pytest.mark.parametrize("threads", [1, 2, 3, None])
def test_neither_threads_nor_blocks_change_a_match(threads: int | None) -> None:
    """More matches than a thread plays at a time, and a last block that is not full."""
    wanted = some_matches(2 * BLOCK + 31, 3, 2)
    rules = RULES["to five"]
    expected = by_numpy(GAME, wanted, TABLES, rules)
    counted: list[int] = []
    played = play_matches(GAME, wanted, pack(TABLES, GAME), rules=rules, threads=threads, progress=counted.append)
    assert_same(played, expected)
    assert len(counted) == 3
    assert sum(counted) == expected.rallies.length.sum()


@pytest.mark.parametrize("room", [1, 7, 60])
def test_room_for_strokes_grows(monkeypatch: pytest.MonkeyPatch, room: int) -> None:
    monkeypatch.setattr("shuttle_marl.kernel.matches._STROKES_A_MATCH", room)
    wanted = some_matches(40, 3, 3)
    assert_same(play_matches(GAME, wanted, TABLES), by_numpy(GAME, wanted, TABLES, BWF))


def test_an_interrupt_while_playing_comes_through() -> None:
    def interrupt(_: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        play_matches(GAME, some_matches(2000, 3, 6), TABLES, progress=interrupt)
