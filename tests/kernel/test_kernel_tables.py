"""The packed tables, and what compiled code reads from them, against the tables of the game."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from shuttle_marl.base.compiling import compiled
from shuttle_marl.game.tables import HURRY_ONE, Game
from shuttle_marl.kernel import KernelError, core
from shuttle_marl.kernel.core import Tables, tables_of
from tests.exact.exact_games import random_game, tiring_game
from tests.recovery import with_recovery

SHORT = random_game(3, 8, 0.5)
TIRING = tiring_game()
RECOVERY = with_recovery(TIRING, 3, 3)
GAMES = {"short": SHORT, "three efforts": TIRING, "recovery": RECOVERY}


@compiled
def _of_state(tables: Tables, s: int, numbers: npt.NDArray[np.int64]) -> None:
    legal = core.legal_strokes(tables, s)
    numbers[0], numbers[1], numbers[2] = core.block_of(tables, s), core.base_of(tables, s), core.row_of(tables, s)
    numbers[3], numbers[4], numbers[5] = legal.n, legal.pair, core.hurried_in(s)
    numbers[6], numbers[7], numbers[8] = core.states_of(tables), core.with_recovery(tables), core.has_choice(tables, s)
    numbers[9], numbers[10] = legal.choices, legal.block


@compiled
def _of_stroke(tables: Tables, s: int, k: int, seat: int, place: int, bits: np.uint64) -> tuple[int, Any, int, int, int, int]:
    legal = core.legal_strokes(tables, s)
    outcome, following = core.strike_one(tables, legal, k, seat, bits)
    arrival = core.arrival_of(tables, legal, k)
    return (
        core.stroke_of(tables, legal, k),
        core.limits_of(tables, legal, k, seat, place),
        arrival,
        outcome,
        following,
        core.next_state(arrival, 5),
    )


@compiled
def _of_receiver(tables: Tables, s: int, place: int, bits: np.uint64) -> tuple[int, int, int]:
    legal = core.legal_strokes(tables, s)
    return core.choices_in(tables, s), core.position_at(tables, s, place), core.uniform_place(legal, bits)


def in_one_number(limits: npt.NDArray[np.uint16], hurry: npt.NDArray[np.uint8]) -> int:
    """Three thresholds in 16 bits each, then the two chances in 8 bits each, the first of them lowest."""
    fault, winner, below, from_below, from_above = map(int, (*limits, *hurry))
    return fault + (winner << 16) + (below << 32) + (from_below << 48) + (from_above << 56)


def some_states(game: Game) -> list[int]:
    """States of all efforts with legal strokes, the first and the last among them."""
    states = np.flatnonzero(game.playable)
    return sorted({*states[:: max(1, len(states) // 60)].tolist(), int(states[-1])})


@pytest.mark.parametrize("game", GAMES.values(), ids=GAMES)
def test_parts_of_a_state_are_those_of_the_game(game: Game) -> None:
    tables, n = tables_of(game), np.empty(11, np.int64)
    for s in some_states(game):
        _of_state(tables, s, n)
        block, base = divmod(s, game.n_base_states)
        choices = 1 if game.recovery is None else int(game.waiting.mask(np.array([base])).sum())
        assert n.tolist() == [
            *(block, base, 2 * game.incoming(s) + game.contact(s), game.legal_count(s), game.pair_start[s], game.hurried(s)),
            *(game.n_states, game.recovery is not None, choices > 1, choices, block),
        ]
        row = int(n[2])
        assert np.array_equal(tables.mask[row][: game.n_strokes], game.mask(s))
        assert np.array_equal(tables.rank[row], game.rank(s, np.arange(game.n_strokes)))
        assert tables.efforts[block].tolist() == [game.effort(s), game.opponent_effort(s)]
        edge = base >> 2
        assert (tables.own[edge], tables.incoming[edge], tables.duel[edge]) == (game.own(s), game.incoming(s), game.duel(s))


@pytest.mark.parametrize("game", [SHORT, TIRING], ids=["short", "three efforts"])
def test_a_stroke_has_the_thresholds_and_the_arrival_of_its_pair(game: Game) -> None:
    tables, lowest, highest = tables_of(game), np.uint64(0), np.uint64(0xFFFFFF)
    for s in some_states(game):
        for k in range(0, int(game.legal_count(s)), 3):
            pair = int(game.pair_start[s]) + k
            arrivals = game.arrivals(np.array([pair]))[0]
            entry = in_one_number(game.limits_of(np.array([pair]))[0], game.hurry[pair % game.n_base_pairs])
            stroke, limits, arrival, outcome, following, hurried_above = _of_stroke(tables, s, k, 0, 0, highest)
            assert (stroke, limits) == (game.pair_stroke[pair], entry)
            # The highest draw returns from above in time: no chance of a hurried receiver reaches 256/256.
            assert (arrival, outcome, following, hurried_above) == (arrivals[0], 3, arrivals[1], arrivals[3])
            fault = game.limits_of(np.array([pair]))[0, 0] > 0
            assert _of_stroke(tables, s, k, 0, 0, lowest)[3] == 0 or not fault


def test_thresholds_depend_on_where_the_receiver_waits() -> None:
    game, tables = RECOVERY, tables_of(RECOVERY)
    for s in some_states(game):
        positions = np.flatnonzero(game.waiting.mask(np.array([s % game.n_base_states]))[0]).tolist()
        own = s // game.n_base_states // game.levels
        for place, position in enumerate(positions):
            # With the upper 24 of the lowest 48 bits of a draw zero, the first position is chosen, with all ones the last.
            found = [_of_receiver(tables, s, place, np.uint64(bits)) for bits in (0, 2**64 - 1)]
            assert found == [(len(positions), position, 0), (len(positions), position, len(positions) - 1)]
            k = int(game.legal_count(s)) - 1
            row = int(game.waiting.row(np.array([s % game.n_base_states]), np.array([k]), np.array([position]))[0])
            entry = in_one_number(game.waiting.limits[own, row], game.waiting.hurry[row])
            assert _of_stroke(tables, s, k, 0, place, np.uint64(0))[1] == entry


def test_each_seat_of_a_pair_strikes_with_its_own_thresholds() -> None:
    people: Any = SimpleNamespace()
    game = dataclasses.replace(TIRING, threshold=np.stack([TIRING.threshold, TIRING.threshold // 2]), people=people)
    tables = tables_of(game)
    for s in some_states(game)[::5]:
        for seat, of_seat in enumerate(game.seats):
            pair = np.array([int(game.pair_start[s])])
            entry = in_one_number(of_seat.limits_of(pair)[0], of_seat.hurry[pair[0] % game.n_base_pairs])
            assert _of_stroke(tables, s, 0, seat, 0, np.uint64(0))[1] == entry
    assert tables.seat * 2 == len(tables.limits)
    assert tables_of(SHORT).seat == 0


def test_masks_of_hidden_positions_show_strokes_positions_or_both() -> None:
    game, tables, n = RECOVERY, tables_of(RECOVERY), RECOVERY.n_strokes
    for s in some_states(game):
        base = s % game.n_base_states
        strokes, feasible = game.mask(s), game.waiting.mask(np.array([base]))[0]
        shown = [tables.mask[row, : n + 9].tolist() for row in tables.head[base, [3, 6, 7]]]
        nothing = np.zeros(9, np.bool_)
        assert shown == [
            [*strokes, *nothing],
            [*np.zeros(n, np.bool_), *feasible],
            [*strokes, *feasible],
        ]
    assert tables.mask.shape[1] == 32
    assert not tables.mask[:, n + 9 :].any()


class Large(SimpleNamespace):
    """Sizes of a game too large to make one."""

    __hash__ = object.__hash__  # type: ignore[assignment]


@pytest.mark.parametrize(
    ("n_blocks", "n_base_states", "n_pairs", "fits"),
    [
        (1, 1 << 28, 1, True),
        (2, 1 << 28, 1, False),  # 2 * 2^56 is the least product for which the multiplication would be wrong
        (64, 1 << 25, (1 << 31) - 1, True),
        (64, 1 << 25, 1 << 31, False),
    ],
)
def test_the_kernel_takes_states_and_pairs_up_to_a_limit(n_blocks: int, n_base_states: int, n_pairs: int, fits: bool) -> None:
    game: Any = Large(
        n_blocks=n_blocks, n_base_states=n_base_states, n_pairs=n_pairs, n_states=n_blocks * n_base_states, reply_edge=None
    )
    with pytest.raises(AttributeError if fits else KernelError, match="people" if fits else "too many for the kernel"):
        tables_of(game)


def test_hurry_is_the_same_at_all_efforts() -> None:
    """Only faults depend on the striker's effort: the upper 16 bits of the thresholds repeat."""
    found = tables_of(TIRING).limits.reshape(3, -1)
    assert TIRING.levels == 3
    assert np.array_equal(found[0] >> np.uint64(48), found[2] >> np.uint64(48))
    assert (found[0] % np.uint64(1 << 16) < found[2] % np.uint64(1 << 16)).all()
    assert int((found >> np.uint64(56)).max()) < HURRY_ONE


def test_the_efforts_change_places_after_a_stroke() -> None:
    alone = dataclasses.replace(RECOVERY, fault_odds=RECOVERY.fault_odds[:1])
    assert tables_of(alone).follows.tolist() == [[0, 0]]
    size = RECOVERY.n_base_states
    # Block own * 3 + other; an attack adds one to the own effort, up to the highest.
    following = ((0, 1), (3, 4), (6, 7), (1, 2), (4, 5), (7, 8), (2, 2), (5, 5), (8, 8))
    assert tables_of(RECOVERY).follows.tolist() == [[after * size, attacked * size] for after, attacked in following]
