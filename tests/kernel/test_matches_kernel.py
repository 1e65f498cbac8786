"""Compiled matches against the lock-step, and that against matches played stroke by stroke; also in the game of a pair."""

import dataclasses
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.env.single import SingleRallyEnv
from shuttle_marl.env.vector import RallyVectorEnv
from shuttle_marl.game import scoring
from shuttle_marl.game.layout import GameError
from shuttle_marl.game.pairs import pair_game
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.game.rules import OUTCOMES, IllegalStrokeError
from shuttle_marl.game.scoring import BWF, Rules
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel import KernelError, Matches, MatchResults, pack, play_matches, play_rallies
from shuttle_marl.kernel.core import BLOCK
from shuttle_marl.kernel.matches import play
from shuttle_marl.league.entrants import Entrant, Strikers, enter
from shuttle_marl.league.tournament import groups, join, matches_of, round_robin
from shuttle_marl.policy.registry import resolve
from tests.exact.exact_games import random_game, random_policy
from tests.kernel.episodes import compare_with_rally_v0
from tests.reduced import reduced_game, reduced_model

GAME = reduced_game()
TABLES = [tabulate(resolve(name, GAME), GAME) for name in ("bc", "random", "attacking@greedy")]
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
    wanted = some_matches(2 * BLOCK + 31, 3, 2)
    rules = RULES["to five"]
    expected = by_numpy(GAME, wanted, TABLES, rules)
    assert_same(play_matches(GAME, wanted, pack(TABLES, GAME), rules=rules, threads=threads), expected)


def test_long_matches_find_room() -> None:
    wanted, rules = some_matches(6, 3, 3), Rules(points=21, clear=2, cap=30, games=9)
    expected = by_numpy(GAME, wanted, TABLES, rules)
    assert np.bincount(expected.rallies.match, expected.rallies.length).max() > 2000
    assert_same(play_matches(GAME, wanted, TABLES, rules=rules), expected)


NAMES = ("attacking", "safe", "random", "attacking@greedy")
ENTRANTS = [enter(name, GAME) for name in NAMES]
STRIKERS = Strikers(GAME, ENTRANTS)
SHORT_RULES = scoring.Rules(points=5, clear=2, cap=7, games=2)

Row = tuple[int, int, int, int, str, tuple[int, ...], list[int], list[int]]
"""Match, rally, server, winner, reason, score before, and strokes of a rally."""


def as_rows(results: MatchResults) -> list[Row]:
    played = results.rallies
    ends = np.cumsum(played.length)
    return [
        (
            int(played.match[i]),
            int(played.rally[i]),
            int(played.server[i]),
            int(played.winner[i]),
            OUTCOMES[played.reason[i]],
            tuple(int(x) for x in played.score[i]),
            played.stroke[ends[i] - played.length[i] : ends[i]].tolist(),
            played.hurried[ends[i] - played.length[i] : ends[i]].tolist(),
        )
        for i in range(len(played.length))
    ]


def matches_of_all(seed: int, first: int = 0, last: int = 4) -> Matches:
    return join([matches_of(pairing, seed, first, last) for pairing in round_robin(NAMES)])


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**63 - 1), st.permutations(range(12)), st.integers(1, 11))
def test_company_never_changes_a_match(seed: int, order: list[int], cut: int) -> None:
    matches = matches_of_all(seed, last=2)
    whole = as_rows(play(GAME, matches, STRIKERS.choose, rules=SHORT_RULES))
    for chosen in (order[:cut], order[cut:]):
        part = Matches(**{f.name: getattr(matches, f.name)[chosen] for f in dataclasses.fields(matches)})
        rows = as_rows(play(GAME, part, STRIKERS.choose, rules=SHORT_RULES))
        assert rows == [(i, *row[1:]) for i, m in enumerate(chosen) for row in whole if row[0] == m]


def test_seats_and_first_serve_are_balanced() -> None:
    pairing = round_robin(NAMES)[2]
    matches = matches_of(pairing, 0, 0, 1000)
    at_seat_0 = matches.entrant[:, 0] == pairing.entrants[0]
    serves_first = matches.entrant[np.arange(1000), matches.first_server] == pairing.entrants[0]
    assert at_seat_0.sum() == serves_first.sum() == 500
    assert (at_seat_0 & serves_first).sum() == 250
    assert np.array_equal(matches.key[0::2], matches.key[1::2])
    assert len(np.unique(matches.key)) == 500


def test_other_entrants_and_their_order_change_nothing() -> None:
    def rallies(pool: tuple[str, ...]) -> list[Row]:
        pairing = next(p for p in round_robin(pool) if set(p.names) == {"safe", "random"})
        found = matches_of(pairing, 1, 0, 4)
        entrant = np.array([NAMES.index(name) for name in pool], dtype=np.int32)[found.entrant]
        return as_rows(play(GAME, dataclasses.replace(found, entrant=entrant), STRIKERS.choose, rules=SHORT_RULES))

    assert rallies(("safe", "random")) == rallies(NAMES) == rallies(("random", "attacking", "safe"))


def test_different_pairings_and_seeds_have_different_draws() -> None:
    pairings = round_robin(NAMES)
    keys = np.concatenate([matches_of(p, seed, 0, 100).key for p in pairings for seed in (0, 1)])
    assert len(np.unique(keys)) == 2 * len(pairings) * 50


@given(st.integers(2, 9), st.integers(1, 30), st.integers(1, 100), st.sets(st.integers(0, 35)))
def test_groups_hold_every_pairing_once_and_fit(n: int, cells: int, batch: int, alone: set[int]) -> None:
    pairings = round_robin([f"p{i}" for i in range(n)])
    made = list(groups(pairings, 2 * cells, batch, alone))
    assert [p for group in made for p in group] == pairings
    assert all(len(group) * 2 * cells <= batch for group in made if len(group) > 1)
    assert all(len(group) == 1 for group in made if alone & {p.number for p in group})


A, B = "viktor-axelsen", "kento-momota"
PAIR = pair_game(A, B, game=reduced_model())
PAIR_NAMES = ("bc", "minimax", "random")


def seated(name: str) -> list[TabulatedPolicy]:
    return [tabulate(resolve(name, game), game) for game in PAIR.seats]


def test_matches_are_those_of_the_lockstep() -> None:
    """Every entrant strikes at seat 0 with the tables of one player, at seat 1 with those of the other."""
    wanted, tables = some_matches(60, len(PAIR_NAMES), 1), [seated(name) for name in PAIR_NAMES]
    entrants = [
        Entrant(name=n, policy=first, table=first, opposite=second) for n, (first, second) in zip(PAIR_NAMES, tables, strict=True)
    ]
    expected = play(PAIR, wanted, Strikers(PAIR, entrants).choose, rules=RULES["to five"])
    packed = [table for seat in zip(*tables, strict=True) for table in seat]
    by_seat = type(wanted)(
        entrant=wanted.entrant + np.array([0, len(PAIR_NAMES)], np.int32), first_server=wanted.first_server, key=wanted.key
    )
    played = play_matches(PAIR, by_seat, packed, rules=RULES["to five"])
    relabelled = played.rallies.policy % len(PAIR_NAMES)
    assert np.array_equal(relabelled, expected.rallies.policy)
    played.rallies.policy[:] = relabelled
    assert_same(played, expected)


def test_rallies_are_those_of_the_environment() -> None:
    bc = seated("bc")
    compare_with_rally_v0(3, play_rallies(PAIR, (bc[0], bc[1]), 60, seed=3), game=PAIR)
    # And not those of the average game.
    with pytest.raises((AssertionError, IllegalStrokeError)):
        compare_with_rally_v0(3, play_rallies(PAIR, (bc[0], bc[1]), 60, seed=3), game=reduced_game())


@pytest.mark.parametrize("seat", [0, 1])
def test_learners_against_the_other_player(seat: Literal[0, 1]) -> None:
    import torch

    from shuttle_marl.env.batched import VersusEnv

    options: dict[str, Any] = {"game": PAIR}
    single = SingleRallyEnv(opponent="minimax", seat=seat, **options)
    vector = RallyVectorEnv(1, opponent="minimax", seat=seat, **options)
    versus = VersusEnv(1, opponents="minimax", seat=seat, seed=4, **options)
    opponent = single.opponent.policy
    assert isinstance(opponent, TabulatedPolicy)
    assert opponent.hash == seated("minimax")[1 - seat].hash
    seen, _ = single.reset(seed=4)
    vector.reset(seed=4)
    now = versus.reset()
    for step in range(300):
        assert single.state_number == vector.versus.rows.state[0] == versus.states[0]
        legal = np.flatnonzero(seen["action_mask"])
        stroke = int(legal[step % len(legal)])
        seen, reward, over, _, _ = single.step(stroke)
        _, rewards, overs, _, _ = vector.step(np.array([stroke]))
        stepped = versus.step_and_maybe_reset(now.set("action", torch.tensor([stroke])))
        assert reward == rewards[0] == stepped[0]["next", "reward"].item()
        assert over == overs[0] == stepped[0]["next", "terminated"].item()
        now = stepped[1]
        if over:
            seen, _ = single.reset()


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(GameError, match="expected 0 or 1 for all rows"):
        RallyVectorEnv(4, game=PAIR, seat=np.array([0, 1, 0, 1]))
    with pytest.raises(KernelError, match="tabulated for another game"):
        pack([seated("bc")[0], random_policy(random_game(1), 0)], PAIR)
