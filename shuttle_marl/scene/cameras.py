"""Cameras of the layouts, each with the place of the scoreboard in its picture."""

import dataclasses
from typing import Final

import numpy as np

from shuttle_marl.scene.frames import WORLD, place_frame


@dataclasses.dataclass(frozen=True, kw_only=True)
class Camera:
    """A camera of the 3D panel. Angles in degrees, lengths in metres.

    Attributes:
        title: of its tab.
        distance: from its target.
        phi: between the vertical and the way to the camera.
        theta: 0 looks along the court from behind seat 0.
        fovy: height of the picture.
        target: middle of the picture, in the frame of reference.
        follow: frame of reference with which it moves and turns; None: it stands still.
    """

    title: str
    distance: float
    phi: float
    theta: float
    fovy: float
    target: tuple[float, float, float]
    follow: str | None = None

    @property
    def board(self) -> str:
        """Topic of the scoreboard that stands in this picture."""
        return f"/scene/board_{self.title.lower()}"

    @property
    def frame(self) -> str:
        """Frame of reference in which target and scoreboard stand."""
        return self.follow or WORLD

    def point(self, right: float, up: float) -> tuple[float, float, float]:
        """Point of the frame of reference that is seen so far from the middle of the picture, in halves of its height."""
        phi, theta, half = (float(np.radians(angle)) for angle in (self.phi, self.theta, self.fovy / 2))
        back = np.array([-np.sin(phi) * np.sin(theta), -np.sin(phi) * np.cos(theta), np.cos(phi)])
        sideways = np.array([np.cos(theta), -np.sin(theta), 0.0])
        upwards = np.cross(back, sideways)
        away = np.tan(half) * self.distance
        x, y, z = (np.array(self.target) + away * (right * sideways + up * upwards)).tolist()
        return x, y, z


CAMERAS: Final = (
    Camera(title="Broadcast", distance=14.5, phi=67.0, theta=0.0, fovy=39.0, target=(0.0, -1.2, 1.3)),
    Camera(title="Side", distance=17.5, phi=74.0, theta=284.0, fovy=36.0, target=(-0.2, -0.3, 1.5)),
    Camera(title="Follow", distance=6.5, phi=78.0, theta=330.0, fovy=42.0, target=(0.0, 0.0, 0.3), follow=place_frame(0)),
)
BOARDS: Final = tuple(camera.board for camera in CAMERAS)
