"""Figures in sentences are those of their sources, within a tolerance that is stated."""

from docs.tools import figures
from docs.tools.figures import FIGURES
from docs.tools.markdown import ROOT

PAGES = {figure.page: (ROOT / figure.page).read_text(encoding="utf-8") for figure in FIGURES}


def test_no_committed_figure_has_drifted() -> None:
    assert figures.drifted(PAGES) == []
    assert figures.written(PAGES) == PAGES
