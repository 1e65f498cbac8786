"""The pure rules of a rally, on tables, for a batch at a time. No torch, no environment, no policy.

A rally alternates between two players. The one to hit is the striker, the other the receiver. What decides a stroke is
the striker's **state**: their own last stroke, the incoming stroke, and the **contact** they are offered (below or above
the net). One 16-bit draw decides each stroke: a fault, a winner, returned from below the net, or returned from above.

How the tables are laid out
---------------------------
``START = n`` stands for "no stroke yet". A pair (own last stroke x, incoming stroke y) that can occur is an **edge**
x → y; edge 0 is START → START, the start of a rally. State ``s = 2 * edge + contact``. The replies to stroke y from
contact c do not depend on x, and their edges y → z lie next to each other: ``reply_start[y, c]`` up to
``reply_start[y, c] + reply_count[y, c]``. So the k-th legal stroke of a state is a number, and so is what follows it.
A **legal pair** is (state, k); its row in ``threshold`` is ``pair_start[state] + k``.
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

from shuttle_marl.errors import ActionError, ShuttleError
from shuttle_marl.files import replace_file
from shuttle_marl.game.stroke import Catalogue, frozen
from shuttle_marl.tensor_files import parsed, read_tensors

OUTCOMES: Final = ("fault", "winner", "returned from below", "returned from above")
FAULT, WINNER, RETURNED_BELOW, RETURNED_ABOVE = range(4)
ONE: Final = 1 << 16
"""Probability 1 in the fixed point of the tables."""
ROOT: Final = 0
"""The state in which every rally starts: the serve, struck from below the net."""

Ints = npt.NDArray[np.int32]
UInts = npt.NDArray[np.uint16]
Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.integer] | int

_ALL: Final = slice(None)


class GameError(ShuttleError):
    """Tables that cannot be read or do not form a game."""


class IllegalStrokeError(ActionError):
    """A stroke of the catalogue that is not legal in the state, or in the kernel a stroke in a rally that is over.

    Attributes:
        stroke: its catalogue index.
        row: row of a batch; None outside of batches.
    """

    def __init__(self, message: str, stroke: int, row: int | None = None) -> None:
        super().__init__(message)
        self.stroke, self.row = stroke, row


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Game:
    """A compiled game: n strokes, E edges, S = 2 E states, P legal pairs.

    Attributes:
        catalogue: the n strokes.
        edge_own: ``[E]`` int32, the striker's own last stroke, n for none.
        edge_incoming: ``[E]`` int32, the incoming stroke, n for none (the serve).
        reply_start: ``[n + 1, 2]`` int32, first edge of the replies to a stroke, by contact.
        reply_count: ``[n + 1, 2]`` int32, their number.
        pair_start: ``[S + 1]`` int32, first legal pair of a state.
        threshold: ``[P, 3]`` uint16, cumulative probabilities of fault, + winner, + returned from below, in units of 1/65536.
    """

    catalogue: Catalogue
    edge_own: Ints
    edge_incoming: Ints
    reply_start: Ints
    reply_count: Ints
    pair_start: Ints
    threshold: UInts

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

    @functools.cached_property
    def n_strokes(self) -> int:
        """Number of strokes in the catalogue."""
        return len(self.catalogue)

    @property
    def n_states(self) -> int:
        """Number of states S; the second contact of edge 0 (a serve from above) has no legal stroke and never occurs."""
        return 2 * len(self.edge_own)

    @property
    def n_pairs(self) -> int:
        """Number of legal pairs P."""
        return len(self.threshold)

    # Parts of a state.

    def own(self, state: Indices) -> Ints:
        """The striker's own last stroke in each state, n for none; any shape."""
        return self.edge_own[np.asarray(state) >> 1]

    def incoming(self, state: Indices) -> Ints:
        """The incoming stroke of each state, n for none: the striker serves; any shape."""
        return self.edge_incoming[np.asarray(state) >> 1]

    @staticmethod
    def contact(state: Indices) -> Ints:
        """The contact offered in each state, 0 below and 1 above the net; any shape."""
        return (np.asarray(state) & 1).astype(np.int32)

    def observation(self, state: Indices) -> Ints:
        """``[..., 3]`` own last stroke, incoming stroke and contact of each state: all that a striker observes of a rally."""
        return np.stack([self.own(state), self.incoming(state), self.contact(state)], axis=-1)

    def state_of(self, own: Indices, incoming: Indices, contact: Indices) -> Ints:
        """The state of an observation, -1 where the game has none such: the inverse of :meth:`observation`.

        Args:
            own, incoming: catalogue indices, n for no stroke yet; anything else is no stroke.
            contact: 0 or 1. All three broadcast against each other.
        """
        n = self.n_strokes
        own, incoming, contact = np.broadcast_arrays(*(np.asarray(part, dtype=np.int64) for part in (own, incoming, contact)))
        begun = (own >= 0) & (own <= n) & (incoming >= 0) & (incoming < n)
        before, struck = np.where(begun, own, 0), np.where(begun, incoming, 0)
        height = self.catalogue.height[struck]
        rank = self.reply_rank[before, height, struck]
        edge = np.where(begun & (rank >= 0), self.reply_start[before, height] + rank, -1)
        edge = np.where((own == n) & (incoming == n), 0, edge)
        return np.where((edge >= 0) & ((contact == 0) | (contact == 1)), 2 * edge + contact, -1).astype(np.int32)

    # Legal strokes of states.

    @functools.cached_property
    def playable(self) -> npt.NDArray[np.bool_]:
        """``[S]`` whether a state has legal strokes: all have but the serve from above, which never occurs."""
        return frozen(np.diff(self.pair_start) > 0)

    def legal_count(self, state: Indices) -> Ints:
        """Number of legal strokes in each state; any shape."""
        state = np.asarray(state)
        return self.pair_start[state + 1] - self.pair_start[state]

    def legal_strokes(self, state: int) -> Ints:
        """Catalogue indices of the legal strokes of one state, in the order of its legal pairs."""
        return self.pair_stroke[self.pairs_of(state)]

    def mask(self, state: Indices) -> npt.NDArray[np.bool_]:
        """``[..., n]`` which strokes are legal in each state."""
        return self.reply_mask[self.incoming(state), self.contact(state)]

    def rank(self, state: Indices, stroke: Indices) -> Ints:
        """Position k of a stroke among the legal ones of its state, -1 where it is not legal; any shape."""
        return self.reply_rank[self.incoming(state), self.contact(state), stroke].astype(np.int32)

    def pair(self, state: Indices, stroke: Indices) -> Ints:
        """Legal pair of a state and a stroke, -1 where the stroke is not legal; any shape."""
        rank = self.rank(state, stroke)
        return np.where(rank < 0, -1, self.pair_at(state, rank)).astype(np.int32)

    def pair_at(self, state: Indices, rank: Indices) -> Ints:
        """Legal pair of a state and a position among its legal strokes, which is not checked; any shape."""
        return np.asarray(self.pair_start[state] + rank)

    def stroke_at(self, state: Indices, rank: Indices) -> Ints:
        """Catalogue index of the stroke at a position among the legal ones of a state, which is not checked; any shape."""
        return self.edge_incoming[self.first_reply[state] + rank]

    def pairs_of(self, state: int) -> slice:
        """The legal pairs of one state, which lie next to each other."""
        return slice(int(self.pair_start[state]), int(self.pair_start[state + 1]))

    def pairs(self, state: npt.NDArray[np.integer]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """All legal pairs of B states, one state after the other.

        Returns:
            ``[M]`` row of ``state`` that each pair belongs to, and ``[M]`` the pair.
        """
        count = self.legal_count(state).astype(np.int64)
        row = np.repeat(np.arange(len(state)), count)
        rank = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
        return row, self.pair_start[state].astype(np.int64)[row] + rank

    # Tables over legal pairs.

    @functools.cached_property
    def pair_state(self) -> Ints:
        """``[P]`` state of each legal pair."""
        return frozen(np.repeat(np.arange(self.n_states, dtype=np.int32), np.diff(self.pair_start)))

    @functools.cached_property
    def pair_rank(self) -> Ints:
        """``[P]`` position k of each legal pair in its state."""
        return frozen(np.arange(self.n_pairs, dtype=np.int32) - self.pair_start[self.pair_state])

    @functools.cached_property
    def pair_edge(self) -> Ints:
        """``[P]`` edge that follows each legal pair if the stroke is returned; the next state is ``2 * edge + contact``."""
        return frozen(self.first_reply[self.pair_state] + self.pair_rank)

    @functools.cached_property
    def pair_stroke(self) -> Ints:
        """``[P]`` catalogue index of the stroke of each legal pair."""
        return frozen(self.edge_incoming[self.pair_edge])

    @functools.cached_property
    def first_reply(self) -> Ints:
        """``[S]`` edge that follows the first legal stroke of a state; that of its k-th one is k further on."""
        s = np.arange(self.n_states)
        return frozen(self.reply_start[self.incoming(s), self.contact(s)])

    @functools.cached_property
    def first_pairs(self) -> Ints:
        """First legal pair of each state that has one, in the order of the states."""
        return frozen(self.pair_start[:-1][self.playable])

    @functools.cached_property
    def last_pairs(self) -> Ints:
        """Last legal pair of each state that has one, in the order of the states."""
        return frozen(self.pair_start[1:][self.playable] - 1)

    @functools.cached_property
    def reply_mask(self) -> npt.NDArray[np.bool_]:
        """``[n + 1, 2, n]`` whether a stroke is legal against an incoming stroke (n: at the start) from a contact."""
        return frozen(self.reply_rank >= 0)

    @functools.cached_property
    def reply_rank(self) -> npt.NDArray[np.int16]:
        """``[n + 1, 2, n]`` position of a stroke among the legal ones, -1 where it is not legal."""
        rank = np.full((self.n_strokes + 1, 2, self.n_strokes), -1, dtype=np.int16)
        s = self.pair_state
        rank[self.incoming(s), self.contact(s), self.pair_stroke] = self.pair_rank
        return frozen(rank)

    # Numbers over legal pairs.

    def sum_by_state(self, values: npt.NDArray[np.floating]) -> Floats:
        """``[S]`` sum of the ``[P]`` values of the legal pairs of each state."""
        return np.bincount(self.pair_state, values, self.n_states).astype(np.float64, copy=False)

    def normalized(self, weights: npt.NDArray[np.floating]) -> Floats:
        """``[P]`` weights divided by their sum in each state: the probabilities of the legal strokes."""
        return np.asarray(weights / self.sum_by_state(weights)[self.pair_state])

    def outcome_probabilities(self, pairs: slice | npt.NDArray[np.integer] = _ALL) -> Floats:
        """``[..., 4]`` probabilities of the :data:`OUTCOMES` of legal pairs, of all by default; exact."""
        return np.asarray(np.diff(self.threshold[pairs].astype(np.int32), axis=-1, prepend=0, append=ONE) / ONE)

    def stroke_probabilities(self) -> tuple[Floats, Floats, Floats]:
        """``[P]`` each: probability that the stroke is good, that a good one is returned, that a return is from above."""
        fault, winner, below = (self.threshold[:, i].astype(np.float64) for i in range(3))
        with np.errstate(invalid="ignore", divide="ignore"):
            good = (ONE - fault) / ONE
            returned = np.where(fault < ONE, (ONE - winner) / (ONE - fault), 0.0)
            above = np.where(winner < ONE, (ONE - below) / (ONE - winner), 0.0)
        return good, returned, above

    def stroke_values(self, following: Floats, pairs: slice | npt.NDArray[np.integer] = _ALL) -> Floats:
        """Q-values: what legal pairs are worth to the striker, +1 for winning the rally and -1 for losing it.

        Args:
            following: ``[S]`` value of the next states to the receiver, who strikes there.
            pairs: which ones; all by default.

        Returns:
            One value for each pair.
        """
        fault, winner, below = self.threshold[pairs].astype(np.float64).T
        after = 2 * self.pair_edge[pairs]
        now = winner - 2 * fault
        return np.asarray((now - (below - winner) * following[after] - (ONE - below) * following[after + 1]) / ONE)

    @functools.cached_property
    def hash(self) -> str:
        """SHA-256 over the names of the strokes and all tables, hexadecimal: the version of the game."""
        digest = hashlib.sha256(self.catalogue.version.encode())
        for name, array in self._arrays().items():
            digest.update(f"{name}{array.dtype.str}{array.shape}".encode())
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

    def describe(self, state: int) -> str:
        """A state in words: own last stroke, incoming stroke, contact."""
        names = (*self.catalogue.names, "none")
        own, incoming = names[int(self.own(state))], names[int(self.incoming(state))]
        return f"own {own}, incoming {incoming}, contact {'above' if state & 1 else 'below'}"

    def _check_layout(self) -> None:
        """Refuse tables that point outside each other: compiled code reads them without looking.

        Raises:
            GameError: they do.
        """
        n, edges, pairs = self.n_strokes, len(self.edge_own), len(self.threshold)
        wanted = {
            "edge_own": (edges,), "edge_incoming": (edges,), "reply_start": (n + 1, 2), "reply_count": (n + 1, 2),
            "pair_start": (2 * edges + 1,), "threshold": (pairs, 3),
        }  # fmt: skip
        for name, shape in wanted.items():
            if getattr(self, name).shape != shape:
                raise GameError(f"table {name} of shape {getattr(self, name).shape}: expected {shape}")
        if not edges or (self.edge_own[0], self.edge_incoming[0]) != (n, n):
            raise GameError("edge 0 is not the start of a rally")
        for name in ("edge_own", "edge_incoming"):
            if not _within(getattr(self, name), 0, n):
                raise GameError(f"table {name}: expected strokes from 0 to {n}")
        starts, counts = self.reply_start.astype(np.int64), self.reply_count.astype(np.int64)
        if not (_within(starts, 0, edges) and _within(counts, 0, n) and _within(starts + counts, 0, edges)):
            raise GameError(f"tables reply_start and reply_count: expected edges from 0 to {edges - 1}")
        ends = np.cumsum(counts[self.edge_incoming].ravel())
        if self.pair_start[0] != 0 or (self.pair_start[1:] != ends).any() or ends[-1] != pairs:
            raise GameError("tables pair_start and threshold do not count the legal strokes of the states")
        if (np.diff(ends, prepend=0)[np.arange(len(ends)) != 1] == 0).any():
            raise GameError("a state other than the serve from above has no legal stroke")
        if (self.threshold[:, 1:] < self.threshold[:, :-1]).any():
            raise GameError("table threshold: the cumulative probabilities of a legal pair fall")
        stroke, contact = np.divmod(np.repeat(np.arange(2 * n + 2), counts.ravel()), 2)
        first = np.repeat(starts.ravel() - np.r_[0, np.cumsum(counts)[:-1]], counts.ravel())
        reply = first + np.arange(len(first))
        if (
            (self.edge_own[reply] != stroke).any()
            or not _within(self.edge_incoming[reply], 0, n - 1)
            or (self.catalogue.height[self.edge_incoming[reply]] != contact).any()
        ):
            raise GameError("table reply_start does not lead to the replies of a stroke")

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


def _within(array: npt.NDArray[np.integer], low: int, high: int) -> bool:
    return bool(((array >= low) & (array <= high)).all())


def strike(
    game: Game, state: npt.NDArray[np.integer], k: npt.NDArray[np.integer], draw: npt.NDArray[np.integer]
) -> tuple[npt.NDArray[np.int8], Ints]:
    """Play the k-th legal stroke of each state.

    Args:
        game: the tables.
        state: ``[B]`` state of the striker.
        k: ``[B]`` which of its legal strokes, 0 <= k < legal_count(state); not checked.
        draw: ``[B]`` uniform integers in [0, 65536).

    Returns:
        ``[B]`` outcome (index into :data:`OUTCOMES`) and ``[B]`` state of the receiver, who is the next striker;
        -1 where the rally is over.
    """
    # Rows by `take` and three comparisons: an index array and a sum over an axis of length three cost several times as much.
    limits = game.threshold.take(game.pair_start[state] + k, axis=0)
    outcome = (draw >= limits[..., 0]).view(np.int8) + (draw >= limits[..., 1]) + (draw >= limits[..., 2])
    edge = game.first_reply[state] + k
    following = np.where(outcome >= RETURNED_BELOW, 2 * edge + outcome - RETURNED_BELOW, -1)
    return outcome, following.astype(np.int32)
