"""Colours, shapes and text for pictures, with pygame, and what stands around the court: score, strokes, the last one's chip.

Shapes are painted at twice the size and scaled down: smooth edges.
"""

import os
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from shuttle_marl.env.snapshot import Snapshot, effort_in_words, shot_in_words, standing
from shuttle_marl.errors import ShuttleError
from shuttle_marl.extras import install_hint
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.rules import FAULT, OUTCOMES, WINNER
from shuttle_marl.game.stroke import HEIGHTS, TECHNIQUES
from shuttle_marl.rally.stepper import Stroke

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
    yield "CONTACT", f"{HEIGHTS[catalogue.height[last.stroke]]} net", TEXT
    yield "TECHNIQUE", TECHNIQUES[catalogue.technique[last.stroke]].replace("-", " "), TEXT
    yield "P(SUCCESS)", f"{last.p_succ:.3f}", GREEN
    yield "P(RETURNED)", f"{last.p_ret:.3f}", YELLOW
    colour = {FAULT: RED, WINNER: GREEN}.get(last.outcome, TEXT)
    yield "OUTCOME", OUTCOMES[last.outcome], colour


def _cell_width(label: str, value: str) -> float:
    return max(text_width(label, _SMALL), text_width(value, _NORMAL)) + 2 * _PAD


def _listed(snapshot: Snapshot) -> list[tuple[int, Stroke]]:
    """The last strokes with their numbers, as many as fit."""
    return list(enumerate(snapshot.strokes, start=1))[-_ROWS:]
