"""Whatever enters compiled code is checked before: shapes, kinds of numbers, ranges."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from shuttle_marl.game.policy import TabulatedPolicy, UniformPolicy, tabulate
from shuttle_marl.kernel import KernelError, Matches, RallyBatch, RallySampler, pack, play_matches
from shuttle_marl.kernel.rows import Observations
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
    strokes, before = batch.random_actions()[0], state_of(batch)
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
    strokes, before, room = batch.random_actions()[0], state_of(batch), change(batch.new_observations())
    for use in (lambda: batch.observe(room), lambda: batch.step(strokes, observed=room)):
        with pytest.raises(KernelError, match=r"output array for (tokens|mask)"):
            use()
    assert state_of(batch) == before


@pytest.mark.parametrize("opponents", [np.ones(ROWS), np.zeros(ROWS - 1, int), np.full(ROWS, -1), np.full(ROWS, 2**40)])
def test_assigned_opponents_are_checked(batch: RallyBatch, opponents: np.ndarray) -> None:
    with pytest.raises(KernelError, match="opponents: "):
        batch.assign(opponents)
    assert (batch.opponents.following == 0).all()


def test_packed_policies_of_another_game_are_refused() -> None:
    other = random_game(3)
    with pytest.raises(KernelError, match="packed policies of another game"):
        play_matches(GAME, some_matches(), pack([random_policy(other, 0)], other))


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


HIDDEN = with_recovery(tiring_game(), 3, 3)
WAITING = tabulate(UniformPolicy(), HIDDEN)


def test_the_last_feasible_position_of_a_table_is_certain() -> None:
    waits, state = WAITING.waiting_table.copy(), int(np.flatnonzero(HIDDEN.playable)[-1])
    last = int(np.flatnonzero(HIDDEN.waiting.mask(HIDDEN.base(state)))[-1])
    waits[state, last:] = 65534
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
            other.step(other.random_actions()[0], np.zeros(3, np.int64))


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
