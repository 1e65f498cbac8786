"""Figures in the sentences of the documentation: where each stands, what it is computed from, and how far it may be off.

``python -m docs.tools.tables`` writes them with the tables, and ``--check`` fails where one has drifted beyond its tolerance.
"""

import functools
import re
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from docs.tools.markdown import saved
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.dynamics.make import MIN_MATCHES_FOR_REFITS, MIN_STROKES
from shuttle_marl.game import default_game, model_folder
from shuttle_marl.game.layout import RALLY_WIDTH, SCORE_WIDTH
from shuttle_marl.game.shipped import read_model_card
from shuttle_marl.league.entrants import LeagueConfig, default_pool

_NUMBER: Final = r"([0-9][0-9,]*(?:\.[0-9]+)?)"


class FigureError(ShuttleError):
    """A figure that is not where it should be, or not what its source says."""


class Figure(NamedTuple):
    """A number in a sentence."""

    page: str
    """Path from the root of the repository."""
    text: str
    """The words around it, with ``{}`` in its place; a space may be a line break."""
    value: Callable[[], float]
    """What it is computed from."""
    form: str = ",.0f"
    tolerance: float = 0.0
    """Largest relative difference from the value that is left as it is."""


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
    Figure("README.md", "fitted to {} annotated strokes", lambda: _card()["data"]["train_strokes"]),
    Figure("README.md", "a round robin of {} policies with", lambda: len(default_pool(default_game()))),
    Figure("README.md", "policies with {} matches per pair", lambda: LeagueConfig().matches),
    Figure("docs/league.md", "about {} million strokes a second on one core", _tournament_millions, tolerance=0.25),
    Figure("docs/league.md", "{} matches a pair are tens of millions", lambda: LeagueConfig().matches),
    Figure("docs/tutorials/five_minutes.md", "tabulated on all {} states of the game", lambda: default_game().n_states),
    Figure("docs/environments.md", "| observation | {} numbers |", lambda: RALLY_WIDTH),
    Figure("docs/environments.md", "numbers | the same, and {} for the score |", lambda: SCORE_WIDTH),
    Figure("benchmarks/README.md", "counted once; the {} numbers and the mask", lambda: RALLY_WIDTH),
    Figure("benchmarks/README.md", "until the next one; {} numbers and the mask", lambda: RALLY_WIDTH + SCORE_WIDTH),
    Figure("docs/tutorials/own_loop.md", "(`[B, {}]`, [the vector", lambda: RALLY_WIDTH),
    Figure("docs/tutorials/own_loop.md", "the loop won {} % of rallies against `bc`", _own_loop_percent, ".0f", 0.02),
    Figure("docs/own_data.md", "At least three matches and {} strokes outside", lambda: MIN_STROKES),
    Figure("docs/own_data.md", "leave open, need {} train matches", lambda: MIN_MATCHES_FOR_REFITS),
    Figure("docs/datasheet.md", "of which {} strokes of", _fitted_strokes),
)
"""All figures that are kept so."""


def updated(pages: Mapping[str, str]) -> tuple[dict[str, str], list[str]]:
    """The pages with every figure that is beyond its tolerance replaced, and a line about each of these.

    Args:
        pages: text of every page by its path.

    Raises:
        FigureError: the words around a figure are not on its page, or more than once.
    """
    after, drifted = dict(pages), []
    for figure in FIGURES:
        page, value = after[figure.page], figure.value()
        before, behind = (r"\s+".join(map(re.escape, part.split(" "))) for part in figure.text.split("{}"))
        places = list(re.finditer(before + _NUMBER + behind, page))
        if len(places) != 1:
            raise FigureError(f"{figure.page}: expected {figure.text!r} once with a number, found it {len(places)} times")
        (start, end), number, expected = places[0].span(1), places[0][1], format(value, figure.form)
        if number != expected and abs(float(number.replace(",", "")) - value) > figure.tolerance * abs(value):
            after[figure.page] = page[:start] + expected + page[end:]
            allowed = f"within {figure.tolerance:.0%} of " if figure.tolerance else ""
            drifted.append(f"{figure.page}: {figure.text.format(number)!r}; expected {allowed}{expected}")
    return after, drifted
