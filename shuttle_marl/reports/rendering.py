"""Pages from templates, which hold the prose and the order of the reports, and the figures that only templates ask for."""

import importlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from markupsafe import Markup

from shuttle_marl.game.court import AREAS, N_SIDES
from shuttle_marl.game.recovery import ACROSS, DEPTHS
from shuttle_marl.game.shipped import RELIABLE
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.reports import charts
from shuttle_marl.reports.html import Heading, Viewer, render
from shuttle_marl.reports.waits import LEAST_METRES, Wait
from shuttle_marl.reports.words import between, metres, of_100, parts, ranged, signed, words

DRILLS: Final = 3
"""Number of drills."""


class Clips(NamedTuple):
    """Staged rallies that a page plays.

    Attributes:
        content: the rallies, as JSON; empty: none.
        viewer: program that plays them.
        reason: why there is none.
        shown: rallies of a match that it plays, by their index.
        numbers: of the rallies of a match on the live court, from 0, by their index; empty: they cannot be shown there.
    """

    content: str = ""
    viewer: Viewer | None = None
    reason: str = ""
    shown: Sequence[int] = ()
    numbers: Mapping[int, int] = {}


def court() -> Any:
    """What stages the rallies of a page, :mod:`shuttle_marl.watch.clips`: above this room, so imported by its name."""
    return importlib.import_module("shuttle_marl.watch.clips")


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
    """The first drills of different kinds."""
    first: dict[int, Drill] = {}
    for drill in asked:
        first.setdefault(drill.kind, drill)
    return [*first.values()][:DRILLS]


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


def page(template: str, clips: Clips, content: Mapping[str, Any]) -> bytes:
    """The page of a report.

    Args:
        template: its file name.
        content: figures that the template shows.
    """
    say = words()
    figures = (between, metres, of_100, parts, ranged, signed, differences, distance, shares, shown_differences)
    return render(
        __package__ or "",
        template,
        assets=("coach.css", "coach.js"),
        viewer=clips.viewer,
        rallies=Markup(clips.content.replace("<", "\\u003c")),
        reason=clips.reason,
        say=say,
        language=say("language.tag"),
        save_table=say("report.save_table"),
        charts=charts,
        heading=Heading,
        AREAS=AREAS,
        SHOTS=SHOTS,
        constants={"RELIABLE": RELIABLE, "LEAST_METRES": LEAST_METRES, "DEPTHS": DEPTHS, "ACROSS": ACROSS},
        **{function.__name__: function for function in figures},
        **content,
    )
