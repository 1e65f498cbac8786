"""The match report as a page: figures for the template ``match.html.j2``."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from shuttle_marl.analysis import Players
from shuttle_marl.analysis.advice import LEAST_REFITS
from shuttle_marl.analysis.match import MatchReport, ShotValue
from shuttle_marl.coach import charts
from shuttle_marl.coach.drills import Drill, drills
from shuttle_marl.coach.examples import shared, viewer
from shuttle_marl.coach.rendering import page
from shuttle_marl.coach.words import signed, words
from shuttle_marl.game.scoring import is_over, wins_game
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.watch.building import BuildError
from shuttle_marl.watch.match import CourtRally

_LEAST_HEAT = 60
"""Strokes in won and in lost rallies from which a map is drawn."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Footage:
    """How a reader gets to the rallies of a report.

    Attributes:
        staged: rallies of the report that can be staged, by their index.
        game, players: in which they are valued.
        command: that shows rallies on the live court, up to the number.
        numbers: of the rallies for that command, by their index; empty: they cannot be shown.
        video: address of the video at a time in seconds; None: no video.
        gaps: sentences on what the data lack.
    """

    staged: dict[int, CourtRally]
    game: Game
    players: Players
    command: str
    numbers: dict[int, int]
    video: Callable[[float], str] | None = None
    gaps: tuple[str, ...] = ()


def match_page(report: MatchReport, footage: Footage) -> bytes:
    """The page as the content of a file."""
    first, second = map(words().player, report.players)
    report = dataclasses.replace(report, players=(first, second))
    moments = [i for i in report.moments if i in footage.staged]
    rallies, program, reason, count = "", None, "", 0
    try:
        program = viewer()
        rallies, count = shared([footage.staged[i] for i in moments], footage.game, footage.players)
    except BuildError as error:
        reason = str(error)
    content = {
        "report": report,
        "footage": footage,
        "examples": {rally: number for number, rally in enumerate(moments[:count])},
        "reason": reason,
        "score": lambda winner=0: _score(report.score, winner),
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
    return page("match.html.j2", content, rallies=rallies, viewer=program)


def _score(score: Sequence[tuple[int, int]], winner: int) -> str:
    return words().listed(f"{points[winner]}\N{EN DASH}{points[1 - winner]}" for points in score)


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
