"""Reports: the value of every stroke, summaries of play, and pages for coaches on how to play against an opponent and on a match.

:func:`analyse_rally` works on one rally of known policies. Summaries and :func:`add_values` work on stroke tables of one
schema (:mod:`shuttle_marl.data.schema`), so annotated matches and rally logs are treated alike. :func:`scout` and
:func:`match_report` compute the figures of the reports for coaches, :func:`scouting_report` and :func:`report` write them as
pages. See ``docs/analysis.md`` and ``docs/coach.md``. Names are imported when first used.
"""

from typing import TYPE_CHECKING

from shuttle_marl.base.extras import lazily

if TYPE_CHECKING:
    from shuttle_marl.reports.coach import CoachReport, report, scouting_report
    from shuttle_marl.reports.match import MatchReport, match_report
    from shuttle_marl.reports.rally import Decision, LogPlayers, Players, RallyAnalysis, analyse_rally, decision
    from shuttle_marl.reports.scouting import ScoutingReport, scout
    from shuttle_marl.reports.summary import AnalysisError, Summary, rally_table, strokes_of, strokes_of_log, summarise
    from shuttle_marl.reports.value import add_values, add_values_of_pairs

__all__ = [
    "AnalysisError",
    "CoachReport",
    "Decision",
    "LogPlayers",
    "MatchReport",
    "Players",
    "RallyAnalysis",
    "ScoutingReport",
    "Summary",
    "add_values",
    "add_values_of_pairs",
    "analyse_rally",
    "decision",
    "match_report",
    "rally_table",
    "report",
    "scout",
    "scouting_report",
    "strokes_of",
    "strokes_of_log",
    "summarise",
]

__getattr__, __dir__ = lazily(__name__)
