"""Arrays that enter and leave compiled code, which reads and writes memory without looking: checks, matches, results.

Needs no compiler, so that a command can show its help without one.
"""

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt

from shuttle_marl.errors import OptionError, ShuttleError, whole_number
from shuttle_marl.game.draws import UInt64s
from shuttle_marl.game.rally import Game


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
