"""The scouting report as a page: figures for the template ``scout.html.j2``."""

import dataclasses
import json
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from shuttle_marl.analysis import Players
from shuttle_marl.analysis.advice import LEAST_REFITS, LEAST_STEADY
from shuttle_marl.analysis.habits import Ending, Habit
from shuttle_marl.analysis.outlook import spread
from shuttle_marl.analysis.scouting import ScoutingReport
from shuttle_marl.analysis.tactics import STEPS, Effect
from shuttle_marl.base.arrays import F64
from shuttle_marl.base.errors import printable
from shuttle_marl.coach import charts
from shuttle_marl.coach.drills import Drill, drills
from shuttle_marl.coach.examples import shared, staged_advice, viewer
from shuttle_marl.coach.rendering import page
from shuttle_marl.coach.words import of_100, ranged, words
from shuttle_marl.game.scoring import BWF
from shuttle_marl.game.shipped import Estimate
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.pages import Viewer
from shuttle_marl.watch.building import BuildError

_SHOWN: int = 12
_RARE = 0.02
"""Least share, of the player or of others, of an answer that is listed."""
_ENDS = ("fault", "winner")
_EVEN = 0.6
"""A match is open if neither player is expected to win it more often."""


def scouting_page(report: ScoutingReport, gaps: Sequence[str] = ()) -> bytes:
    """The page as the content of a file; ``gaps``: sentences on what the data lack."""
    rallies, program, reason = _examples(report)
    report = report.renamed(words().player)
    content = {
        "report": report,
        "known": [known for known in (report.player, report.opponent) if known is not None],
        "gaps": gaps,
        "reason": reason,
        "enough_refits": report.refits >= LEAST_REFITS,
        "least_steady": LEAST_STEADY,
        "catalogue": None if report.pair is None else report.pair.catalogue,
        "SHOTS": SHOTS,
        "isfinite": math.isfinite,
        "even": report.outlook is not None and 1 - _EVEN <= report.outlook.match.value <= _EVEN,
        "habit_bars": lambda habits: [_bar(habit) for habit in habits[:_SHOWN]],
        "answers": lambda kinds: _answers(report, kinds),
        "ending_share": lambda share, digits=0: ranged(Estimate(*share[:3]), digits),
        "clear_endings": list(_clear_endings(report.endings)),
        "endings": sorted((each for each in report.endings if each.technique is None), key=lambda each: -each.strokes),
        "plans": list(_plans(report)),
        "beside": _beside(report),
        "tactics": _tactics(report) if report.effects else None,
        "drills": _drills(report),
        "facts": list(_facts(report)),
    }
    return page("scout.html.j2", content, rallies=rallies, viewer=program)


def _examples(report: ScoutingReport) -> tuple[str, Viewer | None, str]:
    """Staged examples of the advice, and what plays them; or why there are none."""
    if not report.advice or report.pair is None or report.home is None or report.player is None:
        return "", None, ""
    try:
        program = viewer()
    except BuildError as error:
        return "", None, str(error)
    names = printable(report.player.name), printable(report.opponent.name)
    rallies = staged_advice(report.advice, report.pair, report.home, names)
    players = Players(tables=report.home.policies, value=report.home.value)
    content, _ = shared(rallies, report.pair, players)
    return content, program, ""


def _bar(habit: Habit) -> charts.Bar:
    return charts.Bar(words().habit(habit), 100 * habit.share, 100 * habit.low, 100 * habit.high, 100 * habit.usual, player=1)


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


def _plans(report: ScoutingReport) -> Iterator[dict[str, Any]]:
    """What the opponent does at the serve, after it, and with the smash: to prepare serve, return and defence."""
    say = words()
    for kind, about in (("serve", ()), ("return", ("short-serve",)), ("third", ()), ("direction", ("smash",))):
        found = sorted((h for h in report.habits if (h.kind, h.about) == (kind, about)), key=lambda h: -h.share)
        if found:
            named = (say(f"directions.{h.answer}") if kind == "direction" else say.shots(h.answer) for h in found[:3])
            most = say.listed(f"{answer} {of_100(h.share)}" for answer, h in zip(named, found, strict=False))
            yield {"kind": kind, "most": most, "strokes": found[0].strokes}


def _beside(report: ScoutingReport) -> dict[str, Any] | None:
    if report.beside is None:
        return None
    found = [habit for habit in report.beside[1] if habit.kind in ("shots", "serve", "return", "third")]
    differ = sum(habit.clear for habit in found)
    name = words().player(report.beside[0])
    return {"name": name, "differ": differ, "tested": len(found), "habits": list(filter(_listed, found))}


def _tactics(report: ScoutingReport) -> dict[str, Any]:
    """Effects that are clear, the bars of all, and the table of the sliders."""
    assert report.outlook is not None
    found, say = report.effects, words()
    share = 1.0 if report.factor is None else report.factor.value
    middle, less = STEPS.index(0.0), STEPS.index(-0.1)

    def reduced(values: F64) -> F64:
        """Changes at each step, reduced to what real matches realise, as in the chart."""
        return share * (values - values[middle])

    def bar(effect: Effect) -> charts.Bar:
        value, low, high = (100 * part for part in effect.more)
        return charts.Bar(say(f"tactics.{effect.tactic}"), value, low, high, clear=effect.clear)

    at, weights = spread(report.outlook.deviation)
    data = {
        "steps": STEPS,
        "tactics": [{name: reduced(getattr(e, name)).round(6).tolist() for name in ("serving", "receiving")} for e in found],
        "base": {"serving": float(found[0].serving[middle]), "receiving": float(found[0].receiving[middle])},
        "spread": {"at": at.round(6).tolist(), "weights": weights.round(6).tolist()},
        "rules": dataclasses.asdict(BWF),
    }
    return {
        "largest": sorted((effect for effect in found if effect.clear), key=lambda effect: -abs(effect.more.value)),
        "bars": [bar(effect) for effect in found],
        "less": lambda effect: float(reduced((effect.serving + effect.receiving) / 2)[less]),
        "table": json.dumps(data),
        "low": round(100 * STEPS[0]),
        "high": round(100 * STEPS[-1]),
    }


def _drills(report: ScoutingReport) -> list[Drill]:
    """The advised strokes."""
    if report.pair is None:
        return []
    kinds = report.pair.catalogue.shot
    situations = ((*advice.situation[:2], advice.stroke) for advice in report.advice)
    return drills(Drill(None if shot < 0 else SHOTS[shot], area, stroke, int(kinds[stroke])) for shot, area, stroke in situations)


def _facts(report: ScoutingReport) -> Iterator[tuple[str, str]]:
    """What the report rests on: the name of each fact and its value."""
    say = words()
    for known in (report.player, report.opponent):
        if known is not None:
            yield say("scout.sure_strokes", name=known.name), say.number(known.strokes, ",")
            yield say("scout.sure_matches", name=known.name), say.number(known.matches, ",")
            since = say("report.unknown") if known.since is None else say.format_field(known.since, "")
            yield say("scout.sure_since", name=known.name), since
            yield say("scout.sure_choices", name=known.name), say("report.yes" if known.imitated else "report.no")
    if report.player is not None:
        yield say("scout.sure_refits"), f"{report.refits}"
    yield say("scout.sure_model"), f"{report.model[0]}, {report.model[1][:12]}"
