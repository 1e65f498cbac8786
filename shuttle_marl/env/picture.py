"""The picture of a rally from above the court, for ``render_mode="rgb_array"`` and ``"human"``."""

from typing import Any

import numpy as np
import numpy.typing as npt

from shuttle_marl.env.court_picture import (
    paint_court,
    paint_flights,
    paint_net,
    paint_player,
    paint_shadows,
    paint_shuttle,
    paint_steps,
    paint_target,
)
from shuttle_marl.env.overlay import SIZE, paint_boxes, paint_stage, write_overlay
from shuttle_marl.env.painting import Layer, Picture, pygame
from shuttle_marl.env.scene import scene_of
from shuttle_marl.env.snapshot import Snapshot


class CourtRenderer:
    """Draws snapshots; opens a window when first asked to show one."""

    def __init__(self, title: str, *, fps: float) -> None:
        self._title = title
        self._fps = fps
        self._background: Any = None
        self._window: Any = None
        self._clock: Any = None
        self._dismissed = False

    def frame(self, snapshot: Snapshot) -> npt.NDArray[np.uint8]:
        """``[584, 1200, 3]`` picture."""
        pixels = pygame.surfarray.array3d(self._paint(snapshot))
        return np.ascontiguousarray(pixels.swapaxes(0, 1))

    def show(self, snapshot: Snapshot) -> None:
        """Show the picture for one frame; does nothing once the user has closed the window."""
        if self._dismissed:
            return
        if self._window is None:
            pygame.display.init()
            pygame.display.set_caption(f"shuttle_marl {self._title}")
            self._window = pygame.display.set_mode(SIZE)
            self._clock = pygame.time.Clock()
        self._window.blit(self._paint(snapshot), (0, 0))
        pygame.display.flip()
        if any(event.type == pygame.QUIT for event in pygame.event.get()):
            self.close()
            self._dismissed = True
            return
        self._clock.tick(self._fps)

    def close(self) -> None:
        """Close the window."""
        if self._window is not None:
            pygame.display.quit()
            self._window = None

    def _paint(self, snapshot: Snapshot) -> Any:
        if self._background is None:
            self._background = _empty_court()
        scene = scene_of(snapshot)
        picture = Picture(SIZE, self._background)
        floor, air, players, boxes = (Layer(SIZE) for _ in range(4))
        if snapshot.strokes:
            last = snapshot.strokes[-1]
            paint_target(floor, last.player, int(snapshot.game.catalogue.area[last.stroke]))
        paint_shadows(floor, scene.flights)
        paint_steps(floor, scene)
        paint_net(floor)
        paint_flights(air, scene.flights)
        for player in (0, 1):
            paint_player(players, scene.bodies[player], scene.shuttle, player, active=snapshot.striker == player)
        paint_shuttle(players, scene)
        paint_boxes(boxes, snapshot)
        for layer in (floor, air, players, boxes):
            picture.put(layer)
        write_overlay(picture, snapshot)
        return picture.surface


def _empty_court() -> Any:
    picture = Picture(SIZE)
    layer = Layer(SIZE)
    paint_stage(layer)
    paint_court(layer)
    picture.put(layer)
    return picture.copy_large()
