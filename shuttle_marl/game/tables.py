"""The pure rules of a rally, on tables, for a batch at a time. No torch, no environment, no policy.

A rally alternates between two players. The one to hit is the striker, the other the receiver. What decides a stroke is
the striker's **state**:

- their own last stroke, the incoming stroke, and the **contact** they are offered (below or above the net);
- the **duel**: how many net shots in a row end with the incoming stroke, 0 to 3 (3: three or more);
- the **effort** of both players: attacking strokes (smashes, half-smashes) that each has played in this rally, from 0 to
  L - 1 (so many or more).

One 16-bit draw decides each stroke: a fault, a winner, returned from below the net, or returned from above. The striker's
effort multiplies the odds of a fault, and nothing else; the receiver's changes nothing until the roles swap.

How the tables are laid out
---------------------------
``START = n`` stands for "no stroke yet". A pair (own last stroke x, incoming stroke y) that can occur is an **edge**
x -> y; edges between two net shots exist once for each length of the duel; edge 0 is START -> START, the start of a rally.
A **base state** is ``2 * edge + contact``. The replies to stroke y from contact c do not depend on x but for the duel that
they continue, so they stand next to each other in ``reply_edge``: ``reply_count[y, c]`` of them from
``reply_start[y, d, c]`` on, d = 1 where two or more net shots in a row end with y. So the k-th legal stroke of a state is a
number, and so is what follows it. A **base pair** is (base state, k); its row in ``threshold`` is counted in that order.

With S base states and P base pairs, **state** ``block * S + base state`` and **legal pair** ``block * P + base pair`` add the
effort: ``block = own effort * L + opponent's effort``. After a stroke the two change places.
"""

import dataclasses
import functools
import hashlib
import json
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from safetensors.numpy import save

from shuttle_marl.arrays import F64, I16, I32, I64, U16, Bools, Floats, Ints
from shuttle_marl.errors import ShuttleError
from shuttle_marl.files import replace_file
from shuttle_marl.game.stroke import Catalogue, frozen
from shuttle_marl.game.thresholds import ONE, with_fault_odds
from shuttle_marl.tensor_files import parsed, read_tensors

ROOT: Final = 0
"""The state in which every rally starts: the serve, struck from below the net."""
LONGEST_DUEL: Final = 3
"""Longer duels count as this one."""
_MOST_LEVELS: Final = 8
_MOST_ODDS: Final = 1 << 20

Indices = Ints | int

_ALL: Final = slice(None)


class GameError(ShuttleError):
    """Tables that cannot be read or do not form a game."""


def _no_effort() -> I32:
    return np.full(1, ONE, dtype=np.int32)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Game:
    """A compiled game: n strokes, E edges, V replies, L levels of effort; S = 2 E L^2 states, P legal pairs.

    Attributes:
        catalogue: the n strokes.
        edge_own: ``[E]`` int32, the striker's own last stroke, n for none.
        edge_incoming: ``[E]`` int32, the incoming stroke, n for none (the serve).
        edge_duel: ``[E]`` int32, net shots in a row that end with the incoming stroke, 0 to 3; all 0 where duels do not count.
        reply_start: ``[n + 1, 2, 2]`` int32, first reply to a stroke, by duel (1: of two net shots or more) and contact.
        reply_count: ``[n + 1, 2]`` int32, their number by contact.
        reply_edge: ``[V]`` int32, edge that follows each reply.
        threshold: ``[base pairs, 3]`` uint16, cumulative probabilities of fault, + winner, + returned from below at effort 0, in
            units of 1/65536.
        fault_odds: ``[L]`` int32, odds of a fault at each own effort, relative to those at effort 0, in units of 1/65536.
    """

    catalogue: Catalogue
    edge_own: I32
    edge_incoming: I32
    edge_duel: I32
    reply_start: I32
    reply_count: I32
    reply_edge: I32
    threshold: U16
    fault_odds: I32 = dataclasses.field(default_factory=_no_effort)

    def __post_init__(self) -> None:
        for name, array in self._arrays().items():
            if not isinstance(array, np.ndarray) or array.dtype != (np.uint16 if name == "threshold" else np.int32):
                kind = getattr(array, "dtype", type(array).__name__)
                raise GameError(f"table {name} of {kind}: expected uint16 for threshold, int32 for the others")
            object.__setattr__(self, name, frozen(array))
        self._check_layout()

    def __reduce__(self) -> tuple[Any, ...]:
        arrays: dict[str, Any] = self._arrays()
        return functools.partial(Game, catalogue=self.catalogue, **arrays), ()

    def __deepcopy__(self, memo: dict[int, Any]) -> "Game":
        return self  # nothing in it can be changed

    @functools.cached_property
    def n_strokes(self) -> int:
        """Number of strokes in the catalogue."""
        return len(self.catalogue)

    @property
    def levels(self) -> int:
        """Number of levels of effort L; 1 where effort does not count."""
        return len(self.fault_odds)

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
        """Number of states at given efforts; the serve from above (base state 1) has no legal stroke and never occurs."""
        return 2 * len(self.edge_own)

    @property
    def n_states(self) -> int:
        """Number of states S."""
        return self.n_blocks * self.n_base_states

    @property
    def n_base_pairs(self) -> int:
        """Number of legal pairs at given efforts."""
        return len(self.threshold)

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
        return self.edge_own[self.base(state) >> 1]

    def incoming(self, state: Indices) -> I32:
        """The incoming stroke of each state, n for none: the striker serves; any shape."""
        return self.edge_incoming[self.base(state) >> 1]

    def duel(self, state: Indices) -> I32:
        """Net shots in a row that end with the incoming stroke of each state, 3 for three or more; any shape."""
        return self.edge_duel[self.base(state) >> 1]

    @staticmethod
    def contact(state: Indices) -> I32:
        """The contact offered in each state, 0 below and 1 above the net; any shape."""
        return (np.asarray(state) & 1).astype(np.int32)

    def effort(self, state: Indices) -> I32:
        """The striker's effort in each state; any shape."""
        return (np.asarray(state) // (self.n_base_states * self.levels)).astype(np.int32)

    def opponent_effort(self, state: Indices) -> I32:
        """The receiver's effort in each state; any shape."""
        return (np.asarray(state) // self.n_base_states % self.levels).astype(np.int32)

    def observation(self, state: Indices) -> I32:
        """``[..., 6]`` all that a striker observes of a rally.

        Own last stroke, incoming stroke, contact, duel, own effort and the opponent's effort of each state.
        """
        parts = (self.own, self.incoming, self.contact, self.duel, self.effort, self.opponent_effort)
        return np.stack([part(state) for part in parts], axis=-1)

    @property
    def highest_observation(self) -> I32:
        """``[6]`` highest number of each part of an observation."""
        n, effort = self.n_strokes, self.levels - 1
        return np.array([n, n, 1, LONGEST_DUEL, effort, effort], dtype=np.int32)

    def state_of(
        self,
        own: Indices,
        incoming: Indices,
        contact: Indices,
        duel: Indices = 0,
        effort: Indices = 0,
        opponent_effort: Indices = 0,
    ) -> I32:
        """The state of an observation, -1 where the game has none such: the inverse of :meth:`observation`.

        Args:
            own, incoming: catalogue indices, n for no stroke yet; anything else is no stroke.
            contact: 0 or 1.
            duel: 0 to 3.
            effort, opponent_effort: 0 to L - 1. All six broadcast against each other.
        """
        parts = (own, incoming, contact, duel, effort, opponent_effort)
        own, incoming, contact, duel, effort, opponent_effort = np.broadcast_arrays(
            *(np.asarray(part, dtype=np.int64) for part in parts)
        )
        n, levels = self.n_strokes, self.levels
        begun = (own >= 0) & (own <= n) & (incoming >= 0) & (incoming < n) & (duel >= 0) & (duel <= LONGEST_DUEL)
        edge = np.where(begun, self._edge_of[np.where(begun, own, 0), np.where(begun, incoming, 0), np.where(begun, duel, 0)], -1)
        edge = np.where((own == n) & (incoming == n) & (duel == 0), 0, edge)
        found = (edge >= 0) & ((contact == 0) | (contact == 1))
        for level in (effort, opponent_effort):
            found &= (level >= 0) & (level < levels)
        base = 2 * edge + contact
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
        return frozen(np.r_[0, np.cumsum(self.reply_count[self.edge_incoming].ravel())].astype(np.int32))

    @functools.cached_property
    def pair_start(self) -> I32:
        """``[S + 1]`` first legal pair of each state."""
        blocks = np.arange(self.n_blocks, dtype=np.int32)[:, None] * np.int32(self.n_base_pairs)
        return frozen(np.r_[(blocks + self.base_pair_start[:-1]).ravel(), np.int32(self.n_pairs)].astype(np.int32))

    @functools.cached_property
    def playable(self) -> Bools:
        """``[S]`` whether a state has legal strokes: all have but the serve from above, which never occurs."""
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
        """The legal pairs of one state, which lie next to each other."""
        return slice(int(self.pair_start[state]), int(self.pair_start[state + 1]))

    def pairs(self, state: Ints) -> tuple[I64, I64]:
        """All legal pairs of B states, one state after the other.

        Returns:
            ``[M]`` row of ``state`` that each pair belongs to, and ``[M]`` the pair.
        """
        count = self.legal_count(state).astype(np.int64)
        row = np.repeat(np.arange(len(state)), count)
        rank = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
        return row, self.pair_start[state].astype(np.int64)[row] + rank

    def block_pairs(self, block: int) -> slice:
        """The legal pairs of one combination of efforts, which lie next to each other."""
        return slice(block * self.n_base_pairs, (block + 1) * self.n_base_pairs)

    def block_states(self, block: int) -> slice:
        """The states of one combination of efforts, which lie next to each other."""
        return slice(block * self.n_base_states, (block + 1) * self.n_base_states)

    def block_following(self, block: int) -> tuple[int, int]:
        """The block that follows a block after a stroke that is no attack, and after an attack."""
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
    def pair_rank(self) -> I32:
        """``[P]`` position k of each legal pair in its state."""
        return frozen(np.tile(self.base_pair_rank, self.n_blocks))

    @functools.cached_property
    def pair_stroke(self) -> I32:
        """``[P]`` catalogue index of the stroke of each legal pair."""
        return frozen(np.tile(self.base_pair_stroke, self.n_blocks))

    @functools.cached_property
    def first_reply(self) -> I32:
        """``[base states]`` place in ``reply_edge`` of the first legal stroke of a state; the k-th one is k further on."""
        longer = (self.edge_duel >= LONGEST_DUEL - 1).astype(np.int32)
        return frozen(self.reply_start[self.edge_incoming, longer].ravel())

    @functools.cached_property
    def edge_attack(self) -> Bools:
        """``[E]`` whether the incoming stroke of an edge is an attack, which costs the one who played it effort."""
        return frozen(np.append(self.catalogue.is_attack, False)[self.edge_incoming])

    @functools.cached_property
    def first_pairs(self) -> I32:
        """First legal pair of each state that has one, in the order of the states."""
        return frozen(self.pair_start[:-1][self.playable])

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

    def arrivals(self, pairs: slice | Indices = _ALL) -> I32:
        """``[..., 2]`` the receiver's state after a returned stroke, met below and above the net, of legal pairs."""
        block, base = np.divmod(self._numbers(pairs), self.n_base_pairs)
        edge = self.base_pair_edge[base]
        own, other = np.divmod(block, self.levels)
        after = other * self.levels + np.minimum(own + self.edge_attack[edge], self.levels - 1)
        below = after * self.n_base_states + 2 * edge
        return np.stack([below, below + 1], axis=-1).astype(np.int32)

    def _numbers(self, pairs: slice | Indices) -> Ints:
        # Not a part of all numbers: those are tens of megabytes.
        return np.arange(*pairs.indices(self.n_pairs)) if isinstance(pairs, slice) else np.asarray(pairs)

    @functools.cached_property
    def limits(self) -> U16:
        """``[L, base pairs, 3]`` thresholds at each own effort; those at effort 0 are ``threshold``."""
        return frozen(np.stack([with_fault_odds(self.threshold, odds) for odds in self.fault_odds.tolist()]))

    def limits_of(self, pairs: slice | Indices = _ALL) -> U16:
        """``[..., 3]`` thresholds of legal pairs, all by default."""
        return self.limits.reshape(-1, 3)[self.limit_row(pairs)]

    def limit_row(self, pairs: slice | Indices = _ALL) -> Ints:
        """``[...]`` row of legal pairs in tables by own effort and base pair, such as ``limits`` as ``[L * base pairs, 3]``."""
        block, base = np.divmod(self._numbers(pairs), self.n_base_pairs)
        return np.asarray(block // self.levels * self.n_base_pairs + base)

    # Numbers over legal pairs.

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

    def outcome_probabilities(self, pairs: slice | Indices = _ALL) -> F64:
        """``[..., 4]`` probabilities of the :data:`OUTCOMES` of legal pairs, of all by default; exact."""
        return np.asarray(np.diff(self.limits_of(pairs).astype(np.int32), axis=-1, prepend=0, append=ONE) / ONE)

    def stroke_probabilities(self, pairs: slice | Indices = _ALL) -> tuple[F64, F64, F64]:
        """Probability that the stroke is good, that a good one is returned, that a return is from above; of legal pairs."""
        fault, winner, below = np.moveaxis(self.limits_of(pairs).astype(np.float64), -1, 0)
        with np.errstate(invalid="ignore", divide="ignore"):
            good = (ONE - fault) / ONE
            returned = np.where(fault < ONE, (ONE - winner) / (ONE - fault), 0.0)
            above = np.where(winner < ONE, (ONE - below) / (ONE - winner), 0.0)
        return good, returned, above

    def stroke_values(self, following: F64, pairs: slice | Indices = _ALL) -> F64:
        """Q-values: what legal pairs are worth to the striker, +1 for winning the rally and -1 for losing it.

        Args:
            following: ``[S]`` value of the next states to the receiver, who strikes there.
            pairs: which ones; all by default.

        Returns:
            One value for each pair.
        """
        if isinstance(pairs, slice) and pairs == _ALL and self.n_blocks > 1:
            # One block after the other, so that what is needed on the way stays small.
            blocks = [self.stroke_values(following, self.block_pairs(block)) for block in range(self.n_blocks)]
            return np.concatenate(blocks)
        fault, winner, below = np.moveaxis(self.limits_of(pairs).astype(np.float64), -1, 0)
        after = following[self.arrivals(pairs)]
        now = winner - 2 * fault
        return np.asarray((now - (below - winner) * after[..., 0] - (ONE - below) * after[..., 1]) / ONE)

    @functools.cached_property
    def hash(self) -> str:
        """SHA-256 over the names of the strokes and all tables, hexadecimal: the version of the game."""
        digest = hashlib.sha256(self.catalogue.version.encode())
        for name, array in self._arrays().items():
            digest.update(f"{name}{array.dtype.str}{array.shape}".encode())
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

    def describe(self, state: int) -> str:
        """A state in words: own last stroke, incoming stroke, contact, and the duel and the efforts where they count."""
        names = (*self.catalogue.names, "none")
        own, incoming, contact, duel, effort, opponent_effort = self.observation(state).tolist()
        words = f"own {names[own]}, incoming {names[incoming]}, contact {'above' if contact else 'below'}"
        if duel > 1:
            words += f", net shots in a row {duel}{' or more' if duel == LONGEST_DUEL else ''}"
        if self.levels > 1:
            words += f", effort {effort} against {opponent_effort}"
        return words

    def _check_layout(self) -> None:
        """Refuse tables that point outside each other: compiled code reads them without looking.

        Raises:
            GameError: they do.
        """
        n, edges, replies = self.n_strokes, len(self.edge_own), len(self.reply_edge)
        wanted = {
            "edge_own": (edges,), "edge_incoming": (edges,), "edge_duel": (edges,), "reply_start": (n + 1, 2, 2),
            "reply_count": (n + 1, 2), "reply_edge": (replies,), "threshold": (len(self.threshold), 3),
            "fault_odds": (len(self.fault_odds),),
        }  # fmt: skip
        for name, shape in wanted.items():
            if getattr(self, name).shape != shape:
                raise GameError(f"table {name} of shape {getattr(self, name).shape}: expected {shape}")
        if not edges or (self.edge_own[0], self.edge_incoming[0], self.edge_duel[0]) != (n, n, 0):
            raise GameError("edge 0 is not the start of a rally")
        for name, highest in (("edge_own", n), ("edge_incoming", n), ("edge_duel", LONGEST_DUEL), ("reply_edge", edges - 1)):
            if not _within(getattr(self, name), 0, highest):
                raise GameError(f"table {name}: expected numbers from 0 to {highest}")
        if not 1 <= self.levels <= _MOST_LEVELS or self.fault_odds[0] != ONE or not _within(self.fault_odds, 1, _MOST_ODDS):
            raise GameError(f"table fault_odds: expected 1 to {_MOST_LEVELS} odds of 1 to {_MOST_ODDS}, the first of them {ONE}")
        if (self.threshold[:, 1:] < self.threshold[:, :-1]).any():
            raise GameError("table threshold: the cumulative probabilities of a legal pair fall")
        self._check_replies()

    def _check_replies(self) -> None:
        """Refuse replies that do not follow the strokes that they answer.

        Raises:
            GameError: there are some.
        """
        n, replies = self.n_strokes, len(self.reply_edge)
        starts = self.reply_start.astype(np.int64)
        counts = np.broadcast_to(self.reply_count.astype(np.int64)[:, None], starts.shape)
        if not (_within(starts, 0, replies) and _within(counts, 0, n) and _within(starts + counts, 0, replies)):
            raise GameError(f"tables reply_start and reply_count: expected replies from 0 to {replies - 1}")
        legal = self.reply_count[self.edge_incoming].ravel()
        if legal.sum() != len(self.threshold):
            raise GameError("table threshold does not count the legal strokes of the states")
        if (legal[np.arange(len(legal)) != 1] == 0).any():
            raise GameError("a state other than the serve from above has no legal stroke")
        if len(np.unique(np.stack([self.edge_own, self.edge_incoming, self.edge_duel]), axis=1).T) != len(self.edge_own):
            raise GameError("tables edge_own, edge_incoming and edge_duel name an edge twice")
        of, count = np.arange(starts.size), counts.ravel()
        place = np.repeat(of, count)
        edge = self.reply_edge[np.repeat(starts.ravel() - np.r_[0, np.cumsum(count)[:-1]], count) + np.arange(len(place))]
        answered, longer, contact = place >> 2, (place >> 1) & 1, place & 1
        stroke = self.edge_incoming[edge]
        if (
            (self.edge_own[edge] != answered).any()
            or (stroke >= n).any()
            or (self.catalogue.height[stroke] != contact).any()
            or (np.diff(stroke)[np.diff(place) == 0] <= 0).any()
        ):
            raise GameError("tables reply_start and reply_edge do not lead to the replies of a stroke, in their order")
        if self.counts_duels:
            is_net = np.append(self.catalogue.is_net_shot, False)
            duel = np.where(is_net[stroke], np.where(is_net[answered], LONGEST_DUEL - 1 + longer, 1), 0)
            if (self.edge_duel[edge] != duel).any():
                raise GameError("table edge_duel does not count the net shots in a row")
        by_window = self.edge_incoming[self.reply_edge]
        for first, second, size in zip(starts[:, 0].ravel(), starts[:, 1].ravel(), self.reply_count.ravel(), strict=True):
            if first != second and (by_window[first : first + size] != by_window[second : second + size]).any():
                raise GameError("table reply_start: the legal strokes of a state depend on the duel")

    def _arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name != "catalogue"}

    def save(self, path: Path, metadata: dict[str, str] | None = None) -> None:
        """Write the tables as safetensors, beside and moved into place."""
        header = {"strokes": json.dumps(self.catalogue.names), "hash": self.hash, **(metadata or {})}
        replace_file(path, save({k: np.ascontiguousarray(v) for k, v in self._arrays().items()}, metadata=header))

    @classmethod
    def load(cls, path: Path) -> "Game":
        """Read tables written by :meth:`save`.

        Raises:
            GameError: the file is missing or damaged, its hash does not fit, or an index in its tables leads out of them.
        """
        try:
            header, arrays = read_tensors(path)
            names = parsed(header["strokes"])
            if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
                raise ValueError("the strokes are no list of names")
            game = cls(catalogue=Catalogue.from_names(names), **arrays)
        except (OSError, KeyError, TypeError, ValueError, ShuttleError) as error:
            raise GameError(f"{path}: no readable game tables ({error}); fit or install the model again") from error
        if game.hash != header.get("hash"):
            raise GameError(f"{path}: the tables do not fit their hash; the file is damaged, install the model again")
        return game


def _within(array: Ints, low: int, high: int) -> bool:
    return bool(((array >= low) & (array <= high)).all())
