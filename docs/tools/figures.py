"""Figures in the sentences of the documentation: where each stands, what it is computed from, and how far it may be off.

``python -m docs.tools.tables`` writes them with the tables, and ``--check`` fails where one has drifted beyond its tolerance.
"""

import dataclasses
import functools
import re
from collections.abc import Callable, Mapping
from typing import Any, Final

from docs.tools.markdown import saved
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.dynamics.splits import MIN_MATCHES_FOR_REFITS, MIN_STROKES, MIN_STROKES_WITH_PRIOR
from shuttle_marl.game import default_game, model_folder
from shuttle_marl.game.observation import RALLY_WIDTH, SCORE_WIDTH
from shuttle_marl.game.shipped import read_model_card
from shuttle_marl.league.entrants import LeagueConfig, default_pool

_NUMBER: Final = r"([0-9][0-9,]*(?:\.[0-9]+)?)"


class FigureError(ShuttleError):
    """A figure that is not where it should be, or not what its source says."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Figure:
    """A number in a sentence.

    Attributes:
        page: path from the root of the repository.
        text: the words around it, with ``{}`` in its place; a space may be a line break.
        value: what it is computed from.
        form: format of the number.
        tolerance: largest relative difference from the value that is left as it is.
    """

    page: str
    text: str
    value: Callable[[], float]
    form: str = ",.0f"
    tolerance: float = 0.0

    def found(self, page: str) -> re.Match[str]:
        """Place of the number on a page.

        Raises:
            FigureError: the words are not there, or more than once.
        """
        before, after = self.text.split("{}")
        parts = [r"\s+".join(map(re.escape, part.split(" "))) for part in (before, after)]
        matches = list(re.finditer(parts[0] + _NUMBER + parts[1], page))
        if len(matches) != 1:
            raise FigureError(f"{self.page}: expected {self.text!r} once with a number, found it {len(matches)} times")
        return matches[0]

    def fits(self, number: str) -> bool:
        """Whether a number as it stands on the page is within the tolerance."""
        value = self.value()
        return format(value, self.form) == number or abs(float(number.replace(",", "")) - value) <= self.tolerance * abs(value)


@functools.cache
def _card() -> Mapping[str, Any]:
    return read_model_card(model_folder())


def _fitted_strokes() -> float:
    data = _card()["data"]
    return float(data["train_strokes"] + data["validation_strokes"])


def _own_loop_percent() -> float:
    return 100 * float(saved("experiments", "recipes")["recipes"]["own_loop"]["rally_win_vs_bc"])


def _tournament_millions() -> float:
    rows = [row for row in saved("benchmarks", "throughput") if row["what"] == "tournament" and row["threads"] == 1]
    return float(max(row["strokes_per_s"] for row in rows)) / 1e6


FIGURES: Final = (
    Figure(page="README.md", text="fitted to {} annotated strokes", value=lambda: _card()["data"]["train_strokes"]),
    Figure(page="README.md", text="a round robin of {} policies with", value=lambda: len(default_pool(default_game()))),
    Figure(page="README.md", text="policies with {} matches per pair", value=lambda: LeagueConfig().matches),
    Figure(
        page="docs/league.md", text="about {} million strokes a second on one core", value=_tournament_millions, tolerance=0.25
    ),
    Figure(page="docs/league.md", text="{} matches a pair are tens of millions", value=lambda: LeagueConfig().matches),
    Figure(
        page="docs/tutorials/five_minutes.md",
        text="tabulated on all {} states of the game",
        value=lambda: default_game().n_states,
    ),
    Figure(page="docs/environments.md", text="| observation | {} numbers |", value=lambda: RALLY_WIDTH),
    Figure(page="docs/environments.md", text="numbers | the same, and {} for the score |", value=lambda: SCORE_WIDTH),
    Figure(page="benchmarks/README.md", text="counted once; the {} numbers and the mask", value=lambda: RALLY_WIDTH),
    Figure(
        page="benchmarks/README.md", text="until the next one; {} numbers and the mask", value=lambda: RALLY_WIDTH + SCORE_WIDTH
    ),
    Figure(page="docs/tutorials/own_loop.md", text="(`[B, {}]`, [the vector", value=lambda: RALLY_WIDTH),
    Figure(
        page="docs/tutorials/own_loop.md",
        text="the loop won {} % of rallies against `bc`",
        value=_own_loop_percent,
        form=".0f",
        tolerance=0.02,
    ),
    Figure(page="docs/own_data.md", text="At least three matches and {} strokes outside", value=lambda: MIN_STROKES),
    Figure(page="docs/own_data.md", text="It needs {} strokes and two matches", value=lambda: MIN_STROKES_WITH_PRIOR),
    Figure(page="docs/own_data.md", text="leave open, need {} train matches", value=lambda: MIN_MATCHES_FOR_REFITS),
    Figure(page="docs/datasheet.md", text="of which {} strokes of", value=_fitted_strokes),
)
"""All figures that are kept so."""


def written(pages: Mapping[str, str]) -> dict[str, str]:
    """The pages with every figure that is beyond its tolerance replaced.

    Args:
        pages: text of every page by its path.

    Raises:
        FigureError: the words around a figure are not on its page.
    """
    after = dict(pages)
    for figure in FIGURES:
        found = figure.found(after[figure.page])
        if not figure.fits(found[1]):
            text = after[figure.page]
            after[figure.page] = text[: found.start(1)] + format(figure.value(), figure.form) + text[found.end(1) :]
    return after


def drifted(pages: Mapping[str, str]) -> list[str]:
    """A line for every figure that is beyond its tolerance.

    Raises:
        FigureError: the words around a figure are not on its page.
    """
    lines = []
    for figure in FIGURES:
        number = figure.found(pages[figure.page])[1]
        if not figure.fits(number):
            allowed = f"within {figure.tolerance:.0%} of " if figure.tolerance else ""
            lines.append(
                f"{figure.page}: {figure.text.format(number)!r}; expected {allowed}{format(figure.value(), figure.form)}"
            )
    return lines
