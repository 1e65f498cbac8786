"""Whatever enters compiled code is checked before: shapes, kinds of numbers, ranges."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from shuttle_marl.game.policy import UniformPolicy
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.kernel import KernelError, Matches, Players, RallyBatch, RallySampler, pack, play_matches
from shuttle_marl.kernel.core import check_room, checked_array, checked_number
from shuttle_marl.kernel.players import check_players, empty_players, put_player
from shuttle_marl.kernel.rows import NO_OBSERVATIONS, Observations, in_slices
from tests.exact.exact_games import hand_made, random_game, random_policy, tiring_game
from tests.recovery import with_recovery
from tests.reduced import reduced_game

GAME = reduced_game()
TABLE = tabulate(UniformPolicy(), GAME)
PLAYERS = pack([TABLE, TABLE], GAME)
ROWS = 64


@pytest.fixture
def batch() -> RallyBatch:
    return RallyBatch(GAME, ROWS, opponents=[TABLE])


def state_of(batch: RallyBatch) -> list[bytes]:
    return [array.tobytes() for array in batch.rows]


@pytest.mark.parametrize(
    "rows", [np.zeros(ROWS + 1, bool), np.zeros((ROWS, 1), bool), [False], np.zeros(ROWS, np.int8), np.full(ROWS, None)]
)
def test_a_mask_of_rows_is_one_truth_value_a_row(batch: RallyBatch, rows: Any) -> None:
    before = state_of(batch)
    with pytest.raises(KernelError, match=rf"rows: .*; expected bool of shape \({ROWS},\)"):
        batch.reset(rows=rows)
    assert state_of(batch) == before


@pytest.mark.parametrize("change", [np.float64, bool, str, object])
def test_strokes_are_whole_numbers(batch: RallyBatch, change: Any) -> None:
    strokes, before = batch.random_strokes(), state_of(batch)
    with pytest.raises(KernelError, match=r"strokes: .*; expected int64"):
        batch.step(strokes.astype(change))
    with pytest.raises(KernelError, match="strokes: 0 to 18446744073709551615; expected"):
        batch.step(np.r_[np.zeros(ROWS - 1, np.uint64), np.uint64(2**64 - 1)].astype(np.uint64))
    assert state_of(batch) == before


def locked(array: np.ndarray) -> np.ndarray:
    array.flags.writeable = False
    return array


@pytest.mark.parametrize(
    "change",
    [
        lambda o: o._replace(tokens=o.tokens.astype(np.int64)),
        lambda o: o._replace(tokens=o.tokens[:-1]),
        lambda o: o._replace(tokens=np.asfortranarray(o.tokens)),
        lambda o: o._replace(tokens=o.tokens.tolist()),
        lambda o: o._replace(mask=o.mask[:, :-1]),
        lambda o: Observations(*(locked(array) for array in o)),
    ],
)
def test_room_for_observations_is_checked(batch: RallyBatch, change: Callable[[Observations], Observations]) -> None:
    strokes, before, room = batch.random_strokes(), state_of(batch), change(batch.new_observations())
    for use in (lambda: batch.observe(room), lambda: batch.step(strokes, observed=room)):
        with pytest.raises(KernelError, match=r"output array for (tokens|mask)"):
            use()
    assert state_of(batch) == before


@pytest.mark.parametrize("opponents", [np.ones(ROWS), np.zeros(ROWS - 1, int), np.full(ROWS, -1), np.full(ROWS, 2**40)])
def test_assigned_opponents_are_checked(batch: RallyBatch, opponents: np.ndarray) -> None:
    with pytest.raises(KernelError, match="opponents: "):
        batch.assign(opponents)
    assert (batch.opponents.following == 0).all()


def changed(name: str, at: Any, value: int) -> Players:
    players = Players(PLAYERS.cumulative.copy(), PLAYERS.guide.copy(), PLAYERS.waits)
    getattr(players, name)[at] = value
    return players


@pytest.mark.parametrize(
    "players",
    [
        PLAYERS._replace(cumulative=PLAYERS.cumulative[:, :-1]),
        PLAYERS._replace(cumulative=PLAYERS.cumulative.astype(np.int64)),
        PLAYERS._replace(cumulative=PLAYERS.cumulative[:, ::-1]),
        PLAYERS._replace(guide=PLAYERS.guide[:1]),
        changed("cumulative", (1, -1), 65534),
        changed("guide", (1, 7, 3), 255),
        changed("guide", (0, 1, 0), 1),
    ],
)
def test_packed_policies_made_by_hand_are_checked(players: Players) -> None:
    with pytest.raises(KernelError, match=r"packed policies"):
        play_matches(GAME, some_matches(), players)


@pytest.mark.parametrize("cumulative", [TABLE.cumulative[:-1], TABLE.cumulative.astype(float), np.zeros_like(TABLE.cumulative)])
def test_tables_of_policies_made_by_hand_are_checked(cumulative: Any) -> None:
    with pytest.raises(KernelError, match="table of a policy"):
        pack([TabulatedPolicy(game=GAME, cumulative=cumulative)], GAME)


def some_matches(**changes: Any) -> Matches:
    made: dict[str, Any] = {
        "entrant": np.zeros((3, 2), np.int32), "first_server": np.array([0, 1, 0], np.int8), "key": np.arange(3, dtype=np.uint64),
    }  # fmt: skip
    return Matches(**{**made, **changes})


@pytest.mark.parametrize(
    "changes",
    [
        {"entrant": np.zeros((3, 2))},
        {"entrant": np.zeros((2, 2), np.int32)},
        {"entrant": np.full((3, 2), -1)},
        {"entrant": np.full((3, 2), 2**40)},
        {"first_server": np.array([0, 1, 2])},
        {"first_server": np.array([0.0, 1.0, 0.5])},
        {"key": np.array([-1, 0, 1])},
        {"key": np.zeros((3, 1), np.uint64)},
    ],
)
def test_matches_are_checked(changes: dict[str, Any]) -> None:
    with pytest.raises(KernelError, match=r"entrant|first_server|key"):
        some_matches(**changes)


@pytest.mark.parametrize("name", ["entrant", "first_server"])
def test_matches_that_were_changed_after_they_were_made_are_checked_again(name: str) -> None:
    matches = some_matches()
    getattr(matches, name)[1] = 99
    with pytest.raises(KernelError, match=f"{name}: 0 to 99; expected 0 to 1"):
        play_matches(GAME, matches, PLAYERS)
    with pytest.raises(KernelError, match="tabulated for another game"):
        play_matches(GAME, some_matches(), [random_policy(random_game(1), 0)])


@pytest.mark.parametrize("value", [3, np.int64(4)])
def test_whole_numbers_from_the_least_on_are_accepted(value: Any) -> None:
    assert checked_number("size", value, 3) == value
    for wrong in (2, 3.0, "3", None):
        with pytest.raises(KernelError, match=f"size {wrong!r}: expected a whole number, 3 or more"):
            checked_number("size", wrong, 3)


@pytest.mark.parametrize(
    ("array", "type_", "options", "says"),
    [
        ([1, 2], np.int32, {}, ""),
        (np.array([1, 2], np.uint64), np.int8, {}, ""),
        (np.array([-128, 127]), np.int8, {}, ""),
        (np.array([-129, 127]), np.int8, {}, "-129 to 127; expected -128 to 127"),
        (np.array([-128, 128]), np.int8, {}, "-128 to 128; expected -128 to 127"),
        (np.array([2, 5], np.int8), np.int8, {"low": 2, "high": 5}, ""),
        (np.array([2, 5], np.int8), np.int8, {"low": 3}, "2 to 5; expected 3 to 127"),
        (np.array([2, 5], np.int8), np.int8, {"high": 4}, "2 to 5; expected -128 to 4"),
        (np.array([2, 5]), np.int8, {"high": 4}, "2 to 5; expected -128 to 4"),
        (np.array([0.5, np.nan], np.float32), np.float32, {}, ""),
        (np.array([0.5, 1.0]), np.float32, {}, r"float64 of shape \(2,\); expected float32 of shape \(2,\)"),
        (np.array([1, 2]), np.float32, {}, "int64 of shape"),
        (np.array([1.0, 2.0]), np.int32, {}, "float64 of shape"),
        (np.array([True, False]), np.bool_, {}, ""),
        (np.array([True, False]), np.int8, {}, "bool of shape"),
        (np.array([1, 0], np.int8), np.bool_, {}, "int8 of shape"),
        (np.array([1, 2, 3]), np.int64, {}, r"int64 of shape \(3,\); expected int64 of shape \(2,\)"),
        (np.array([[1, 2]]), np.int64, {}, r"int64 of shape \(1, 2\)"),
    ],
)
def test_arrays_have_a_shape_and_numbers_of_their_kind(array: Any, type_: Any, options: dict[str, int], says: str) -> None:
    if says:
        with pytest.raises(KernelError, match=f"numbers: {says}"):
            checked_array("numbers", array, type_, (2,), **options)
    else:
        found = checked_array("numbers", array, type_, (2,), **options)
        assert (found.dtype, found.shape, found.flags.c_contiguous) == (np.dtype(type_), (2,), True)
        assert np.array_equal(found, array, equal_nan=found.dtype.kind == "f")


def test_arrays_without_numbers_are_within_every_range_and_views_are_copied() -> None:
    assert checked_array("numbers", np.zeros((0, 2), np.int64), np.int8, (0, 2), 5, 6).shape == (0, 2)
    matrix = np.arange(6, dtype=np.int32).reshape(2, 3)
    assert checked_array("numbers", matrix, np.int32, (2, 3)) is matrix
    assert checked_array("numbers", matrix.T, np.int32, (3, 2)).flags.c_contiguous


def unaligned() -> np.ndarray:
    return np.zeros(9, np.uint8)[1:].view(np.int32)


@pytest.mark.parametrize(
    ("array", "found"),
    [
        (np.zeros(2, np.int64), r"int64 of shape \(2,\)"),
        (np.zeros(3, np.int32), r"int32 of shape \(3,\)"),
        (np.zeros(4, np.int32)[::2], r"int32 of shape \(2,\)"),
        (locked(np.zeros(2, np.int32)), r"int32 of shape \(2,\)"),
        (unaligned(), r"int32 of shape \(2,\)"),
        ([0, 0], "list"),
    ],
)
def test_room_is_contiguous_aligned_and_writeable(array: Any, found: str) -> None:
    says = rf"output array for names, {found}: expected int32 of shape \(2,\), writeable and C-contiguous"
    with pytest.raises(KernelError, match=says):
        check_room("names", array, np.int32, (2,))
    check_room("names", np.zeros(2, np.int32), np.int32, (2,))


HIDDEN = with_recovery(tiring_game(), 3, 3)
WAITING = tabulate(UniformPolicy(), HIDDEN)


def test_policies_fit_into_their_places() -> None:
    players = pack([TABLE, TABLE], GAME)
    other = random_policy(GAME, 3)
    put_player(players, 1, other, GAME)
    assert np.array_equal(players.cumulative[1], other.cumulative)
    assert np.array_equal(players.cumulative[0], TABLE.cumulative)
    for number in (-1, 2):
        with pytest.raises(KernelError, match=f"policy number {number}: expected 0 to 1"):
            put_player(players, number, other, GAME)
    with pytest.raises(KernelError, match="no policy: expected one or more"):
        pack([], GAME)
    assert empty_players(GAME, 3).guide.shape == (3, GAME.n_states, 16)
    assert empty_players(GAME, 3).waits.shape == (3, 0, 8)
    assert empty_players(HIDDEN, 2).waits.shape == (2, HIDDEN.n_states, 8)


def test_a_state_has_at_most_256_legal_strokes(monkeypatch: pytest.MonkeyPatch) -> None:
    most = int(GAME.legal_count(np.arange(GAME.n_states)).max())
    monkeypatch.setattr("shuttle_marl.kernel.players._MOST_LEGAL", most)
    assert len(empty_players(GAME, 1).cumulative) == 1
    monkeypatch.setattr("shuttle_marl.kernel.players._MOST_LEGAL", most - 1)
    with pytest.raises(KernelError, match=f"a state has {most} legal strokes; the kernel supports up to {most - 1}"):
        empty_players(GAME, 1)


def test_guides_lead_to_the_first_stroke_that_a_choice_may_be() -> None:
    """For each value of the upper four bits, the first legal stroke whose cumulative probability is above 4096 times it."""
    table = random_policy(HIDDEN, 2)
    guide = pack([dataclasses.replace(table, waits=None)], HIDDEN).guide[0]
    for state in np.flatnonzero(HIDDEN.playable)[::97].tolist():
        entries = table.cumulative[HIDDEN.pairs_of(state)].tolist()
        assert guide[state].tolist() == [next(k for k, entry in enumerate(entries) if entry > 4096 * part) for part in range(16)]


def test_packed_positions_are_those_of_the_feasible_ones_and_then_certain() -> None:
    packed = pack([WAITING], HIDDEN)
    for state in np.flatnonzero(HIDDEN.playable)[::97].tolist():
        feasible = np.flatnonzero(HIDDEN.waiting.mask(np.array([state % HIDDEN.n_base_states]))[0])
        expected = WAITING.waiting_table[state, feasible].tolist()
        assert packed.waits[0, state].tolist() == (expected + [65535] * 9)[:8]


def broken(name: str, at: Any, value: int) -> Players:
    packed = pack([WAITING, WAITING], HIDDEN)
    getattr(packed, name)[at] = value
    return packed


STATE = int(np.flatnonzero(HIDDEN.playable)[-1])
FEASIBLE = int(HIDDEN.waiting.choices[STATE % HIDDEN.n_base_states])


@pytest.mark.parametrize(
    ("players", "says"),
    [
        (broken("cumulative", (0, int(HIDDEN.last_pairs[3])), 65534), "tables that choose strokes that do not exist"),
        (broken("guide", (1, STATE, 0), int(HIDDEN.legal_count(STATE))), "tables that choose strokes that do not exist"),
        (broken("waits", (0, STATE, FEASIBLE - 1), 65534), "tables that choose strokes that do not exist"),
        (broken("waits", (1, STATE, 7), 0), "tables that choose strokes that do not exist"),
        (broken("guide", (0, 0, 0), 0)._replace(guide=np.asfortranarray(PLAYERS.guide)), "guide of packed policies: "),
        (broken("guide", (0, 0, 0), 0)._replace(waits=np.zeros((2, 0, 8), np.uint16)), "positions of packed policies: "),
    ],
)
def test_packed_policies_choose_what_exists(players: Players, says: str) -> None:
    with pytest.raises(KernelError, match=says):
        check_players(players, HIDDEN)


def test_packed_policies_that_are_right_are_accepted() -> None:
    check_players(broken("guide", (1, STATE, 0), int(HIDDEN.legal_count(STATE)) - 1), HIDDEN)
    check_players(broken("waits", (0, STATE, FEASIBLE - 2), 7), HIDDEN)
    check_players(PLAYERS, GAME)
    for name in ("cumulative", "guide", "waits"):
        packed = pack([WAITING, WAITING], HIDDEN)
        with pytest.raises(KernelError, match=r"packed policies: arrays are not C-contiguous; make them with pack\(\)"):
            check_players(packed._replace(**{name: np.asfortranarray(getattr(packed, name))}), HIDDEN)


def test_the_last_feasible_position_of_a_table_is_certain() -> None:
    waits = WAITING.waiting_table.copy()
    last = int(np.flatnonzero(HIDDEN.waiting.mask(np.array([STATE % HIDDEN.n_base_states]))[0])[-1])
    waits[STATE, last:] = 65534
    with pytest.raises(KernelError, match="positions of a policy: the last feasible one of each state needs"):
        pack([dataclasses.replace(WAITING, waits=waits)], HIDDEN)


def test_positions_of_receivers_are_needed_where_no_learner_chooses_them() -> None:
    batch = RallyBatch(HIDDEN, 3, seed=1)
    stroke, _ = batch.random_actions()
    first = HIDDEN.waiting.position[HIDDEN.base(batch.rows.state), 0].astype(np.int64)
    with pytest.raises(KernelError, match="and needed there"):
        batch.step(stroke)
    batch.step(stroke, first)
    for other in (RallyBatch(GAME, 3), RallyBatch(HIDDEN, 3, opponents=[WAITING])):
        with pytest.raises(KernelError, match="positions are for rows without opponents in the game with recovery"):
            other.step(other.random_strokes(), np.zeros(3, np.int64))


def test_rows_without_observations_have_none() -> None:
    assert [array.shape for array in NO_OBSERVATIONS] == [(0, 7), (0, 0)]
    assert [array.shape for array in RallyBatch(HIDDEN, 3).new_observations()] == [(3, 8), (3, HIDDEN.n_strokes + 9)]
    assert [array.shape for array in RallyBatch(GAME, 2).new_observations()] == [(2, 7), (2, GAME.n_strokes)]


@pytest.mark.parametrize(
    ("size", "threads", "expected"),
    [
        (10, 4, [(0, 10)]),
        (4000, 1, [(0, 4000)]),
        (2047, 2, [(0, 2047)]),
        (2048, 2, [(0, 1024), (1024, 2048)]),
        (4000, 3, [(0, 1333), (1333, 2666), (2666, 4000)]),
        (4000, 9, [(0, 1333), (1333, 2666), (2666, 4000)]),
    ],
)
def test_a_thread_has_at_least_1024_rows(size: int, threads: int, expected: list[tuple[int, int]]) -> None:
    slices: list[tuple[int, int]] = []
    in_slices(lambda first, last: slices.append((first, last)), size, threads)
    assert sorted(slices) == expected


@pytest.mark.parametrize(
    ("options", "fits"),
    [
        ({"gae_lambda": 0.0}, True),
        ({"gae_lambda": 1.0}, True),
        ({"cache_iterations": 1}, True),
        ({"gae_lambda": -0.01}, False),
        ({"gae_lambda": 1.01}, False),
        ({"cache_iterations": 0}, False),
        ({"gae_lambda": float("nan")}, False),
    ],
)
def test_numbers_of_samplers_have_bounds(options: dict[str, Any], fits: bool) -> None:
    game = hand_made()
    if fits:
        sampler = RallySampler(game, **options)
        for fraction in (0.0, 1.0):
            sampler.restart(np.array([0]), fraction)
        for fraction in (-0.01, 1.01):
            with pytest.raises(KernelError, match=f"fraction {fraction}: expected 0 to 1"):
                sampler.restart(np.array([0]), fraction)
        for state in (-1, game.n_states):
            with pytest.raises(KernelError, match="states: "):
                sampler.restart(np.array([state]), 0.5)
    else:
        with pytest.raises(KernelError, match="expected 0 to 1, and 1 iteration or more"):
            RallySampler(game, **options)
