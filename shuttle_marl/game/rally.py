"""A rally stroke by stroke, in plain Python, and the record of played rallies.

    stepper, draws = stepper_of(game), RallyDraws(seed)
    state, player = ROOT, draws.first_server(rally)
    for i in itertools.count():
        stroke = choose(policies[player], game, state, draws.choice(rally, i))
        played, state = stepper.step(state, player, stroke, draws.outcome(rally, i))
        if played.outcome < RETURNED_BELOW:
            break
        player = 1 - player

With recovery ``step`` also takes the receiver's position: ``choose(…, waits=True) - n``, by ``draws.position``. The rule is that
of :mod:`shuttle_marl.game.rules`, without the cost of numpy calls on single numbers; tests hold both equal.

:class:`Rallies` holds many played rallies in columns, :class:`Rally` is one of them.
"""

import bisect
import dataclasses
import functools
from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shuttle_marl.base.arrays import F32, I8, I32, I64, U8, U16, U32, U64, Bools, Ints, UInts
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.game.court import HANDS, Hands, area_box, seen_by, service_area, service_box
from shuttle_marl.game.draws import ONE, choice_draw, draw, first_server, outcome_draw, position_draw, stream
from shuttle_marl.game.layout import EFFORT, LONGEST_DUEL, SWAP, Layout, features
from shuttle_marl.game.policy import (
    LAGS,
    Policy,
    States,
    TabulatedPolicy,
    checked_positions,
    checked_probabilities,
    drawn_strokes,
)
from shuttle_marl.game.recovery import CENTRE, N_POSITIONS
from shuttle_marl.game.rules import HURRIED_BELOW, OUTCOMES, RETURNED_BELOW, WINNER
from shuttle_marl.game.scoring import BWF, Rules, Score, serves_from_right
from shuttle_marl.game.stroke import Catalogue
from shuttle_marl.game.tables import Game

PER_STROKE: Final = ("stroke", "hurried", "waited", "log_probability", "value")
"""Columns of :class:`Rallies` with one entry for each stroke; the others have one for each rally."""
OPTIONAL: Final = ("seed", "episode", "ending", "update", "waited", "log_probability", "value")  # columns that may be missing


def columns_of(game: Game, *others: str) -> tuple[str, ...]:
    """The columns of :data:`OPTIONAL` that a record of a game has: some, and the positions in the game with recovery."""
    return tuple(name for name in OPTIONAL if (game.hides if name == "waited" else name in others))


def stroke_dtype(n_strokes: int) -> np.dtype[np.unsignedinteger]:
    """Type of ``Rallies.stroke`` in a game of ``n_strokes`` strokes: uint8 or uint16."""
    return np.dtype(np.uint8 if n_strokes <= 256 else np.uint16)


def states_of_rallies(game: Layout, stroke: Ints, position: Ints, hurried: Bools | Ints) -> I32:
    """The state in which each stroke of rallies was struck.

    Args:
        stroke: ``[N]`` catalogue indices, rally after rally.
        position: ``[N]`` number of each stroke in its rally, from 0.
        hurried: ``[N]`` whether the striker of each stroke was hurried.

    Returns:
        ``[N]`` state, -1 where the game has no such state. It does not look whether the stroke is legal there.
    """
    n, stroke, position = game.n_strokes, np.asarray(stroke, dtype=np.int64), np.asarray(position, dtype=np.int64)
    row = np.arange(len(stroke))
    own = np.where(position >= 2, stroke[np.maximum(row - 2, 0)], n)
    incoming = np.where(position >= 1, stroke[np.maximum(row - 1, 0)], n)
    even = position % 2 == 0
    attack = game.catalogue.is_attack[stroke]
    # Attacks before each stroke since the beginning of its rally, of those who struck at even and at odd positions.
    so_far = np.stack([np.r_[0, np.cumsum(attack & side)] for side in (even, ~even)])
    counts = np.minimum(so_far[:, row] - so_far[:, row - position], game.levels - 1)
    effort, opponent_effort = np.where(even, counts, counts[::-1])
    duel = np.zeros(len(stroke), dtype=np.int64)
    if game.counts_duels:
        net = game.catalogue.is_net_shot[stroke]
        # The last stroke up to each one that is no net shot; at the latest the one before the rally.
        broken = np.maximum.accumulate(np.where(net, row - position - 1, row))
        in_a_row = np.minimum(row - broken, LONGEST_DUEL)
        duel = np.where(position >= 1, in_a_row[np.maximum(row - 1, 0)], 0)
    hurry = np.asarray(hurried, dtype=np.int64)
    return game.state_of(own, incoming, game.catalogue.height[stroke], duel, effort, opponent_effort, hurry)


class RallyError(ShuttleError):
    """Strokes that do not form a rally."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Rally:
    """One rally, finished or still being played. Seats are 0 and 1; strikers alternate, beginning with the server.

    Attributes:
        catalogue: strokes of the game.
        server: seat that serves.
        stroke: ``[n]`` catalogue index of every stroke; n >= 1 in a finished rally.
        hurried: ``[n]`` whether the striker of each stroke was hurried; never at the serve.
        ending: outcome of the last stroke, an index into :data:`shuttle_marl.game.rules.OUTCOMES`: FAULT or WINNER, or a return
            while the rally continues.
        points: points of seats 0 and 1 in the current game, before the rally.
        games: games won by seats 0 and 1, before the rally.
        match: number of the match.
        number: number of the rally within its match.
        ends_changed: whether the players are at other ends of the court than in the first rally of the match.
        hands: ``right`` or ``left``, of seats 0 and 1.
        waited: ``[n]`` position of the receiver of every stroke; -1: not known, or without a choice in the whole game.
    """

    catalogue: Catalogue
    server: int
    stroke: I64
    hurried: Bools
    ending: int
    points: tuple[int, int] = (0, 0)
    games: tuple[int, int] = (0, 0)
    match: int = 0
    number: int = 0
    ends_changed: bool = False
    hands: Hands = ("right", "right")
    waited: I64

    def checked(self) -> "Rally":
        """Return this rally.

        Raises:
            RallyError: no strokes, an unknown seat, stroke, ending, hand or position, a serve that is not the first stroke, or a
                hurried server.
        """
        if not set(self.hands) <= set(HANDS):
            raise RallyError(f"hands {self.hands}: expected {' or '.join(HANDS)} for each player")
        if self.server not in (0, 1):
            raise RallyError(f"server {self.server}: expected seat 0 or 1")
        if self.ending not in range(len(OUTCOMES)):
            raise RallyError(f"ending {self.ending}: expected 0 to {len(OUTCOMES) - 1}, {', '.join(OUTCOMES)}")
        if not len(self.stroke):
            if self.open:
                return self
            raise RallyError("a rally without strokes; expected at least the serve")
        if self.stroke.min() < 0 or self.stroke.max() >= len(self.catalogue):
            raise RallyError(f"strokes {self.stroke.tolist()}: the catalogue has {len(self.catalogue)} strokes, from 0")
        serves = self.catalogue.is_serve[self.stroke]
        if not serves[0] or serves[1:].any():
            raise RallyError("a rally starts with a serve and has no other; check the order of its strokes")
        if self.hurried.shape != self.stroke.shape or self.hurried[0]:
            raise RallyError(f"hurried {self.hurried.tolist()}: expected one for each of {len(self)} strokes, none for the serve")
        if self.waited.shape != self.stroke.shape or set(self.waited) - set(range(-1, N_POSITIONS)):
            told = f"expected 0 to {N_POSITIONS - 1}, or -1 where it is not known, for each of {len(self)} strokes"
            raise RallyError(f"positions {self.waited.tolist()}: {told}")
        return self

    def __len__(self) -> int:
        return len(self.stroke)

    @property
    def open(self) -> bool:
        """Whether the rally continues."""
        return self.ending >= RETURNED_BELOW

    @property
    def winner(self) -> int | None:
        """Seat that won the rally; None while it continues."""
        last = (self.server + len(self.stroke) - 1) % 2
        return None if self.open else last if self.ending == WINNER else 1 - last

    @functools.cached_property
    def striker(self) -> I64:
        """``[n]`` seat of the striker of each stroke."""
        return (self.server + np.arange(len(self.stroke))) % 2

    @property
    def from_right(self) -> bool:
        """Whether the server serves from the right service court."""
        return bool(serves_from_right(self.points[self.server]))

    @functools.cached_property
    def aim(self) -> I64:
        """``[2, strokes of the catalogue]`` area at which each seat aims with each stroke in this rally, as the receiver sees it.

        Areas of the catalogue are mirrored for a left-handed receiver, and those of serves by the score.
        """
        areas = self.catalogue.area.astype(np.int64)
        area = np.stack([seen_by(hand, areas) for hand in reversed(self.hands)])
        return np.where(self.catalogue.is_serve, service_area(area, self.from_right), area)

    def target(self, seat: int, stroke: int) -> int:
        """Area at which a seat aims with a stroke of the catalogue, as a right-handed receiver sees it."""
        return seen_by(self.hands[1 - seat], int(self.aim[seat, stroke]))

    def as_named(self, seat: int, stroke: int) -> bool:
        """Whether a stroke of the catalogue aims at the area of its name; the score mirrors some serves."""
        return self.target(seat, stroke) == self.catalogue.area[stroke]

    def aim_box(self, seat: int, stroke: int) -> tuple[tuple[float, float], tuple[float, float]]:
        """Extent of the area at which a seat aims with a stroke of the catalogue, in the striker's frame [m]."""
        area = int(self.aim[seat, stroke])
        return service_box(area, self.from_right) if self.catalogue.is_serve[stroke] else area_box(area)

    def facing(self, seat: int) -> float:
        """Sign, +1 or -1, of x and y between the frame of a seat and the frame of the court, in which seat 0 begins at y < 0."""
        return 1.0 if bool(seat) == self.ends_changed else -1.0

    @functools.cached_property
    def outcome(self) -> I64:
        """``[n]`` outcome of each stroke, an index into :data:`shuttle_marl.game.rules.OUTCOMES`."""
        following = np.where(self.hurried, HURRIED_BELOW, RETURNED_BELOW) + self.catalogue.height[self.stroke]
        return np.r_[following[1:], self.ending][: len(self.stroke)]

    def states(self, game: Layout) -> I32:
        """``[n]`` state of the game in which each stroke was struck, -1 where the game has no such state."""
        return states_of_rallies(game, self.stroke, np.arange(len(self.stroke)), self.hurried)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Rallies:
    """R finished rallies of N strokes in total, as columns.

    Attributes:
        pairing: ``[R]`` uint32 index into the pairings of the tournament or log.
        match: ``[R]`` uint32 number of the match within its pairing.
        rally: ``[R]`` uint16 number of the rally within its match.
        policy: ``[R, 2]`` uint16 policies at seats 0 and 1, indices into the policies of the tournament or log.
        server: ``[R]`` uint8 seat that served; strikers alternate.
        winner: ``[R]`` uint8 seat that won the rally; 2: nobody, it was cut off.
        reason: ``[R]`` uint8 end of the rally, an index into :data:`shuttle_marl.game.rules.REASONS`; above 1 it was cut off.
        score: ``[R, 4]`` uint8 points of seats 0 and 1 and games of seats 0 and 1 before the rally.
        length: ``[R]`` int32 number of strokes, at least 1 unless it was cut off.
        stroke: ``[N]`` uint8 or uint16 catalogue index of every stroke, rally after rally; empty if strokes were not recorded.
        hurried: ``[N]`` uint8 whether the striker of every stroke was hurried, 0 or 1, never at a serve; empty if strokes
            were not recorded.
        waited: ``[N]`` int8 position of the receiver of every stroke; None: in the game without recovery, or not recorded.
        seed: ``[R]`` uint64 seed of the environment that played the rally; None: all have the seed of the log.
        episode: ``[R]`` uint32 number of its episode since the seed, of which and of ``rally`` its draws follow; None: without
            ``seed``.
        ending: ``[R]`` uint8 outcome of the last stroke, 0 without strokes; None: no rally was cut off.
        update: ``[R]`` uint32 number of updates of the learner before the end of the rally; None: not recorded.
        log_probability: ``[N]`` float32 log-probability of the stroke under the striker's policy, NaN if unknown; None: not
            recorded.
        value: ``[N]`` float32 the striker's value estimate before the stroke, NaN if unknown; None: not recorded.
    """

    pairing: U32
    match: U32
    rally: U16
    policy: U16
    server: U8
    winner: U8
    reason: U8
    score: U8
    length: I32
    stroke: UInts
    hurried: U8
    seed: U64 | None = None
    episode: U32 | None = None
    ending: U8 | None = None
    waited: I8 | None = None
    update: U32 | None = None
    log_probability: F32 | None = None
    value: F32 | None = None

    @classmethod
    def of(cls, game: Game, **columns: Any) -> "Rallies":
        """Rallies of a game, of pairing 0 if none is given, without the positions of receivers if none has a choice."""
        lacking, pairing = {*OPTIONAL} - {*columns_of(game, *columns)}, np.zeros(len(columns["length"]), np.uint32)
        return cls(**{"pairing": pairing, **{name: column for name, column in columns.items() if name not in lacking}})

    @property
    def places(self) -> I8:
        """``[N]`` position of the receiver of every stroke: ``waited``, or the middle."""
        return np.full(len(self.stroke), CENTRE, np.int8) if self.waited is None else self.waited

    def __repr__(self) -> str:
        return f"Rallies(rallies={len(self)}, strokes={len(self.stroke)}, columns={[name for name, _ in self.columns()]})"

    def __len__(self) -> int:
        return len(self.length)

    @functools.cached_property
    def first_stroke(self) -> I64:
        """``[R + 1]`` index of the first stroke of each rally in ``stroke``, followed by the number of strokes."""
        return np.r_[0, np.cumsum(self.length, dtype=np.int64)]

    @functools.cached_property
    def position(self) -> I64:
        """``[N]`` number of each stroke within its rally, from 0."""
        return np.arange(self.first_stroke[-1]) - self.first_stroke[self.row_of_stroke]

    @functools.cached_property
    def row_of_stroke(self) -> I64:
        """``[N]`` row of the rally of each stroke."""
        return np.repeat(np.arange(len(self)), self.length)

    @functools.cached_property
    def striker(self) -> I64:
        """``[N]`` seat of the striker of each stroke."""
        return (self.server[self.row_of_stroke] + self.position) & 1

    def outcome(self, catalogue: Catalogue) -> I8:
        """``[N]`` outcome of each stroke, an index into :data:`shuttle_marl.game.rules.OUTCOMES`.

        The contact of a return is the height of the next stroke.
        """
        step = np.int8(HURRIED_BELOW - RETURNED_BELOW)
        following: I8 = np.roll(catalogue.height[self.stroke] + step * self.hurried.astype(np.int8) + np.int8(RETURNED_BELOW), -1)
        following[self.first_stroke[1:][self.length > 0] - 1] = self.endings[self.length > 0]
        return following.astype(np.int8)

    @property
    def endings(self) -> U8:
        """``[R]`` outcome of the last stroke of each rally."""
        return self.reason if self.ending is None else self.ending

    @property
    def finished(self) -> Bools:
        """``[R]`` whether the last stroke ended the rally, which was not cut off."""
        return np.asarray(self.reason <= WINNER)

    @property
    def optional_columns(self) -> tuple[str, ...]:
        """Names of the columns of :data:`OPTIONAL` that are present."""
        return tuple(name for name in OPTIONAL if getattr(self, name) is not None)

    def row(self, i: int, catalogue: Catalogue, rules: Rules = BWF, hands: Hands = ("right", "right")) -> Rally:
        """One rally, of row 0 <= i < R; ``hands``: of seats 0 and 1."""
        first, last = self.first_stroke[[i, i + 1]]
        points_0, points_1, games_0, games_1 = self.score[i].tolist()
        score = Score(points=(points_0, points_1), games=(games_0, games_1), server=int(self.server[i]), rules=rules)
        return Rally(
            catalogue=catalogue,
            server=score.server,
            stroke=self.stroke[first:last].astype(np.int64),
            hurried=self.hurried[first:last].astype(np.bool_),
            ending=int(self.endings[i]),
            points=score.points,
            games=score.games,
            match=int(self.match[i]),
            number=int(self.rally[i]),
            ends_changed=score.ends_changed,
            hands=hands,
            waited=np.full(last - first, -1) if self.waited is None else self.waited[first:last].astype(np.int64),
        )

    def states(self, game: Layout) -> I32:
        """``[N]`` state of the game in which each stroke was struck, -1 where the game has no such state."""
        return states_of_rallies(game, self.stroke, self.position, self.hurried)

    def legal(self, game: Layout) -> tuple[I32, I32]:
        """``[N]`` each: state in which every stroke was struck, and its position among the legal strokes.

        Both are -1 if the stroke or the incoming stroke is illegal.
        """
        state = self.states(game)
        k = np.where(state < 0, -1, game.rank(np.maximum(state, 0), self.stroke.astype(np.int64)))
        return np.where(k < 0, -1, state), k

    def slice(self, first: int, last: int) -> "Rallies":
        """Rows ``first`` up to ``last``, without a copy."""
        a, b = self.first_stroke[[first, last]]
        return Rallies(**{name: column[a:b] if name in PER_STROKE else column[first:last] for name, column in self.columns()})

    def select(self, rows: Bools | Ints) -> "Rallies":
        """Some rows: ``[R]`` a mask, or indices in the order wanted."""
        rows = np.flatnonzero(rows) if rows.dtype == np.bool_ else rows
        length = self.length[rows].astype(np.int64)
        first = np.repeat(self.first_stroke[rows] - (np.cumsum(length) - length), length)
        strokes = first + np.arange(len(first))
        return Rallies(**{name: column[strokes if name in PER_STROKE else rows] for name, column in self.columns()})

    @classmethod
    def concatenate(cls, parts: Sequence["Rallies"]) -> "Rallies":
        """Rows of several parts with the same columns, in their order."""
        return cls(**{name: np.concatenate([getattr(part, name) for part in parts]) for name, _ in parts[0].columns()})

    def columns(self) -> Iterator[tuple[str, Any]]:
        """Name and array of every column that is present."""
        for field in dataclasses.fields(self):
            if (column := getattr(self, field.name)) is not None:
                yield field.name, column


class Stroke(NamedTuple):
    """A stroke that was played.

    Attributes:
        p_ret: probability that a good stroke was returned; in the game with recovery by a receiver who waits as people do, so it
            tells nothing of the position.
    """

    player: int  # seat of the striker, 0 or 1
    stroke: int  # catalogue index
    outcome: int  # index into `OUTCOMES`
    p_succ: float  # probability that the stroke was good
    p_ret: float


class Stepper:
    """A game, or that of a pair, prepared for playing strokes one at a time; read-only. :func:`stepper_of` shares one per game.

    Attributes:
        game: the tables, or the game of a pair.
        n_actions: number of strokes and positions.
        observations: ``[2 base states, 60]`` float32 observation of the striker in each state, then of the receiver, efforts
            zero; with recovery ``[2 base states, 61]``, the last number zero.
    """

    def __init__(self, game: Game) -> None:
        self.game = game
        seen = features(game)
        self.observations = np.pad(np.concatenate([seen, seen[:, SWAP]]), ((0, 0), (0, game.hides)))
        self._n, self._one, self.n_actions = game.n_strokes, ONE, game.n_actions
        masks = game.reply_mask.reshape(-1, self._n).astype(np.int8)
        self._masks = np.pad(masks, ((0, 0), (0, self.n_actions - self._n)))
        tables = game.reply_rank, game.base_pair_start, game.first_reply
        self._rank, self._pair_start, self._first_reply = (_view(table) for table in tables)
        self._arrival = _view(4 * game.reply_edge + game.edge_attack[game.reply_edge])
        self._incoming = _view(game.edge_incoming)
        self._size, self._levels = game.n_base_states, game.levels
        self._next_block = [tuple(b * self._size for b in game.block_following(block)) for block in range(game.n_blocks)]
        waiting = [seat.waiting for seat in game.seats]
        self._limits: list[list[Any]] = [[_view(limits) for limits in seat.limits] for seat in game.seats]
        self._met: list[list[Any]] = [[_view(limits) for limits in seat.limits] for seat in waiting]
        self._hurry: list[Any] = [_view(seat.hurry) for seat in game.seats]
        self._late: list[Any] = [_view(seat.hurry) for seat in waiting]
        self._feasible = waiting[0].place >= 0
        by_place = waiting[0].place, waiting[0].choices, waiting[0].start
        self._place, self._choices, self._first_row = (_view(table) for table in by_place)
        self._only = _view(np.where(waiting[0].choices > 1, -1, waiting[0].position[:, 0]))
        highest = max(1, game.levels - 1)
        self._efforts = [(own / highest, other / highest) for own in range(game.levels) for other in range(game.levels)]

    def __deepcopy__(self, memo: dict[int, Any]) -> "Stepper":
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return stepper_of, (self.game,)

    def observe(self, state: int, *, receiver: bool = False) -> F32:
        """``[60]`` observation of the striker in a state, or of the receiver; with recovery ``[61]``. A new array."""
        block, base = divmod(state, self._size)
        row: F32 = self.observations[base + self._size * receiver].copy()
        if block:
            efforts = self._efforts[block]
            row[EFFORT : EFFORT + 2] = efforts[::-1] if receiver else efforts
        return row

    def legal_action_mask(self, state: int) -> I8:
        """``[n_actions]`` int8 legal strokes of a state, a new array."""
        mask: I8 = self._masks[self._reply(state)].copy()
        return mask

    def position_mask(self, state: int) -> I8:
        """``[n_actions]`` int8 feasible positions of a receiver who has a choice, a new array."""
        mask = np.zeros(self.n_actions, np.int8)
        mask[self._n :] = self._feasible[state % self._size]
        return mask

    def chooses_position(self, state: int) -> bool:
        """Whether the receiver can wait at more than one position."""
        return bool(self._only[state % self._size] < 0)

    def only_position(self, state: int) -> int | None:
        """Where a receiver without a choice waits; None: they have one."""
        only: int = self._only[state % self._size]
        return None if only < 0 else only

    def is_feasible(self, state: int, position: int) -> bool:
        """Whether a receiver can wait at a position."""
        return 0 <= position < N_POSITIONS and self._place[N_POSITIONS * (state % self._size) + position] >= 0

    def is_legal(self, state: int, stroke: int) -> bool:
        """Whether a stroke is in the catalogue and legal in a state."""
        return 0 <= stroke < self._n and self._rank[self._reply(state) * self._n + stroke] >= 0

    @staticmethod
    def is_hurried(state: int) -> bool:
        """Whether the striker is hurried in a state."""
        return bool(state & 2)

    def step(self, state: int, player: int, stroke: int, draw: int, position: int | None = None) -> tuple[Stroke, int]:
        """Play a legal stroke.

        Args:
            stroke: catalogue index, legal in this state; not checked.
            draw: uniform integer in [0, 2^24), see :func:`shuttle_marl.game.draws.outcome_draw`.
            position: where the receiver waits, feasible in this state, which is not checked; None: as people do.

        Returns:
            The stroke and the receiver's state; after a fault or a winner, the state after the stroke with contact below and not
            hurried.
        """
        block, base = divmod(state, self._size)
        k = self._rank[(2 * self._incoming[base >> 2] + (base & 1)) * self._n + stroke]
        row = self._pair_start[base] + k
        entry = 3 * row
        limits, hurry = self._limits[player][block // self._levels], self._hurry[player]
        fault, winner, one = limits[entry], limits[entry + 1], self._one
        good, returned = (one - fault) / one, (one - winner) / (one - fault)
        if position is not None:
            row = self._first_row[base] + k * self._choices[base] + self._place[N_POSITIONS * base + position]
            entry = 3 * row
            limits, hurry = self._met[player][block // self._levels], self._late[player]
            fault, winner = limits[entry], limits[entry + 1]
        low = draw & one - 1
        outcome = (low >= fault) + (low >= winner) + (low >= limits[entry + 2])
        if outcome >= RETURNED_BELOW and draw >> 16 < hurry[2 * row + outcome - RETURNED_BELOW]:
            outcome += HURRIED_BELOW - RETURNED_BELOW
        arrival = self._arrival[self._first_reply[base] + k]
        following = self._next_block[block][arrival & 1] + (arrival & ~1) + max(outcome - RETURNED_BELOW, 0)
        return Stroke(player, stroke, outcome, good, returned), following

    def _reply(self, state: int) -> int:
        """Row of the legal strokes: twice the incoming stroke plus the contact."""
        return 2 * self._incoming[state % self._size >> 2] + (state & 1)


@functools.lru_cache(maxsize=8)
def stepper_of(game: Game) -> Stepper:
    """The stepper of a game, built once."""
    return Stepper(game)


def waited_at(rally: Rally, game: Game, stroke: int, state: int) -> int | None:
    """Position that the receiver of a stroke chose, which is struck in a state; None: they had no choice, or it is not known."""
    return int(rally.waited[stroke]) if rally.waited[stroke] >= 0 and stepper_of(game).chooses_position(state) else None


def choose(
    policy: Policy,
    game: Game,
    state: int,
    draw: int,
    score: tuple[int, int, int, int] | None = None,
    strokes: Sequence[int] | None = None,
    *,
    waits: bool = False,
) -> int:
    """What a policy plays in one state: catalogue index of a stroke, or n plus the position in which it waits.

    Args:
        policy: a :class:`~shuttle_marl.game.policy.TabulatedPolicy` of this game, or any other policy.
        draw: uniform integer in [0, 65535); see :func:`shuttle_marl.game.draws.choice_draw`, and for positions
            :func:`~shuttle_marl.game.draws.position_draw`.
        score: points of the striker, of the receiver, games of the striker, of the receiver; None outside of matches.
        strokes: catalogue indices of the rally so far; None: not known.
        waits: whether the policy chooses a position, as the receiver, in the game with recovery.

    Raises:
        PolicyError: the policy raised or returned no distribution over the legal strokes or feasible positions.
    """
    first = game.n_strokes if waits else 0
    if isinstance(policy, TabulatedPolicy):
        if waits:
            return first + bisect.bisect_right(policy.waiting_table[state].tolist(), draw)
        pairs = game.pairs_of(state)
        return int(game.stroke_at(state, bisect.bisect_right(policy.cumulative, draw, pairs.start, pairs.stop) - pairs.start))
    scores = None if score is None else np.array([score], np.int16)
    history = None if strokes is None else np.array([[*strokes[: -LAGS - 1 : -1], *LAGS * [game.n_strokes]][:LAGS]], np.int32)
    number = None if strokes is None else np.array([len(strokes) + 1], np.int32)
    states = States(game=game, state=np.array([state], np.int32), score=scores, history=history, number=number)
    p = checked_positions(policy, states) if waits else checked_probabilities(policy, states)
    return first + int(drawn_strokes(p, np.array([draw]))[0])


_RALLIES: Final = 32
_STROKES: Final = 32
_PARTS: Final = (outcome_draw, choice_draw, position_draw, first_server)


class RallyDraws:
    """Draws of rallies 0, 1, 2, … of one stream, computed in blocks.

    Stroke k of rally r uses ``draw(stream(seed, *numbers, r), k)``: ``outcome_draw`` of it decides the outcome, ``choice_draw``
    chooses the stroke where a policy plays, ``position_draw`` where the receiver waits, and ``first_server`` at k = 0 decides who
    serves where that is random.
    """

    def __init__(self, seed: int, *numbers: int) -> None:
        self._name = (seed, *numbers)
        self._block, self._parts = -1, list[memoryview]()

    def __reduce__(self) -> tuple[Any, ...]:
        return RallyDraws, self._name

    def outcome(self, rally: int, stroke: int) -> int:
        """Number in [0, 2^24) that decides the outcome of a stroke."""
        return self._part(0, rally, stroke)

    def choice(self, rally: int, stroke: int) -> int:
        """Number in [0, 65535) by which a policy chooses a stroke."""
        return self._part(1, rally, stroke)

    def position(self, rally: int, stroke: int) -> int:
        """Number in [0, 65535) by which a policy chooses where it waits for a stroke."""
        return self._part(2, rally, stroke)

    def first_server(self, rally: int) -> int:
        """Random seat that serves in a rally: 0 or 1."""
        return self._part(3, rally, 0)

    def _part(self, part: int, rally: int, stroke: int) -> int:
        if stroke >= _STROKES:
            return int(_PARTS[part](draw(stream(*self._name, rally), stroke))[0])
        block, row = divmod(rally, _RALLIES)
        if block != self._block:
            bits = draw(stream(*self._name, np.arange(_RALLIES) + rally - row)[:, None], np.arange(_STROKES))
            self._block, self._parts = block, [_view(of(bits)) for of in _PARTS]
        return self._parts[part][row * _STROKES + stroke]


def _view(table: npt.NDArray[Any]) -> memoryview:
    # A memoryview yields Python integers four times as fast as an array, without the memory of a list.
    return np.ascontiguousarray(table).ravel().data
