"""Pages from templates, which hold the prose and the order of the reports."""

from collections.abc import Mapping
from typing import Any

from markupsafe import Markup

from shuttle_marl.analysis.waits import LEAST_METRES
from shuttle_marl.coach import charts, waits
from shuttle_marl.coach.words import between, metres, of_100, parts, ranged, signed, words
from shuttle_marl.game.recovery import ACROSS, DEPTHS
from shuttle_marl.game.shipped import RELIABLE
from shuttle_marl.pages import Heading, Viewer, render


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
        constants={"RELIABLE": RELIABLE, "LEAST_METRES": LEAST_METRES, "DEPTHS": DEPTHS, "ACROSS": ACROSS},
        **{function.__name__: function for function in (*figures, waits.shown_differences)},
        **content,
    )
