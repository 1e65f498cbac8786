"""Texts of the reports, from a catalogue: ``words.toml`` for English, another file for another language."""

import functools
import re
import tomllib
from pathlib import Path
from typing import Any, Final

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES, Catalogue

CATALOGUE: Final = Path(__file__).parent / "words.toml"


class Words:
    """Texts by key."""

    def __init__(self, path: Path = CATALOGUE) -> None:
        self._texts = tomllib.loads(path.read_text(encoding="utf-8"))

    def __call__(self, key: str, **fields: Any) -> str:
        """The text of a key, such as ``scout.title``, with its fields filled.

        Raises:
            ShuttleError: the catalogue has no such text.
        """
        text: Any = self._texts
        for part in key.split(".", 1):
            text = text.get(part) if isinstance(text, dict) else None
        if not isinstance(text, str):
            raise ShuttleError(f"{key!r}: no such text in the catalogue; expected one of its keys")
        return text.format(**fields) if fields else text

    def shot(self, shot: str, *, many: bool = False) -> str:
        """A shot type, such as ``a smash``, or ``smashes``."""
        return str(self._texts["shots"][shot][many])

    @staticmethod
    def player(name: str) -> str:
        """A player as people write the name: ``Viktor Axelsen`` for ``viktor-axelsen``; other names stay as they are."""
        return name.replace("-", " ").title() if name.islower() and re.fullmatch(r"[^\W\d_]+(-[^\W\d_]+)+", name) else name

    def area(self, area: int, whose: str) -> str:
        """An area, such as ``your front left corner``."""
        return self(f"areas.{AREAS[area]}", whose=self(f"whose.{whose}"))

    def stroke(self, catalogue: Catalogue, stroke: int, whose: str) -> str:
        """A stroke, such as ``a push with the forehand to their right side``."""
        shot, technique = SHOTS[catalogue.shot[stroke]], TECHNIQUES[catalogue.technique[stroke]]
        return f"{self.shot(shot)} {self(f'techniques.{technique}')} to {self.area(int(catalogue.area[stroke]), whose)}"

    def height(self, contact: int) -> str:
        """The height of a contact."""
        return self(f"heights.{HEIGHTS[contact]}")


@functools.cache
def words() -> Words:
    """The English texts."""
    return Words()


def of_100(share: float, digits: int = 0) -> str:
    """A share as a number of 100."""
    return f"{round(100 * share, digits) + 0.0:.{digits}f}"  # adding 0 turns a rounded -0.0 into 0.0


def signed(share: float, digits: int = 1) -> str:
    """A difference of shares as a number of 100 with its sign."""
    number = round(100 * share, digits)
    return f"{number:+.{digits}f}" if number else f"{0:.{digits}f}"
