"""One stroke, compiled: draws, the table read that decides a stroke, the choice of a tabulated policy, and passes over rows.

A stroke reads tables at two places that no one can foresee, and each of them may be far from the processor. So a pass is a
tight loop over all rows of a block that does one thing: the reads of many rows are then under way at once, and arithmetic is
done for several rows in one instruction. A loop that did everything for one row after the other takes twice as long.

Everything here is inlined into the loops of this package. The rule is that of :func:`shuttle_marl.game.rules.strike`, the draws
are those of :mod:`shuttle_marl.game.draws`; tests hold them equal bit for bit.
"""

import functools
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from shuttle_marl.arrays import I8, I16, I32, I64, U8, U16, U64, Bools
from shuttle_marl.game.draws import CHOICE_ONE, GOLDEN, MIX_1, MIX_2
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.kernel.checks import KernelError, checked_array
from shuttle_marl.kernel.compiling import compiled, inlined

_LOW_16: Final = np.uint64(0xFFFF)
_CHOICE_ONE: Final = np.uint64(CHOICE_ONE)
_VECTOR: Final = 32
_GUIDES: Final = 16
_GUIDE_SHIFT: Final = np.uint16(12)


_SHIFT: Final = np.uint64(57)


class Tables(NamedTuple):
    """A game packed so that a stroke costs few reads, from tables that are small enough for the second cache where it can be.

    B is the number of blocks, combinations of both players' efforts.

    Attributes:
        limits: ``[L * base pairs]`` uint64, by own effort the three thresholds of a base pair in its lowest 48 bits, the fault's
            lowest.
        head: ``[base states, 4]`` int32, first pair of a base state, number of its legal strokes, place of the first of its
            replies, row of ``rank`` and ``mask``.
        inverse: 2^57 divided by the number of base states, rounded up: a multiplication finds the block of a state.
        first: ``[B, 3]`` int32 of each block the first state, the first legal pair, and the first of its thresholds.
        follows: ``[B, 2]`` int32 first state of the block that follows a block, after a stroke that is no attack and after one.
        efforts: ``[B, 2]`` int32 effort of the striker and of the receiver in a block.
        arrival: ``[V]`` int32 twice the edge that follows each reply, and 1 more after an attack.
        stroke: ``[V]`` int16 stroke of each reply.
        incoming: ``[E]`` int16 incoming stroke of an edge.
        own: ``[E]`` int16 own last stroke of an edge.
        duel: ``[E]`` int8 net shots in a row that end with the incoming stroke.
        rank: ``[2 (n + 1), n]`` int16 position of a stroke among the legal ones, -1 where it is not legal.
        mask: ``[2 (n + 1), m]`` bool legal strokes; m is n and what is missing to whole vectors of the processor, False.
    """

    limits: U64
    head: I32
    inverse: np.uint64
    first: I32
    follows: I32
    efforts: I32
    arrival: I32
    stroke: I16
    incoming: I16
    own: I16
    duel: I8
    rank: I16
    mask: Bools


@functools.lru_cache(maxsize=8)
def tables_of(game: Game) -> Tables:
    """The packed tables of a game, made once.

    Raises:
        KernelError: it has more states than can be told apart.
    """
    size, edge = game.n_base_states, game.reply_edge
    # With e = inverse * size - 2^57 < size, the block of s comes out right where s * e < 2^57, that is for all s < B size.
    if game.n_blocks * size * size >= 1 << 57 or game.n_pairs >= 1 << 31:
        raise KernelError(f"the game has {game.n_states:,} states and {game.n_pairs:,} legal pairs: too many for the kernel")
    t = game.limits.reshape(-1, 3).astype(np.uint64)
    base, block = np.arange(size), np.arange(game.n_blocks, dtype=np.int32)
    effort = block // game.levels
    row = 2 * game.incoming(base) + game.contact(base)
    head = np.stack([game.base_pair_start[:-1], np.diff(game.base_pair_start), game.first_reply, row], axis=1, dtype=np.int32)
    first = np.stack([block * size, block * game.n_base_pairs, effort * game.n_base_pairs], axis=1, dtype=np.int32)
    return Tables(
        limits=t[:, 0] | (t[:, 1] << np.uint64(16)) | (t[:, 2] << np.uint64(32)),
        head=np.ascontiguousarray(head),
        inverse=np.uint64(-(-(1 << int(_SHIFT)) // size)),
        first=np.ascontiguousarray(first),
        follows=np.array([game.block_following(b) for b in block.tolist()], np.int32) * np.int32(size),
        efforts=np.ascontiguousarray(np.stack([effort, block % game.levels], axis=1)),
        arrival=2 * edge + game.edge_attack[edge],
        stroke=game.edge_incoming[edge].astype(np.int16),
        incoming=game.edge_incoming.astype(np.int16),
        own=game.edge_own.astype(np.int16),
        duel=game.edge_duel.astype(np.int8),
        rank=np.ascontiguousarray(game.reply_rank.reshape(-1, game.n_strokes)),
        mask=np.pad(game.reply_mask.reshape(-1, game.n_strokes), ((0, 0), (0, -game.n_strokes % _VECTOR))),
    )


# An index without a sign need not be checked for counting from the end.


@inlined
def block_of(tables: Any, s: Any) -> Any:
    """Block of a state."""
    return np.uint64((np.uint64(s) * tables.inverse) >> _SHIFT)


@inlined
def base_of(tables: Any, s: Any) -> Any:
    """Base state of a state."""
    return np.uint64(s - tables.first[block_of(tables, s), 0])


@inlined
def row_of(tables: Any, s: Any) -> Any:
    """Row of ``rank`` and ``mask`` that belongs to a state."""
    return np.uint64(tables.head[base_of(tables, s), 3])


@inlined
def first_pair(tables: Any, s: Any) -> Any:
    """First legal pair of a state."""
    return tables.head[base_of(tables, s), 0] + tables.first[block_of(tables, s), 1]


@inlined
def legal_count(tables: Any, s: Any) -> Any:
    """Number of legal strokes of a state."""
    return tables.head[base_of(tables, s), 1]


@inlined
def reply_of(tables: Any, s: Any, k: Any) -> Any:
    """Place of the k-th legal stroke of a state among the replies."""
    return np.uint64(tables.head[base_of(tables, s), 2] + k)


@inlined
def arrival_of(tables: Any, block: Any, reply: Any) -> Any:
    """The receiver's state, contact below, after a reply in a block."""
    code = tables.arrival[reply]
    return tables.follows[block, np.uint64(code & 1)] + (code & ~1)


@inlined
def mix(x: Any) -> Any:
    """:func:`shuttle_marl.game.draws.mix` of one number."""
    x = (x ^ (x >> np.uint64(30))) * MIX_1
    x = (x ^ (x >> np.uint64(27))) * MIX_2
    return x ^ (x >> np.uint64(31))


@inlined
def extend(key: Any, number: Any) -> Any:
    """:func:`shuttle_marl.game.draws.extend` of one key."""
    return mix((key ^ np.uint64(number)) + GOLDEN)


@inlined
def draw(key: Any, counter: Any) -> Any:
    """:func:`shuttle_marl.game.draws.draw` of one key."""
    return mix(mix(key + np.uint64(counter) * GOLDEN) + GOLDEN)


@inlined
def first_server(bits: Any) -> Any:
    """The seat that serves a rally where it is drawn at random: bit 16 of its first draw."""
    return np.int64((bits >> np.uint64(16)) & np.uint64(1))


@inlined
def outcome_of(limits: Any, bits: Any) -> Any:
    """Outcome of a stroke, 0 to 3, by the lowest 16 bits of a draw."""
    u = bits & _LOW_16
    return (
        np.int64(u >= (limits & _LOW_16))
        + np.int64(u >= ((limits >> np.uint64(16)) & _LOW_16))
        + np.int64(u >= ((limits >> np.uint64(32)) & _LOW_16))
    )


@inlined
def uniform_choice(count: Any, bits: Any) -> Any:
    """One of ``count`` strokes, equally likely, by the upper half of a draw."""
    return np.int64(((bits >> np.uint64(32)) * np.uint64(count)) >> np.uint64(32))


@inlined
def table_choice(players: Any, player: Any, s: Any, start: Any, bits: Any) -> Any:
    """The stroke that a tabulated policy plays, by the upper half of a draw: the first entry above it."""
    return table_rank(players, player, start, first_guess(players, player, s, bits), bits)


@inlined
def first_guess(players: Any, player: Any, s: Any, bits: Any) -> Any:
    """Position from which on a tabulated policy's choice is looked for: none before it is the choice."""
    return np.int64(players.guide[np.uint64(player), np.uint64(s), _sixteen(bits) >> _GUIDE_SHIFT])


@inlined
def table_rank(players: Any, player: Any, start: Any, guess: Any, bits: Any) -> Any:
    """Position of the choice of :func:`table_choice`, from its first guess on."""
    u, k = _sixteen(bits), np.uint64(guess)
    # Indices without a sign need not be checked for counting from the end.
    who, first = np.uint64(player), np.uint64(start)
    # Seven in eight choices need two steps or fewer; as additions they cost no mispredicted branch.
    k += np.uint64(players.cumulative[who, first + k] <= u)
    k += np.uint64(players.cumulative[who, first + k] <= u)
    while players.cumulative[who, first + k] <= u:
        k += np.uint64(1)
    return np.int64(k)


@inlined
def _sixteen(bits: Any) -> Any:
    """Number from 0 to 65534 by the upper half of a draw."""
    return np.uint16(((bits >> np.uint64(32)) * _CHOICE_ONE) >> np.uint64(32))


class Players(NamedTuple):
    """K tabulated policies, packed for choosing strokes.

    Attributes:
        cumulative: ``[K, P]`` uint16, as in :class:`shuttle_marl.game.tabulated.TabulatedPolicy`.
        guide: ``[K, S, 16]`` uint8, where to begin looking, by the highest four bits of a draw.
    """

    cumulative: U16
    guide: U8


@compiled
def _write_guide(cumulative: U16, pair_start: I32, guide: U8) -> None:
    for s in range(len(pair_start) - 1):
        k = pair_start[s]
        if pair_start[s + 1] > k:
            for part in range(guide.shape[1]):
                while cumulative[k] <= part << _GUIDE_SHIFT:
                    k += 1
                guide[s, part] = k - pair_start[s]


def pack(policies: Sequence[TabulatedPolicy], game: Game) -> Players:
    """Policies tabulated for one game, packed.

    Raises:
        KernelError: no policy, one of another game, or more than 256 legal strokes in a state.
    """
    if not policies:
        raise KernelError("no policy: expected one or more that are tabulated")
    players = Players(
        np.empty((len(policies), game.n_pairs), np.uint16), np.zeros((len(policies), game.n_states, _GUIDES), np.uint8)
    )
    if np.diff(game.pair_start).max() > 256:
        raise KernelError("a state has more than 256 legal strokes, more than the kernel's tables can count")
    for number, policy in enumerate(policies):
        put(players, number, policy, game)
    return players


def put(players: Players, number: int, policy: TabulatedPolicy, game: Game) -> None:
    """Write a policy in the place of one of them.

    Raises:
        KernelError: a policy of another game or without a table of its states, or no such place.
    """
    if policy.game.hash != game.hash:
        raise KernelError("a policy was tabulated for another game; tabulate it for this one")
    if not 0 <= number < len(players.cumulative):
        raise KernelError(f"policy number {number}: expected 0 to {len(players.cumulative) - 1}")
    cumulative = checked_array("table of a policy", policy.cumulative, np.uint16, (game.n_pairs,))
    if (cumulative[game.last_pairs] != CHOICE_ONE).any():
        raise KernelError("table of a policy: the last legal stroke of each state needs the cumulative probability 65535")
    players.cumulative[number] = cumulative
    _write_guide(players.cumulative[number], game.pair_start, players.guide[number])


BLOCK: Final = 256
"""Rows of a block: few enough that what one pass leaves is in the first cache for the next."""


def check_players(players: Players, game: Game, count: int | None = None) -> None:
    """Refuse packed policies by which a stroke could be chosen that does not exist.

    Args:
        players: as :func:`pack` makes them.
        game: for which they were packed.
        count: how many there must be; None: any number.

    Raises:
        KernelError: another number or another game, or tables that :func:`pack` never makes.
    """
    number = len(players.cumulative) if count is None else count
    cumulative = checked_array("packed policies", players.cumulative, np.uint16, (number, game.n_pairs))
    guide = checked_array("guide of packed policies", players.guide, np.uint8, (number, game.n_states, _GUIDES))
    if cumulative is not players.cumulative or guide is not players.guide:
        raise KernelError("packed policies: expected arrays whose numbers lie one behind the other, as pack() makes them")
    last = np.maximum(np.diff(game.pair_start) - 1, 0).astype(np.uint8)  # pack() takes no game with more than 256
    if (cumulative[:, game.last_pairs] != CHOICE_ONE).any() or (guide > last[:, None]).any():
        raise KernelError("packed policies: tables that choose strokes that do not exist; make them with pack()")


class Block(NamedTuple):
    """Results that the passes leave for each other, ``[BLOCK]`` each.

    Attributes:
        bits: uint64 draw of the stroke.
        limit: int32 place of the thresholds of the pair that is played.
        reply: int32 place of the stroke that is played among the replies.
        arrival: int32 state of who strikes next, contact below.
        limits: uint64 thresholds of the pair.
        outcome: int64 outcome, 0 to 3.
        listed: int64 rows that are to be looked at once more.
    """

    bits: U64
    limit: I32
    reply: I32
    arrival: I32
    limits: U64
    outcome: I64
    listed: I64


@inlined
def new_block() -> Any:
    """Room for a block."""
    return Block(
        np.empty(BLOCK, np.uint64),
        np.empty(BLOCK, np.int32),
        np.empty(BLOCK, np.int32),
        np.empty(BLOCK, np.int32),
        np.empty(BLOCK, np.uint64),
        np.empty(BLOCK, np.int64),
        np.empty(BLOCK, np.int64),
    )


@inlined
def draw_strokes(part: Any, bits: Any) -> None:
    """Write the draw of the stroke that is due in each row of a part."""
    for j in range(part.key.size):
        bits[j] = draw(part.key[j], part.stroke[j])


@inlined
def find_pair(tables: Any, block: Any, j: Any, s: Any, k: Any) -> None:
    """Note that the k-th legal stroke of state s is played."""
    of = block_of(tables, s)
    head = tables.head[np.uint64(s - tables.first[of, 0])]
    block.limit[j] = head[0] + k + tables.first[of, 2]
    reply = np.uint64(head[2] + k)
    block.reply[j] = reply
    block.arrival[j] = arrival_of(tables, of, reply)


@inlined
def read_limits(tables: Any, block: Any, count: Any) -> None:
    """Read the thresholds of the pairs that are played."""
    for j in range(count):
        block.limits[j] = tables.limits[np.uint64(block.limit[j])]


@inlined
def next_state(arrival: Any, outcome: Any) -> Any:
    """State of who strikes next; where the rally is over, the state after its last stroke, contact below."""
    return arrival + max(outcome - 2, 0)


@inlined
def play(part: Any, block: Any) -> None:
    """Decide the stroke of every row of a part, and continue to the next."""
    for j in range(part.state.size):
        outcome = outcome_of(block.limits[j], block.bits[j])
        block.outcome[j] = outcome
        part.state[j] = next_state(block.arrival[j], outcome)
        part.stroke[j] += 1
        part.striker[j] ^= 1


@inlined
def strike(tables: Any, part: Any, rank: Any, block: Any) -> None:
    """Play, in every row of a part, the legal stroke whose rank is given."""
    draw_strokes(part, block.bits)
    for j in range(rank.size):
        find_pair(tables, block, j, part.state[j], rank[j])
    read_limits(tables, block, rank.size)
    play(part, block)


@inlined
def list_where(block: Any, count: Any, over: Any) -> Any:
    """List the rows whose rally is over, or those whose rally continues; returns their number."""
    listed = 0
    for j in range(count):
        block.listed[listed] = j
        listed += (block.outcome[j] < 2) == over
    return listed
