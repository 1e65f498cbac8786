"""Reports as pages from templates, which hold the prose and the order, and the figures that only templates ask for."""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from markupsafe import Markup

from shuttle_marl.data.hands import area_inferred
from shuttle_marl.data.matches import event
from shuttle_marl.data.schema import Outcome
from shuttle_marl.game.court import AREAS, N_SIDES
from shuttle_marl.game.recovery import ACROSS, DEPTHS
from shuttle_marl.game.scoring import wins_game
from shuttle_marl.game.shipped import RELIABLE, Estimate
from shuttle_marl.game.stroke import SHOTS, Catalogue
from shuttle_marl.reports import charts
from shuttle_marl.reports.habits import Habit, clear_endings
from shuttle_marl.reports.html import Heading, Viewer, render
from shuttle_marl.reports.match import MatchReport, matches_in
from shuttle_marl.reports.scouting import ScoutingReport
from shuttle_marl.reports.summary import met
from shuttle_marl.reports.value import LEAST_REFITS
from shuttle_marl.reports.waits import LEAST_METRES, Wait, differences
from shuttle_marl.reports.words import between, metres, of_100, parts, ranged, signed, words

if TYPE_CHECKING:
    from shuttle_marl.reports.coach import Source

DRILLS: Final = 3


class Example(NamedTuple):
    """A staged rally that shows a habit of the opponent."""

    statement: int = 0  # number of the habit on page 1
    match: str = ""  # annotated match; empty: the rally is simulated
    people: tuple[str, str] = ("", "")  # its players
    game: int = 0  # number of the game
    points: tuple[int, int] = (0, 0)  # of the opponent and of the other player before the rally


class Clips(NamedTuple):
    """Staged rallies that a page plays, of :mod:`shuttle_marl.court.clips`."""

    content: str = ""  # the rallies, as JSON; empty: none
    viewer: Viewer | None = None  # program that plays them
    reason: str = ""  # why there is none
    shown: Sequence[int] = ()  # rallies of a match that it plays, by their index
    numbers: Mapping[int, int] = {}  # of rallies of a match on the live court, from 0, by their index; empty: not shown there
    examples: Sequence[Example] = ()  # what each rally of a scouting report shows


NO_CLIPS: Final = Clips()


class Drill(NamedTuple):
    """A stroke to train: shot type that is fed (None: the player serves), area where it is met, catalogue index of the stroke."""

    shot: str | None
    area: int
    stroke: int


def drills(catalogue: Catalogue, asked: Iterable[tuple[int, int, int]]) -> list[Drill]:
    """The first strokes of different shot types, each asked for after a shot type (-1: a serve) to an area."""
    first: dict[int, Drill] = {}
    for shot, area, stroke in asked:
        first.setdefault(int(catalogue.shot[stroke]), Drill(None if shot < 0 else SHOTS[shot], int(area), stroke))
    return [*first.values()][:DRILLS]


def distance(wait: Wait) -> str:
    """The mean distance from the net with its interval, if it is known."""
    value, low, high = map(metres, wait.depth.mean)
    return value if np.isnan(wait.depth.mean.low) else words()("report.interval", value=value, low=low, high=high)


def shares(wait: Wait, axis: int) -> str:
    """Shares by depth (``axis`` 1) or by side (0)."""
    return " / ".join(of_100(share) for share in np.reshape(wait.positions, (-1, N_SIDES)).sum(axis=axis).tolist())


def page(template: str, clips: Clips, content: Mapping[str, Any]) -> bytes:
    """The page of a report; ``template``: its file name; ``content``: figures that the template shows."""
    say = words()
    figures = (between, metres, of_100, parts, ranged, signed, differences, distance, shares)
    return render(
        __package__ or "",
        template,
        assets=("coach.css", "coach.js"),
        viewer=clips.viewer,
        rallies=Markup(clips.content.replace("<", "\\u003c")),
        reason=clips.reason,
        say=say,
        language=say("language.tag"),
        save_table=say("report.save_table"),
        charts=charts,
        heading=Heading,
        AREAS=AREAS,
        SHOTS=SHOTS,
        constants={"RELIABLE": RELIABLE, "LEAST_METRES": LEAST_METRES, "DEPTHS": DEPTHS, "ACROSS": ACROSS},
        **{function.__name__: function for function in figures},
        **content,
    )


_RUN = 3  # points in a row that are mentioned


def match_page(report: MatchReport, source: "Source | None" = None, clips: Clips = NO_CLIPS) -> bytes:
    """The match report as the content of a file; ``source``: file of the match, for what its data lack (None: without that);
    ``clips``: its rallies."""
    match, named = report.match, report.players
    if source is not None and isinstance(source.match, tuple) and match:
        match = log_title(*source.match)  # in the language of the page
    report = dataclasses.replace(report, players=(words().player(named[0]), words().player(named[1])))
    catalogue = report.game.catalogue
    shots, areas = ([*part.tolist(), -1] for part in (catalogue.shot, catalogue.area))  # the last one is of the serve
    content: dict[str, Any] = {
        "report": report,
        "command": "" if source is None else source.command,
        "video": None if source is None else source.video,
        "met": None,
        "met_of": 0,
        "gaps": (),
        "examples": {rally: number for number, rally in enumerate(clips.shown)},
        "numbers": clips.numbers,
        "score": lambda winner=0: words().listed(f"{points[winner]}\N{EN DASH}{points[1 - winner]}" for points in report.score),
        "event": event(match, named),
        "reasons": lambda i: _reasons(report, i),
        "points": lambda value: {part: signed(share / 100) for part, share in value._asdict().items()},
        "enough_refits": report.refits >= LEAST_REFITS,
        "course": _course(report),
        "values": sorted((each for each in report.values if each.clear), key=lambda each: -abs(each.points.value)),
        "all_values": sorted(report.values, key=lambda each: (each.player, -each.points.value)),
        "areas": areas,
        "drills": [
            drills(catalogue, ((shots[c.incoming], areas[c.incoming], c.better) for c in report.choices if c.player == player))
            for player in (0, 1)
        ],
        "mean_length": float(np.mean([row.strokes for row in report.rallies])),
        "landed": [counts / max(1.0, counts.sum()) for counts in report.targets],
    }
    if source is not None and source.strokes is not None:
        played = source.strokes.filter(pc.equal(source.strokes["match"], str(source.match)))
        against = source.strokes.filter(pc.equal(source.strokes["opponent"], source.people[1]))
        of_opponent = {"met": met(source.strokes, *source.people), "met_of": len(matches_in(against))}
        content |= {**of_opponent, "gaps": gaps(played)}
    return page("match.html.j2", clips, content)


def _course(report: MatchReport) -> dict[str, Any]:
    """Points, probabilities of winning over the rallies, and where games end or are cut off."""
    rows, rules = report.rallies, report.rules
    by_game = dict(zip(dict.fromkeys(row.key[0] for row in rows), report.score, strict=True))
    ended = list(by_game.items())[: None if report.winner is not None else -1]
    return {
        "won": np.sum(report.score, axis=0).tolist(),
        "chance": [row.before for row in rows] + [rows[-1].after],
        "ends": [i for i in range(1, len(rows)) if rows[i].key[0] != rows[i - 1].key[0]],
        "played": sum(map(sum, report.score)),
        "by_game": by_game,
        "absent": [game for game in range(1, max(by_game)) if game not in by_game],
        "cut": [game for game, points in ended if not wins_game(max(points), min(points), rules)],
    }


def _reasons(report: MatchReport, i: int) -> Iterator[str]:
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


_DOUBTFUL = 0.5


def log_title(pairing: int, match: int) -> str:
    """Name of a match of a rally log."""
    return words()("match.of_log", match=match, pairing=pairing)


def gaps(strokes: pa.Table) -> tuple[str, ...]:
    """Sentences on the values of annotated strokes that are unknown, inferred or doubtful."""
    say, fault = words(), pc.equal(strokes["outcome"], Outcome.FAULT)
    guessed = pa.array(area_inferred(strokes))
    unknown = pc.sum(pc.and_(pc.is_null(strokes["area"]), pc.invert(fault))).as_py() or 0
    doubtful = pc.sum(pc.and_(pc.less(strokes["confidence"], _DOUBTFUL), pc.invert(guessed))).as_py() or 0
    inferred, right = pc.sum(guessed).as_py() or 0, pc.mean(strokes["confidence"].filter(guessed)).as_py()
    counts = {"strokes": len(strokes), "inferred": inferred, "unknown": unknown, "right": of_100(right or 0.0)}
    places = (say("scout.sure_places", **counts),) if inferred or unknown else ()
    return (*places, say("scout.sure_doubtful", doubtful=doubtful)) if doubtful else places


_SHOWN: int = 12
_RARE = 0.02  # least share, of the player or of others, of an answer that is listed


def scouting_page(report: ScoutingReport, gaps: Sequence[str] = (), clips: Clips = NO_CLIPS) -> bytes:
    """The scouting report as the content of a file; ``gaps``: sentences on what the data lack; ``clips``: its rallies."""
    say = words()
    report = report.renamed(say.player)
    whole = [each for each in report.endings if len(each.about) == 1]  # faults and winners in turn
    content = {
        "report": report,
        "known": [known for known in (report.player, report.opponent) if known is not None],
        "gaps": gaps,
        "clips": {each.statement: f"#example-{i}" for i, each in enumerate(clips.examples)},
        "examples": [_example(report, each) for each in clips.examples],
        "recorded": any(each.match for each in clips.examples),
        "framed": [AREAS.index(each.answer) for each in report.habits if each.kind == "targets" and each.clear],
        "most_clear": [habit for habit in report.habits if habit.clear][:_SHOWN],
        "answers": lambda kinds: _answers(report, kinds),
        "ending_share": lambda each, digits=0: ranged(Estimate(each.share, each.low, each.high), digits),
        "clear_endings": clear_endings(report.endings),
        "endings": sorted(zip(whole[::2], whole[1::2], strict=True), key=lambda ends: -ends[0].strokes),
    }
    return page("scout.html.j2", clips, content)


def _example(report: ScoutingReport, each: Example) -> str:
    say = words()
    figure = report.page1.of(1, "habit")[each.statement].figure
    assert isinstance(figure, Habit)
    habit = say.capital(say.habit(figure))
    points = "\N{EN DASH}".join(map(str, each.points))
    where = {"game": each.game, "points": points, "event": event(each.match, each.people)}
    return say("scout.examples_at", habit=habit, **where) if each.match else habit


def _listed(habit: Habit) -> bool:
    return max(habit.share, habit.usual) >= _RARE


def _answers(report: ScoutingReport, kinds: Sequence[str]) -> list[Habit]:
    asked = [habit for habit in report.habits if habit.kind in kinds and _listed(habit)]
    return sorted(asked, key=lambda habit: (kinds.index(habit.kind), habit.about, -habit.share))
