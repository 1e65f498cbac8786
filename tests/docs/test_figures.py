"""Figures in sentences are those of their sources, within a tolerance that is stated."""

import dataclasses

import pytest

from docs.tools import figures
from docs.tools.figures import FIGURES, Figure, FigureError
from docs.tools.markdown import ROOT

PAGES = {figure.page: (ROOT / figure.page).read_text(encoding="utf-8") for figure in FIGURES}
SPEED = Figure(page="x.md", text="about {} million strokes", value=lambda: 20.4, tolerance=0.1)


def test_no_committed_figure_has_drifted() -> None:
    assert figures.drifted(PAGES) == []
    assert figures.written(PAGES) == PAGES


@pytest.mark.parametrize("figure", FIGURES, ids=lambda figure: figure.text)
def test_a_changed_figure_is_seen_and_written_again(figure: Figure) -> None:
    page = PAGES[figure.page]
    place = figure.found(page)
    wrong = str(round(1.5 * float(place[1].replace(",", "")) + 1))
    changed = {**PAGES, figure.page: page[: place.start(1)] + wrong + page[place.end(1) :]}
    (line,) = figures.drifted(changed)
    assert figure.page in line
    assert wrong in line
    assert figures.drifted(figures.written(changed)) == []


@pytest.mark.parametrize(("number", "fits"), [("20", True), ("22", True), ("18.5", True), ("23", False), ("18", False)])
def test_the_tolerance_is_kept(number: str, fits: bool) -> None:
    assert SPEED.fits(number) == fits
    assert dataclasses.replace(SPEED, tolerance=0.0).fits(number) == (number == "20")


def test_words_that_are_not_there_once() -> None:
    assert SPEED.found("about 20\nmillion   strokes")[1] == "20"
    for text in ("", "about many million strokes", "about 2 million strokes, about 3 million strokes"):
        with pytest.raises(FigureError, match="once with a number"):
            SPEED.found(text)
