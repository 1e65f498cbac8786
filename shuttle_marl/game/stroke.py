"""The vocabulary of strokes and the catalogue of those that players use.

A stroke is shot type x target area x contact height x technique. The catalogue is a fixed, versioned list; an action
of every environment is an index into it, and every stroke has a readable name such as
``smash:middle-left:above:forehand``.
"""

import dataclasses
import functools
from collections.abc import Iterable, Sequence
from typing import Any, Final, TypeVar

import numpy as np
import numpy.typing as npt

from shuttle_marl.base.arrays import I8, I16, Bools
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import content_hash
from shuttle_marl.game.court import AREAS, mirrored

A = TypeVar("A", bound=np.generic)


def frozen(array: npt.NDArray[A]) -> npt.NDArray[A]:
    """The numbers of an array in memory that can never be made writable; a frozen array is not copied again."""
    if isinstance(array.base, bytes) and array.flags.c_contiguous and not array.flags.writeable:
        return array
    return np.ndarray(array.shape, array.dtype, array.tobytes())


SHOTS: Final = (  # shot types; the first two are the serves
    "short-serve",
    "long-serve",
    "clear",
    "lift",
    "drop",
    "smash",
    "half-smash",
    "drive",
    "push",
    "net-kill",
    "net-shot",
    "block",
    "cross-court-net-shot",
)
HEIGHTS: Final = ("below", "above")  # height of the contact relative to the top of the net
TECHNIQUES: Final = ("forehand", "backhand", "around-the-head")
AROUND_THE_HEAD: Final = TECHNIQUES.index("around-the-head")

ATTACKS: Final = ("smash", "half-smash")  # shot types that cost effort
FRONT_COURT: Final = ("net-kill", "net-shot", "cross-court-net-shot")  # nobody can play them from the back third of the court
NET_SHOTS: Final = ("net-shot", "cross-court-net-shot")  # shot types of a duel at the net

N_SHOTS: Final = len(SHOTS)
N_SERVES: Final = 2
N_TECHNIQUES: Final = len(TECHNIQUES)


class UnknownStrokeError(ShuttleError):
    """A name or a combination that is not in the catalogue."""


@dataclasses.dataclass(frozen=True, eq=False)
class Catalogue:
    """The strokes that can be played, in a fixed order; serves come first.

    Attributes:
        shot: ``[n]`` index into :data:`SHOTS`.
        area: ``[n]`` index into :data:`shuttle_marl.game.court.AREAS`, the intended target.
        height: ``[n]`` 0 below, 1 above the net.
        technique: ``[n]`` index into :data:`TECHNIQUES`.
    """

    shot: I8
    area: I8
    height: I8
    technique: I8

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            object.__setattr__(self, field.name, frozen(getattr(self, field.name)))

    def __repr__(self) -> str:
        return f"Catalogue(version={self.version!r}, n_strokes={len(self)})"

    def __reduce__(self) -> tuple[Any, ...]:
        return Catalogue, (self.shot, self.area, self.height, self.technique)

    @classmethod
    def from_names(cls, names: Iterable[str]) -> "Catalogue":
        """A catalogue of stroke names, in their order. Raises UnknownStrokeError: no ``shot:area:height:technique``, or twice."""
        names = list(names)
        if len(set(names)) != len(names):
            raise UnknownStrokeError("a stroke name stands in the catalogue twice")
        parts = np.array([parse(name) for name in names], dtype=np.int8).reshape(-1, 4)
        return cls(*(np.ascontiguousarray(column) for column in parts.T))

    def __len__(self) -> int:
        return len(self.shot)

    @functools.cached_property
    def names(self) -> tuple[str, ...]:
        """Readable names, in order."""
        rows = zip(self.shot, self.area, self.height, self.technique, strict=True)
        return tuple(f"{SHOTS[s]}:{AREAS[a]}:{HEIGHTS[h]}:{TECHNIQUES[t]}" for s, a, h, t in rows)

    @functools.cached_property
    def is_serve(self) -> Bools:
        """``[n]`` whether a stroke is a serve."""
        return frozen(self.shot < N_SERVES)

    @functools.cached_property
    def is_attack(self) -> Bools:
        """``[n]`` whether a stroke is an attack, which costs effort: a smash or a half-smash."""
        return frozen(np.isin(self.shot, [SHOTS.index(shot) for shot in ATTACKS]))

    @functools.cached_property
    def is_net_shot(self) -> Bools:
        """``[n]`` whether a stroke is a net shot, straight or cross-court: the strokes of a duel at the net."""
        return frozen(np.isin(self.shot, [SHOTS.index(shot) for shot in NET_SHOTS]))

    @functools.cached_property
    def other_side(self) -> I16:
        """``[n]`` index of the same stroke to the other side of the receiver; the stroke itself where there is none."""
        other = self.by_parts[self.shot, mirrored(self.area), self.height, self.technique]
        return frozen(np.where(other < 0, np.arange(len(other), dtype=np.int16), other))

    @functools.cached_property
    def version(self) -> str:
        """First 12 hex digits of the SHA-256 of the names."""
        return content_hash("\n".join(self.names).encode())[:12]

    def index(self, name: str) -> int:
        """Index of a stroke by name. Raises UnknownStrokeError: not in the catalogue."""
        try:
            return self._index_by_name[name]
        except KeyError:
            parse(name)  # says which part is misspelt, if one is
            raise UnknownStrokeError(f"{name!r} is not in catalogue {self.version}: elite players use it too rarely") from None

    @functools.cached_property
    def _index_by_name(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.names)}

    @functools.cached_property
    def by_parts(self) -> I16:
        """``[13, 9, 2, 3]`` catalogue index of every combination, -1 where there is none."""
        table = np.full((N_SHOTS, len(AREAS), len(HEIGHTS), N_TECHNIQUES), -1, dtype=np.int16)
        table[self.shot, self.area, self.height, self.technique] = np.arange(len(self))
        return frozen(table)


def parse(name: str) -> tuple[int, int, int, int]:
    """Split ``shot:area:height:technique`` into indices. Raises UnknownStrokeError: wrong number of parts, or an unknown part."""
    vocabularies: Sequence[tuple[str, tuple[str, ...]]] = (
        ("shot type", SHOTS),
        ("area", AREAS),
        ("height", HEIGHTS),
        ("technique", TECHNIQUES),
    )
    parts = name.split(":")
    if len(parts) != len(vocabularies):
        raise UnknownStrokeError(f"{name!r}: a stroke is named shot:area:height:technique")
    for part, (kind, words) in zip(parts, vocabularies, strict=True):
        if part not in words:
            raise UnknownStrokeError(f"{name!r}: unknown {kind} {part!r}; expected one of {', '.join(words)}")
    s, a, h, t = (words.index(part) for part, (_, words) in zip(parts, vocabularies, strict=True))
    return s, a, h, t
