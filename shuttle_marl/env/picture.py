"""The picture of a rally from above the court, for ``render_mode="rgb_array"`` and ``"human"``."""

import itertools
import os
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import F64, U8, Floats
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
from shuttle_marl.game.court import AREA_WORDS, HALF_LENGTH, HALF_WIDTH, LONG_SERVICE, N_AREAS, SHORT_SERVICE, WIDTH
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

Colour = tuple[int, int, int]
Box = tuple[float, float, float, float]
"""Left, top, width and height [px]."""

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
PX: Final = 51.0
"""Pixels per metre."""
CENTRE: Final = np.array([450.0, 292.0])
"""Position of the middle of the net in the picture."""
MAT: Final = (18, 114, 87)
MAT_DARK: Final = (14, 93, 72)
LINE: Final = (222, 236, 230)

_LINE_WIDTH: Final = 0.05 * PX
_RISE: Final = 17.0
"""Pixels that a flight is lifted for each metre of height."""
_FADE: Final = (1.0, 0.62, 0.42, 0.28, 0.16)
"""Opacity of the last flights, newest first."""


class Sheet:
    """Transparent paper in picture coordinates. Paint replaces what is under it on the same sheet; text lies on top."""

    def __init__(self) -> None:
        self.surface = pygame.Surface((SIZE[0] * SCALE, SIZE[1] * SCALE), pygame.SRCALPHA)

    def rect(self, box: Box, colour: Colour, alpha: int = 255, *, width: float = 0, radius: float = 0) -> None:
        """A filled rectangle with rounded corners, or its outline if it has a width."""
        scaled = pygame.Rect([round(each * SCALE) for each in box])
        pygame.draw.rect(self.surface, (*colour, alpha), scaled, round(width * SCALE), border_radius=round(radius * SCALE))

    def circle(self, at: Floats, radius: float, colour: Colour, alpha: int = 255, *, width: float = 0) -> None:
        """A disc, or a ring if it has a width."""
        pygame.draw.circle(self.surface, (*colour, alpha), (SCALE * at).tolist(), radius * SCALE, round(width * SCALE))

    def polygon(self, points: Floats, colour: Colour, alpha: int = 255) -> None:
        """A filled polygon of ``[n, 2]`` corners."""
        pygame.draw.polygon(self.surface, (*colour, alpha), (SCALE * points).tolist())

    def line(self, a: Floats, b: Floats, width: float, colour: Colour, alpha: int = 255) -> None:
        """A straight stroke with square ends."""
        side = width / 2 * _across(b - a)
        self.polygon(np.stack([a + side, b + side, b - side, a - side]), colour, alpha)

    def write(self, text: str, x: float, y: float, size: int, colour: Colour = TEXT, anchor: str = "midleft") -> float:
        """Write a line of text; returns its width. ``anchor`` names the point of the text that lies at (x, y)."""
        image = _font(size).render(text, True, colour)
        self.surface.blit(image, image.get_rect(**{anchor: (round(x * SCALE), round(y * SCALE))}))
        return float(image.get_width() / SCALE)


_fonts: dict[int, Any] = {}


def _font(size: int) -> Any:
    """The font that comes with pygame, the same on every machine."""
    if not pygame.font.get_init():
        pygame.font.init()
        _fonts.clear()
    if size not in _fonts:
        _fonts[size] = pygame.font.Font(None, size * SCALE)
    return _fonts[size]


def text_width(text: str, size: int) -> float:
    """Width of a line of text [px]."""
    return float(_font(size).size(text)[0] / SCALE)


def _across(direction: Floats) -> F64:
    """Unit vector at a right angle to a direction: to the right, because y points down."""
    return np.array([-direction[1], direction[0]]) / max(1e-9, float(np.hypot(*direction)))


def _paint_score(sheet: Sheet, snapshot: Snapshot) -> None:
    """Names, efforts where they count, and points of the players, and the title."""
    x, y = _SCORE
    names = _NAME_WIDTH + (_EFFORT_WIDTH if snapshot.game.levels > 1 else 0)
    width = names + _GAME_WIDTH * max(1, len(snapshot.by_game)) + 8
    sheet.rect((x, y, width, 56), INK, 235, radius=6)
    if snapshot.by_game:
        sheet.rect((x + width - _GAME_WIDTH - 4, y + 3, _GAME_WIDTH, 50), SELECTED, radius=4)
    serving = snapshot.winner if snapshot.winner is not None else snapshot.server
    sheet.circle(np.array([x + 16, y + 14 + 28 * serving]), 4.5, YELLOW)
    for player, name in enumerate(snapshot.names):
        middle = y + 14 + 28 * player
        sheet.rect((x, y + 28 * player, 4, 28), PLAYERS[player])
        end = x + 28 + sheet.write(name, x + 28, middle, _NORMAL)
        if snapshot.game.levels > 1:
            sheet.write(f"effort {effort_in_words(snapshot, player)}", end + 10, middle + 1, _SMALL, MUTED)
        for column, points in enumerate(snapshot.by_game):
            current = column == len(snapshot.by_game) - 1
            colour = TEXT if current or points[player] > points[1 - player] else MUTED
            centre = x + names + _GAME_WIDTH * (column + 0.5) + 4
            sheet.write(str(points[player]), centre, middle, _LARGE if current else _NORMAL, colour, "center")
        if not snapshot.by_game and snapshot.winner == player:
            sheet.write("won", x + names + _GAME_WIDTH / 2, middle, _NORMAL, GREEN, "center")
    sheet.write(snapshot.title, _STAGE[0] + _STAGE[2] - 14, y + 10, _NORMAL, MUTED, "midright")


def _paint_list(sheet: Sheet, snapshot: Snapshot) -> None:
    """The last strokes, as many as fit, and the state of the rally."""
    left, top, width, height = _LIST
    right, strokes, catalogue = left + width - 16, snapshot.strokes, snapshot.game.catalogue
    sheet.write(f"RALLY - {len(strokes)} STROKE{'' if len(strokes) == 1 else 'S'}", left + 16, top + 20, _SMALL, MUTED)
    sheet.write("GOOD", right - 38, top + 20, _SMALL, MUTED, "midright")
    sheet.write("RET.", right, top + 20, _SMALL, MUTED, "midright")
    for row, (number, played) in enumerate(list(enumerate(strokes, start=1))[-_ROWS:]):
        middle = _LIST_TOP + _ROW * row
        if number == len(strokes):
            sheet.rect((left + 8, middle - _ROW / 2 + 1, width - 16, _ROW - 2), SELECTED, radius=4)
        sheet.circle(np.array([left + 42, middle]), 4, PLAYERS[played.player])
        sheet.write(str(number), left + 28, middle, _SMALL, MUTED, "midright")
        end = left + 62 + sheet.write(shot_in_words(catalogue, played.stroke), left + 54, middle, _NORMAL)
        area = AREA_WORDS[catalogue.area[played.stroke]]
        if end + text_width(area, _SMALL) < right - 74:
            sheet.write(area, end, middle + 1, _SMALL, MUTED)
        sheet.write(f"{played.p_succ:.2f}", right - 38, middle, _NORMAL, GREEN, "midright")
        sheet.write(f"{played.p_ret:.2f}", right, middle, _NORMAL, YELLOW, "midright")
    colour = TEXT if snapshot.winner is None else PLAYERS[snapshot.winner]
    sheet.write(standing(snapshot), left + 16, top + height - 24, _NORMAL, colour)


def _paint_chip(sheet: Sheet, snapshot: Snapshot) -> None:
    """The last stroke in detail."""
    x, y, height = _CHIP
    last, cells = snapshot.strokes[-1], _cells(snapshot, snapshot.strokes[-1])
    name = shot_in_words(snapshot.game.catalogue, last.stroke).upper()
    head = text_width(name, _LARGE) + 2 * _PAD
    sheet.rect((x, y, head + sum(_cell_width(label, value) for label, value, _ in cells), height), INK, 235, radius=8)
    sheet.rect((x, y, head, height), PLAYERS[last.player], radius=8)
    sheet.rect((x + head - 8, y, 8, height), PLAYERS[last.player])
    sheet.write(name, x + _PAD, y + height / 2, _LARGE, INK)
    at = x + head
    for label, value, colour in cells:
        sheet.write(label, at + _PAD, y + 14, _SMALL, MUTED)
        sheet.write(value, at + _PAD, y + 32, _NORMAL, colour)
        at += _cell_width(label, value)


def _cells(snapshot: Snapshot, last: Stroke) -> list[tuple[str, str, Colour]]:
    catalogue = snapshot.game.catalogue
    result = "RETURNED" if last.outcome >= RETURNED_BELOW else "OUTCOME"  # the widest chip has to end before the list
    colour = {FAULT: RED, WINNER: GREEN}.get(last.outcome, TEXT)
    return [
        ("TARGET", AREA_WORDS[catalogue.area[last.stroke]], TEXT),
        ("CONTACT", HEIGHTS[catalogue.height[last.stroke]], TEXT),
        ("TECHNIQUE", TECHNIQUES[catalogue.technique[last.stroke]].replace("-", " "), TEXT),
        ("P(GOOD)", f"{last.p_succ:.3f}", GREEN),
        ("P(RET.)", f"{last.p_ret:.3f}", YELLOW),
        (result, OUTCOMES[last.outcome].removeprefix("returned "), colour),
    ]


def _cell_width(label: str, value: str) -> float:
    return max(text_width(label, _SMALL), text_width(value, _NORMAL)) + 2 * _PAD


def px(point: Point) -> F64:
    """A point of the plan in the picture."""
    return np.asarray(CENTRE + PX * np.asarray(point))


def _box(a: Point, b: Point) -> Box:
    """The rectangle between two points of the plan."""
    (x0, y0), (x1, y1) = np.sort([px(a), px(b)], axis=0).tolist()
    return x0, y0, x1 - x0, y1 - y0


def _paint_court(sheet: Sheet) -> None:
    """The stage and the empty list; mat and lines, in the proportions of the Laws."""
    for box, colour in ((_STAGE, _FLOOR), (_LIST, PANEL)):
        sheet.rect(box, colour, radius=10)
        sheet.rect(box, EDGE, width=1, radius=10)
    length, half = HALF_LENGTH, WIDTH / 2
    sheet.rect(_box((-length - 1, -half - 1), (length + 1, half + 1)), MAT_DARK, radius=10)
    sheet.rect(_box((-length, -half), (length, half)), MAT)
    for side in (-1, 1):
        across = [((side * x, -half), (side * x, half)) for x in (length, length - LONG_SERVICE, SHORT_SERVICE)]
        along = [((-length, side * y), (length, side * y)) for y in (HALF_WIDTH, half)]
        for a, b in (*across, *along, ((side * SHORT_SERVICE, 0), (side * length, 0))):
            sheet.line(px(a), px(b), _LINE_WIDTH, LINE)


def _paint_target(sheet: Sheet, player: int, area: int) -> None:
    """The nine areas that a player can aim at, the chosen one filled."""
    for other in range(N_AREAS):
        box = _box(*area_corners(player, other))
        if other == area:
            sheet.rect(box, YELLOW, 88)
            sheet.rect(box, YELLOW, width=1.8)
        else:
            sheet.rect(box, LINE, 46, width=1)


def _paint_net(sheet: Sheet) -> None:
    """The net with its posts, above everything on the floor."""
    overhang = WIDTH / 2 + 0.05
    sheet.line(px((0.06, -overhang)), px((0.06, overhang)), 5, INK, 90)
    sheet.line(px((0, -overhang)), px((0, overhang)), 3.2, WHITE)
    for y in np.arange(-overhang, overhang, 0.16).tolist():
        sheet.line(px((0, y)), px((0, y + 0.04)), 3.2, (150, 165, 175))
    for y in (-overhang, overhang):
        sheet.circle(px((0, y)), 5.5, INK)
        sheet.circle(px((0, y)), 4, (200, 208, 216))


def _flight_points(flight: Flight, count: int = 48) -> F64:
    """``[count, 2]`` points of a flight in the picture, lifted by its height."""
    t = np.linspace(0, 1, count)[:, None]
    # A shuttle slows down so much that it is highest well behind the middle of its flight.
    height = flight.peak * 6.75 * t**2 * (1 - t)
    return np.asarray(px(flight.start) + t * (px(flight.end) - px(flight.start)) - height * [0, _RISE])


def _paint_flights(sheet: Sheet, flights: tuple[Flight, ...]) -> None:
    """The last flights in the colour of who struck them, older ones fainter, each brighter and wider towards its end."""
    for strength, flight in reversed(list(zip(_FADE, reversed(flights), strict=False))):
        points, colour, newest = _flight_points(flight), PLAYERS[flight.stroke.player], strength == 1.0
        for i, (a, b) in enumerate(itertools.pairwise(points)):
            t = i / (len(points) - 1)
            if flight.stroke.outcome != FAULT or i % 4 < 2:
                sheet.line(a, b, (1.6 + 3.0 * t) if newest else 2.0, colour, round(255 * strength * (0.45 + 0.55 * t)))
        sheet.circle(points[0], 3.4 if newest else 2.4, colour, round(255 * max(strength, 0.25)))


def _paint_player(sheet: Sheet, snapshot: Snapshot, body: Point, facing: Point, player: int) -> None:
    """A player from above: shoulders, head, and the racket towards the shuttle."""
    right = 1.25 * _across(px(facing) - px(body))
    frame = np.stack([[right[1], -right[0]], right * (1 if snapshot.hands[player] == "right" else -1)])
    colour = PLAYERS[player]

    def point(*forward_and_racket: float) -> F64:
        return np.asarray(px(body) + np.array(forward_and_racket) @ frame)

    if snapshot.striker == player:
        sheet.circle(px(body), 26, colour, 60)
        sheet.circle(px(body), 26, colour, 230, width=2)
    sheet.circle(px(body) + np.array([3, 5]), 15, INK, 90)
    sheet.line(point(0, 10), point(9, 11), 6, (colour[0] // 2, colour[1] // 2, colour[2] // 2))
    sheet.line(point(9, 11), point(24, 11), 2.2, WHITE)
    sheet.circle(point(30, 11), 8, WHITE, 80)
    sheet.circle(point(30, 11), 8, WHITE, width=1.5)
    angles = np.linspace(0, 2 * np.pi, 28, endpoint=False)
    sheet.polygon(px(body) + np.stack([7 * np.cos(angles), 14 * np.sin(angles)], axis=1) @ frame, colour)
    sheet.circle(point(1.5, 0), 8, INK)
    sheet.circle(point(1.5, 0), 6.8, (238, 205, 175))


def _paint_floor(sheet: Sheet, plan: Plan) -> None:
    """The path of the last flights on the floor, the steps of the players since the last contact, and where a receiver waited."""
    for age, flight in enumerate(reversed(plan.flights[-2:])):
        sheet.line(px(flight.start), px(flight.end), 2.0, INK, 70 - 35 * age)
    for player, (came_from, body) in enumerate(zip(plan.came_from, plan.bodies, strict=True)):
        if came_from is not None:
            for t in np.arange(0.0, 1.0, 0.14).tolist():
                sheet.circle(px(came_from) + t * (px(body) - px(came_from)), 2.2, PLAYERS[player], round(50 + 110 * t))
    if plan.waited is not None:
        sheet.circle(px(plan.waited), 30, WHITE, 60)
        sheet.circle(px(plan.waited), 30, WHITE, 200, width=2)


def _paint_shuttle(sheet: Sheet, plan: Plan) -> None:
    """The shuttle, cork first, or a mark that says how the rally ended there."""
    at, direction = px(plan.shuttle), np.array([1.0, 0.0])
    if plan.flights:
        if plan.flights[-1].stroke.outcome == WINNER:
            for radius, alpha in ((26, 90), (18, 170), (10, 255)):
                sheet.circle(at, radius, GREEN, alpha, width=2)
            return
        if plan.flights[-1].stroke.outcome == FAULT:
            for arm in np.array([[9, 9], [9, -9]]):
                sheet.line(at - arm, at + arm, 4, RED)
            return
        points = _flight_points(plan.flights[-1])
        direction = points[-1] - points[-3]
    side = _across(direction)
    ahead = np.array([side[1], -side[0]])
    sheet.polygon(at - np.outer([11, 11, 1, 1], ahead) + np.outer([6.5, -6.5, -2.4, 2.4], side), WHITE)
    sheet.circle(at, 3.4, YELLOW)


class CourtRenderer:
    """Draws snapshots; opens a window when first asked to show one."""

    def __init__(self, title: str, *, fps: float) -> None:
        self._title = title
        self._fps = fps
        self._court = Sheet()
        self._court.surface.fill(INK)
        _paint_court(self._court)
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
        plan = plan_of(snapshot)
        floor, air, players, boxes = (Sheet() for _ in range(4))
        if snapshot.strokes:
            last = snapshot.strokes[-1]
            _paint_target(floor, last.player, snapshot.target(last))
            _paint_chip(boxes, snapshot)
        _paint_floor(floor, plan)
        _paint_net(floor)
        _paint_flights(air, plan.flights)
        for player in (0, 1):
            _paint_player(players, snapshot, plan.bodies[player], plan.shuttle, player)
        _paint_shuttle(players, plan)
        _paint_score(boxes, snapshot)
        _paint_list(boxes, snapshot)
        picture = self._court.surface.copy()
        for sheet in (floor, air, players, boxes):
            picture.blit(sheet.surface, (0, 0))
        return pygame.transform.smoothscale(picture, SIZE)
