"""Matches to be played, and their results; needs no compiler, so that a command can show its help without one."""

import dataclasses

import numpy as np
import numpy.typing as npt

from shuttle_marl.game.draws import UInt64s
from shuttle_marl.game.rally import Game
from shuttle_marl.kernel.checks import checked_array


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

    entrant: npt.NDArray[np.int32]
    first_server: npt.NDArray[np.int8]
    key: UInt64s

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
        reason: ``[R]`` uint8 how the last stroke ended the rally: FAULT or WINNER of :mod:`shuttle_marl.game.rally`.
        score: ``[R, 4]`` uint8 points of seats 0 and 1 and games of seats 0 and 1 before the rally.
        length: ``[R]`` int32 strokes of each rally.
        stroke: ``[N]`` uint8 (uint16 in a game of more than 256 strokes) catalogue index of every stroke; empty where
            strokes were not kept.
    """

    games: npt.NDArray[np.int32]
    match: npt.NDArray[np.int32]
    rally: npt.NDArray[np.int32]
    server: npt.NDArray[np.uint8]
    winner: npt.NDArray[np.uint8]
    reason: npt.NDArray[np.uint8]
    score: npt.NDArray[np.uint8]
    length: npt.NDArray[np.int32]
    stroke: npt.NDArray[np.unsignedinteger]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SingleRallies:
    """R rallies of N strokes, each of which stands for itself, as those of :class:`~shuttle_marl.kernel.RallyBatch`.

    Attributes:
        rally: ``[R]`` int64 number of the rally, which with the seed names its draws.
        opponent: ``[R]`` int32 the learner's opponent; 0 where there is none.
        server: ``[R]`` uint8 seat that served.
        winner: ``[R]`` uint8 seat that won.
        reason: ``[R]`` uint8 how the last stroke ended the rally: FAULT or WINNER of :mod:`shuttle_marl.game.rally`.
        length: ``[R]`` int32 strokes of each rally.
        stroke: ``[N]`` uint8 or uint16 catalogue index of every stroke, rally after rally.
        extra: ``[E, N]`` float32 what was given with the strokes, NaN for those of opponents.
    """

    rally: npt.NDArray[np.int64]
    opponent: npt.NDArray[np.int32]
    server: npt.NDArray[np.uint8]
    winner: npt.NDArray[np.uint8]
    reason: npt.NDArray[np.uint8]
    length: npt.NDArray[np.int32]
    stroke: npt.NDArray[np.unsignedinteger]
    extra: npt.NDArray[np.float32]


def stroke_type(game: Game) -> np.dtype[np.unsignedinteger]:
    """The narrowest type that holds a catalogue index."""
    return np.dtype(np.uint8 if game.n_strokes <= 256 else np.uint16)
