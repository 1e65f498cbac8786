"""The match report as a page."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from shuttle_marl.analysis import Players
from shuttle_marl.analysis.advice import LEAST_REFITS
from shuttle_marl.analysis.course import RallyRow
from shuttle_marl.analysis.marks import Choice
from shuttle_marl.analysis.match import MatchReport, ShotValue, Won
from shuttle_marl.coach import charts
from shuttle_marl.coach.blocks import Block, Section, chart, page, shown, text
from shuttle_marl.coach.drills import training
from shuttle_marl.coach.examples import shared, viewer
from shuttle_marl.coach.scout_page import habit_words
from shuttle_marl.coach.waits import waiting
from shuttle_marl.coach.words import between, of_100, realised, signed, words, yes_or_no
from shuttle_marl.game.scoring import is_over, wins_game
from shuttle_marl.game.shipped import RELIABLE
from shuttle_marl.game.tables import Game
from shuttle_marl.pages import Cell, Column, Table, name, table
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
    say = words()
    first, second = map(say.player, report.players)
    report = dataclasses.replace(report, players=(first, second))
    moments = [i for i in report.moments if i in footage.staged]
    rallies, program, reason, count = "", None, "", 0
    try:
        program = viewer()
        rallies, count = shared([footage.staged[i] for i in moments], footage.game, footage.players)
    except BuildError as error:
        reason = str(error)
    examples = {rally: number for number, rally in enumerate(moments[:count])}
    sections = [
        _course(report),
        _moments(report, examples, reason),
        _values(report),
        _choices(report),
        *_training(report),
        _serving(report),
        _lengths(report),
        _heat(report),
        *waiting(report.waits, report.players, report.hands, match=True),
        _changes(report),
        _rallies(report, footage),
        _sure(report, footage.gaps),
    ]
    hands = say.hands(zip(report.players, report.hands, strict=True))
    subtitle = say("match.subtitle", hands=hands, score=_score(report), name=f" · {report.match}" if report.match else "")
    return page(say("match.title", first=first, second=second), subtitle, sections, rallies=rallies, viewer=program)


def _score(report: MatchReport, winner: int = 0) -> str:
    return words().listed(f"{points[winner]}\N{EN DASH}{points[1 - winner]}" for points in report.score)


def _winner(report: MatchReport) -> int | None:
    games = np.bincount([int(points[1] > points[0]) for points in report.score], minlength=2)
    return int(games.argmax()) if is_over(games, report.rules) else None


def _course(report: MatchReport) -> Section:
    say, winner = words(), _winner(report)
    won = [sum(row.winner == player for row in report.rallies) for player in (0, 1)]
    if winner is None:
        lead = say("match.course_open", first=report.players[0], second=report.players[1], score=_score(report))
    else:
        fields = {"winner": report.players[winner], "score": _score(report, winner)}
        lead = say("match.course_lead", points=won[winner], rallies=sum(won), **fields)
    chance = [row.before for row in report.rallies] + [report.rallies[-1].after]
    games = [i for i in range(1, len(report.rallies)) if report.rallies[i].key[0] != report.rallies[i - 1].key[0]]
    caption = say("match.course_chart", first=report.players[0])
    drawn = charts.course(chance, games, report.moments, report.players, caption)
    key = "course_before" if report.skilled else "course_equal"
    blocks = [chart(drawn, caption), text(say(f"match.{key}", first=report.players[0], share=of_100(report.before)))]
    played = sum(map(sum, report.score))
    if played > len(report.rallies):
        blocks.insert(0, text(say("match.course_missing", played=played, rallies=len(report.rallies))))
    ended = report.score if winner is not None else report.score[:-1]
    for number, points in enumerate(ended, 1):
        if not wins_game(max(points), min(points), report.rules):
            blocks.insert(0, text(say("match.course_cut", game=number)))
    for player, (forced, unforced) in zip(report.players, report.faults, strict=True):
        if forced + unforced:
            blocks.append(text(say("match.course_faults", player=player, forced=forced, unforced=unforced)))
    return Section(say("match.course"), lead, blocks)


def _points(row: RallyRow) -> str:
    return f"{row.points[0]}\N{EN DASH}{row.points[1]}"


def _ending(row: RallyRow) -> str:
    say = words()
    return say(f"endings.{row.ending}", shot=say.shot(row.last_shot, 0))


def _moments(report: MatchReport, examples: dict[int, int], reason: str) -> Section:
    say, blocks = words(), []
    for i in report.moments:
        row = report.rallies[i]
        assert row.winner is not None
        side = 1 if row.winner == 0 else -1
        before, after = (of_100(chance if side == 1 else 1 - chance) for chance in (row.before, row.after))
        winner = report.players[row.winner]
        lines = [
            say("match.moment_swing", winner=winner, before=before, after=after),
            say("match.moment_length", strokes=row.strokes, ending=_ending(row)),
        ]
        if row.decided is not None:
            number, player, shot, change = row.decided
            fields = {"shot": say.shot(shot), "player": report.players[player], "change": signed(change, 0)}
            lines.insert(1, say("match.moment_decided", number=number, **fields))
        title = say("match.moment_title", game=row.key[0], points=_points(row), winner=winner)
        blocks.append(Block("card", title, items=lines, example=examples.get(i), label=say("report.play_rally")))
    if reason:
        blocks.append(text(say("report.too_large", reason=reason)))
    row = report.rallies[report.moments[0]]
    fields = {"game": str(row.key[0]), "points": _points(row), "change": of_100(abs(row.swing))}
    return Section(say("match.moments"), say("match.moments_lead", winner=report.players[row.winner or 0], **fields), blocks)


def _values(report: MatchReport) -> Section:
    say = words()
    clear = sorted((each for each in report.values if each.clear), key=lambda each: -abs(each.points.value))
    lines = [_value_line(report, each) for each in clear] or [say("match.values_none")]
    blocks = [Block("list", items=lines[1:])] if lines[1:] else []
    if report.values:
        ordered = sorted(report.values, key=lambda each: (each.player, -each.points.value))
        rows = [
            charts.Bar(f"{report.players[e.player][:24]}: {say.shots(e.shot)}", *e.points, clear=e.clear, player=e.player)
            for e in ordered
        ]
        caption = say("match.values_chart")
        blocks.append(chart(charts.bars(rows, caption), caption))
        columns: list[Column[ShotValue]] = [
            Column(say("match.values_head"), lambda e: name(report.players[e.player]), left=True, wrap=True),
            Column(say("match.values_shot"), lambda e: name(say.shots(e.shot)), left=True),
            Column(say("match.values_strokes"), lambda e: Cell(say.number(e.strokes, ","), e.strokes)),
            Column(say("match.values_points"), lambda e: Cell(signed(e.points.value / 100), e.points.value)),
            Column(say("match.values_range"), lambda e: Cell(say("report.range", **_points_of(e)), e.points.low)),
            Column(say("match.values_clear"), lambda e: yes_or_no(e.clear)),
        ]
        blocks.append(shown(table(ordered, columns)))
    return Section(say("match.values"), lines[0], blocks)


def _points_of(each: ShotValue) -> dict[str, str]:
    return {
        "points": signed(each.points.value / 100),
        "low": signed(each.points.low / 100),
        "high": signed(each.points.high / 100),
    }


def _value_line(report: MatchReport, each: ShotValue) -> str:
    say, key = words(), "values_lead" if each.points.value > 0 else "values_lost"
    return say(f"match.{key}", player=report.players[each.player], shots=say.shots(each.shot), **_points_of(each))


def _choices(report: MatchReport) -> Section:
    say, blocks, names = words(), [], report.game.catalogue
    if not report.choices:
        key = "choices_none" if report.refits >= LEAST_REFITS else "choices_no_refits"
        return Section(say("match.choices"), say(f"match.{key}"), [])
    for choice in report.choices:
        played, better = _compared(report, choice)
        row = report.rallies[choice.rally]
        where: dict[str, object] = {"game": row.key[0], "points": _points(row)}
        if choice.incoming >= len(names.names):
            when = say("match.choice_serve", **where)
        else:
            incoming = say.stroke(names, choice.incoming, "own")
            where |= {"number": choice.stroke, "stroke": choice.stroke, "incoming": incoming}
            when = say("match.choice_when", height=say.height(choice.contact), **where)
        cost = {"cost": of_100(choice.cost.value), "low": of_100(choice.cost.low), "high": of_100(choice.cost.high)}
        lines = [
            when,
            say("match.choice_better", better=better, **cost),
            say("match.choice_behind", played=int(choice.played_behind), better=int(choice.better_behind), times=choice.times),
        ]
        title = say("match.choice_title", player=report.players[choice.player], stroke=played)
        blocks.append(Block("card", title, items=lines))
    worst = report.choices[0]
    played, _ = _compared(report, worst)
    lead = say("match.choices_lead", player=report.players[worst.player], stroke=played, cost=of_100(worst.cost.value))
    return Section(say("match.choices"), lead, blocks)


def _compared(report: MatchReport, choice: Choice) -> tuple[str, str]:
    """The stroke played and the better one, in words."""
    catalogue, hands = report.game.catalogue, (report.hands[choice.player], report.hands[1 - choice.player])
    met = int(np.append(catalogue.area, -1)[choice.incoming])
    first, second = (words().stroke(catalogue, k, "receiver", met=met, hands=hands) for k in (choice.played, choice.better))
    return first, second


def _training(report: MatchReport) -> list[Section]:
    say, catalogue, out = words(), report.game.catalogue, []
    for player, who in enumerate(report.players):
        asked = []
        for choice in report.choices:
            serve = choice.incoming >= len(catalogue.names)
            met = (-1, -1) if serve else (int(catalogue.shot[choice.incoming]), int(catalogue.area[choice.incoming]))
            if choice.player == player:
                asked.append((*met, choice.better))
        if asked:
            hands = report.hands[player], report.hands[1 - player]
            section = training(catalogue, asked, say("match.training_lead", player=who), hands)
            out.append(dataclasses.replace(section, heading=say("match.training", player=who)))
    return out


def _won_table(rows: Sequence[Won], label: Callable[[Won], str], players: tuple[str, str] | None, head: str) -> Table:
    say = words()
    columns: list[Column[Won]] = (
        [] if players is None else [Column(say("match.won_player"), lambda w: name(players[w.player]), left=True, wrap=True)]
    )
    columns += [
        Column(head, lambda w: name(label(w)), left=True),
        Column(say("match.won_won"), lambda w: Cell(f"{w.won}", w.won)),
        Column(say("match.won_of"), lambda w: Cell(f"{w.rallies}", w.rallies)),
        Column(say("match.won_share"), lambda w: Cell(of_100(w.won / w.rallies), w.won / w.rallies)),
        Column(say("match.won_range"), lambda w: Cell(between(w.low, w.high), w.high - w.low)),
    ]
    return table(rows, columns)


def _serving(report: MatchReport) -> Section:
    say = words()
    served = {w.player: w for w in report.serving if w.label == "serving"}
    rows = shown(_won_table(report.serving, lambda w: say(f"match.label_{w.label}"), report.players, say("match.won_label")))
    if len(served) < 2:
        return Section(say("match.serving"), "", [rows])
    one, two = served[0], served[1]
    fields = {"won": one.won, "rallies": one.rallies, "other_won": two.won, "other_rallies": two.rallies}
    lead = say("match.serving_lead", player=report.players[0], other=report.players[1], **fields)
    return Section(say("match.serving"), lead, [rows])


def _lengths(report: MatchReport) -> Section:
    say = words()
    strokes = [row.strokes for row in report.rallies]
    lines = []
    for each in report.lengths:
        if each.clear:
            winner = int(each.won * 2 < each.rallies)
            won = each.won if winner == 0 else each.rallies - each.won
            lines.append(
                say("match.lengths_clear", player=report.players[winner], label=each.label, won=won, rallies=each.rallies)
            )
    head = say("match.lengths_label")
    return Section(
        say("match.lengths"),
        say("match.lengths_lead", mean=float(np.mean(strokes)), longest=max(strokes)),
        [
            *([Block("list", items=lines)] if lines else []),
            text(say("match.lengths_won", first=report.players[0])),
            shown(_won_table(report.lengths, lambda w: w.label, None, head)),
        ],
    )


def _heat(report: MatchReport) -> Section:
    say, blocks, maps, lead = words(), [], [], words()("match.heat_none")
    for heat in report.heat:
        won, lost = (np.array(part) for part in (heat.won, heat.lost))
        n, m = won.sum(), lost.sum()
        if min(n, m) < _LEAST_HEAT:
            continue
        player, hand = report.players[heat.player], report.hands[1 - heat.player]
        caption = say("match.heat_chart", player=player, won=round(n), lost=round(m), sides=say.sides(hand))
        maps.append((charts.court(won / n, lost / m, caption, hand, heat.clear), caption))
        for area in heat.clear:
            shares = {"won": of_100(won[area] / n), "lost": of_100(lost[area] / m)}
            line = say("match.heat_lead", player=player, area=say.area(area, "receiver"), **shares)
            if lead == say("match.heat_none"):
                lead = line
            else:
                blocks.append(text(line))
    return Section(say("match.heat"), lead, [*blocks, Block("courts", items=maps)])


def _changes(report: MatchReport) -> Section:
    say = words()
    lines = [
        say(
            "match.changes_lead",
            player=report.players[change.player],
            game=change.game,
            habit=habit_words(change.habit),
            share=of_100(change.habit.share),
            usual=of_100(change.habit.usual),
            strokes=round(change.habit.strokes),
        )
        for change in report.changes
    ]
    if not lines:
        return Section(say("match.changes"), say("match.changes_none"), [])
    return Section(say("match.changes"), lines[0], [Block("list", items=lines[1:])] if lines[1:] else [])


def _rallies(report: MatchReport, footage: Footage) -> Section:
    say = words()
    numbered = list(enumerate(report.rallies))
    players = report.players
    columns: list[Column[tuple[int, RallyRow]]] = [
        Column(say("match.rallies_head"), lambda r: Cell(f"{r[0] + 1}", r[0]), ascending=True),
        Column(say("match.rallies_game"), lambda r: Cell(f"{r[1].key[0]}", r[1].key[0]), ascending=True),
        Column(say("match.rallies_score"), lambda r: Cell(_points(r[1]), sum(r[1].points))),
        Column(say("match.rallies_server"), lambda r: name(players[r[1].server]), left=True),
        Column(
            say("match.rallies_winner"),
            lambda r: name(say("report.unknown") if r[1].winner is None else players[r[1].winner]),
            left=True,
        ),
        Column(say("match.rallies_strokes"), lambda r: Cell(f"{r[1].strokes}", r[1].strokes)),
        Column(say("match.rallies_ending"), lambda r: name(_ending(r[1])), left=True),
        Column(say("match.rallies_swing"), lambda r: Cell(signed(r[1].swing), abs(r[1].swing))),
    ]
    if footage.video is not None:
        columns.append(Column(say("match.rallies_video"), lambda r: _link(footage, r[1]), left=True))
    blocks = []
    if footage.numbers:
        head = say("match.rallies_number")
        columns.append(Column(head, lambda r: Cell() if (n := footage.numbers.get(r[0])) is None else Cell(str(n), n)))
        blocks.append(text(say("match.rallies_watch", command=footage.command, column=head)))
    lead = say("match.rallies_lead", first=players[0])
    return Section(say("match.rallies"), lead, [*blocks, shown(table(numbered, columns))])


def _link(footage: Footage, row: RallyRow) -> Cell:
    if footage.video is None or row.seconds is None:
        return Cell()
    return Cell(f"{row.seconds // 60:.0f}:{row.seconds % 60:02.0f}", row.seconds, footage.video(row.seconds))


def _sure(report: MatchReport, gaps: Sequence[str]) -> Section:
    say = words()
    lead = say("match.sure_lead", strokes=report.strokes, rallies=len(report.rallies))
    choices = say("match.sure_choices", least=RELIABLE, refits=report.refits)
    rests = [say("match.sure_values"), choices, realised(report.factor), *gaps, say("scout.sure_observed"), say("scout.named")]
    return Section(say("match.sure"), lead, list(map(text, rests)))
