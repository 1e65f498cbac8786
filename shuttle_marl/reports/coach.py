"""Reports for coaches as objects: their figures, and their page.

Example::

    report("club/strokes.parquet", "final").save("report.html", language="id")
    scouting_report("an-se-young", "chen-yufei").figures["value"]
"""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from shuttle_marl.base.files import replace_file
from shuttle_marl.data import read_matches
from shuttle_marl.game.shipped import resolve_game
from shuttle_marl.game.tables import Game
from shuttle_marl.reports import sources
from shuttle_marl.reports.languages import Language, speaking
from shuttle_marl.reports.match_page import match_page
from shuttle_marl.reports.scout_page import scouting_page
from shuttle_marl.reports.scouting import scout


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class CoachReport:
    """A report.

    Attributes:
        figures: all figures by name, as ``--json`` prints them.
    """

    figures: Mapping[str, Any]
    _page: Callable[[], bytes]

    def html(self, language: Language = "en") -> bytes:
        """The page, one HTML file: English, Chinese (``zh``) or Indonesian (``id``)."""
        with speaking(language):
            return self._page()

    def save(self, path: Path | str, language: Language = "en") -> Path:
        """Write the page, and return its path.

        Raises:
            FileWriteError: it cannot be written.
        """
        replace_file(Path(path), self.html(language))
        return Path(path)


def report(
    path: Path | str, match: str | None = None, *, game: Game | str | None = None, columns: Path | str | None = None
) -> CoachReport:
    """The report of a match: what decided it, its key moments, and the choices that cost most.

    Args:
        path: annotated matches, as :func:`shuttle_marl.data.read_matches` reads them, or a rally log.
        match: words of the name of the match, or its number in a rally log; None: the only match, or the first of a log.
        game: in which strokes are valued; None: the benchmark's.
        columns: column map of a CSV file.

    Raises:
        DataError, RecordingError: the file cannot be read.
        AnalysisError: no such match, or several.
    """
    found, source = sources.of_file(Path(path), resolve_game(game), match, columns=None if columns is None else Path(columns))
    return CoachReport(figures=found.as_json(), _page=lambda: match_page(found, source))


def scouting_report(
    player: str,
    opponent: str | None = None,
    *,
    data: Path | str | None = None,
    beside: str | None = None,
    date: str | None = None,
    model: str = "default",
) -> CoachReport:
    """Scouting report: what a player should do against an opponent, how the opponent plays, and where the opponent is weak.

    Args:
        player: who is to win; without an opponent, whose profile it is.
        data: annotated matches, for counted habits; None: those of the model alone.
        beside: another opponent, whose habits are shown beside.
        date: day of the players' skill, such as 2021-07-31; None: the last one known.
        model: name or folder of the model.

    Raises:
        ShuttleError: the model does not know a player, or the data cannot be read.
    """
    strokes = None if data is None else read_matches(data)
    names = (player,) if opponent is None else (opponent, player)
    found = scout(*names, beside=beside, model=model, date=date, data=strokes)
    return CoachReport(
        figures=found.as_json(), _page=lambda: scouting_page(found, () if strokes is None else sources.gaps(strokes))
    )
