"""Colours, shapes and text for pictures, with pygame. Shapes are painted at twice the size and scaled down: smooth edges."""

import os
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from shuttle_marl.errors import ShuttleError

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")


class RenderError(ShuttleError):
    """Pictures cannot be drawn."""


try:
    import pygame
except ImportError as error:
    raise RenderError(
        "render_mode 'human' and 'rgb_array' need pygame: pip install 'shuttle-marl[render]'; 'ansi' works without"
    ) from error

__all__ = ["Layer", "Picture", "RenderError", "pygame", "text_width"]

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
