"""Figures in sentences are those of their sources, within a tolerance that is stated."""

from docs.tools import figures
from docs.tools.figures import FIGURES
from docs.tools.markdown import ROOT

PAGES = {figure.page: (ROOT / figure.page).read_text(encoding="utf-8") for figure in FIGURES}


def test_no_committed_figure_has_drifted() -> None:
    assert figures.drifted(PAGES) == []
    assert figures.written(PAGES) == PAGES


def test_a_changed_figure_is_seen_and_written_again() -> None:
    figure = FIGURES[0]
    page = PAGES[figure.page]
    place = figure.found(page)
    wrong = str(round(1.5 * float(place[1].replace(",", "")) + 1))
    changed = {**PAGES, figure.page: page[: place.start(1)] + wrong + page[place.end(1) :]}
    (line,) = figures.drifted(changed)
    assert figure.page in line
    assert wrong in line
    assert figures.drifted(figures.written(changed)) == []
