"""The picture of a rally from above the court, for ``render_mode="rgb_array"`` and ``"human"``."""

import itertools
import os
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import U8
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.extras import install_hint
from shuttle_marl.env.snapshot import (
    Flight,
    Plan,
    Point,
    Snapshot,
    area_corners,
    effort_in_words,
    plan_of,
    shot_in_words,
    standing,
)
from shuttle_marl.game.court import AREAS, HALF_LENGTH, HALF_WIDTH, LENGTH, LONG_SERVICE, SHORT_SERVICE, WIDTH
from shuttle_marl.game.rally.stepper import Stroke
from shuttle_marl.game.rules import FAULT, OUTCOMES, RETURNED_BELOW, WINNER
from shuttle_marl.game.stroke import HEIGHTS, TECHNIQUES

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")


class RenderError(ShuttleError):
    """Pictures cannot be drawn."""


try:
    import pygame
except ImportError as error:
    raise RenderError(
        "render_mode 'human' and 'rgb_array' need pygame, which is not installed ('ansi' works without); "
        + install_hint("render")
    ) from error

__all__ = ["Layer", "Picture", "RenderError", "paint_boxes", "paint_stage", "pygame", "write_overlay"]

Colour = tuple[int, int, int]
XY = tuple[float, float]

INK: Final = (11, 15, 23)
PANEL: Final = (19, 26, 38)
EDGE: Final = (36, 48, 68)
TEXT: Final = (229, 231, 235)
MUTED: Final = (139, 151, 168)
SELECTED: Final = (30, 52, 88)
PLAYERS: Final = ((56, 189, 248), (251, 113, 133))
YELLOW: Final = (251, 191, 36)
GREEN: Final = (52, 211, 153)
RED: Final = (248, 80, 80)
WHITE: Final = (240, 244, 248)

SCALE: Final = 2
"""Painted pixels per pixel of the picture."""
SIZE: Final = (1200, 584)
"""Width and height of the picture [px]."""

_FLOOR: Final = (27, 44, 84)
_STAGE: Final = (12, 12, 876, 560)
_LIST: Final = (900, 12, 288, 560)
_LIST_TOP: Final = 58
_ROW: Final = 27
_ROWS: Final = 17
_SCORE: Final = (24, 24)
_NAME_WIDTH: Final = 126
_EFFORT_WIDTH: Final = 84
_GAME_WIDTH: Final = 34
_CHIP: Final = (24, 514, 46)
_PAD: Final = 14
_SMALL: Final = 15
_NORMAL: Final = 20
_LARGE: Final = 25


class Layer:
    """A transparent sheet in picture coordinates. Paint replaces what is under it on the same sheet."""

    def __init__(self, size: tuple[int, int]) -> None:
        self.surface = pygame.Surface((size[0] * SCALE, size[1] * SCALE), pygame.SRCALPHA)

    def rect(self, x: float, y: float, w: float, h: float, colour: Colour, alpha: int = 255, radius: float = 0) -> None:
        """A filled rectangle with rounded corners."""
        box = pygame.Rect(round(x * SCALE), round(y * SCALE), round(w * SCALE), round(h * SCALE))
        pygame.draw.rect(self.surface, (*colour, alpha), box, border_radius=round(radius * SCALE))

    def frame(
        self, x: float, y: float, w: float, h: float, colour: Colour, alpha: int = 255, *, width: float, radius: float = 0
    ) -> None:
        """The outline of a rectangle."""
        box = pygame.Rect(round(x * SCALE), round(y * SCALE), round(w * SCALE), round(h * SCALE))
        pygame.draw.rect(self.surface, (*colour, alpha), box, max(1, round(width * SCALE)), border_radius=round(radius * SCALE))

    def circle(self, at: XY, radius: float, colour: Colour, alpha: int = 255, width: float = 0) -> None:
        """A disc, or a ring if it has a width."""
        centre = (at[0] * SCALE, at[1] * SCALE)
        pygame.draw.circle(self.surface, (*colour, alpha), centre, radius * SCALE, round(width * SCALE))

    def polygon(self, points: Sequence[XY], colour: Colour, alpha: int = 255) -> None:
        """A filled polygon."""
        pygame.draw.polygon(self.surface, (*colour, alpha), [(x * SCALE, y * SCALE) for x, y in points])

    def line(self, a: XY, b: XY, width: float, colour: Colour, alpha: int = 255) -> None:
        """A straight stroke with square ends."""
        along = np.subtract(b, a)
        length = float(np.hypot(*along))
        if length > 0:
            side = width / 2 / length * np.array([-along[1], along[0]])
            corners = [np.add(a, side), np.add(b, side), np.subtract(b, side), np.subtract(a, side)]
            self.polygon([(float(x), float(y)) for x, y in corners], colour, alpha)


class Picture:
    """An opaque picture: layers first, then text at its final size."""

    def __init__(self, size: tuple[int, int], background: Any = None) -> None:
        self.size = size
        self._large = background.copy() if background is not None else pygame.Surface((size[0] * SCALE, size[1] * SCALE))
        if background is None:
            self._large.fill(INK)
        self._small: Any = None

    def put(self, layer: Layer) -> None:
        """Lay a sheet on top."""
        self._large.blit(layer.surface, (0, 0))

    def copy_large(self) -> Any:
        """The picture before scaling, as a background for others."""
        return self._large.copy()

    def write(self, text: str, at: XY, size: int, colour: Colour = TEXT, anchor: str = "midleft") -> float:
        """Write a line of text; returns its width. ``anchor`` names the point of the text that lies at ``at``."""
        large = font(size).render(text, True, colour)
        image = pygame.transform.smoothscale(large, (large.get_width() // SCALE, large.get_height() // SCALE))
        self.surface.blit(image, image.get_rect(**{anchor: (round(at[0]), round(at[1]))}))
        return float(image.get_width())

    @property
    def surface(self) -> Any:
        """The picture at its final size; nothing can be put under the text any more."""
        if self._small is None:
            self._small = pygame.transform.smoothscale(self._large, self.size)
        return self._small


_fonts: dict[int, Any] = {}


def font(size: int) -> Any:
    """The font that comes with pygame, the same on every machine, at the size before scaling."""
    if not pygame.font.get_init():
        pygame.font.init()
        _fonts.clear()
    if size not in _fonts:
        _fonts[size] = pygame.font.Font(None, size * SCALE)
    return _fonts[size]


def text_width(text: str, size: int) -> float:
    """Width of a line of text [px]."""
    return float(font(size).size(text)[0] // SCALE)


def paint_stage(layer: Layer) -> None:
    """The floor around the court and the empty list."""
    x, y, w, h = _STAGE
    layer.rect(x, y, w, h, _FLOOR, radius=10)
    layer.frame(x, y, w, h, EDGE, width=1, radius=10)
    x, y, w, h = _LIST
    layer.rect(x, y, w, h, PANEL, radius=10)
    layer.frame(x, y, w, h, EDGE, width=1, radius=10)


def paint_boxes(layer: Layer, snapshot: Snapshot) -> None:
    """Everything under the text."""
    x, y = _SCORE
    width = _name_width(snapshot) + _GAME_WIDTH * max(1, len(snapshot.by_game)) + 8
    layer.rect(x, y, width, 56, INK, 235, radius=6)
    for player in (0, 1):
        layer.rect(x, y + 28 * player, 4, 28, PLAYERS[player])
    current = x + width - _GAME_WIDTH - 4
    if snapshot.by_game:
        layer.rect(current, y + 3, _GAME_WIDTH, 50, SELECTED, radius=4)
    serving = snapshot.winner if snapshot.winner is not None else snapshot.server
    layer.circle((x + 16, y + 14 + 28 * serving), 4.5, YELLOW)
    for row, (_, played) in enumerate(_listed(snapshot)):
        top = _LIST_TOP + _ROW * row
        if played is snapshot.strokes[-1]:
            layer.rect(_LIST[0] + 8, top - _ROW / 2 + 1, _LIST[2] - 16, _ROW - 2, SELECTED, radius=4)
        layer.circle((_LIST[0] + 42, top), 4, PLAYERS[played.player])
    if snapshot.strokes:
        last = snapshot.strokes[-1]
        x, y, height = _CHIP
        cells = sum((_cell_width(label, value) for label, value, _ in _cells(snapshot, last)), 0.0)
        head = text_width(shot_in_words(snapshot.game.catalogue, last.stroke).upper(), _LARGE) + 2 * _PAD
        layer.rect(x, y, head + cells, height, INK, 235, radius=8)
        layer.rect(x, y, head, height, PLAYERS[last.player], radius=8)
        layer.rect(x + head - 8, y, 8, height, PLAYERS[last.player])


def write_overlay(picture: Picture, snapshot: Snapshot) -> None:
    """All text."""
    _write_score(picture, snapshot)
    _write_list(picture, snapshot)
    if snapshot.strokes:
        _write_chip(picture, snapshot, snapshot.strokes[-1])


def _name_width(snapshot: Snapshot) -> int:
    """Width of the names, and of the efforts behind them where they count."""
    return _NAME_WIDTH + (_EFFORT_WIDTH if snapshot.game.levels > 1 else 0)


def _write_score(picture: Picture, snapshot: Snapshot) -> None:
    x, y = _SCORE
    width = _name_width(snapshot)
    for player, name in enumerate(snapshot.names):
        middle = y + 14 + 28 * player
        end = x + 28 + picture.write(name, (x + 28, middle), _NORMAL)
        if snapshot.game.levels > 1:
            picture.write(f"effort {effort_in_words(snapshot, player)}", (end + 10, middle + 1), _SMALL, MUTED)
        for column, points in enumerate(snapshot.by_game):
            current = column == len(snapshot.by_game) - 1
            at = (x + width + _GAME_WIDTH * (column + 0.5) + 4, middle)
            won = points[player] > points[1 - player]
            picture.write(str(points[player]), at, _LARGE if current else _NORMAL, TEXT if won or current else MUTED, "center")
        if not snapshot.by_game and snapshot.winner == player:
            picture.write("won", (x + width + _GAME_WIDTH / 2, middle), _NORMAL, GREEN, "center")
    right = _STAGE[0] + _STAGE[2] - 14
    picture.write(snapshot.title, (right, y + 10), _NORMAL, MUTED, "midright")


def _write_list(picture: Picture, snapshot: Snapshot) -> None:
    left, top, width, height = _LIST
    right = left + width - 16
    count = len(snapshot.strokes)
    picture.write(f"RALLY - {count} STROKE{'' if count == 1 else 'S'}", (left + 16, top + 20), _SMALL, MUTED)
    picture.write("GOOD", (right - 38, top + 20), _SMALL, MUTED, "midright")
    picture.write("RET.", (right, top + 20), _SMALL, MUTED, "midright")
    catalogue = snapshot.game.catalogue
    for row, (number, played) in enumerate(_listed(snapshot)):
        middle = _LIST_TOP + _ROW * row
        picture.write(str(number), (left + 28, middle), _SMALL, MUTED, "midright")
        end = left + 54 + picture.write(shot_in_words(catalogue, played.stroke), (left + 54, middle), _NORMAL)
        area = AREAS[catalogue.area[played.stroke]].replace("-", " ")
        if end + 8 + text_width(area, _SMALL) < right - 74:
            picture.write(area, (end + 8, middle + 1), _SMALL, MUTED)
        picture.write(f"{played.p_succ:.2f}"[-3:], (right - 38, middle), _NORMAL, GREEN, "midright")
        picture.write(f"{played.p_ret:.2f}", (right, middle), _NORMAL, YELLOW, "midright")
    bottom = top + height - 24
    colour = TEXT if snapshot.winner is None else PLAYERS[snapshot.winner]
    picture.write(standing(snapshot), (left + 16, bottom), _NORMAL, colour)


def _write_chip(picture: Picture, snapshot: Snapshot, last: Stroke) -> None:
    x, y, height = _CHIP
    name = shot_in_words(snapshot.game.catalogue, last.stroke).upper()
    at = x + _PAD + picture.write(name, (x + _PAD, y + height / 2), _LARGE, INK) + _PAD
    for label, value, colour in _cells(snapshot, last):
        picture.write(label, (at + _PAD, y + 14), _SMALL, MUTED)
        picture.write(value, (at + _PAD, y + 32), _NORMAL, colour)
        at += _cell_width(label, value)


def _cells(snapshot: Snapshot, last: Stroke) -> Iterator[tuple[str, str, Colour]]:
    catalogue = snapshot.game.catalogue
    yield "TARGET", AREAS[catalogue.area[last.stroke]].replace("-", " "), TEXT
    yield "CONTACT", HEIGHTS[catalogue.height[last.stroke]], TEXT
    yield "TECHNIQUE", TECHNIQUES[catalogue.technique[last.stroke]].replace("-", " "), TEXT
    yield "P(GOOD)", f"{last.p_succ:.3f}", GREEN
    yield "P(RET.)", f"{last.p_ret:.3f}", YELLOW
    # The widest chip has to end before the list.
    if last.outcome >= RETURNED_BELOW:
        yield "RETURNED", OUTCOMES[last.outcome].removeprefix("returned "), TEXT
    else:
        yield "OUTCOME", OUTCOMES[last.outcome], RED if last.outcome == FAULT else GREEN


def _cell_width(label: str, value: str) -> float:
    return max(text_width(label, _SMALL), text_width(value, _NORMAL)) + 2 * _PAD


def _listed(snapshot: Snapshot) -> list[tuple[int, Stroke]]:
    """The last strokes with their numbers, as many as fit."""
    return list(enumerate(snapshot.strokes, start=1))[-_ROWS:]


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
