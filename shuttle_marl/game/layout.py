"""Layout of the tables of a game: states, legal pairs and the index arithmetic between them.

How the tables are laid out
---------------------------
``START = n`` stands for "no stroke yet". A pair (own last stroke x, incoming stroke y) that can occur is an **edge**
x -> y; edges between two net shots exist once for each length of the duel; edge 0 is START -> START, the start of a rally.
A **base state** is ``4 * edge + 2 * hurried + contact``. The replies to stroke y from contact c do not depend on x but for the
duel that they continue, so they stand next to each other in ``reply_edge``: ``reply_count[y, c]`` of them from
``reply_start[y, d, c]`` on, d = 1 where two or more net shots in a row end with y. So the k-th legal stroke of a state is a
number, and so is what follows it. A **base pair** is (base state, k); its row in ``threshold`` is counted in that order.

With S base states and P base pairs, **state** ``block * S + base state`` and **legal pair** ``block * P + base pair`` add the
effort: ``block = own effort * L + opponent's effort``. After a stroke the two change places.
"""

import dataclasses
import functools
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.base.arrays import F32, F64, I16, I32, I64, Bools, Floats, Ints
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.stroke import HEIGHTS, N_SHOTS, N_TECHNIQUES, Catalogue, frozen

LONGEST_DUEL: Final = 3  # longer duels count as this one

Indices = Ints | int

ALL: Final = slice(None)


class GameError(ShuttleError):
    """Tables that cannot be read or do not form a game."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Layout:
    """States and legal pairs: n strokes, E edges, V replies, L levels of effort; S = 4 E L^2 states, P legal pairs.

    Attributes:
        catalogue: the n strokes.
        edge_own: ``[E]`` int32, the striker's own last stroke, n for none.
        edge_incoming: ``[E]`` int32, the incoming stroke, n for none (the serve).
        edge_duel: ``[E]`` int32, net shots in a row that end with the incoming stroke, 0 to 3; all 0 where duels do not count.
        reply_start: ``[n + 1, 2, 2]`` int32, first reply to a stroke, by duel (1: of two net shots or more) and contact.
        reply_count: ``[n + 1, 2]`` int32, number of replies by contact.
        reply_edge: ``[V]`` int32, edge that follows each reply.
    """

    catalogue: Catalogue
    edge_own: I32
    edge_incoming: I32
    edge_duel: I32
    reply_start: I32
    reply_count: I32
    reply_edge: I32

    @property
    def levels(self) -> int:
        """Number of levels of effort L; 1 where effort does not count."""
        return 1

    @functools.cached_property
    def n_base_pairs(self) -> int:
        """Number of legal pairs at given efforts."""
        return int(self.base_pair_start[-1])

    @functools.cached_property
    def n_strokes(self) -> int:
        """Number of strokes in the catalogue."""
        return len(self.catalogue)

    @functools.cached_property
    def counts_duels(self) -> bool:
        """Whether states count net shots in a row."""
        return bool(self.edge_duel.any())

    @property
    def n_blocks(self) -> int:
        """Number of combinations of both players' efforts."""
        return self.levels**2

    @property
    def n_base_states(self) -> int:
        """Number of states at given efforts. Serves from above have no legal stroke; they and hurried serves never occur."""
        return 4 * len(self.edge_own)

    @property
    def n_states(self) -> int:
        """Number of states S."""
        return self.n_blocks * self.n_base_states

    @property
    def n_pairs(self) -> int:
        """Number of legal pairs P."""
        return self.n_blocks * self.n_base_pairs

    # Parts of a state.

    def base(self, state: Indices) -> Ints:
        """The base state of each state; any shape."""
        return np.asarray(state) % self.n_base_states

    def own(self, state: Indices) -> I32:
        """The striker's own last stroke in each state, n for none; any shape."""
        return self.edge_own[self.base(state) >> 2]

    def incoming(self, state: Indices) -> I32:
        """The incoming stroke of each state, n for none: the striker serves; any shape."""
        return self.edge_incoming[self.base(state) >> 2]

    def incoming_shot(self, state: Indices) -> I64:
        """Shot type of the incoming stroke of each state, 13 for none; any shape."""
        return np.append(self.catalogue.shot, N_SHOTS).astype(np.int64)[self.incoming(state)]

    def duel(self, state: Indices) -> I32:
        """Net shots in a row that end with the incoming stroke of each state, 3 for three or more; any shape."""
        return self.edge_duel[self.base(state) >> 2]

    @staticmethod
    def contact(state: Indices) -> I32:
        """The contact offered in each state, 0 below and 1 above the net; any shape."""
        return (np.asarray(state) & 1).astype(np.int32)

    @staticmethod
    def hurried(state: Indices) -> I32:
        """Whether the striker is hurried in each state, 0 or 1; any shape."""
        return (np.asarray(state) >> 1 & 1).astype(np.int32)

    def effort(self, state: Indices) -> I32:
        """The striker's effort in each state; any shape."""
        return (np.asarray(state) // (self.n_base_states * self.levels)).astype(np.int32)

    def opponent_effort(self, state: Indices) -> I32:
        """The receiver's effort in each state; any shape."""
        return (np.asarray(state) // self.n_base_states % self.levels).astype(np.int32)

    def observation(self, state: Indices) -> I32:
        """``[..., 7]`` observation of the striker as integers.

        Own last stroke, incoming stroke, contact, duel, own effort, the opponent's effort and hurried of each state.
        """
        parts = (self.own, self.incoming, self.contact, self.duel, self.effort, self.opponent_effort, self.hurried)
        return np.stack([part(state) for part in parts], axis=-1)

    @property
    def highest_observation(self) -> I32:
        """``[7]`` highest number of each part of an observation."""
        n, effort = self.n_strokes, self.levels - 1
        return np.array([n, n, 1, LONGEST_DUEL, effort, effort, 1], dtype=np.int32)

    def state_of(
        self,
        own: Indices,
        incoming: Indices,
        contact: Indices,
        duel: Indices = 0,
        effort: Indices = 0,
        opponent_effort: Indices = 0,
        hurried: Indices = 0,
    ) -> I32:
        """The state of an observation, -1 where the game has none such: the inverse of :meth:`observation`.

        Args:
            own, incoming: catalogue indices, n for no stroke yet; anything else is no stroke.
            contact: 0 or 1.
            duel: 0 to 3.
            effort, opponent_effort: 0 to L - 1.
            hurried: 0 or 1. All seven broadcast against each other.
        """
        parts = (own, incoming, contact, duel, effort, opponent_effort, hurried)
        own, incoming, contact, duel, effort, opponent_effort, hurried = np.broadcast_arrays(
            *(np.asarray(part, dtype=np.int64) for part in parts)
        )
        n, levels = self.n_strokes, self.levels
        begun = (own >= 0) & (own <= n) & (incoming >= 0) & (incoming < n) & (duel >= 0) & (duel <= LONGEST_DUEL)
        edge = np.where(begun, self._edge_of[np.where(begun, own, 0), np.where(begun, incoming, 0), np.where(begun, duel, 0)], -1)
        edge = np.where((own == n) & (incoming == n) & (duel == 0), 0, edge)
        found = (edge >= 0) & ((contact == 0) | (contact == 1)) & ((hurried == 0) | (hurried == 1))
        for level in (effort, opponent_effort):
            found &= (level >= 0) & (level < levels)
        base = 4 * edge + 2 * hurried + contact
        return np.where(found, (effort * levels + opponent_effort) * self.n_base_states + base, -1).astype(np.int32)

    @functools.cached_property
    def _edge_of(self) -> I32:
        """``[n + 1, n + 1, 4]`` edge of own last stroke, incoming stroke and duel, -1 where there is none."""
        table = np.full((self.n_strokes + 1, self.n_strokes + 1, LONGEST_DUEL + 1), -1, dtype=np.int32)
        table[self.edge_own, self.edge_incoming, self.edge_duel] = np.arange(len(self.edge_own))
        return frozen(table)

    # Legal strokes of states.

    @functools.cached_property
    def base_pair_start(self) -> I32:
        """``[base states + 1]`` first base pair of each base state."""
        return frozen(np.r_[0, np.cumsum(np.tile(self.reply_count[self.edge_incoming], (1, 2)).ravel())].astype(np.int32))

    @functools.cached_property
    def pair_start(self) -> I32:
        """``[S + 1]`` first legal pair of each state."""
        blocks = np.arange(self.n_blocks, dtype=np.int32)[:, None] * np.int32(self.n_base_pairs)
        return frozen(np.r_[(blocks + self.base_pair_start[:-1]).ravel(), np.int32(self.n_pairs)].astype(np.int32))

    @functools.cached_property
    def playable(self) -> Bools:
        """``[S]`` whether a state has legal strokes: all have but serves from above, which never occur."""
        return frozen(np.diff(self.pair_start) > 0)

    def legal_count(self, state: Indices) -> I32:
        """Number of legal strokes in each state; any shape."""
        base = self.base(state)
        return self.base_pair_start[base + 1] - self.base_pair_start[base]

    def legal_strokes(self, state: int) -> I32:
        """Catalogue indices of the legal strokes of one state, in the order of its legal pairs."""
        return self.stroke_at(state, np.arange(int(self.legal_count(state))))

    def mask(self, state: Indices) -> Bools:
        """``[..., n]`` which strokes are legal in each state."""
        return self.reply_mask[self.incoming(state), self.contact(state)]

    def rank(self, state: Indices, stroke: Indices) -> I32:
        """Position k of a stroke among the legal ones of its state, -1 where it is not legal; any shape."""
        return self.reply_rank[self.incoming(state), self.contact(state), stroke].astype(np.int32)

    def pair(self, state: Indices, stroke: Indices) -> I32:
        """Legal pair of a state and a stroke, -1 where the stroke is not legal; any shape."""
        rank = self.rank(state, stroke)
        return np.where(rank < 0, -1, self.pair_at(state, rank)).astype(np.int32)

    def pair_at(self, state: Indices, rank: Indices) -> I32:
        """Legal pair of a state and a position among its legal strokes, which is not checked; any shape."""
        return np.asarray(self.pair_start[state] + rank)

    def stroke_at(self, state: Indices, rank: Indices) -> I32:
        """Catalogue index of the stroke at a position among the legal ones of a state, which is not checked; any shape."""
        return self.edge_incoming[self.reply_edge[self.first_reply[self.base(state)] + rank]]

    def pairs_of(self, state: int) -> slice:
        """Legal pairs of one state, which are consecutive."""
        return slice(int(self.pair_start[state]), int(self.pair_start[state + 1]))

    def pairs(self, state: Ints) -> tuple[I64, I64]:
        """``[M]`` row of ``state`` of each pair, and ``[M]`` all legal pairs of B states, one state after the other."""
        count = self.legal_count(state).astype(np.int64)
        row = np.repeat(np.arange(len(state)), count)
        rank = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
        return row, self.pair_start[state].astype(np.int64)[row] + rank

    def block_pairs(self, block: int) -> slice:
        """Legal pairs of one combination of efforts, which are consecutive."""
        return slice(block * self.n_base_pairs, (block + 1) * self.n_base_pairs)

    def block_states(self, block: int) -> slice:
        """States of one combination of efforts, which are consecutive."""
        return slice(block * self.n_base_states, (block + 1) * self.n_base_states)

    def block_following(self, block: int) -> tuple[int, int]:
        """Next block after a stroke that is no attack, and after an attack."""
        own, other = divmod(block, self.levels)
        return other * self.levels + own, other * self.levels + min(own + 1, self.levels - 1)

    # Tables over base pairs, which hold in every block, and over all legal pairs.

    @functools.cached_property
    def base_pair_state(self) -> I32:
        """``[base pairs]`` base state of each base pair."""
        return frozen(np.repeat(np.arange(self.n_base_states, dtype=np.int32), np.diff(self.base_pair_start)))

    @functools.cached_property
    def base_pair_rank(self) -> I32:
        """``[base pairs]`` position k of each base pair in its state."""
        return frozen(np.arange(self.n_base_pairs, dtype=np.int32) - self.base_pair_start[self.base_pair_state])

    @functools.cached_property
    def base_pair_edge(self) -> I32:
        """``[base pairs]`` edge that follows each base pair if the stroke is returned."""
        return frozen(self.reply_edge[self.first_reply[self.base_pair_state] + self.base_pair_rank])

    @functools.cached_property
    def base_pair_stroke(self) -> I32:
        """``[base pairs]`` catalogue index of the stroke of each base pair."""
        return frozen(self.edge_incoming[self.base_pair_edge])

    @functools.cached_property
    def pair_state(self) -> I32:
        """``[P]`` state of each legal pair."""
        return frozen(np.repeat(np.arange(self.n_states, dtype=np.int32), np.diff(self.pair_start)))

    @functools.cached_property
    def pair_stroke(self) -> I32:
        """``[P]`` catalogue index of the stroke of each legal pair."""
        return frozen(np.tile(self.base_pair_stroke, self.n_blocks))

    @functools.cached_property
    def first_reply(self) -> I32:
        """``[base states]`` index in ``reply_edge`` of the first legal stroke of a state; k more for the k-th."""
        longer = (self.edge_duel >= LONGEST_DUEL - 1).astype(np.int32)
        return frozen(np.tile(self.reply_start[self.edge_incoming, longer], (1, 2)).ravel())

    @functools.cached_property
    def edge_attack(self) -> Bools:
        """``[E]`` whether the incoming stroke of an edge is an attack, which costs its striker effort."""
        return frozen(np.append(self.catalogue.is_attack, False)[self.edge_incoming])

    @functools.cached_property
    def last_pairs(self) -> I32:
        """Last legal pair of each state that has one, in the order of the states."""
        return frozen(self.pair_start[1:][self.playable] - 1)

    @functools.cached_property
    def reply_mask(self) -> Bools:
        """``[n + 1, 2, n]`` whether a stroke is legal against an incoming stroke (n: at the start) from a contact."""
        return frozen(self.reply_rank >= 0)

    @functools.cached_property
    def reply_rank(self) -> I16:
        """``[n + 1, 2, n]`` position of a stroke among the legal ones, -1 where it is not legal."""
        rank = np.full((self.n_strokes + 1, 2, self.n_strokes), -1, dtype=np.int16)
        s = self.base_pair_state
        rank[self.incoming(s), self.contact(s), self.base_pair_stroke] = self.base_pair_rank
        return frozen(rank)

    def arrivals(self, pairs: slice | Indices = ALL) -> I32:
        """``[..., 4]`` receiver's state after a returned stroke, of legal pairs.

        With contact below and above the net for a receiver who is not hurried, then for one who is.
        """
        block, base = np.divmod(self._numbers(pairs), self.n_base_pairs)
        edge = self.base_pair_edge[base]
        own, other = np.divmod(block, self.levels)
        after = other * self.levels + np.minimum(own + self.edge_attack[edge], self.levels - 1)
        first = after * self.n_base_states + 4 * edge
        return (first[..., None] + np.arange(4)).astype(np.int32)

    def _numbers(self, pairs: slice | Indices) -> Ints:
        # Without an array of all pairs, which takes tens of megabytes.
        return np.arange(*pairs.indices(self.n_pairs)) if isinstance(pairs, slice) else np.asarray(pairs)

    # Values over legal pairs.

    def sum_by_state(self, values: Floats) -> F64:
        """``[S]`` sum of the ``[P]`` values of the legal pairs of each state."""
        total = np.empty(self.n_states)
        for block in range(self.n_blocks):
            part = values[self.block_pairs(block)]
            total[self.block_states(block)] = np.bincount(self.base_pair_state, part, self.n_base_states)
        return total

    def normalized(self, weights: Floats) -> F64:
        """``[P]`` weights divided by their sum in each state: the probabilities of the legal strokes."""
        return np.asarray(weights / self.of_pairs(self.sum_by_state(weights)))

    def of_pairs(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """``[P]`` for each legal pair the value of its state, from ``[S]`` values."""
        return np.repeat(values, np.diff(self.pair_start))

    def counterparts(self, other: "Layout") -> I64:
        """``[base pairs]`` base pair of a game of equal hands in which the shuttle flies as in each pair of this one.

        Between different hands own strokes go to the other side, the last one and this one. Where ``other`` has no such last
        stroke, it is another one; -1 where it has no such incoming stroke.
        """
        state, side = self.base_pair_state, np.append(self.catalogue.other_side, self.n_strokes)
        incoming, contact, hurried = self.incoming(state), self.contact(state), self.hurried(state)
        found = other.state_of(side[self.own(state)], incoming, contact, self.duel(state), 0, 0, hurried).astype(np.int64)
        first = np.full(self.n_strokes + 1, -1, dtype=np.int64)
        first[other.edge_incoming[::-1]] = np.arange(len(other.edge_incoming))[::-1]
        edge = first[incoming]
        found = np.where((found < 0) & (edge >= 0), 4 * edge + 2 * hurried + contact, found)
        rank = other.rank(np.maximum(found, 0), side[self.base_pair_stroke])
        return np.where((found < 0) | (rank < 0), -1, other.base_pair_start[np.maximum(found, 0)] + rank)

    def describe(self, state: int) -> str:
        """State in words: own last stroke, incoming stroke, contact, and hurried, the duel and the efforts where they count."""
        names = (*self.catalogue.names, "none")
        own, incoming, contact, duel, effort, opponent_effort, hurried = self.observation(state).tolist()
        words = f"own {names[own]}, incoming {names[incoming]}, contact {'above' if contact else 'below'}"
        if hurried:
            words += ", hurried"
        if duel > 1:
            words += f", net shots in a row {duel}{' or more' if duel == LONGEST_DUEL else ''}"
        if self.levels > 1:
            words += f", effort {effort} against {opponent_effort}"
        return words


def layout(catalogue: Catalogue, replies: Bools, *, duels: bool = False) -> dict[str, Any]:
    """The index tables of a game from who may answer what.

    Args:
        replies: ``[n + 1, n]`` whether stroke z may answer stroke y (row n: at the start of a rally). The contact height
            of z is the contact from which it is legal.
        duels: whether the state counts net shots in a row.

    Returns:
        ``edge_own``, ``edge_incoming``, ``edge_duel``, ``reply_start``, ``reply_count``, ``reply_edge`` of
        :class:`~shuttle_marl.game.tables.Game`. Only strokes that can be reached from the serve get edges.

    Raises:
        GameError: a reachable stroke has no legal reply from one of the contacts, or another stroke than a serve starts a rally.
    """
    n = len(catalogue)
    if replies[n, ~catalogue.is_serve].any() or replies[:n, catalogue.is_serve].any():
        raise GameError("only serves must be legal at the start, and only there")
    is_net = np.append(catalogue.is_net_shot & duels, False)
    edges: dict[tuple[int, int, int], int] = {(n, n, 0): 0}
    reply_edge: list[int] = []
    reply_start = np.zeros((n + 1, 2, 2), dtype=np.int32)
    reply_count = np.zeros((n + 1, 2), dtype=np.int32)
    for y in [n, *np.flatnonzero(_reachable(replies)[:n]).tolist()]:
        for contact in (0, 1):
            strokes = np.flatnonzero(replies[y] & (catalogue.height == contact)).tolist()
            if not strokes and (y != n or contact == 0):
                raise GameError(f"no legal reply to {(*catalogue.names, 'the start of a rally')[y]} from contact {contact}")
            reply_count[y, contact] = len(strokes)
            for longer in (0, 1):
                # The replies to a net shot are listed twice: those that make a duel of two strokes, and of three or more.
                if longer and not is_net[y]:
                    reply_start[y, 1, contact] = reply_start[y, 0, contact]
                    continue
                reply_start[y, longer, contact] = len(reply_edge)
                for z in strokes:
                    duel = (LONGEST_DUEL - 1 + longer if is_net[y] else 1) if is_net[z] else 0
                    reply_edge.append(edges.setdefault((y, z, duel), len(edges)))
    own, incoming, duel_of = np.ascontiguousarray(np.array(list(edges), dtype=np.int32).T)
    return {
        "edge_own": own,
        "edge_incoming": incoming,
        "edge_duel": duel_of,
        "reply_start": reply_start,
        "reply_count": reply_count,
        "reply_edge": np.array(reply_edge, dtype=np.int32),
    }


def _reachable(replies: Bools) -> Bools:
    """``[n + 1]`` strokes that can be played in a rally, and its start."""
    start = len(replies) - 1
    reachable = np.zeros(len(replies), dtype=bool)
    frontier = [start]
    while frontier:
        y = frontier.pop()
        if not reachable[y]:
            reachable[y] = True
            frontier.extend(np.flatnonzero(replies[y]).tolist())
    return reachable


def base_pairs(tables: dict[str, I32]) -> int:
    """Number of base pairs of the index tables of :func:`layout`: the rows that its thresholds need."""
    return 2 * int(tables["reply_count"][tables["edge_incoming"]].sum())


PARTS: Final = (N_SHOTS, N_AREAS, len(HEIGHTS), N_TECHNIQUES)
"""Number of shot types, areas, heights and techniques: the four components of a stroke."""
STROKE_WIDTH: Final = sum(PARTS)  # numbers that describe one stroke: the one-hots of its four components; all zero for "none yet"
CONTACT: Final = 2 * STROKE_WIDTH  # position of the contact offered to the striker (1: above the net)
SERVE: Final = CONTACT + 1  # position of the flag that a serve is due
DUEL: Final = SERVE + 1  # position of the number of net shots in a row, divided by 3
EFFORT: Final = DUEL + 1  # position of the own effort, divided by the highest one; the opponent's follows
HURRIED: Final = EFFORT + 2  # position of the flag that the striker is hurried
RALLY_WIDTH: Final = HURRIED + 1  # length of an observation of a rally
SCORE_WIDTH: Final = 6  # points, games and serving flag of both players; only in a match

SWAP: Final = np.r_[STROKE_WIDTH : 2 * STROKE_WIDTH, :STROKE_WIDTH, CONTACT, SERVE, DUEL, EFFORT + 1, EFFORT, HURRIED]
"""Permutation that turns the striker's observation into the receiver's."""

SWAP_TOKENS: Final = np.array([1, 0, 2, 3, 5, 4, 6])  # the same of the numbers of `Layout.observation`


def stroke_features(game: Layout) -> F32:
    """``[n + 1, 27]`` one-hots of shot type, area, height and technique; the last row ("none yet") is zero."""
    catalogue = game.catalogue
    table = np.zeros((len(catalogue) + 1, STROKE_WIDTH), dtype=np.float32)
    rows = np.arange(len(catalogue))
    columns = (catalogue.shot, catalogue.area, catalogue.height, catalogue.technique)
    for offset, column in zip(np.r_[0, np.cumsum(PARTS)[:-1]], columns, strict=True):
        table[rows, offset + column] = 1
    return table


def features(game: Layout) -> F32:
    """``[base states, 60]`` observation of the striker in every state without efforts; :func:`with_efforts` writes those.

    0-26 own last stroke, 27-53 the incoming stroke, 54 the contact offered (1 above, 0 below the net), 55 whether a serve
    is due, 56 net shots in a row, 57 own effort and 58 the opponent's, these three as shares of the highest number, 59 whether
    the striker is hurried.
    """
    strokes = stroke_features(game)
    own, incoming, contact, duel, effort, other, hurried = game.observation(np.arange(game.n_base_states)).T
    rest = np.stack([contact, incoming == game.n_strokes, duel / LONGEST_DUEL, effort, other, hurried], axis=1)
    return np.concatenate([strokes[own], strokes[incoming], rest], axis=1, dtype=np.float32)


def with_efforts(game: Layout, rows: F32, state: Ints, receives: Bools | None = None) -> F32:
    """``[B, 60]`` observations of ``[B]`` states, from the rows of :func:`features`.

    Args:
        receives: ``[B]`` whether the receiver looks, whose rows follow all those of the striker; None: the striker always does.
    """
    base, own, other = game.base(state), game.effort(state), game.opponent_effort(state)
    if receives is not None:
        base, own, other = base + game.n_base_states * receives, np.where(receives, other, own), np.where(receives, own, other)
    found: F32 = rows.take(base, axis=0)
    highest = max(1, game.levels - 1)
    found[:, EFFORT], found[:, EFFORT + 1] = own / highest, other / highest
    return found


def observations(game: Layout, state: npt.ArrayLike) -> F32:
    """``[B, 60]`` what the striker sees in each of ``[B]`` states, as ``rally_v0`` shows it."""
    return with_efforts(game, features(game), np.asarray(state))


def states_of(game: Layout, observation: npt.ArrayLike) -> I32:
    """``[B]`` states of ``[B, 60]`` observations of the player who is to strike: the inverse of :func:`observations`.

    Args:
        observation: of ``rally_v0``, or longer ones of ``match_v0``, whose scores are ignored.

    Raises:
        GameError: an observation is of no state of the game.
    """
    seen = np.asarray(observation, dtype=np.float64)
    if seen.ndim != 2 or seen.shape[1] < RALLY_WIDTH:
        raise GameError(f"observations of shape {seen.shape}: expected [B, {RALLY_WIDTH}] or wider")
    if not np.isfinite(seen).all():
        raise GameError("observations contain numbers that are not finite")
    table = stroke_features(game)  # the last row is "no stroke yet"
    parts = (seen[:, :STROKE_WIDTH], seen[:, STROKE_WIDTH : 2 * STROKE_WIDTH])
    own, incoming = (((part[:, None] - table) ** 2).sum(axis=-1).argmin(axis=1) for part in parts)
    efforts = np.rint(seen[:, [EFFORT, EFFORT + 1]] * max(1, game.levels - 1)).astype(np.int64)
    duel = np.rint(seen[:, DUEL] * LONGEST_DUEL).astype(np.int64)
    contact, hurried = np.rint(seen[:, [CONTACT, HURRIED]]).astype(np.int64).T
    effort, opponent_effort = efforts.T
    state = game.state_of(own, incoming, contact, duel, effort, opponent_effort, hurried)
    wrong = state < 0
    wrong[~wrong] = np.abs(observations(game, state[~wrong]) - seen[~wrong, :RALLY_WIDTH]).max(axis=1, initial=0) > 1e-3
    if wrong.any():
        raise GameError(f"observation {int(wrong.argmax())} is of no state of the game with this player to strike")
    return state
