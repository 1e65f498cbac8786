"""Scoreboard of a scene, one in the picture of every camera; names of any length as lines that fit."""

import dataclasses
import math
import textwrap
from typing import Final

from foxglove.messages import SceneEntity

from shuttle_marl.scene.cameras import CAMERAS, Camera
from shuttle_marl.scene.report import RallyReport
from shuttle_marl.scene.topics import Send, colour, entities_on, label, stamp

COLUMNS: Final = 28
"""Letters in a line of the board."""
_MOST_LINES: Final = 3
"""Lines of one name."""
_LEAST_ROWS: Final = 7
"""Rows of the board, so that it does not jump from stroke to stroke."""
_AT: Final = (-0.95, 0.58)
"""Middle of the board from the middle of the picture, to the right and up, in halves of the picture's height."""
_PIXELS: Final = 16
_SHADE: Final = colour(0.97, 0.97, 0.97)


def name_lines(name: str, width: int = 22) -> list[str]:
    """A name in equal parts of at most a width, three at most; only a longer name loses its end."""
    shown = name if len(name) <= _MOST_LINES * width else f"{name[: _MOST_LINES * width - 1]}…"
    length = math.ceil(len(shown) / math.ceil(max(len(shown), 1) / width)) or 1
    return [shown[i : i + length] for i in range(0, len(shown), length)] or [""]


def board_text(report: RallyReport, words: str, *, after: bool, marked: int | None = None) -> str:
    """Names with games and points, seat 0 first, and words below them, as a block of equally long lines.

    Args:
        report: of the rally.
        words: what happens; lines of any length.
        after: whether the points are those after the rally.
        marked: seat that serves or strikes.
    """
    points = report.points_after if after else report.points
    in_match = any(report.games) or report.match or any(report.points)
    rows = []
    for seat in (0, 1):
        games = f"{report.games[seat]:>2}" if in_match else "  "
        first, *others = name_lines(report.names[seat], COLUMNS - 8)
        rows += [
            f"{'>' if seat == marked else ' '} {first:<{COLUMNS - 8}}{games} {points[seat]:>3}",
            *(f"  {line}" for line in others),
        ]
    rows.append("")
    for line in words.split("\n"):
        rows += textwrap.wrap(line, COLUMNS)
    rows += [""] * (_LEAST_ROWS - len(rows))
    return "\n".join(row.ljust(COLUMNS) for row in rows)


def boards(text: str) -> list[Send]:
    """Sender of the board to the picture of every camera."""
    return [entities_on(camera.board, _Board(camera, text)) for camera in CAMERAS]


@dataclasses.dataclass(frozen=True)
class _Board:
    camera: Camera
    text: str

    def __call__(self, time: int) -> list[SceneEntity]:
        # Letters are as large on the screen from everywhere.
        words = label(self.text, self.camera.point(*_AT), _PIXELS, _SHADE)
        return [SceneEntity(id="board", timestamp=stamp(time), frame_id=self.camera.frame, frame_locked=True, texts=[words])]
