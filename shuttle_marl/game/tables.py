"""Tables of a game: the probabilities of outcomes over the layout of its states (:mod:`shuttle_marl.game.layout`).

What decides a stroke is the striker's state (:class:`shuttle_marl.game.rules.State`). *Hurried* is late or stretched, like the
worst quarter of strokes from such an incoming shot and contact. The striker's effort multiplies the odds of a fault alone.
"""

import dataclasses
import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.base.arrays import F64, I32, U8, U16, Bools, Ints
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import content_hash, parsed, replace_file
from shuttle_marl.base.tensor_files import checked, read_tensors, tensor_bytes
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.draws import HURRY_ONE, ONE, with_fault_odds
from shuttle_marl.game.layout import ALL, LONGEST_DUEL, GameError, Indices, Layout, layout
from shuttle_marl.game.recovery import N_POSITIONS, NO_CHOICE, POSITIONS, Recovery, Waiting, waiting_of
from shuttle_marl.game.stroke import SHOTS, Catalogue, frozen

if TYPE_CHECKING:
    from shuttle_marl.game.pairs import People
    from shuttle_marl.game.shipped import Origin

ROOT: Final = 0  # the state in which every rally starts: the serve, struck from below the net
_TYPES: Final[dict[str, tuple[Any, int]]] = {"threshold": (np.uint16, 3), "hurry": (np.uint8, 2)}
_NO_TABLES: Final = ("catalogue", "recovery", "people", "whole", "seat", "origin")
_MOST_LEVELS: Final = 8
_MOST_ODDS: Final = 1 << 20


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Game(Layout):
    """A compiled game: its layout and the probabilities of outcomes.

    In most games both seats strike with the same tables. In the game of a pair (:mod:`shuttle_marl.game.pairs`) each seat has
    thresholds of its own; what plays or values strokes takes the tables of the striker, ``game.seats[striker]``.

    Attributes:
        threshold: ``[base pairs, 3]`` uint16, cumulative probabilities of fault, + winner, + returned from below at effort 0, in
            units of 1/65536; in the game of a pair ``[2, base pairs, 3]``, by seat.
        hurry: ``[base pairs, 2]`` uint8, probability that the receiver of a return is hurried, from below and from above the net,
            in units of 1/256; 0 in games that do not know it.
        fault_odds: ``[L]`` int32, odds of a fault at each own effort, relative to those at effort 0, in units of 1/65536.
        recovery: where receivers wait and what that changes (:mod:`shuttle_marl.game.recovery`); by default all in the middle.
        people: the players of the game of a pair; None: both seats have the same tables, or these are those of one seat.
        whole: the game of the pair that these are the tables of one seat of; None: of none.
        seat: that seat.
        origin: where the game was loaded from; None for any other, also for a changed copy.
    """

    threshold: U16
    hurry: U8
    fault_odds: I32 = dataclasses.field(default_factory=lambda: np.full(1, ONE, dtype=np.int32))
    recovery: Recovery = NO_CHOICE
    people: "People | None" = None
    whole: "Game | None" = None
    seat: int = 0
    origin: "Origin | None" = dataclasses.field(default=None, init=False)

    def __post_init__(self) -> None:
        for name, array in self._arrays().items():
            if not isinstance(array, np.ndarray) or array.dtype != _TYPES.get(name, (np.int32, 0))[0]:
                kind = getattr(array, "dtype", type(array).__name__)
                raise GameError(f"table {name} of {kind}: expected uint16 for threshold, uint8 for hurry, int32 for the others")
            object.__setattr__(self, name, frozen(array))
        if (self.people is not None) != (self.threshold.ndim == 3):
            raise GameError("tables of two seats are those of a pair: make them with pair_game")
        if self.whole is None:  # else it is checked
            self._check_layout()

    def __repr__(self) -> str:
        if self.people is not None:
            return f"Game(hash={self.hash[:12]!r}, people={self.people!r})"
        return (
            f"Game(hash={self.hash[:12]!r}, n_strokes={self.n_strokes}, n_states={self.n_states}, n_pairs={self.n_pairs}, "
            f"levels={self.levels})"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        if self.whole is not None:
            return _game_of_seat, (self.whole, self.seat)
        # The game of a pair and a shipped one are pickled by their names, because their tables are megabytes.
        make = self.people.game if self.people is not None else None if self.origin is None else self.origin.loader
        if make is not None:
            return _made_again, (make, self.hash)
        arrays: dict[str, Any] = self._arrays()
        return functools.partial(Game, catalogue=self.catalogue, recovery=self.recovery, **arrays), ()

    def __deepcopy__(self, memo: dict[int, Any]) -> "Game":
        return self  # nothing in it can be changed

    def without(self, *strokes: str) -> "Game":
        """The game in which some strokes are illegal; the catalogue stays, and the states are those that still occur.

        Args:
            strokes: shot types such as ``net-shot``, or strokes of the catalogue.

        Raises:
            GameError: a stroke is unknown, or is the only legal one after a stroke that remains.
        """
        shots, names = np.array([SHOTS[shot] for shot in self.catalogue.shot]), np.array(self.catalogue.names)
        unknown = [stroke for stroke in strokes if stroke not in shots and stroke not in names]
        if unknown:
            raise GameError(f"no stroke {unknown[0]!r}; shot types are: {', '.join(dict.fromkeys(shots.tolist()))}")
        removed: Bools = np.isin(shots, strokes) | np.isin(names, strokes)
        tables = layout(self.catalogue, self.reply_mask.any(axis=1) & ~removed, duels=self.counts_duels)
        smaller = Layout(catalogue=self.catalogue, **tables)
        own, incoming, contact, duel, _, _, hurried = smaller.observation(smaller.base_pair_state).T
        pair = self.pair(self.state_of(own, incoming, contact, duel, hurried=hurried), smaller.base_pair_stroke)
        return dataclasses.replace(self, **tables, threshold=self.threshold[pair], hurry=self.hurry[pair])

    @functools.cached_property
    def seats(self) -> "tuple[Game, Game]":
        """The tables with which seats 0 and 1 strike: these, twice, but in the game of a pair."""
        if self.people is None:
            return self, self
        first, second = (
            dataclasses.replace(self, threshold=self.threshold[seat], people=None, whole=self, seat=seat) for seat in (0, 1)
        )
        return first, second

    @property
    def opposite(self) -> "Game":
        """The tables with which the opponent of a player with these tables strikes: the same ones, but in the game of a pair."""
        return self if self.whole is None else self.whole.seats[1 - self.seat]

    @property
    def average(self) -> "Game":
        """The game without skill of players, whose agents can play this one: the same one, but in the game of a pair."""
        people = self.people if self.whole is None else self.whole.people
        return self if people is None else people.average

    @property
    def swapped(self) -> "Game":
        """The game with the seats exchanged."""
        if self.people is None:
            return self
        return dataclasses.replace(self, threshold=np.ascontiguousarray(self.threshold[::-1]), people=self.people.swapped)

    @property
    def levels(self) -> int:
        """Number of levels of effort L; 1 where effort does not count."""
        return len(self.fault_odds)

    @property
    def hides(self) -> bool:
        """Whether receivers choose where they wait, which strikers do not see: the game with recovery."""
        return self.recovery.hides

    @property
    def n_decisions(self) -> int:
        """Number of decisions: the stroke in each state, and with recovery the position where the opponent strikes in it."""
        return self.n_states * (1 + self.hides)

    @property
    def n_actions(self) -> int:
        """Number of actions: the n strokes, and in the game with recovery the nine positions behind them."""
        return self.n_strokes + N_POSITIONS * self.hides

    @functools.cached_property
    def action_names(self) -> tuple[str, ...]:
        """Names of the strokes and, in the game with recovery, of the nine positions (``wait:front-centre``)."""
        return (*self.catalogue.names, *(f"wait:{name}" for name in POSITIONS))[: self.n_actions]

    def people_positions(self, state: Indices) -> F64:
        """``[..., 9]`` probabilities of people's positions as receivers where a striker is in each state; see ``waiting``."""
        shot, area, base = self.incoming_shot(state), np.append(self.catalogue.area, N_AREAS), self.base(state)
        return self.recovery.chosen[shot, area[self.own(base)], area[self.incoming(base)], self.contact(base), self.hurried(base)]

    @functools.cached_property
    def waiting(self) -> Waiting:
        """The tables by position of the receiver, who waits in the middle where they have no choice.

        Raises:
            GameError: in the game of a pair, each seat has its own.
        """
        return waiting_of(self)

    def chooses(self, state: Indices) -> Bools:
        """``[...]`` whether the receiver can wait at more than one position while a striker is in each state."""
        return np.asarray(self.seats[0].waiting.choices[self.base(state)] > 1)

    def chances(self, state: int, stroke: int, position: int) -> tuple[list[int], list[int]]:
        """How draws decide a legal stroke against a receiver at a feasible position.

        Returns:
            Limits of fault, winner and return from below in units of 1/65536, and chances of a hurried receiver of a return from
            below and from above in units of 1/256.
        """
        row = int(self.waiting.row(self.base(state), self.rank(state, stroke), np.array(position)))
        return self.waiting.limits[self.effort(state), row].tolist(), self.waiting.hurry[row].tolist()

    @functools.cached_property
    def limits(self) -> U16:
        """``[L, base pairs, 3]`` thresholds by own effort. Raises GameError: in the game of a pair, each seat has its own."""
        if self.people is not None:
            advice = "take those of a seat, game.seats[0]"
            raise GameError(f"the game of {self.people.title} has the tables of both players; {advice}")
        return frozen(np.stack([with_fault_odds(self.threshold, odds) for odds in self.fault_odds.tolist()]))

    @property
    def tables(self) -> "Game":
        """The game with the same layout whose tables do not depend on the positions of a receiver: itself."""
        return self

    def table_of(self, block: int) -> int:
        """Row of ``limits`` that holds in a block."""
        return block // self.levels

    def hurry_at(self, table: int) -> U8:  # noqa: ARG002  the same in all rows
        """``[base pairs, 2]`` chances of a hurried receiver in a row of ``limits``."""
        return self.hurry

    def limits_of(self, pairs: slice | Indices = ALL) -> U16:
        """``[..., 3]`` thresholds of legal pairs, all by default."""
        return self.limits.reshape(-1, 3)[self.limit_row(pairs)]

    def limit_row(self, pairs: slice | Indices = ALL) -> Ints:
        """``[...]`` row of legal pairs in tables by own effort and base pair, such as ``limits`` as ``[L * base pairs, 3]``."""
        block, base = np.divmod(self._numbers(pairs), self.n_base_pairs)
        return np.asarray(block // self.levels * self.n_base_pairs + base)

    def outcome_probabilities(self, pairs: slice | Indices = ALL, position: int | None = None) -> F64:
        """``[..., 6]`` exact probabilities of OUTCOMES of legal pairs, at a feasible ``position``; None: without recovery."""
        if position is None:
            limits, hurried = self.limits_of(pairs), self.hurry_of(pairs)
        else:
            block, pair = np.divmod(self._numbers(pairs), self.n_base_pairs)
            row = self.waiting.row(self.base_pair_state[pair], self.base_pair_rank[pair], np.array(position))
            limits, hurried = self.waiting.limits[block // self.levels, row], self.waiting.hurry[row] / HURRY_ONE
        four = np.diff(limits.astype(np.int32), axis=-1, prepend=0, append=ONE) / ONE
        return np.concatenate([four[..., :2], four[..., 2:] * (1 - hurried), four[..., 2:] * hurried], axis=-1)

    def hurry_of(self, pairs: slice | Indices = ALL) -> F64:
        """``[..., 2]`` probability that the receiver of a return is hurried, from below and from above the net; exact."""
        return np.asarray(self.hurry[self._numbers(pairs) % self.n_base_pairs] / HURRY_ONE)

    def stroke_probabilities(self, pairs: slice | Indices = ALL) -> tuple[F64, F64, F64]:
        """Probability that the stroke is good, that a good one is returned, that a return is from above; of legal pairs."""
        fault, winner, below = np.moveaxis(self.limits_of(pairs).astype(np.float64), -1, 0)
        return (ONE - fault) / ONE, (ONE - winner) / (ONE - fault), (ONE - below) / (ONE - winner)

    def stroke_values(self, following: F64, pairs: slice | Indices = ALL) -> F64:
        """Q-values: what legal pairs are worth to the striker, +1 for winning the rally and -1 for losing it.

        Args:
            following: ``[S]`` value of the next states to the receiver, who strikes there.
            pairs: which ones; all by default.
        """
        if isinstance(pairs, slice) and pairs == ALL and self.n_blocks > 1:
            # One block after the other, so that what is needed on the way stays small.
            blocks = [self.stroke_values(following, self.block_pairs(block)) for block in range(self.n_blocks)]
            return np.concatenate(blocks)
        fault, winner, below = np.moveaxis(self.limits_of(pairs).astype(np.float64), -1, 0)
        after, hurried = following[self.arrivals(pairs)], self.hurry_of(pairs)
        after = (1 - hurried) * after[..., :2] + hurried * after[..., 2:]
        now = winner - 2 * fault
        return np.asarray((now - (below - winner) * after[..., 0] - (ONE - below) * after[..., 1]) / ONE)

    @functools.cached_property
    def hash(self) -> str:
        """SHA-256 over the names of the strokes and all tables, hexadecimal: the version of the game."""
        if self.people is not None:
            return content_hash(f"pair {self.seats[0].hash} {self.seats[1].hash}".encode())
        parts = [self.catalogue.version.encode()]
        for name, array in self._arrays().items():
            parts += f"{name}{array.dtype.str}{array.shape}".encode(), np.ascontiguousarray(array).tobytes()
        return content_hash(*parts, *([f"recovery {self.recovery.hash}".encode()] if self.hides else []))

    def _check_layout(self) -> None:
        """Check that all indices are in range: compiled code reads the tables without bounds checks."""
        n, edges, replies = self.n_strokes, len(self.edge_own), len(self.reply_edge)
        wanted = {
            "edge_own": (edges,), "edge_incoming": (edges,), "edge_duel": (edges,), "reply_start": (n + 1, 2, 2),
            "reply_count": (n + 1, 2), "reply_edge": (replies,), "threshold": (*self.threshold.shape[:-1], 3),
            "hurry": (*self.threshold.shape[-2:-1], 2), "fault_odds": (len(self.fault_odds),),
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
        if (self.threshold[..., 1:] < self.threshold[..., :-1]).any():
            raise GameError("table threshold: the cumulative probabilities of a legal pair fall")
        self._check_replies()

    def _check_replies(self) -> None:
        """Check that replies follow the strokes that they answer."""
        n, replies = self.n_strokes, len(self.reply_edge)
        starts = self.reply_start.astype(np.int64)
        counts = np.broadcast_to(self.reply_count.astype(np.int64)[:, None], starts.shape)
        if not (_within(starts, 0, replies) and _within(counts, 0, n) and _within(starts + counts, 0, replies)):
            raise GameError(f"tables reply_start and reply_count: expected replies from 0 to {replies - 1}")
        legal = self.reply_count[self.edge_incoming].ravel()
        if 2 * legal.sum() != len(self.hurry):
            raise GameError("table threshold does not count the legal strokes of the states")
        if (legal[np.arange(len(legal)) != 1] == 0).any():
            raise GameError("a state other than the serve from above has no legal stroke")
        if (self._edge_of[self.edge_own, self.edge_incoming, self.edge_duel] != np.arange(len(self.edge_own))).any():
            raise GameError("tables edge_own, edge_incoming and edge_duel name an edge twice")
        of, count = np.arange(starts.size), counts.ravel()
        place = np.repeat(of, count)
        edge = self.reply_edge[np.repeat(starts.ravel() - np.r_[0, np.cumsum(count)[:-1]], count) + np.arange(len(place))]
        answered, longer, contact, stroke = place >> 2, (place >> 1) & 1, place & 1, self.edge_incoming[edge]
        height, is_net = np.append(self.catalogue.height, -1), np.append(self.catalogue.is_net_shot & self.counts_duels, False)
        wrong = (self.edge_own[edge] != answered) | (height[stroke] != contact)
        if wrong.any() or (np.diff(stroke)[np.diff(place) == 0] <= 0).any():
            raise GameError("tables reply_start and reply_edge do not lead to the replies of a stroke, in their order")
        if (self.edge_duel[edge] != np.where(is_net[stroke], np.where(is_net[answered], LONGEST_DUEL - 1 + longer, 1), 0)).any():
            raise GameError("table edge_duel does not count the net shots in a row")
        legal = np.zeros((n + 1, 2, 2, n), dtype=np.bool_)
        legal.reshape(-1, n)[place, stroke] = True
        if (legal[:, 0] != legal[:, 1]).any():
            raise GameError("table reply_start: the legal strokes of a state depend on the duel")

    def _arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(Game) if field.name not in _NO_TABLES}

    def save(self, path: Path, metadata: dict[str, str] | None = None) -> None:
        """Write the tables as safetensors, beside and moved into place."""
        header = {"strokes": json.dumps(self.catalogue.names), "hash": self.hash, **(metadata or {})}
        arrays: dict[str, npt.NDArray[Any]] = self._arrays()
        order = np.argsort(self.base_pair_edge, kind="stable")
        for name in _TYPES:
            # Differences in the order of the edges that follow, column by column: the same answers are alike, and pack well.
            alike = arrays[name][order].T
            arrays[name] = np.ascontiguousarray(np.diff(alike, axis=1, prepend=np.zeros_like(alike[:, :1])))
        replace_file(path, tensor_bytes(arrays, header, pack=True))

    @classmethod
    def load(cls, path: Path) -> "Game":
        """Read tables of :meth:`save`. Raises GameError: missing or damaged, another hash, or an index out of its table."""
        try:
            header, arrays = read_tensors(path)
            names, pairs = parsed(header["strokes"]), arrays["threshold"].shape[-1]
            columns = {name: checked(arrays.pop(name), kind, (wide, pairs)) for name, (kind, wide) in _TYPES.items()}
            if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
                raise ValueError("the strokes are no list of names")
            catalogue = Catalogue.from_names(names)
            shape = Layout(catalogue=catalogue, **{name: array for name, array in arrays.items() if name != "fault_odds"})
            if shape.n_base_pairs != pairs:
                raise ValueError(f"{shape.n_base_pairs} legal pairs with thresholds for {pairs}")
            order = np.argsort(shape.base_pair_edge, kind="stable")
            for name, (kind, wide) in _TYPES.items():
                arrays[name] = np.empty((pairs, wide), kind)
                arrays[name][order] = np.cumsum(columns[name], axis=1, dtype=kind).T
            tables: dict[str, Any] = arrays
            game = cls(catalogue=catalogue, **tables)
        except (OSError, KeyError, IndexError, TypeError, ValueError, ShuttleError) as error:
            raise GameError(f"{path}: no readable game tables ({error}); fit or install the model again") from error
        if game.hash != header.get("hash"):
            raise GameError(f"{path}: the tables do not fit their hash; the file is damaged, install the model again")
        return game


def _made_again(make: Callable[[], Game], value: str) -> Game:
    """The game that was pickled by its name."""
    game = make()
    if game.hash != value:
        raise GameError(f"{game!r}: pickled with game {value[:12]}, and this version of the model is another one; make it again")
    return game


def _game_of_seat(whole: Game, seat: int) -> Game:
    return whole.seats[seat]


def _within(array: Ints, low: int, high: int) -> bool:
    return bool(((array >= low) & (array <= high)).all())


def thresholds(p_good: F64, p_returned: F64, p_above: F64) -> U16:
    """Fixed-point thresholds ``[P, 3]`` from the three probabilities, each rounded to the nearest 1/65536.

    The first three outcomes together never reach 1, so the last one keeps at least 1/65536.
    """
    fault = 1 - p_good
    winner = fault + p_good * (1 - p_returned)
    below = winner + p_good * p_returned * (1 - p_above)
    cumulative = np.rint(np.stack([fault, winner, below], axis=-1) * ONE)
    if not np.isfinite(cumulative).all():
        raise GameError("a probability of the dynamics is not a number; the model is damaged")
    return np.clip(cumulative, 0, ONE - 1).astype(np.uint16)


def hurry_units(p: F64) -> U8:
    """Fixed-point probabilities of a hurried receiver, each rounded to the nearest 1/256 and at most 255/256."""
    if not np.isfinite(p).all():
        raise GameError("a probability of a hurried receiver is not a number; the model is damaged")
    return np.clip(np.rint(p * HURRY_ONE), 0, HURRY_ONE - 1).astype(np.uint8)
