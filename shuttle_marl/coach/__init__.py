"""For coaches: the scouting report and the match report as pages. See ``docs/coach.md``."""

from typing import TYPE_CHECKING

from shuttle_marl.base.lazy import lazily

if TYPE_CHECKING:
    from shuttle_marl.coach.reports import CoachReport, report, scouting_report

__all__ = ["CoachReport", "report", "scouting_report"]

__getattr__, __dir__ = lazily(__name__)
