"""Cameras of the layouts, and the scoreboard in the picture of each."""

import dataclasses
import textwrap
from typing import Final

import numpy as np
from foxglove.messages import SceneEntity

from shuttle_marl.scene.rally_report import RallyReport
from shuttle_marl.scene.topics import BOARDS, WORLD, Timed, colour, entities_on, label, place_frame, stamp

COLUMNS: Final = 28
"""Characters in a line of the board."""
_MOST_LINES: Final = 3
"""Lines of one name."""
_LEAST_ROWS: Final = 7
"""Rows of the board, so that its height is the same at every stroke."""
_CENTRE: Final = (-0.95, 0.58)
"""Centre of the board relative to the centre of the picture, to the right and up, in halves of the picture's height."""
_PIXELS: Final = 16
_SHADE: Final = colour(0.97, 0.97, 0.97)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Camera:
    """A camera of the 3D panel. Angles in degrees, lengths in metres.

    Attributes:
        board: topic of the scoreboard in its picture.
        phi: angle between the vertical and the direction from the target to the camera.
        theta: azimuth; 0 looks along the court from behind seat 0.
        fovy: vertical field of view.
        target: centre of the picture, in the frame of reference.
        frame: frame of reference of target and scoreboard; the camera moves with it.
    """

    title: str
    board: str
    distance: float
    phi: float
    theta: float
    fovy: float
    target: tuple[float, float, float]
    frame: str = WORLD

    def point(self, right: float, up: float) -> tuple[float, float, float]:
        """Point of the frame of reference that appears at an offset from the picture's centre, in halves of its height."""
        phi, theta, half = (float(np.radians(angle)) for angle in (self.phi, self.theta, self.fovy / 2))
        back = np.array([-np.sin(phi) * np.sin(theta), -np.sin(phi) * np.cos(theta), np.cos(phi)])
        sideways = np.array([np.cos(theta), -np.sin(theta), 0.0])
        upwards = np.cross(back, sideways)
        away = np.tan(half) * self.distance
        x, y, z = (np.array(self.target) + away * (right * sideways + up * upwards)).tolist()
        return x, y, z


_BROADCAST, _SIDE, _FOLLOW = BOARDS
CAMERAS: Final = (
    Camera(title="Broadcast", board=_BROADCAST, distance=14.5, phi=67.0, theta=0.0, fovy=39.0, target=(0.0, -1.2, 1.3)),
    Camera(title="Side", board=_SIDE, distance=17.5, phi=74.0, theta=284.0, fovy=36.0, target=(-0.2, -0.3, 1.5)),
    Camera(
        title="Follow",
        board=_FOLLOW,
        distance=6.5,
        phi=78.0,
        theta=330.0,
        fovy=42.0,
        target=(0.0, 0.0, 1.25),
        frame=place_frame(0),
    ),
)


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
    for camera in CAMERAS:
        shown = label(block, camera.point(*_CENTRE), _PIXELS, _SHADE)
        entity = SceneEntity(id="board", timestamp=stamp(time), frame_id=camera.frame, frame_locked=True, texts=[shown])
        out.append(entities_on(camera.board, time, [entity]))
    return out
