"""Played rallies: :class:`Rallies` holds many in columns, :class:`Rally` is one of them."""

import dataclasses
import functools
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import F32, I8, I32, I64, U8, U16, U32, Bools, Ints, UInts
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.game.court import HANDS, Hands, area_box, seen_by, service_area, service_box
from shuttle_marl.game.layout import LONGEST_DUEL, Layout
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.rules import HURRIED_BELOW, OUTCOMES, RETURNED_BELOW, WINNER
from shuttle_marl.game.scoring import BWF, Rules, Score, serves_from_right
from shuttle_marl.game.stroke import Catalogue
from shuttle_marl.game.tables import Game

PER_STROKE: Final = ("stroke", "hurried", "waited", "log_probability", "value")
"""Columns of :class:`Rallies` with one entry for each stroke; the others have one for each rally."""
OPTIONAL: Final = ("update", "waited", "log_probability", "value")
"""Columns of :class:`Rallies` that may be missing."""


def columns_of(game: Game, *others: str) -> tuple[str, ...]:
    """The columns of :data:`OPTIONAL` that a record of a game has: some, and the positions in the game with recovery."""
    return tuple(name for name in OPTIONAL if name in others or (name == "waited" and game.hides))


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
        waited: ``[n]`` position of the receiver of every stroke; None: in the game without recovery, or not known.
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
    waited: I64 | None = None

    @classmethod
    def from_strokes(cls, catalogue: Catalogue, strokes: Iterable[tuple[int, int, int]]) -> "Rally":
        """Build a rally from its strokes.

        Args:
            strokes: seat of the striker, catalogue index and outcome of each stroke.

        Raises:
            RallyError: seats that do not alternate, outcomes that contradict the strokes, or see :meth:`checked`. Whether a
                striker was hurried follows from the outcome before, so nothing can contradict that.
        """
        rows = np.array(list(strokes), dtype=np.int64).reshape(-1, 3)
        if not len(rows):
            raise RallyError("a rally without strokes; expected at least the serve")
        seat, stroke, outcome = rows.T
        if (seat != (seat[0] + np.arange(len(seat))) % 2).any():
            raise RallyError(f"seats {seat.tolist()}: expected two players who take turns")
        hurried = np.r_[False, outcome[:-1] >= HURRIED_BELOW]
        rally = cls(catalogue=catalogue, server=int(seat[0]), stroke=stroke, hurried=hurried, ending=int(outcome[-1])).checked()
        if (outcome != rally.outcome).any():
            raise RallyError(f"outcomes {outcome.tolist()}: the heights of the strokes give {rally.outcome.tolist()}")
        return rally

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
        if self.waited is not None and (self.waited.shape != self.stroke.shape or set(self.waited) - set(range(N_POSITIONS))):
            raise RallyError(f"positions {self.waited.tolist()}: expected 0 to {N_POSITIONS - 1} for each of {len(self)} strokes")
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
        area = self._seen
        return np.where(self.catalogue.is_serve, service_area(area, self.from_right), area)

    @functools.cached_property
    def _seen(self) -> I64:
        """``[2, strokes of the catalogue]`` area of each stroke of each seat as the receiver sees it."""
        area = self.catalogue.area.astype(np.int64)
        return np.stack([seen_by(self.hands[1 - seat], area) for seat in (0, 1)])

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
        winner: ``[R]`` uint8 seat that won the rally.
        reason: ``[R]`` uint8 outcome of the last stroke: FAULT or WINNER of :mod:`shuttle_marl.game.rules`.
        score: ``[R, 4]`` uint8 points of seats 0 and 1 and games of seats 0 and 1 before the rally.
        length: ``[R]`` int32 number of strokes, at least 1.
        stroke: ``[N]`` uint8 or uint16 catalogue index of every stroke, rally after rally; empty if strokes were not recorded.
        hurried: ``[N]`` uint8 whether the striker of every stroke was hurried, 0 or 1, never at a serve; empty if strokes
            were not recorded.
        waited: ``[N]`` int8 position of the receiver of every stroke; None: in the game without recovery, or not recorded.
        update: ``[R]`` uint32 number of updates of the learner before the end of the rally; None: not recorded.
        log_probability: ``[N]`` float32 log-probability of the stroke under the striker's policy, NaN if unknown; None: not
            were not recorded.
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
    waited: I8 | None = None
    update: U32 | None = None
    log_probability: F32 | None = None
    value: F32 | None = None

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
        following[self.first_stroke[1:] - 1] = self.reason
        return following.astype(np.int8)

    @property
    def optional_columns(self) -> tuple[str, ...]:
        """Names of the columns of :data:`OPTIONAL` that are present."""
        return tuple(name for name in OPTIONAL if getattr(self, name) is not None)

    def row(self, i: int, catalogue: Catalogue, rules: Rules = BWF, hands: Hands = ("right", "right")) -> Rally:
        """One rally.

        Args:
            i: row, 0 <= i < R.
            hands: of seats 0 and 1.
        """
        first, last = self.first_stroke[[i, i + 1]]
        points_0, points_1, games_0, games_1 = self.score[i].tolist()
        score = Score(points=(points_0, points_1), games=(games_0, games_1), server=int(self.server[i]), rules=rules)
        return Rally(
            catalogue=catalogue,
            server=score.server,
            stroke=self.stroke[first:last].astype(np.int64),
            hurried=self.hurried[first:last].astype(np.bool_),
            ending=int(self.reason[i]),
            points=score.points,
            games=score.games,
            match=int(self.match[i]),
            number=int(self.rally[i]),
            ends_changed=score.ends_changed,
            hands=hands,
            waited=None if self.waited is None else self.waited[first:last].astype(np.int64),
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
