"""The picture of a rally from above the court, for ``render_mode="rgb_array"`` and ``"human"``."""

import itertools
from typing import Any, Final

import numpy as np

from shuttle_marl.arrays import U8
from shuttle_marl.env.painting import (
    GREEN,
    INK,
    PLAYERS,
    RED,
    SIZE,
    WHITE,
    XY,
    YELLOW,
    Layer,
    Picture,
    paint_boxes,
    paint_stage,
    pygame,
    write_overlay,
)
from shuttle_marl.env.snapshot import Flight, Plan, Point, Snapshot, area_corners, plan_of
from shuttle_marl.game.court import HALF_LENGTH, HALF_WIDTH, LENGTH, LONG_SERVICE, SHORT_SERVICE, WIDTH
from shuttle_marl.game.rules import FAULT, WINNER

PX: Final = 51.0
"""Pixels per metre."""
CENTRE: Final = (450.0, 292.0)
"""Position of the middle of the net in the picture."""
MAT: Final = (18, 114, 87)
MAT_DARK: Final = (14, 93, 72)
LINE: Final = (222, 236, 230)

_LINE_WIDTH: Final = 0.05 * PX
_RISE: Final = 17.0
"""Pixels that a flight is lifted for each metre of height."""
_FADE: Final = (1.0, 0.62, 0.42, 0.28, 0.16)
"""Opacity of the last flights, newest first."""


def px(point: Point) -> XY:
    """A point of the plan in the picture."""
    return CENTRE[0] + PX * point[0], CENTRE[1] + PX * point[1]


def paint_court(layer: Layer) -> None:
    """Mat, lines and net, in the proportions of the Laws."""
    margin = 1.0
    left, top = px((-HALF_LENGTH - margin, -WIDTH / 2 - margin))
    layer.rect(left, top, PX * (LENGTH + 2 * margin), PX * (WIDTH + 2 * margin), MAT_DARK, radius=10)
    left, top = px((-HALF_LENGTH, -WIDTH / 2))
    layer.rect(left, top, PX * LENGTH, PX * WIDTH, MAT)
    across = [s * x for x in (HALF_LENGTH, HALF_LENGTH - LONG_SERVICE, SHORT_SERVICE) for s in (-1, 1)]
    for x in across:
        layer.line(px((x, -WIDTH / 2)), px((x, WIDTH / 2)), _LINE_WIDTH, LINE)
    for y in (-WIDTH / 2, -HALF_WIDTH, HALF_WIDTH, WIDTH / 2):
        layer.line(px((-HALF_LENGTH, y)), px((HALF_LENGTH, y)), _LINE_WIDTH, LINE)
    for side in (-1, 1):
        layer.line(px((side * SHORT_SERVICE, 0)), px((side * HALF_LENGTH, 0)), _LINE_WIDTH, LINE)


def paint_net(layer: Layer) -> None:
    """The net with its posts, above everything on the floor."""
    overhang = WIDTH / 2 + 0.05
    layer.line(px((0.06, -overhang)), px((0.06, overhang)), 5, INK, 90)
    layer.line(px((0, -overhang)), px((0, overhang)), 3.2, WHITE)
    for y in np.arange(-overhang, overhang, 0.16):
        layer.line(px((0, y)), px((0, y + 0.04)), 3.2, (150, 165, 175))
    for y in (-overhang, overhang):
        layer.circle(px((0, y)), 5.5, INK)
        layer.circle(px((0, y)), 4, (200, 208, 216))


def paint_target(layer: Layer, player: int, area: int) -> None:
    """The nine areas that a player can aim at, the chosen one filled."""
    for other in range(9):
        (x0, y0), (x1, y1) = (px(corner) for corner in area_corners(player, other))
        left, top, w, h = min(x0, x1), min(y0, y1), abs(x1 - x0), abs(y1 - y0)
        if other == area:
            layer.rect(left, top, w, h, YELLOW, 88)
            layer.frame(left, top, w, h, YELLOW, width=1.8)
        else:
            layer.frame(left, top, w, h, LINE, 46, width=1)


def flight_points(flight: Flight, count: int = 48) -> list[XY]:
    """A flight in the picture, lifted by its height."""
    start, end = np.array(px(flight.start)), np.array(px(flight.end))
    t = np.linspace(0, 1, count)[:, None]
    # A shuttle slows down so much that it is highest well behind the middle of its flight.
    height = flight.peak * 6.75 * t**2 * (1 - t)
    points = start + t * (end - start) - np.concatenate([np.zeros_like(t), height * _RISE], axis=1)
    return [(float(x), float(y)) for x, y in points]


def paint_shadows(layer: Layer, flights: tuple[Flight, ...]) -> None:
    """The straight path of the last flights on the floor."""
    for age, flight in enumerate(reversed(flights[-2:])):
        layer.line(px(flight.start), px(flight.end), 2.0, INK, 70 - 35 * age)


def paint_flights(layer: Layer, flights: tuple[Flight, ...]) -> None:
    """The last flights in the colour of who struck them, older ones fainter, each brighter and wider towards its end."""
    recent = list(zip(_FADE, reversed(flights), strict=False))
    for strength, flight in reversed(recent):
        points = flight_points(flight)
        colour = PLAYERS[flight.stroke.player]
        newest = strength == 1.0
        for i, (a, b) in enumerate(itertools.pairwise(points)):
            t = i / (len(points) - 1)
            if flight.stroke.outcome == FAULT and i % 4 >= 2:
                continue
            alpha = round(255 * strength * (0.45 + 0.55 * t))
            layer.line(a, b, (1.6 + 3.0 * t) if newest else 2.0, colour, alpha)
        layer.circle(points[0], 3.4 if newest else 2.4, colour, round(255 * max(strength, 0.25)))


def paint_player(layer: Layer, body: Point, facing: Point, player: int, active: bool) -> None:
    """A player from above: shoulders, head, and the racket towards the shuttle."""
    at, size = np.array(px(body)), 1.25
    ahead = np.array(px(facing)) - at
    ahead /= max(1e-9, float(np.hypot(*ahead)))
    side = np.array([-ahead[1], ahead[0]])
    colour = PLAYERS[player]
    dark = (colour[0] // 2, colour[1] // 2, colour[2] // 2)

    def point(forward: float, right: float) -> XY:
        x, y = at + size * (forward * ahead + right * side)
        return float(x), float(y)

    if active:
        layer.circle(point(0, 0), 26, colour, 60)
        layer.circle(point(0, 0), 26, colour, 230, width=2)
    layer.circle((point(0, 0)[0] + 3, point(0, 0)[1] + 5), 15, INK, 90)
    grip, tip = point(9, 11), point(24, 11)
    layer.line(point(0, 10), grip, 6, dark)
    layer.line(grip, tip, 2.2, WHITE)
    layer.circle(point(30, 11), 8, WHITE, 80)
    layer.circle(point(30, 11), 8, WHITE, 255, width=1.5)
    angles = np.linspace(0, 2 * np.pi, 28, endpoint=False)
    shoulders = [point(7.0 * float(np.cos(angle)), 14.0 * float(np.sin(angle))) for angle in angles]
    layer.polygon(shoulders, colour)
    layer.circle(point(1.5, 0), 8, INK)
    layer.circle(point(1.5, 0), 6.8, (238, 205, 175))


def paint_steps(layer: Layer, plan: Plan) -> None:
    """Steps of the players since the last contact."""
    for player in (0, 1):
        came_from = plan.came_from[player]
        if came_from is not None:
            a, b = np.array(px(came_from)), np.array(px(plan.bodies[player]))
            for t in np.arange(0.0, 1.0, 0.14):
                x, y = a + t * (b - a)
                layer.circle((float(x), float(y)), 2.2, PLAYERS[player], round(50 + 110 * t))


def paint_shuttle(layer: Layer, plan: Plan) -> None:
    """The shuttle, cork first, with a mark that says how the rally ended there."""
    at = np.array(px(plan.shuttle))
    direction = np.array([1.0, 0.0])
    if plan.flights:
        flight = plan.flights[-1]
        points = flight_points(flight)
        direction = np.subtract(points[-1], points[-3])
        direction = direction / max(1e-9, float(np.hypot(*direction)))
        centre = (float(at[0]), float(at[1]))
        if flight.stroke.outcome == WINNER:
            for radius, alpha in ((26, 90), (18, 170), (10, 255)):
                layer.circle(centre, radius, GREEN, alpha, width=2)
        elif flight.stroke.outcome == FAULT:
            for a in (-1, 1):
                layer.line((centre[0] - 9, centre[1] - 9 * a), (centre[0] + 9, centre[1] + 9 * a), 4, RED)
            return
    side = np.array([-direction[1], direction[0]])
    skirt = [at - 11 * direction + 6.5 * side, at - 11 * direction - 6.5 * side, at - 1 * direction - 2.4 * side]
    skirt.append(at - 1 * direction + 2.4 * side)
    layer.polygon([(float(x), float(y)) for x, y in skirt], WHITE)
    layer.circle((float(at[0]), float(at[1])), 3.4, YELLOW)


class CourtRenderer:
    """Draws snapshots; opens a window when first asked to show one."""

    def __init__(self, title: str, *, fps: float) -> None:
        self._title = title
        self._fps = fps
        self._background: Any = None
        self._window: Any = None
        self._clock: Any = None
        self._dismissed = False

    def frame(self, snapshot: Snapshot) -> U8:
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
        plan = plan_of(snapshot)
        picture = Picture(SIZE, self._background)
        floor, air, players, boxes = (Layer(SIZE) for _ in range(4))
        if snapshot.strokes:
            last = snapshot.strokes[-1]
            paint_target(floor, last.player, int(snapshot.game.catalogue.area[last.stroke]))
        paint_shadows(floor, plan.flights)
        paint_steps(floor, plan)
        paint_net(floor)
        paint_flights(air, plan.flights)
        for player in (0, 1):
            paint_player(players, plan.bodies[player], plan.shuttle, player, active=snapshot.striker == player)
        paint_shuttle(players, plan)
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
