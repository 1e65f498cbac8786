"""Where players wait: the figures of the section of both reports."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from shuttle_marl.analysis.waits import Wait
from shuttle_marl.coach.words import metres, of_100, words
from shuttle_marl.game.court import N_SIDES


class Difference(NamedTuple):
    """A difference of a player from others that the data support: where they wait, and its size and interval [m]."""

    wait: Wait
    kind: str
    value: float
    low: float
    high: float


def differences(found: Sequence[Wait], *, match: bool) -> list[Difference]:
    """The largest first. ``match``: the players are each other's only opponents, so a difference is named for one of them."""
    first = {wait.shot for wait in found if wait.player == 0}
    named = [each for wait in found if not (match and wait.player and wait.shot in first) for each in _named(wait)]
    return sorted(named, key=lambda each: -each.value)


def _named(wait: Wait) -> Iterator[Difference]:
    for place, kinds in ((wait.depth, ("closer", "farther")), (wait.side, ("backhand", "forehand"))):
        if place.clear:
            value, *interval = place.difference
            yield Difference(wait, kinds[value > 0], abs(value), *sorted(map(abs, interval)))


def shown_differences(wait: Wait) -> str:
    """What the data support, as short texts with commas between them."""
    say = words()
    parts = [say(f"waits.shown_{each.kind}", metres=metres(each.value)) for each in _named(wait)]
    return say.listed(parts) or say("waits.same")


def distance(wait: Wait) -> str:
    """The mean distance from the net with its interval, if it is known."""
    value, low, high = map(metres, wait.depth.mean)
    return value if np.isnan(wait.depth.mean.low) else words()("report.interval", value=value, low=low, high=high)


def shares(wait: Wait, axis: int) -> str:
    """Shares by depth (``axis`` 1) or by side (0)."""
    return " / ".join(of_100(share) for share in np.reshape(wait.positions, (-1, N_SIDES)).sum(axis=axis).tolist())
