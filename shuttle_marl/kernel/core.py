"""One stroke, compiled: draws, table look-ups and outcomes, and passes over blocks of rows.

A pass is a tight loop over all rows of a block that does one thing, so that the reads of many rows overlap and arithmetic is
vectorised: twice as fast as one loop that does everything. Compiled code accesses memory unchecked, so every array from outside
is checked first (:func:`checked_array`).
"""

import functools
from collections.abc import Callable
from typing import Any, Final, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from shuttle_marl.base.arrays import I8, I16, I32, I64, U64, Bools, Ints
from shuttle_marl.base.compiling import compiled, inlined
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.game import draws, scoring
from shuttle_marl.game.draws import GOLDEN
from shuttle_marl.game.recovery import CENTRE, N_POSITIONS
from shuttle_marl.game.tables import Game

int64: Final = cast("Callable[[Any], int]", np.int64)  # as callers of compiled functions see it
LOW_16: Final = np.uint64(0xFFFF)
LOW_8: Final = np.uint64(0xFF)
_VECTOR: Final = 32
_SHIFT: Final = np.uint64(57)
BLOCK: Final = 256  # rows of a block: few enough that the results of one pass are in the first-level cache for the next
OPEN: Final = 2  # least outcome of a stroke after which the rally continues


class KernelError(ShuttleError):
    """An argument that the kernel cannot take."""


def checked_array(
    name: str, array: Any, type_: npt.DTypeLike, shape: tuple[int, ...], low: int | None = None, high: int | None = None
) -> npt.NDArray[Any]:
    """Return an array as a C-contiguous array of one dtype.

    Integers of any width are converted to integers; nothing else is converted, so no fraction is truncated.

    Args:
        low, high: least and greatest value of integers; None: those of the dtype.

    Raises:
        KernelError: wrong kind of numbers, wrong shape, or a number out of range.
    """
    wanted = np.dtype(type_)
    found = np.asarray(array)
    alike = found.dtype == wanted or (wanted.kind in "iu" and found.dtype.kind in "iu")
    if not alike or found.shape != shape:
        raise KernelError(f"{name}: {found.dtype} of shape {found.shape}; expected {wanted} of shape {shape}")
    if wanted.kind in "iu" and found.size and (found.dtype != wanted or (low, high) != (None, None)):
        least = np.iinfo(wanted).min if low is None else low
        largest = np.iinfo(wanted).max if high is None else high
        smallest, greatest = int(found.min()), int(found.max())
        if smallest < least or greatest > largest:
            raise KernelError(f"{name}: {smallest} to {greatest}; expected {least} to {largest}")
    return np.ascontiguousarray(found, dtype=wanted)


def check_room(name: str, array: Any, type_: npt.DTypeLike, shape: tuple[int, ...]) -> None:
    """Check an output array. Raises KernelError: wrong dtype or shape, or not C-contiguous, aligned and writeable."""
    wanted = np.dtype(type_)
    fits = isinstance(array, np.ndarray) and array.dtype == wanted and array.shape == shape
    if not fits or not (array.flags.c_contiguous and array.flags.writeable and array.flags.aligned):
        found = f"{array.dtype} of shape {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
        raise KernelError(f"output array for {name}, {found}: expected {wanted} of shape {shape}, writeable and C-contiguous")


class Tables(NamedTuple):
    """A game packed so that a stroke costs few reads, mostly from tables that fit into the second-level cache.

    B is the number of blocks, combinations of both players' efforts.

    Attributes:
        limits: ``[L * base pairs]`` uint64 three thresholds of a base pair in the lowest 48 bits, the fault's lowest, and above
            them the two chances of a hurried receiver, that of a return from below first; indexed by (own effort, base pair). In
            the game of a pair ``[2 * L * base pairs]``: those of seat 0, then those of seat 1. With recovery the R rows by
            position (:class:`~shuttle_marl.game.recovery.Waiting`) take the place of the base pairs.
        recovery: 1 if receivers choose positions, else None, a type of its own: code is compiled for each game, and without a
            choice it reads no positions.
        head: ``[base states, 8]`` int32 of each base state: first pair, number of legal strokes, index of its first reply, row of
            ``rank`` and of ``mask`` with its legal strokes, first row by position, number of feasible positions, which are the
            rows from one stroke to the next, and the rows of ``mask`` with these positions and with both. Without recovery the
            first four, which stay in the cache.
    """

    limits: U64
    seat: np.int64  # index of the first thresholds of seat 1; 0 if both seats strike with the same ones
    recovery: np.int64 | None
    position: I8  # [base states, 9] its feasible positions in rising order, then -1
    place: I8  # [base states, 9] number of each position among the feasible ones, else -1
    head: I32
    inverse: np.uint64  # 2^57 divided by the number of base states, rounded up: the block of a state follows by a multiplication
    first: I32  # [B, 3] of each block: first state, first legal pair, index of its first thresholds in `limits`
    follows: I32  # [B, 2] first state of the following block, after a stroke that is not an attack and after an attack
    efforts: I32  # [B, 2] efforts of striker and receiver in each block
    arrival: I32  # [V] four times the edge that follows each reply, plus 1 if the reply is an attack
    stroke: I16  # [V] stroke of each reply
    incoming: I16  # [E] incoming stroke of an edge
    own: I16  # [E] own last stroke of an edge
    duel: I8  # [E] net shots in a row that end with the incoming stroke
    rank: I16  # [2 (n + 1), n] position of a stroke among the legal strokes, -1 if it is not legal
    mask: Bools  # [M, m] legal actions; m is n (with recovery n + 9) rounded up to a multiple of 32


@functools.lru_cache(maxsize=8)
def tables_of(game: Game) -> Tables:
    """Packed tables of a game (cached). Raises KernelError: the game has too many states or legal pairs."""
    size, edge = game.n_base_states, game.reply_edge
    # With e = inverse * size - 2^57 < size, the block of s comes out right where s * e < 2^57, that is for all s < B size.
    if game.n_blocks * size * size >= 1 << 57 or game.n_pairs >= 1 << 31:
        raise KernelError(f"the game has {game.n_states:,} states and {game.n_pairs:,} legal pairs: too many for the kernel")
    seats = game.seats if game.people is not None else (game,)
    met = [tables.waiting for tables in seats]
    t = np.concatenate([part.limits.reshape(-1, 3) for part in met]).astype(np.uint64)
    hurry = np.concatenate([np.tile(part.hurry, (game.levels, 1)) for part in met]).astype(np.uint64)
    shifts = np.array([0, 16, 32, 48, 56], np.uint64)
    base, block = np.arange(size), np.arange(game.n_blocks, dtype=np.int32)
    effort = block // game.levels
    row = 2 * game.incoming(base) + game.contact(base)
    mask, shown = _masks(game.reply_mask.reshape(-1, game.n_strokes), met[0].place >= 0, row)
    head = [game.base_pair_start[:-1], np.diff(game.base_pair_start), game.first_reply, row]
    head += [met[0].start[:-1], met[0].choices, *shown]
    mask = mask[:, : game.n_actions]
    first = np.stack([block * size, block * game.n_base_pairs, effort * len(met[0].hurry)], axis=1, dtype=np.int32)
    width = -(-game.n_actions // _VECTOR) * _VECTOR
    return Tables(
        limits=np.bitwise_or.reduce(np.concatenate([t, hurry], axis=1) << shifts, axis=1),
        seat=np.int64(len(t) // 2 if game.people is not None else 0),
        recovery=np.int64(1) if game.hides else None,
        position=np.ascontiguousarray(met[0].position),
        place=met[0].place,
        head=np.stack(head[: 4 + 4 * game.hides], axis=1, dtype=np.int32, casting="same_kind"),
        inverse=np.uint64(-(-(1 << int(_SHIFT)) // size)),
        first=np.ascontiguousarray(first),
        follows=np.array([game.block_following(b) for b in block.tolist()], np.int32) * np.int32(size),
        efforts=np.ascontiguousarray(np.stack([effort, block % game.levels], axis=1)),
        arrival=4 * edge + game.edge_attack[edge],
        stroke=game.edge_incoming[edge].astype(np.int16),
        incoming=game.edge_incoming.astype(np.int16),
        own=game.edge_own.astype(np.int16),
        duel=game.edge_duel.astype(np.int8),
        rank=np.ascontiguousarray(game.reply_rank.reshape(-1, game.n_strokes)),
        mask=np.pad(mask, ((0, 0), (0, width - mask.shape[1]))),
    )


def _masks(strokes: Bools, feasible: Bools, row: I32) -> tuple[Bools, tuple[Ints, Ints]]:
    """``[M, n + 9]`` masks, those of strokes alone first, and ``[base states]`` the rows with positions alone and with both."""
    n = len(strokes)
    positions, of_base = np.unique(feasible, axis=0, return_inverse=True)
    pairs, both = np.unique(row * len(positions) + of_base.ravel(), return_inverse=True)
    mask = np.zeros((n + len(positions) + len(pairs), strokes.shape[1] + N_POSITIONS), np.bool_)
    mask[:n, :-N_POSITIONS] = strokes
    mask[n : n + len(positions), -N_POSITIONS:] = positions
    mask[n + len(positions) :] = np.concatenate([strokes[pairs // len(positions)], positions[pairs % len(positions)]], axis=1)
    return mask, (n + of_base.ravel(), n + len(positions) + both.ravel())


class Legal(NamedTuple):
    """Legal strokes of a state."""

    block: np.uint64  # effort block of the state
    n: int  # number of legal strokes
    pair: int  # first legal pair
    reply: int  # index of the first reply
    limit: int  # index of the first thresholds
    choices: int  # number of thresholds of a stroke, one for each feasible position of the receiver; 1 without recovery


# Unsigned indices need no check for counting from the end.


@inlined
def block_of(tables: Tables, s: int) -> np.uint64:
    """Effort block of a state."""
    return np.uint64((np.uint64(s) * tables.inverse) >> _SHIFT)


@inlined
def base_of(tables: Tables, s: int) -> np.uint64:
    """Base state of a state."""
    return np.uint64(s - tables.first[block_of(tables, s), 0])


@inlined
def row_of(tables: Tables, s: int) -> np.uint64:
    """Row of a state in ``rank`` and ``mask``."""
    return np.uint64(tables.head[base_of(tables, s), 3])


@inlined
def hurried_in(s: int) -> int:
    """Whether the striker of a state is hurried, 0 or 1."""
    return s >> 1 & 1


@inlined
def legal_strokes(tables: Tables, s: int) -> Legal:
    """Legal strokes of a state; look-ups of fields that are not used are eliminated by the compiler."""
    block = block_of(tables, s)
    base = np.uint64(s - tables.first[block, 0])
    pair = tables.head[base, 0]
    row, choices = int64(pair), int64(1)
    if with_recovery(tables):
        row, choices = int64(tables.head[base, 4]), int64(tables.head[base, 5])
    first = tables.first[block]
    return Legal(block, tables.head[base, 1], pair + first[1], tables.head[base, 2], row + first[2], choices)


@inlined
def stroke_of(tables: Tables, legal: Legal, k: int) -> int:
    """Catalogue index of the k-th legal stroke."""
    stroke: int = tables.stroke[np.uint64(legal.reply + k)]
    return stroke


@inlined
def arrival_of(tables: Tables, legal: Legal, k: int) -> int:
    """State of the receiver, contact below and not hurried, after the k-th legal stroke."""
    code = tables.arrival[np.uint64(legal.reply + k)]
    arrival: int = tables.follows[legal.block, np.uint64(code & 1)] + (code & ~1)
    return arrival


@inlined
def next_state(arrival: int, outcome: int) -> int:
    """State of the next striker; after the end of the rally the state that would follow its last stroke returned from below."""
    return arrival + max(outcome - OPEN, 0)


@inlined
def with_recovery(tables: Tables) -> bool:
    """Whether receivers have a choice of positions; known when code is compiled."""
    return tables.recovery is not None


@inlined
def states_of(tables: Tables) -> int:
    """Number of states S."""
    states: int = tables.first.shape[0] * tables.head.shape[0]
    return states


@inlined
def choices_in(tables: Tables, s: int) -> int:
    """Number of feasible positions of the receiver in a state."""
    return legal_strokes(tables, s).choices


@inlined
def position_at(tables: Tables, s: int, place: int) -> int:
    """The feasible position ``place`` of the receiver in a state."""
    return int64(tables.position[base_of(tables, s), np.uint64(place)]) if with_recovery(tables) else CENTRE


@inlined
def place_of(tables: Tables, s: int, position: int) -> int:
    """Number of a position of the receiver among the feasible ones in a state."""
    return int64(tables.place[base_of(tables, s), np.uint64(position)])


mix: Final = cast("Callable[[np.uint64], np.uint64]", inlined(draws.mix))
count_rally: Final = inlined(scoring.count_rally)


@inlined
def extend(key: np.uint64, number: int) -> np.uint64:
    """:func:`shuttle_marl.game.draws.extend` of one key."""
    return mix((key ^ np.uint64(number)) + GOLDEN)


@inlined
def draw(key: np.uint64, counter: int) -> np.uint64:
    """:func:`shuttle_marl.game.draws.draw` of one key."""
    return mix(mix(key + np.uint64(counter) * GOLDEN) + GOLDEN)


@inlined
def first_server(bits: np.uint64) -> int:
    """Seat that serves a rally whose server is random: bit 24 of its first draw."""
    return int64((bits >> np.uint64(24)) & np.uint64(1))


@inlined
def outcome_of(limits: np.uint64, bits: np.uint64) -> int:
    """Outcome of a stroke, 0 to 5, by the lowest 24 bits of a draw."""
    u = bits & LOW_16
    returned = int64(u >= ((limits >> np.uint64(16)) & LOW_16))
    above = int64(u >= ((limits >> np.uint64(32)) & LOW_16))
    chance = (limits >> np.uint64(48 + 8 * above)) & LOW_8
    hurried = int64(((bits >> np.uint64(16)) & LOW_8) < chance)
    return int64(u >= (limits & LOW_16)) + returned + above + 2 * (returned & hurried)


@inlined
def uniform_choice(count: int, bits: np.uint64) -> int:
    """One of ``count`` strokes with equal probabilities, by the upper half of a draw."""
    return int64(((bits >> np.uint64(32)) * np.uint64(count)) >> np.uint64(32))


class Block(NamedTuple):
    """Arrays ``[BLOCK]``, or longer ones, in which each pass leaves its results for the next."""

    bits: U64  # draw of the stroke
    player: I32  # number of the striker among `Players`
    other: I32  # the same of the receiver
    place: I32  # number of the receiver's feasible position
    rank: I32  # position of the stroke among the legal strokes
    effort: I32  # effort block of the state
    pair: I32  # first legal pair of the state, then that of the stroke
    reply: I32  # index of its first reply, then of the stroke
    limit: I32  # index of the thresholds of its first stroke, then of the stroke
    choices: I32  # number of thresholds of a stroke
    limits: U64  # thresholds of the stroke
    arrival: I32  # state of the next striker, contact below and not hurried
    outcome: I64  # outcome, 0 to 5
    listed: I64  # indices of rows, see `list_where`


@inlined
def new_block(size: int = BLOCK) -> Block:
    """Allocate a block; nobody waits where there is a choice."""
    return Block(
        np.empty(size, np.uint64), np.empty(size, np.int32), np.empty(size, np.int32), np.zeros(size, np.int32),
        np.empty(size, np.int32), np.empty(size, np.int32), np.empty(size, np.int32), np.empty(size, np.int32),
        np.empty(size, np.int32), np.empty(size, np.int32), np.empty(size, np.uint64), np.empty(size, np.int32),
        np.empty(size, np.int64), np.empty(size, np.int64),
    )  # fmt: skip


@inlined
def put_stroke(tables: Tables, block: Block, j: int, legal: Legal, k: int, seat: int) -> None:
    """Set the stroke of row j, struck by a seat, to the k-th of its legal strokes."""
    block.limit[j] = legal.limit + k * legal.choices + tables.seat * seat
    block.arrival[j] = arrival_of(tables, legal, k)


@inlined
def strike(tables: Tables, state: Ints, block: Block, count: int) -> None:
    """Decide the strokes of the first ``count`` rows against the positions of ``place``, and move on to the next state.

    This is the one pass by which everything compiled plays, after :func:`put_stroke`.
    """
    if with_recovery(tables):
        for j in range(count):
            block.limit[j] += block.place[j]
    for j in range(count):
        block.limits[j] = tables.limits[np.uint64(block.limit[j])]
    for j in range(count):
        outcome = outcome_of(block.limits[j], block.bits[j])
        block.outcome[j], state[j] = outcome, next_state(block.arrival[j], outcome)


@inlined
def list_where(block: Block, count: int, over: bool) -> int:
    """List the rows whose rally is over, or those whose rally continues; returns their number."""
    listed = 0
    for j in range(count):
        block.listed[listed] = j
        listed += (block.outcome[j] < OPEN) == over
    return listed


@compiled
def _strike_all(tables: Tables, state: I64, seat: I8, position: I64, block: Block) -> None:
    for j in range(state.size):
        put_stroke(tables, block, j, legal_strokes(tables, state[j]), block.rank[j], seat[j])
        block.place[j] = place_of(tables, state[j], position[j])
    strike(tables, state, block, state.size)


def struck(
    game: Game, state: Ints, k: Ints, draw: Ints, striker: Ints | int = 0, position: Ints | int = CENTRE
) -> tuple[I8, I32]:
    """Play the k-th legal stroke of each state; the rule of :func:`shuttle_marl.game.rules.outcome`. Nothing is checked.

    Args:
        state: ``[B]`` state of the striker.
        k: ``[B]`` which of its legal strokes, 0 <= k < legal_count(state).
        draw: ``[B]`` uniform integers in [0, 2^24), see :func:`shuttle_marl.game.draws.outcome_draw`.
        striker: ``[B]`` seat of the striker.
        position: ``[B]`` position of the receiver, feasible in the state.

    Returns:
        ``[B]`` outcome (index into :data:`shuttle_marl.game.rules.OUTCOMES`) and ``[B]`` state of the receiver, who is the next
        striker; -1 where the rally is over.
    """
    block, size = new_block(len(state)), len(state)
    block.rank[:], block.bits[:] = k, np.asarray(draw).astype(np.uint64)
    after, seats, positions = np.empty(size, np.int64), np.empty(size, np.int8), np.empty(size, np.int64)
    after[:], seats[:], positions[:] = state, striker, position
    _strike_all(tables_of(game), after, seats, positions, block)
    return block.outcome.astype(np.int8), np.where(block.outcome < OPEN, -1, after).astype(np.int32)
