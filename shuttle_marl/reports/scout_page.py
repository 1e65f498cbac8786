"""The scouting report as a page: figures for the template ``scout.html.j2``."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from shuttle_marl.game.shipped import Estimate
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.reports import charts
from shuttle_marl.reports.advice import LEAST_STEADY
from shuttle_marl.reports.habits import Ending, Habit
from shuttle_marl.reports.rendering import Clips, Drill, court, drills, page
from shuttle_marl.reports.scouting import ScoutingReport
from shuttle_marl.reports.value import LEAST_REFITS
from shuttle_marl.reports.words import ranged, words

_SHOWN: int = 12
_RARE = 0.02
"""Least share, of the player or of others, of an answer that is listed."""
_ENDS = ("fault", "winner")


def scouting_page(report: ScoutingReport, gaps: Sequence[str] = ()) -> bytes:
    """The page as the content of a file; ``gaps``: sentences on what the data lack."""
    say, clips = words(), court().scout_clips(report) if report.advice and report.home is not None else Clips()
    report = report.renamed(say.player)
    content = {
        "report": report,
        "known": [known for known in (report.player, report.opponent) if known is not None],
        "gaps": gaps,
        "enough_refits": report.refits >= LEAST_REFITS,
        "least_steady": LEAST_STEADY,
        "catalogue": None if report.pair is None else report.pair.catalogue,
        "habit_bars": lambda habits: [
            charts.Bar(say.habit(each), 100 * each.share, 100 * each.low, 100 * each.high, 100 * each.usual, player=1)
            for each in habits[:_SHOWN]
        ],
        "answers": lambda kinds: _answers(report, kinds),
        "ending_share": lambda share, digits=0: ranged(Estimate(*share[:3]), digits),
        "clear_endings": list(_clear_endings(report.endings)),
        "endings": sorted((each for each in report.endings if each.technique is None), key=lambda each: -each.strokes),
        "ends": [
            sorted((e for e in report.endings if e.technique is None), key=lambda e: getattr(e, end)[3] - getattr(e, end)[0])
            for end in _ENDS
        ],
        "beside": _beside(report),
        "drills": _drills(report),
    }
    return page("scout.html.j2", clips, content)


def _listed(habit: Habit) -> bool:
    return max(habit.share, habit.usual) >= _RARE


def _answers(report: ScoutingReport, kinds: Sequence[str]) -> list[Habit]:
    """All answers to some questions that are not very rare."""
    asked = [habit for habit in report.habits if habit.kind in kinds and _listed(habit)]
    return sorted(asked, key=lambda habit: (kinds.index(habit.kind), habit.about, -habit.share))


def _clear_endings(endings: Sequence[Ending]) -> Iterator[tuple[Ending, str]]:
    """Faults and winners that differ from those of others; what holds of a shot type is not repeated for its techniques."""
    whole = {(each.shot, key) for each in endings if each.technique is None for key in np.flatnonzero(each.clear).tolist()}
    for each in endings:
        for key, end in enumerate(_ENDS):
            if each.clear[key] and (each.technique is None or (each.shot, key) not in whole):
                yield each, end


def _beside(report: ScoutingReport) -> dict[str, Any] | None:
    if report.beside is None:
        return None
    found = [habit for habit in report.beside[1] if habit.kind in ("shots", "serve", "return", "third")]
    differ = sum(habit.clear for habit in found)
    name = words().player(report.beside[0])
    return {"name": name, "differ": differ, "tested": len(found), "habits": list(filter(_listed, found))}


def _drills(report: ScoutingReport) -> list[Drill]:
    """The advised strokes."""
    if report.pair is None:
        return []
    kinds = report.pair.catalogue.shot
    situations = ((*advice.situation[:2], advice.stroke) for advice in report.advice)
    return drills(Drill(None if shot < 0 else SHOTS[shot], area, stroke, int(kinds[stroke])) for shot, area, stroke in situations)
