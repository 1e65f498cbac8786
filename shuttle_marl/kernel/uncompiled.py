"""Parts of the kernel that need no compiler: checks of the arrays it takes, what it returns, and matches played in lock-step.

Compiled code reads and writes memory without looking, so every array is checked before it enters. A command can show its help,
and a policy can be asked, without a compiler.

In lock-step each of thousands of matches is at a rally and a stroke of its own, and all strike at once. That is for policies
that read the score and so have to be asked; between tables :func:`shuttle_marl.kernel.play_matches` plays the same matches
bit for bit, much faster. The draws of a rally are named by the key of its match, its number and the seat that serves, so which
matches share a batch never shows in the results. No slot is refilled: after t steps every match that still runs has seen
exactly t strokes.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.arrays import F32, I8, I32, I64, U8, U64, Bools, Intp, UInts
from shuttle_marl.errors import OptionError, ShuttleError, whole_number
from shuttle_marl.game import draws
from shuttle_marl.game.policy import Policy, PolicyError, States, checked_probabilities, drawn_strokes
from shuttle_marl.game.rules import WINNER, strike
from shuttle_marl.game.scoring import BWF, Rules, count_rally
from shuttle_marl.game.tables import ROOT, Game


class KernelError(ShuttleError):
    """An argument that the kernel cannot take."""


def checked_number(name: str, value: Any, least: int) -> int:
    """A whole number that is not below ``least``.

    Raises:
        KernelError: it is something else.
    """
    try:
        return whole_number(name, value, least)
    except OptionError as error:
        raise KernelError(str(error)) from None


def checked_array(
    name: str, array: Any, type_: npt.DTypeLike, shape: tuple[int, ...], low: int | None = None, high: int | None = None
) -> npt.NDArray[Any]:
    """An array as compiled code takes it: of one type, its numbers one behind the other.

    Integers of any width may stand for integers; nothing else is converted, so no fraction is ever cut off.

    Args:
        name: for the message.
        array: what was given.
        type_: type that is needed.
        shape: shape that is needed.
        low, high: least and largest value that is allowed, where integers have limits.

    Raises:
        KernelError: another kind of numbers, another shape, or a number outside the limits.
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
    """Refuse an array that compiled code cannot write its results to as it stands.

    Raises:
        KernelError: another type or shape, numbers that do not lie one behind the other, or a read-only array.
    """
    wanted = np.dtype(type_)
    fits = isinstance(array, np.ndarray) and array.dtype == wanted and array.shape == shape
    if not fits or not (array.flags.c_contiguous and array.flags.writeable and array.flags.aligned):
        found = f"{array.dtype} of shape {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
        raise KernelError(f"room for {name}, {found}: expected {wanted} of shape {shape}, writeable, one row behind the other")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Matches:
    """M matches to be played.

    Attributes:
        entrant: ``[M, 2]`` int32, the policy at each seat: position in the list of policies.
        first_server: ``[M]`` int8, the seat that serves first.
        key: ``[M]`` uint64, names the draws of a match; matches with one key share their draws.

    Raises:
        KernelError: arrays of other shapes or kinds of numbers, a negative entrant, or a server that is neither 0 nor 1.
    """

    entrant: I32
    first_server: I8
    key: U64

    def __post_init__(self) -> None:
        size = len(self.key)
        for name, type_, shape, high in (
            ("entrant", np.int32, (size, 2), None), ("first_server", np.int8, (size,), 1), ("key", np.uint64, (size,), None),
        ):  # fmt: skip
            object.__setattr__(self, name, checked_array(name, getattr(self, name), type_, shape, 0, high))

    def __len__(self) -> int:
        return len(self.key)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PlayedMatches:
    """Record of M matches: R rallies of N strokes, in the order of match, rally, stroke.

    Attributes:
        games: ``[M, 2]`` int32 games won by each seat.
        match: ``[R]`` int32 match of each rally, from 0.
        rally: ``[R]`` int32 number of the rally within its match, from 0.
        server: ``[R]`` uint8 seat that served.
        winner: ``[R]`` uint8 seat that won.
        reason: ``[R]`` uint8 how the last stroke ended the rally: FAULT or WINNER of :mod:`shuttle_marl.game.rules`.
        score: ``[R, 4]`` uint8 points of seats 0 and 1 and games of seats 0 and 1 before the rally.
        length: ``[R]`` int32 strokes of each rally.
        stroke: ``[N]`` uint8 (uint16 in a game of more than 256 strokes) catalogue index of every stroke; empty where
            strokes were not kept.
    """

    games: I32
    match: I32
    rally: I32
    server: U8
    winner: U8
    reason: U8
    score: U8
    length: I32
    stroke: UInts


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SingleRallies:
    """R rallies of N strokes, each of which stands for itself, as those of :class:`~shuttle_marl.kernel.RallyBatch`.

    Attributes:
        rally: ``[R]`` int64 number of the rally, which with the seed names its draws.
        opponent: ``[R]`` int32 the learner's opponent; 0 where there is none.
        server: ``[R]`` uint8 seat that served.
        winner: ``[R]`` uint8 seat that won.
        reason: ``[R]`` uint8 how the last stroke ended the rally: FAULT or WINNER of :mod:`shuttle_marl.game.rules`.
        length: ``[R]`` int32 strokes of each rally.
        stroke: ``[N]`` uint8 or uint16 catalogue index of every stroke, rally after rally.
        extra: ``[E, N]`` float32 what was given with the strokes, NaN for those of opponents.
    """

    rally: I64
    opponent: I32
    server: U8
    winner: U8
    reason: U8
    length: I32
    stroke: UInts
    extra: F32


def stroke_type(game: Game) -> np.dtype[np.unsignedinteger]:
    """The narrowest type that holds a catalogue index."""
    return np.dtype(np.uint8 if game.n_strokes <= 256 else np.uint16)


Choose = Callable[[I32, I32, I32, I32, I32], Intp]
"""``(entrant [B], state [B], draw [B], striker [B], score [4, B]) -> [B]``: which of its legal strokes each striker plays.

``striker`` is the seat; ``score`` holds points of seats 0 and 1 and games of seats 0 and 1.
"""

_MATCH, _STATE, _STRIKER, _STROKE, _RALLY, _SERVER, _POINTS, _GAMES = 0, 1, 2, 3, 4, 5, 6, 8
_ROWS: Final = 10
_REPORT_EVERY: Final = 64


def play(
    game: Game,
    matches: Matches,
    choose: Choose,
    *,
    rules: Rules = BWF,
    keep_strokes: bool = True,
    progress: Callable[[int], None] | None = None,
) -> PlayedMatches:
    """Play all matches to their end.

    Args:
        game: the tables.
        matches: who plays whom, who serves first, and with which draws.
        choose: the strikers' decisions.
        rules: when a game and a match are won.
        keep_strokes: whether to return the strokes, or only their number.
        progress: called now and then with the number of strokes played since the last call.
    """
    log = _MatchLog(len(matches), rules.max_rallies, stroke_type(game))
    games = np.zeros((len(matches), 2), dtype=np.int32)
    entrant = matches.entrant.ravel()
    keys, key_row = np.unique(matches.key, return_inverse=True)
    names = 2 * (log.longest + 1)
    rally_key = draws.extend(keys[:, None], np.arange(names)).ravel()  # by 2 * rally + server
    key_row = key_row * names

    slots = np.zeros((_ROWS, len(matches)), dtype=np.int32)
    slots[_MATCH] = np.arange(len(matches))
    slots[_STATE] = ROOT
    slots[_STRIKER] = slots[_SERVER] = matches.first_server
    key = rally_key[key_row + slots[_SERVER]]
    unreported = 0
    while alive := slots.shape[1]:
        match, state, striker, stroke = slots[: _STROKE + 1]
        bits = draws.draw(key, stroke)
        k = choose(entrant[2 * match + striker], state, draws.choice_draw(bits), striker, slots[_POINTS:])
        if keep_strokes:
            log.write_strokes(match, game.stroke_at(state, k))
        outcome, following = strike(game, state, k, draws.outcome_draw(bits))
        stroke += 1
        ended = np.flatnonzero(following < 0)
        if len(ended):
            now = slots[:, ended]
            won_by = np.where(outcome[ended] == WINNER, now[_STRIKER], 1 - now[_STRIKER])
            log.write_rallies(now, won_by, outcome[ended])
            over = _count_rally(now, won_by, rules)
            slots[:, ended] = now
            key[ended] = rally_key[key_row[now[_MATCH]] + 2 * now[_RALLY] + now[_SERVER]]
        continues = following >= 0
        np.copyto(state, following, where=continues)
        striker ^= continues
        if len(ended) and over.any():
            games[now[_MATCH, over]] = now[_GAMES:, over].T
            slots, key = _without(ended[over], slots, key)
        unreported += alive
        if progress is not None and (unreported > _REPORT_EVERY * len(matches) or not slots.shape[1]):
            progress(unreported)
            unreported = 0
    return log.read(games)


def ask(policy: Policy, name: str, game: Game, state: I32, draw: I32, striker: I32, score: I32) -> Intp:
    """Which of its legal strokes a policy plays that has to be asked; for :data:`Choose`, whose arrays it takes.

    Raises:
        PolicyError: the policy raised, or returned no distribution over the legal strokes; ``name`` says which one.
    """
    # Points and games as the strikers see them: own first.
    seats, column = np.stack([striker, 1 - striker]), np.arange(len(striker))
    seen = np.concatenate([score[seats, column], score[2 + seats, column]]).T.astype(np.int16)
    states = States(game=game, state=state, score=seen)
    rank = game.rank(state, drawn_strokes(checked_probabilities(policy, states, name), draw))
    if (rank < 0).any():
        raise PolicyError(f"policy {name!r}: no legal stroke was drawn")
    return rank.astype(np.intp)


def _count_rally(now: I32, won_by: Intp, rules: Rules) -> Bools:
    """Count a rally in each column of ``now`` and set up the next one; returns which matches are over."""
    column = np.arange(now.shape[1])
    own, other, games = _POINTS + won_by, _POINTS + 1 - won_by, _GAMES + won_by
    counted = count_rally(now[own, column], now[other, column], now[games, column], rules)
    now[own, column], now[games, column] = counted.points, counted.games
    now[_POINTS:_GAMES, counted.game_won] = 0
    now[_STATE], now[_STROKE] = ROOT, 0
    now[_STRIKER] = now[_SERVER] = won_by
    now[_RALLY] += 1
    over: Bools = counted.match_won
    return over


def _without(gone: Intp, slots: I32, key: U64) -> tuple[I32, U64]:
    """Slots and keys without some columns: what stands at the end moves into the gaps, and the rest is cut off."""
    alive = len(key) - len(gone)
    moved = np.setdiff1d(np.arange(alive, len(key)), gone, assume_unique=True)
    gaps = gone[gone < alive]
    slots[:, gaps], key[gaps] = slots[:, moved], key[moved]
    return slots[:, :alive], key[:alive]


class _MatchLog:
    """Collects rallies at (match, rally) and strokes at (step, match), and reads them out in order."""

    def __init__(self, n_matches: int, longest: int, type_: np.dtype[np.unsignedinteger]) -> None:
        self.longest = longest
        self._shape = (n_matches, longest)
        size = n_matches * longest
        self._server, self._winner, self._reason = (np.zeros(size, dtype=np.uint8) for _ in range(3))
        self._score = np.zeros((size, 4), dtype=np.uint8)
        self._length = np.zeros(size, dtype=np.int32)
        self._stroke_type = type_
        self._steps: list[UInts] = []

    def write_strokes(self, match: I32, stroke: I32) -> None:
        row = np.empty(self._shape[0], dtype=self._stroke_type)
        row[match] = stroke
        self._steps.append(row)

    def write_rallies(self, now: I32, won_by: Intp, reason: I8) -> None:
        at = now[_MATCH] * self.longest + now[_RALLY]
        self._server[at] = now[_SERVER]
        self._winner[at] = won_by
        self._reason[at] = reason
        self._score[at] = now[_POINTS:].T
        self._length[at] = now[_STROKE]

    def read(self, games: I32) -> PlayedMatches:
        at = np.flatnonzero(self._length)
        match, rally = np.divmod(at, self.longest)
        total = self._length.reshape(self._shape).sum(axis=1)
        stroke = np.empty(0, dtype=self._stroke_type)
        if self._steps:
            stroke = np.stack(self._steps, axis=1)[np.arange(len(self._steps)) < total[:, None]]
        return PlayedMatches(
            games=games,
            match=match.astype(np.int32),
            rally=rally.astype(np.int32),
            server=self._server[at],
            winner=self._winner[at],
            reason=self._reason[at],
            score=self._score[at],
            length=self._length[at],
            stroke=stroke,
        )
