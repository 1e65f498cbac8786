"""Tabulated policies packed for the kernel, and the choice of a stroke by one of them."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import I32, U8, U16, Bools, Ints
from shuttle_marl.base.compiling import compiled, inlined
from shuttle_marl.game.draws import CHOICE_ONE, POSITION_SHIFT
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel.core import (
    Block,
    KernelError,
    Legal,
    Tables,
    checked_array,
    int64,
    legal_strokes,
    put_stroke,
    tables_of,
    with_recovery,
)

GUIDES: Final = 16  # entries of the guide of a state: one for each value of the highest four bits of a choice
_GUIDE_SHIFT: Final = np.uint16(12)
_MOST_LEGAL: Final = 256  # most legal strokes of a state: positions are stored as uint8
_CHOICE_ONE: Final = np.uint64(CHOICE_ONE)
_PLACES: Final = N_POSITIONS - 1  # positions whose cumulative probability is stored: the last one always has 65535


class Players(NamedTuple):
    """K tabulated policies.

    Attributes:
        guide: ``[K, S, GUIDES]`` uint8 position among the legal strokes at which the search of a choice starts, indexed by the
            highest four bits of the choice.
        waits: ``[K, S, 8]`` uint16 the same as ``cumulative`` for the feasible positions of each state in rising order, but the
            ninth, filled up with 65535; ``[K, 0, 8]`` in the game without recovery.
    """

    cumulative: U16  # [K, P] cumulative probabilities, see `TabulatedPolicy`
    guide: U8
    waits: U16


@inlined
def choice_of(bits: np.uint64) -> np.uint16:
    """Choice from 0 to 65534, by the upper half of a draw; see :func:`shuttle_marl.game.draws.choice_draw`."""
    return np.uint16(((bits >> np.uint64(32)) * _CHOICE_ONE) >> np.uint64(32))


@inlined
def first_guess(players: Players, player: int, s: int, bits: np.uint64) -> int:
    """Position at which the search of :func:`find_rank` starts."""
    return int64(players.guide[np.uint64(player), np.uint64(s), choice_of(bits) >> _GUIDE_SHIFT])


@inlined
def find_rank(players: Players, player: int, start: int, guess: int, bits: np.uint64) -> int:
    """Position of the first cumulative probability above the choice, searched from ``guess``."""
    choice, k = choice_of(bits), np.uint64(guess)
    # Unsigned indices need no check for counting from the end.
    row, first = np.uint64(player), np.uint64(start)
    # Seven in eight searches take two steps or fewer; additions avoid their mispredicted branches.
    k += np.uint64(players.cumulative[row, first + k] <= choice)
    k += np.uint64(players.cumulative[row, first + k] <= choice)
    while players.cumulative[row, first + k] <= choice:
        k += np.uint64(1)
    return int64(k)


@inlined
def place_choice(players: Players, player: int, s: int, bits: np.uint64) -> int:
    """Number of the feasible position in which a policy waits where the opponent is in state ``s``, by the draw of the stroke."""
    choice, row, place = choice_of(bits << POSITION_SHIFT), np.uint64(player), 0
    for i in range(_PLACES):
        place += players.waits[row, np.uint64(s), i] <= choice
    return int64(place)


@inlined
def table_choice(players: Players, player: int, s: int, start: int, bits: np.uint64) -> int:
    """Position of the stroke that a tabulated policy chooses in state ``s``, whose first legal pair is ``start``."""
    return find_rank(players, player, start, first_guess(players, player, s, bits), bits)


@inlined
def choose(tables: Tables, players: Players, state: Ints, seat: Ints, block: Block, count: int) -> None:
    """Choose the stroke of ``player`` and the position of ``other`` in the first ``count`` states by their tables.

    Each pass reads tables at unpredictable places in many rows at once.
    """
    for j in range(count):
        legal = legal_strokes(tables, state[j])
        block.effort[j], block.pair[j], block.reply[j] = legal.block, legal.pair, legal.reply
        block.limit[j], block.choices[j] = legal.limit, legal.choices
        block.rank[j] = first_guess(players, block.player[j], state[j], block.bits[j])
    for j in range(count):
        block.rank[j] = find_rank(players, block.player[j], block.pair[j], block.rank[j], block.bits[j])
    for j in range(count):
        legal = Legal(np.uint64(block.effort[j]), 0, block.pair[j], block.reply[j], block.limit[j], block.choices[j])
        put_stroke(tables, block, j, legal, block.rank[j], seat[j])
        block.pair[j] += block.rank[j]
        block.reply[j] += block.rank[j]
    if with_recovery(tables):
        for j in range(count):
            block.place[j] = place_choice(players, block.other[j], state[j], block.bits[j])


@inlined
def write_guide(cumulative: U16, start: int, guide: U8) -> None:
    """Write the guide ``[GUIDES]`` of one state, whose first legal pair is ``start``."""
    k = start
    for part in range(guide.size):
        while cumulative[k] <= part << _GUIDE_SHIFT:
            k += 1
        guide[part] = k - start


@compiled
def _write_guides(cumulative: U16, pair_start: I32, guide: U8) -> None:
    for s in range(len(pair_start) - 1):
        if pair_start[s + 1] > pair_start[s]:
            write_guide(cumulative, pair_start[s], guide[s])


def empty_players(game: Game, count: int) -> Players:
    """Tables of ``count`` policies, filled with zeros. Raises KernelError: more than 256 legal strokes in a state."""
    most = int(np.diff(game.pair_start).max())
    if most > _MOST_LEGAL:
        raise KernelError(f"a state has {most} legal strokes; the kernel supports up to {_MOST_LEGAL}")
    waits = np.full((count, game.n_states * game.hides, _PLACES), CHOICE_ONE, np.uint16)
    return Players(np.zeros((count, game.n_pairs), np.uint16), np.zeros((count, game.n_states, GUIDES), np.uint8), waits)


def pack(policies: Sequence[TabulatedPolicy], game: Game) -> Players:
    """Pack policies of a game, or of either seat of it. Raises KernelError: none, another game, over 256 legal strokes."""
    if not policies:
        raise KernelError("no policy: expected one or more that are tabulated")
    players = empty_players(game, len(policies))
    for number, policy in enumerate(policies):
        put_player(players, number, policy, game)
    return players


def put_player(players: Players, number: int, policy: TabulatedPolicy, game: Game) -> None:
    """Replace a packed policy. Raises KernelError: of another game, without a table of its states, or an invalid number."""
    if policy.game.hash not in (tables.hash for tables in game.seats):
        raise KernelError("a policy was tabulated for another game; tabulate it for this one")
    if not 0 <= number < len(players.cumulative):
        raise KernelError(f"policy number {number}: expected 0 to {len(players.cumulative) - 1}")
    cumulative = checked_array("table of a policy", policy.cumulative, np.uint16, (game.n_pairs,))
    if (cumulative[game.last_pairs] != CHOICE_ONE).any():
        raise KernelError("table of a policy: the last legal stroke of each state needs the cumulative probability 65535")
    players.cumulative[number] = cumulative
    _write_guides(players.cumulative[number], game.pair_start, players.guide[number])
    if game.hides:
        waits = checked_array("positions of a policy", policy.waiting_table, np.uint16, (game.n_states, N_POSITIONS))
        feasible = tables_of(game).position[game.base(np.arange(game.n_states))]
        waits = np.where(feasible < 0, CHOICE_ONE, np.take_along_axis(waits, np.maximum(feasible, 0), axis=1))
        if (waits[_last_places(game)] != CHOICE_ONE).any():
            raise KernelError("positions of a policy: the last feasible one of each state needs the cumulative probability 65535")
        players.waits[number] = waits[:, :_PLACES]


def _last_places(game: Game) -> Bools:
    """``[S, 9]`` places from the last feasible position on."""
    choices = game.seats[0].waiting.choices[game.base(np.arange(game.n_states))]
    return np.asarray(np.arange(N_POSITIONS) >= choices[:, None] - 1)


def check_players(players: Players, game: Game) -> None:
    """Check that packed policies are of a game. Raises KernelError: they are of another one."""
    shapes = (game.n_pairs, game.n_states, game.n_states * game.hides)
    if tuple(array.shape[1] for array in players) != shapes:
        raise KernelError("packed policies of another game; make them with pack()")
