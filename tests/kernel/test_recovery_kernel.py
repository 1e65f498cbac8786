"""Positions in the kernel: matches, rallies and batches against the rules, one stroke at a time."""

import dataclasses
import math

import numpy as np
import pytest

from shuttle_marl.base.arrays import I32, Intp
from shuttle_marl.exact.profile import evaluate
from shuttle_marl.game import draws
from shuttle_marl.game.policy import TabulatedPolicy, cumulative_positions
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel import KernelError, Matches, MatchResults, RallyBatch, pack, play_matches, play_rallies, wrong_outcomes
from shuttle_marl.kernel.matches import asking as asked_of
from shuttle_marl.kernel.matches import play
from tests.exact.exact_games import random_game, random_policy
from tests.kernel.recovery import GAME, PAIR, RECOVERY, TABLES, people, with_positions
from tests.kernel.test_matches_kernel import RULES, assert_same, some_matches


def by_numpy(game: Game, wanted: Matches, tables: list[TabulatedPolicy], rule: str) -> MatchResults:
    """Matches of tables in lockstep; in the game of a pair the tables of seat 1 follow those of seat 0."""

    def choose(entrant: I32, state: I32, draw: I32, *_: I32) -> Intp:
        k = np.empty(len(state), np.intp)
        for i, table in enumerate(tables):
            k[entrant == i] = table.choose(state[entrant == i], draw[entrant == i])
        return k

    def wait(entrant: I32, state: I32, draw: I32, *_: I32) -> Intp:
        position = np.empty(len(state), np.intp)
        for i, table in enumerate(tables):
            position[entrant == i] = table.choose_position(state[entrant == i], draw[entrant == i])
        return position

    return play(game, wanted, choose, wait, rules=RULES[rule])


@pytest.mark.parametrize("rule", ["bwf", "one point"])
def test_matches_are_those_of_the_lockstep(rule: str) -> None:
    wanted = some_matches(60, len(TABLES), 1)
    played = play_matches(GAME, wanted, TABLES, rules=RULES[rule])
    assert_same(played, by_numpy(GAME, wanted, TABLES, rule))
    rallies = played.rallies
    assert rallies.waited is not None
    assert GAME.waiting.mask(GAME.base(rallies.states(GAME)))[np.arange(len(rallies.waited)), rallies.waited].all()


@pytest.mark.parametrize("seed", range(4))
def test_random_games(seed: int) -> None:
    game = dataclasses.replace(random_game(seed), recovery=RECOVERY)
    tables = [with_positions(random_policy(game, seed + i, 1.0 + i), seed + i) for i in range(3)]
    wanted = some_matches(30, 3, seed)
    assert_same(play_matches(game, wanted, tables, rules=RULES["to five"]), by_numpy(game, wanted, tables, "to five"))


def test_matches_of_a_pair() -> None:
    tables = [with_positions(people(name, game), seed) for seed, game in enumerate(PAIR.seats) for name in ("safe", "random")]
    wanted = some_matches(40, 2, 2)
    wanted = dataclasses.replace(wanted, entrant=wanted.entrant + np.array([0, 2], np.int32))
    expected = by_numpy(PAIR, wanted, tables, "to five")
    assert_same(play_matches(PAIR, wanted, tables, rules=RULES["to five"]), expected)


def test_policies_that_are_called_wait_as_their_tables_do() -> None:
    wanted = some_matches(20, 2, 3)
    asking = (asked_of(GAME, TABLES, positions=positions) for positions in (False, True))
    assert_same(play(GAME, wanted, *asking, rules=RULES["to five"]), by_numpy(GAME, wanted, TABLES, "to five"))


def test_exact_values_are_those_of_sampled_rallies() -> None:
    size = 100_000
    for first, second in ((0, 1), (1, 2), (2, 0)):
        expected = evaluate(TABLES[first], TABLES[second]).odds().rally
        share = (play_rallies(GAME, (TABLES[first], TABLES[second]), size, seed=first).winner == 0).mean()
        assert abs(share - expected) < 4 * math.sqrt(expected * (1 - expected) / size)


def test_recorded_positions_replay_the_outcomes() -> None:
    played = play_rallies(GAME, (TABLES[1], TABLES[2]), 500, seed=1)
    key = draws.extend(draws.stream(1), np.arange(500))
    assert not wrong_outcomes(played, GAME, key).any()
    assert wrong_outcomes(dataclasses.replace(played, waited=(played.waited + 1) % 9), GAME, key).any()


def test_positions_of_packed_policies_are_checked() -> None:
    wrong = dataclasses.replace(TABLES[1], waits=np.zeros_like(TABLES[1].waits))
    with pytest.raises(KernelError, match="positions of a policy"):
        pack([wrong], GAME)


def test_people_wait_where_their_table_says() -> None:
    waits = cumulative_positions(GAME.people_positions(np.arange(GAME.n_states)))
    explicit = [dataclasses.replace(TABLES[0], waits=waits), TABLES[1]]
    one, other = (play_rallies(GAME, (tables[0], tables[1]), 200, seed=2) for tables in (explicit, TABLES))
    assert np.array_equal(one.stroke, other.stroke)


@pytest.mark.parametrize("wrong", [-1, 9, None])
def test_positions_from_outside_are_checked(wrong: int | None) -> None:
    batch = RallyBatch(GAME, 8, seed=1)
    batch.run(3)
    stroke, position = batch.random_actions()
    infeasible = int((~GAME.waiting.mask(GAME.base(batch.rows.state))[5]).argmax())
    position[5] = infeasible if wrong is None else wrong
    before = batch.rows.state.copy()
    with pytest.raises(KernelError, match=f"row 5: position {position[5]} is not feasible"):
        batch.step(stroke, position)
    with pytest.raises(KernelError, match="needed there"):
        batch.step(stroke)
    assert np.array_equal(batch.rows.state, before)
