"""Drills for the week."""

from collections.abc import Iterable
from typing import Final, NamedTuple

DRILLS: Final = 3


class Drill(NamedTuple):
    """A stroke to train.

    Attributes:
        shot: shot type that is fed; None: the player serves.
        area: where the player meets it; -1: the player serves.
        stroke: catalogue index of the stroke to play.
        kind: shot type of that stroke.
    """

    shot: str | None
    area: int
    stroke: int
    kind: int


def drills(asked: Iterable[Drill]) -> list[Drill]:
    """Three drills of different kinds, the first ones where there are more."""
    found = list(asked)
    kinds = [(drill.shot, drill.kind) for drill in found]
    order = sorted(range(len(found)), key=lambda i: (kinds[i] in kinds[:i], i))
    return [found[i] for i in order[:DRILLS]]
