"""The picture of a rally from above the court, for ``render_mode="rgb_array"`` and ``"human"``."""

import itertools
import os
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import F64, U8, Floats
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.extras import install_hint
from shuttle_marl.env.snapshot import Flight, Plan, Point, Snapshot, area_corners, effort_in_words, in_words, plan_of, standing
from shuttle_marl.game.court import HALF_LENGTH, HALF_WIDTH, LONG_SERVICE, SHORT_SERVICE, WIDTH
from shuttle_marl.game.rules import FAULT, OUTCOMES, WINNER

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

Colour = tuple[int, ...]

INK, TEXT, MUTED, WHITE = (13, 17, 26), (229, 231, 235), (139, 151, 168), (240, 244, 248)
PLAYERS: Final = ((56, 189, 248), (251, 113, 133))
YELLOW, GREEN, RED = (251, 191, 36), (52, 211, 153), (248, 80, 80)
MAT, AROUND, TARGET = (18, 114, 87), (14, 93, 72), (70, 128, 76)

SIZE: Final = (900, 560)
"""Width and height of the picture [px]; it is painted twice as large."""
WIDE, HIGH = 2 * SIZE[0], 2 * SIZE[1]
PX: Final = 116.0
"""Painted pixels per metre."""
_RISE: Final = 34.0
"""Painted pixels that a flight is lifted for each metre of height."""


def px(point: Point | Floats) -> F64:
    """A point of the plan in the painting."""
    return np.array([WIDE / 2, HIGH / 2]) + PX * np.asarray(point)


def _rect(surface: Any, a: Point, b: Point, colour: Colour) -> None:
    (left, top), (right, bottom) = np.rint(np.sort([px(a), px(b)], axis=0)).tolist()
    pygame.draw.rect(surface, colour, (left, top, right - left, bottom - top))


def _line(surface: Any, points: Sequence[Floats] | Floats, width: float, colour: Colour) -> None:
    for a, b in itertools.pairwise(points):
        side = width / 2 * np.array([a[1] - b[1], b[0] - a[0]]) / max(float(np.hypot(*(b - a))), 1e-9)
        pygame.draw.polygon(surface, colour, [a + side, b + side, b - side, a - side])


def _write(surface: Any, text: str, at: tuple[float, float], size: int, colour: Colour, anchor: str = "midleft") -> float:
    """Write a line of text, of which the point ``anchor`` lies at ``at``; returns the x of its end."""
    pygame.font.init()
    image = pygame.font.Font(None, size).render(text, True, colour)
    place = image.get_rect(**{anchor: at})
    surface.blit(image, place)
    return float(place.right)


def _faded(colour: Colour, strength: float) -> Colour:
    return tuple(round(strength * c + (1 - strength) * m) for c, m in zip(colour, MAT, strict=True))


def _paint_court(surface: Any) -> None:
    """Mat and lines, in the proportions of the Laws."""
    length, half = HALF_LENGTH, WIDTH / 2
    _rect(surface, (-length - 0.9, -half - 0.5), (length + 0.9, half + 0.5), AROUND)
    _rect(surface, (-length, -half), (length, half), MAT)
    for side in (-1, 1):
        lines = [((side * x, -half), (side * x, half)) for x in (length, length - LONG_SERVICE, SHORT_SERVICE)]
        lines += [((-length, side * y), (length, side * y)) for y in (HALF_WIDTH, half)]
        for a, b in (*lines, ((side * SHORT_SERVICE, 0), (side * length, 0))):
            _line(surface, [px(a), px(b)], 0.05 * PX, WHITE)


def _path(flight: Flight) -> F64:
    """``[n, 2]`` points of a flight in the painting, lifted by its height."""
    t = np.linspace(0, 1, 40)[:, None]
    # A shuttle slows down so much that it is highest well behind the middle of its flight.
    height = flight.peak * 6.75 * t**2 * (1 - t)
    return np.asarray(px(flight.start) + t * (px(flight.end) - px(flight.start)) - height * [0, _RISE])


def _paint_player(surface: Any, snapshot: Snapshot, plan: Plan, player: int) -> None:
    """A player from above: the way since the last contact, shoulders, head, and the racket towards the shuttle."""
    body, colour, origin = px(plan.bodies[player]), PLAYERS[player], plan.came_from[player]
    if origin is not None:
        _line(surface, [px(origin), body], 6, _faded(colour, 0.4))
    if snapshot.striker == player:
        pygame.draw.circle(surface, WHITE, body, 54, 5)
    ahead = px(plan.shuttle) - body
    ahead = ahead / max(float(np.hypot(*ahead)), 1e-9)
    right = np.array([-ahead[1], ahead[0]]) * (1 if snapshot.hands[player] == "right" else -1)
    hand = body + 26 * right
    _line(surface, [hand, hand + 50 * ahead], 6, WHITE)
    pygame.draw.circle(surface, WHITE, hand + 68 * ahead, 20, 4)
    _line(surface, [body - 34 * right, body + 34 * right], 32, colour)
    pygame.draw.circle(surface, INK, body, 18)


def _paint_shuttle(surface: Any, plan: Plan) -> None:
    """The shuttle, or a mark that says how the rally ended there."""
    at, outcome = px(plan.shuttle), plan.flights[-1].stroke.outcome if plan.flights else None
    if outcome == WINNER:
        for radius in (18, 32, 46):
            pygame.draw.circle(surface, GREEN, at, radius, 5)
    elif outcome == FAULT:
        for arm in ([18, 18], [18, -18]):
            _line(surface, [at - arm, at + arm], 8, RED)
    else:
        pygame.draw.circle(surface, YELLOW, at, 13)


def _paint_words(surface: Any, snapshot: Snapshot) -> None:
    """The score above the court, the last stroke below it."""
    serving = snapshot.winner if snapshot.winner is not None else snapshot.server
    for player, name in enumerate(snapshot.names):
        y = 40 + 52 * player
        pygame.draw.rect(surface, PLAYERS[player], (40, y - 22, 8, 44))
        end = _write(surface, name, (104, y), 44, TEXT)
        if player == serving:
            pygame.draw.circle(surface, YELLOW, (76, y), 10)
        if snapshot.game.levels > 1:
            end = _write(surface, f"effort {effort_in_words(snapshot, player)}", (end + 20, y), 34, MUTED)
        for column, points in enumerate(snapshot.by_game):
            colour = TEXT if column == len(snapshot.by_game) - 1 else MUTED
            _write(surface, str(points[player]), (max(600, end + 40) + 80 * column, y), 52, colour, "center")
    _write(surface, snapshot.title, (WIDE - 40, 40), 40, MUTED, "midright")
    _write(surface, standing(snapshot), (WIDE - 40, 92), 44, TEXT, "midright")
    if snapshot.strokes:
        last, number = snapshot.strokes[-1], len(snapshot.strokes)
        words = in_words(snapshot.game.catalogue, last.stroke)
        _write(surface, f"{number}  {snapshot.names[last.player]}: {words}", (40, HIGH - 88), 48, PLAYERS[last.player])
        odds = f"good {last.p_succ:.1%}, returned {last.p_ret:.1%}: {OUTCOMES[last.outcome]}"
        _write(surface, odds, (40, HIGH - 36), 40, MUTED)


class CourtRenderer:
    """Draws snapshots; opens a window when first asked to show one."""

    def __init__(self, title: str, *, fps: float) -> None:
        self._title = title
        self._fps = fps
        self._court = pygame.Surface((WIDE, HIGH))
        self._court.fill(INK)
        _paint_court(self._court)
        self._window: Any = None
        self._clock: Any = None
        self._dismissed = False

    def frame(self, snapshot: Snapshot) -> U8:
        """``[560, 900, 3]`` picture."""
        return np.ascontiguousarray(pygame.surfarray.array3d(self._paint(snapshot)).swapaxes(0, 1))

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
        surface, plan = self._court.copy(), plan_of(snapshot)
        if snapshot.strokes:
            last = snapshot.strokes[-1]
            _rect(surface, *area_corners(last.player, snapshot.target(last)), TARGET)
        if plan.waited is not None:
            pygame.draw.circle(surface, WHITE, px(plan.waited), 62, 4)
        _line(surface, [px((0, -WIDTH / 2 - 0.1)), px((0, WIDTH / 2 + 0.1))], 10, WHITE)
        for player in (0, 1):
            _paint_player(surface, snapshot, plan, player)
        for flight, strength in zip(plan.flights[-3:], (0.35, 0.6, 1.0)[-len(plan.flights) :], strict=False):
            _line(surface, _path(flight), 6, _faded(PLAYERS[flight.stroke.player], strength))
        _paint_shuttle(surface, plan)
        _paint_words(surface, snapshot)
        return pygame.transform.smoothscale(surface, SIZE)
