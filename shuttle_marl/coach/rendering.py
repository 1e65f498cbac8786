"""Pages from templates, which hold the prose and the order of the reports."""

from collections.abc import Iterable, Mapping
from typing import Any, Final, NamedTuple

from markupsafe import Markup

from shuttle_marl.analysis.waits import LEAST_METRES
from shuttle_marl.coach import charts, waits
from shuttle_marl.coach.words import between, metres, of_100, parts, ranged, signed, words
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.recovery import ACROSS, DEPTHS
from shuttle_marl.game.shipped import RELIABLE
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.pages import Heading, Viewer, render

DRILLS: Final = 3
"""Number of drills."""


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
    return list({drill.kind: drill for drill in [*asked][::-1]}.values())[::-1][:DRILLS]


def page(template: str, content: Mapping[str, Any], *, rallies: str = "", viewer: Viewer | None = None) -> bytes:
    """The page of a report.

    Args:
        template: its file name.
        content: figures that the template shows.
        rallies: staged rallies, as JSON that cannot end a script element; empty: none.
        viewer: program that plays them.
    """
    say = words()
    figures = (between, metres, of_100, parts, ranged, signed, waits.differences, waits.distance, waits.shares)
    return render(
        __package__ or "",
        template,
        assets=("coach.css", "coach.js"),
        viewer=viewer,
        rallies=Markup(rallies.replace("<", "\\u003c")),
        say=say,
        language=say("language.tag"),
        save_table=say("report.save_table"),
        charts=charts,
        heading=Heading,
        AREAS=AREAS,
        SHOTS=SHOTS,
        constants={"RELIABLE": RELIABLE, "LEAST_METRES": LEAST_METRES, "DEPTHS": DEPTHS, "ACROSS": ACROSS},
        **{function.__name__: function for function in (*figures, waits.shown_differences)},
        **content,
    )
