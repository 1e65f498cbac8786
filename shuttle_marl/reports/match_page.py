"""The match report as a page: figures for the template ``match.html.j2``."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np

from shuttle_marl.game.scoring import is_over, wins_game
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.reports import charts
from shuttle_marl.reports.match import MatchReport, ShotValue
from shuttle_marl.reports.rendering import Clips, Drill, court, drills, page
from shuttle_marl.reports.sources import Source, gaps, match_strokes, title_of_log
from shuttle_marl.reports.summary import met, rally_table
from shuttle_marl.reports.value import LEAST_REFITS
from shuttle_marl.reports.words import signed, words

_RUN = 3
"""Points in a row that are mentioned."""
_LEAST_HEAT = 60
"""Strokes in won and in lost rallies from which a map is drawn."""


def match_page(report: MatchReport, source: Source | None = None) -> bytes:
    """The page as the content of a file.

    Args:
        source: file of the match, for its rallies on the live court and what its data lack; None: without them.
    """
    clips, named = Clips() if source is None else court().match_clips(report, source), report.players
    match = report.match
    if source is not None and isinstance(source.match, tuple) and match:
        match = title_of_log(*source.match)  # in the language of the page
    report = dataclasses.replace(report, players=(words().player(named[0]), words().player(named[1])))
    content: dict[str, Any] = {
        "report": report,
        "command": "" if source is None else source.command,
        "video": None if source is None else source.video,
        "met": None,
        "gaps": (),
        "examples": {rally: number for number, rally in enumerate(clips.shown)},
        "numbers": clips.numbers,
        "score": lambda winner=0: words().listed(f"{points[winner]}\N{EN DASH}{points[1 - winner]}" for points in report.score),
        "event": words().event(match, named),
        "number": lambda i: clips.numbers[i] + 1 if i in clips.numbers else "\N{EN DASH}" if clips.numbers else i + 1,
        "reasons": lambda i: _reasons(report, i),
        "points": lambda value: {part: signed(share / 100) for part, share in value._asdict().items()},
        "enough_refits": report.refits >= LEAST_REFITS,
        "course": _course(report),
        "values": sorted((each for each in report.values if each.clear), key=lambda each: -abs(each.points.value)),
        "all_values": sorted(report.values, key=lambda each: (each.player, -each.points.value)),
        "bars": lambda values: [_bar(report, each) for each in values],
        "areas": [*report.game.catalogue.area.tolist(), -1],
        "drills": [_drills(report, player) for player in (0, 1)],
        "mean_length": float(np.mean([row.strokes for row in report.rallies])),
        "maps": [heat for heat in report.heat if min(sum(heat.won), sum(heat.lost)) >= _LEAST_HEAT],
        "share_of": lambda counts: np.array(counts) / np.sum(counts),
    }
    if source is not None and source.strokes is not None:
        played = match_strokes(source.strokes, str(source.match))
        content |= {"met": met(rally_table(source.strokes), *source.people), "gaps": gaps(played)}
    return page("match.html.j2", clips, content)


def _course(report: MatchReport) -> dict[str, Any]:
    """Who won (None: the match is open), probabilities of winning over the rallies, and where games end or are cut off."""
    games = np.bincount([int(points[1] > points[0]) for points in report.score], minlength=2)
    winner = int(games.argmax()) if is_over(games, report.rules) else None
    ended = report.score if winner is not None else report.score[:-1]
    rows = report.rallies
    return {
        "winner": winner,
        "won": [sum(row.winner == player for row in rows) for player in (0, 1)],
        "chance": [row.before for row in rows] + [rows[-1].after],
        "ends": [i for i in range(1, len(rows)) if rows[i].key[0] != rows[i - 1].key[0]],
        "played": sum(map(sum, report.score)),
        "cut": [n for n, points in enumerate(ended, 1) if not wins_game(max(points), min(points), report.rules)],
    }


def _reasons(report: MatchReport, i: int) -> Iterator[str]:
    """Why a rally counted."""
    rows, row = report.rallies, report.rallies[i]
    assert row.winner is not None
    rules, own, other = report.rules, row.points[row.winner], row.points[1 - row.winner]
    if wins_game(other + 1, own, rules):
        yield words()("match.moment_saved", player=report.players[row.winner])
    if wins_game(own + 1, other, rules):
        yield words()("match.moment_game", game=row.key[0])
    run = next((n for n in range(i + 1) if rows[i - n].winner != row.winner or rows[i - n].key[0] != row.key[0]), i + 1)
    if run >= _RUN:
        yield words()("match.moment_run", player=report.players[row.winner], points=run)


def _bar(report: MatchReport, each: ShotValue) -> charts.Bar:
    named = f"{report.players[each.player][:24]}: {words().shots(each.shot)}"
    return charts.Bar(named, *each.points, clear=each.clear, player=each.player)


def _drills(report: MatchReport, player: int) -> list[Drill]:
    """The better strokes of the costly decisions of a player."""
    catalogue = report.game.catalogue
    asked = []
    for choice in report.choices:
        if choice.player == player:
            serve = choice.incoming >= len(catalogue.names)
            shot = None if serve else SHOTS[catalogue.shot[choice.incoming]]
            area = -1 if serve else int(catalogue.area[choice.incoming])
            asked.append(Drill(shot, area, choice.better, int(catalogue.shot[choice.better])))
    return drills(asked)
