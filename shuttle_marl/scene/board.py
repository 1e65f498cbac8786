"""Scoreboards, one in the picture of each camera of the layouts."""

import textwrap
from typing import Final

from foxglove.messages import SceneEntity

from shuttle_marl.scene.rally_report import RallyReport
from shuttle_marl.scene.topics import BOARDS, WORLD, Timed, colour, entities_on, label, place_frame, stamp

COLUMNS: Final = 28
"""Characters in a line of the board."""
_MOST_LINES: Final = 3
"""Lines of one name."""
_LEAST_ROWS: Final = 7
"""Rows of the board, so that its height is the same at every stroke."""
_PIXELS: Final = 16
_SHADE: Final = colour(0.97, 0.97, 0.97)


PLACES: Final = dict(
    zip(
        BOARDS,
        ((WORLD, (-4.878, -0.036, 4.041)), (WORLD, (-2.389, -5.321, 4.67)), (place_frame(0), (-2.203, -0.925, 2.666))),
        strict=True,
    )
)
"""Of each scoreboard the frame of reference and the centre [m]: at the upper left in the picture of its camera in the layouts."""


def name_lines(name: str, width: int = 22) -> list[str]:
    """A name in at most three lines; longer ones are truncated."""
    return textwrap.wrap(name, width, max_lines=_MOST_LINES, placeholder="…") or [""]


def boards(report: RallyReport, time: int, text: str, *, after: bool = False, marked: int | None = None) -> list[Timed]:
    """Scoreboards of all cameras: names with games and points, seat 0 first, and text below them.

    Args:
        time: time of the messages [ns].
        text: action; lines of any length are wrapped.
        after: whether the points are those after the rally.
        marked: seat that serves or strikes.
    """
    points = report.points_after if after else report.played.points
    rows = []
    for seat in (0, 1):
        games = f"{report.played.games[seat]:>2}" if report.in_match else "  "
        first, *others = name_lines(report.names[seat], COLUMNS - 8)
        rows += [
            f"{'>' if seat == marked else ' '} {first:<{COLUMNS - 8}}{games} {points[seat]:>3}",
            *(f"  {line}" for line in others),
        ]
    rows.append("")
    for line in text.split("\n"):
        rows += textwrap.wrap(line, COLUMNS)
    rows += [""] * (_LEAST_ROWS - len(rows))
    block = "\n".join(row.ljust(COLUMNS) for row in rows)
    out = []
    for topic, (frame, place) in PLACES.items():
        shown = label(block, place, _PIXELS, _SHADE)
        entity = SceneEntity(id="board", timestamp=stamp(time), frame_id=frame, frame_locked=True, texts=[shown])
        out.append(entities_on(topic, time, [entity]))
    return out
