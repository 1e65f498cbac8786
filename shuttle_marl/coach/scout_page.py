"""The scouting report as a page."""

import dataclasses
import json
from collections.abc import Sequence

import numpy as np

from shuttle_marl.analysis import Players
from shuttle_marl.analysis.advice import LEAST_REFITS, LEAST_STEADY, Advice
from shuttle_marl.analysis.habits import Ending, Habit
from shuttle_marl.analysis.outlook import spread
from shuttle_marl.analysis.scouting import Known, ScoutingReport
from shuttle_marl.analysis.tactics import STEPS, Effect
from shuttle_marl.base.arrays import F64
from shuttle_marl.base.errors import printable
from shuttle_marl.coach import charts
from shuttle_marl.coach.blocks import Block, Section, chart, page, shown, text
from shuttle_marl.coach.drills import training
from shuttle_marl.coach.examples import shared, staged_advice, viewer
from shuttle_marl.coach.waits import waiting
from shuttle_marl.coach.words import between, of_100, ranged, realised, signed, words, yes_or_no
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.scoring import BWF
from shuttle_marl.game.shipped import RELIABLE, Estimate
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.pages import Cell, Column, Table, Viewer, name, table
from shuttle_marl.watch.building import BuildError

_SHOWN: int = 12
_RARE = 0.02
"""Least share, of the player or of others, of an answer that is listed."""
_ENDS = ("fault", "winner")
_EVEN = 0.6
"""A match is open if neither player is expected to win it more often."""


def scouting_page(report: ScoutingReport, gaps: Sequence[str] = ()) -> bytes:
    """The page as the content of a file; ``gaps``: sentences on what the data lack."""
    say = words()
    rallies, program, reason = _examples(report)
    report = report.renamed(say.player)
    opponent = report.opponent.name
    sections = [_outlook(report), _habits(report)] if report.player is not None else [_habits(report)]
    sections += [part for part in (_recent(report), _plan(report), _beside(report)) if part is not None]
    people = [("", None) if known is None else (known.name, known.hand) for known in (report.player, report.opponent)]
    names, hands = zip(*people, strict=True)
    sections += waiting(report.waits, names, hands)
    if report.effects:
        sections += [_advice(report, reason), _tactics(report)]
    elif report.player is not None:
        unknown = [known.name for known in (report.player, report.opponent) if not known.strokes]
        lead = " ".join(say("scout.advice_unknown", name=each) for each in unknown)
        sections.append(Section(say("scout.advice", opponent=opponent), lead, []))
    if report.advice and report.pair is not None:
        asked = [(*advice.situation[:2], advice.stroke) for advice in report.advice]
        lead = say("scout.training_lead", opponent=opponent)
        hands = (None if report.player is None else report.player.hand, report.opponent.hand)
        sections.append(training(report.pair.catalogue, asked, lead, hands))
    sections.append(_sure(report, gaps))
    since = report.opponent.since
    known_ones = [known for known in (report.player, report.opponent) if known is not None]
    fields = {
        "hands": say.hands((known.name, known.hand) for known in known_ones),
        "discipline": say(f"disciplines.{report.discipline}"),
        "day": say("scout.undated") if since is None else say("scout.today", date=since),
    }
    title = (
        say("scout.title_alone", opponent=opponent)
        if report.player is None
        else say("scout.title", player=report.player.name, opponent=opponent)
    )
    return page(title, say("scout.subtitle", **fields), sections, rallies=rallies, viewer=program)


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


def _knowledge(known: Known, discipline: str) -> str:
    say = words()
    if known.since is None:
        return say("scout.outlook_unknown", name=known.name, discipline=say(f"disciplines.{discipline}"))
    if not known.imitated:
        return say("scout.outlook_few", name=known.name, strokes=known.strokes)
    return say("scout.outlook_rests", name=known.name, strokes=known.strokes, matches=known.matches, since=known.since)


def _outlook(report: ScoutingReport) -> Section:
    say, found = words(), report.outlook
    assert found is not None
    assert report.player is not None
    key = "outlook_even" if 1 - _EVEN <= found.match.value <= _EVEN else "outlook_lead"
    lead = say(f"scout.{key}", player=report.player.name, rallies=ranged(found.rally), matches=ranged(found.match))
    tiles = [
        (ranged(found.serving), say("scout.serving")),
        (ranged(found.receiving), say("scout.receiving")),
        (ranged(found.game), say("scout.game_won")),
        (ranged(found.match), say("scout.match_won")),
    ]
    known = [text(_knowledge(each, report.discipline)) for each in (report.player, report.opponent)]
    return Section(say("scout.outlook"), lead, [Block("tiles", items=tiles), *known, text(say("scout.outlook_past"))])


def habit_words(habit: Habit) -> str:
    """A habit in words."""
    say = words()
    fields: dict[str, str] = {"direction": "", "shots": "", "area": "", "about": "", "height": ""}
    if habit.answer in SHOTS:
        fields["shots"] = say.shots(habit.answer)
    elif habit.kind == "targets":
        fields["area"] = say.area(AREAS.index(habit.answer), "receiver")
    else:
        fields["direction"] = say(f"directions.{habit.answer}")
    if habit.about:
        fields["about"] = say.shots(habit.about[0])
    if len(habit.about) > 1:
        fields["height"] = say(f"heights.{habit.about[1]}")
    return say(f"habit.{habit.kind}", **fields)


def _habits(report: ScoutingReport) -> Section:
    say, opponent = words(), report.opponent.name
    clear = [habit for habit in report.habits if habit.clear]
    discipline = say(f"disciplines.{report.discipline}")
    key = "habits_lead" if clear else "habits_none"
    lead = say(f"scout.{key}", opponent=opponent, discipline=discipline, count=len(clear), tested=len(report.habits))
    strokes = report.opponent.strokes if report.seen is None else report.seen.strokes
    blocks: list[Block] = []
    if report.seen is not None:
        seen = report.seen
        days = "" if seen.first is None else say("scout.days", first=seen.first, last=seen.last)
        counts = {"matches": seen.matches, "strokes": strokes, "days": days}
        blocks.append(text(say("scout.habits_from_data", opponent=opponent, **counts)))
    elif report.opponent.since is not None:
        blocks.append(text(say("scout.habits_from_model", strokes=strokes, opponent=opponent, matches=report.opponent.matches)))
    if strokes < 10 * RELIABLE:
        blocks.append(text(say("scout.habits_few", strokes=strokes, opponent=opponent)))
    if clear:
        rows = [
            charts.Bar(habit_words(h), 100 * h.share, 100 * h.low, 100 * h.high, 100 * h.usual, player=1) for h in clear[:_SHOWN]
        ]
        blocks.append(chart(charts.bars(rows, say("scout.habits", opponent=opponent)), say("scout.habit_chart")))
    blocks += _described(report, ("shots",), "scout.mix_table")
    if report.target_strokes >= RELIABLE:
        hand = None if report.player is None else report.player.hand
        told = round(report.target_strokes)
        caption = say("scout.targets_chart", opponent=opponent, strokes=told, sides=say.sides(hand))
        drawn = charts.court(report.targets, report.targets_usual, caption, hand)
        blocks.append(Block("courts", items=[(drawn, caption)]))
    lines = _endings(report.endings)
    if lines:
        blocks += [text(say("scout.endings_lead")), Block("list", items=lines)]
    if whole := [each for each in report.endings if each.technique is None]:
        blocks.append(shown(_ends(whole)))
    if report.seen is not None:
        blocks.append(text(say("scout.tempo", opponent=opponent, length=report.seen.length, usual=report.seen.length_usual)))
        if report.seen.seconds == report.seen.seconds:
            seconds = {"seconds": report.seen.seconds, "usual": report.seen.seconds_usual}
            blocks.append(text(say("scout.seconds", opponent=opponent, **seconds)))
    return Section(say("scout.habits", opponent=opponent), lead, blocks)


def _described(report: ScoutingReport, kinds: Sequence[str], heading: str) -> list[Block]:
    """Table of all answers to some questions that are not very rare, with their numbers."""
    asked = [habit for kind in kinds for habit in report.habits if habit.kind == kind and max(habit.share, habit.usual) >= _RARE]
    asked.sort(key=lambda habit: (kinds.index(habit.kind), habit.about, -habit.share))
    return [shown(_table(asked, words()(heading, opponent=report.opponent.name)))] if asked else []


def _recent(report: ScoutingReport) -> Section | None:
    say, opponent = words(), report.opponent.name
    if not report.recent:
        return None
    lines = [
        say("scout.recent_line", habit=habit_words(h), share=of_100(h.share), usual=of_100(h.usual), strokes=round(h.strokes))
        for h in report.recent
        if h.clear
    ]
    lead = say("scout.recent_lead" if lines else "scout.recent_none", opponent=opponent)
    return Section(say("scout.recent"), lead, [Block("list", items=lines)] if lines else [])


def _beside(report: ScoutingReport) -> Section | None:
    if report.beside is None:
        return None
    say, opponent, other = words(), report.opponent.name, words().player(report.beside[0])
    found = [habit for habit in report.beside[1] if habit.kind in ("shots", "serve", "return", "third")]
    clear = sum(habit.clear for habit in found)
    lead = say("scout.beside_lead", opponent=opponent, other=other, count=clear, tested=len(found))
    listed = [habit for habit in found if max(habit.share, habit.usual) >= _RARE]
    heading = say("scout.beside", opponent=opponent, other=other)
    return Section(heading, lead, [shown(_table(listed, heading, other))])


def _plan(report: ScoutingReport) -> Section | None:
    """What the opponent does at the serve, after it, and with the smash: to prepare serve, return and defence."""
    say, opponent, lines = words(), report.opponent.name, []
    for kind, about in (("serve", ()), ("return", ("short-serve",)), ("third", ()), ("direction", ("smash",))):
        found = sorted((h for h in report.habits if (h.kind, h.about) == (kind, about)), key=lambda h: -h.share)
        if found:
            answers = [h.answer if kind == "direction" else say.shots(h.answer) for h in found[:3]]
            shares = [of_100(h.share) for h in found[:3]]
            if kind == "direction":
                answers = [say(f"directions.{answer}") for answer in answers]
            most = say.listed(f"{answer} {share}" for answer, share in zip(answers, shares, strict=True))
            lines.append(say(f"scout.plan_{kind}", opponent=opponent, most=most, strokes=round(found[0].strokes)))
    if not lines:
        return None
    kinds = ("serve", "serve_side", "return", "third")
    blocks = [Block("list", items=lines[1:]), *_described(report, kinds, "scout.plan_table")]
    return Section(say("scout.plan"), lines[0], blocks)


def _ends(endings: Sequence[Ending]) -> Table:
    say = words()
    columns: list[Column[Ending]] = [
        Column(say("match.values_shot"), lambda e: name(say.shots(e.shot)), left=True),
        Column(say("scout.habit_strokes"), lambda e: Cell(say.number(e.strokes, ",.0f"), e.strokes)),
        Column(say("scout.ends_faults"), lambda e: Cell(ranged(Estimate(*e.fault[:3])), e.fault[0])),
        Column(say("scout.ends_winners"), lambda e: Cell(ranged(Estimate(*e.winner[:3])), e.winner[0])),
    ]
    return table(sorted(endings, key=lambda e: -e.strokes), columns, say("scout.ends_table"))


def _table(habits: Sequence[Habit], heading: str, others: str = "") -> Table:
    say = words()
    columns: list[Column[Habit]] = [
        Column(
            say("scout.habit_head"),
            lambda h: name(say.shots(h.answer) if h.kind == "shots" else habit_words(h)),
            left=True,
            wrap=True,
        ),
        Column(say("scout.habit_share"), lambda h: Cell(of_100(h.share), h.share)),
        Column(say("scout.habit_range"), lambda h: Cell(between(h.low, h.high), h.high - h.low)),
        Column(others or say("scout.habit_usual"), lambda h: Cell(of_100(h.usual), h.usual)),
        Column(say("scout.habit_strokes"), lambda h: Cell(say.number(h.strokes, ",.0f"), h.strokes)),
        Column(say("scout.habit_clear"), lambda h: yes_or_no(h.clear), left=True),
    ]
    return table(habits, columns, heading)


def _endings(endings: Sequence[Ending]) -> list[str]:
    say, lines = words(), []
    # What holds of a shot type is not repeated for its techniques.
    whole = {(each.shot, key) for each in endings if each.technique is None for key in np.flatnonzero(each.clear).tolist()}
    for each in endings:
        for key, (share, low, high, usual), clear in zip(_ENDS, (each.fault, each.winner), each.clear, strict=True):
            if clear and (each.technique is None or (each.shot, _ENDS.index(key)) not in whole):
                fields = {"share": ranged(Estimate(share, low, high), 1), "usual": of_100(usual, 1)}
                shots = say.shots(each.shot)
                if each.technique is not None:
                    shots = say("stroke.with", shots=shots, technique=say.technique(each.technique))
                lines.append(say(f"scout.{key}_line", shots=shots[:1].upper() + shots[1:], strokes=round(each.strokes), **fields))
    return lines


def _advice(report: ScoutingReport, reason: str) -> Section:
    say, opponent = words(), report.opponent.name
    fields = {"opponent": opponent, "count": len(report.advice)}
    if report.advice and report.with_advice is not None and report.outlook is not None:
        key = "advice_lead" if len(report.advice) > 1 else "advice_one"
        lead = say(f"scout.{key}", before=of_100(report.outlook.rally.value, 1), after=ranged(report.with_advice, 1), **fields)
    else:
        key = "advice_none" if report.refits >= LEAST_REFITS else "advice_no_refits"
        lead = say(f"scout.{key}", opponent=opponent)
    blocks = [text(say("scout.advice_why", least=RELIABLE, steady=of_100(LEAST_STEADY)))]
    blocks += [_card(report, advice, number) for number, advice in enumerate(report.advice)]
    if reason:
        blocks.append(text(say("report.too_large", reason=reason)))
    return Section(say("scout.advice", opponent=opponent), lead, blocks)


def _card(report: ScoutingReport, advice: Advice, number: int) -> Block:
    say, opponent = words(), report.opponent.name
    assert report.pair is not None
    catalogue = report.pair.catalogue
    shot, area, contact = advice.situation
    hands = (None if report.player is None else report.player.hand, report.opponent.hand)
    usual, advised = (say.stroke(catalogue, k, "their", met=area, hands=hands) for k in (advice.usual, advice.stroke))
    if shot < 0:
        when, behind = say("scout.advice_serve"), say("scout.advice_behind_serve", stroke=int(advice.behind))
    else:
        when = say(
            "scout.advice_when",
            opponent=opponent,
            shot=say.shot(SHOTS[shot]),
            area=say.area(area, "your"),
            height=say.height(contact),
        )
        behind = say("scout.advice_behind", stroke=int(advice.behind), situation=int(advice.situation_behind))
    expected = advice.expected
    lines = [
        when,
        say(
            "scout.advice_gain",
            gain=signed(expected.value),
            low=signed(expected.low),
            high=signed(expected.high),
            each=of_100(expected.value / advice.often, 0),
            often=of_100(advice.often),
        ),
        say(
            "scout.advice_already" if advice.usual == advice.stroke else "scout.advice_instead",
            stroke=usual,
            share=of_100(advice.usual_share),
        ),
        say("scout.advice_steady", positive=int((advice.refits > 0).sum()), refits=len(advice.refits)),
    ]
    if np.isfinite(advice.against_average):
        lines.append(say("scout.advice_average", average=signed(advice.against_average)))
    if advice.before is not None:
        lines.append(
            say(
                "scout.advice_before",
                shot=say.shot(SHOTS[advice.before[0]]),
                area=say.area(advice.before[1], "their"),
                opponent=opponent,
                share=of_100(advice.before_share),
                usual=of_100(advice.before_average),
            )
        )
    lines.append(behind)
    if report.realised and (real := report.realised[number]) is not None:
        counts = {"won": real.won, "n": real.strokes, "others_won": real.others_won, "others": real.others}
        of_shot = {"low": of_100(real.low), "high": of_100(real.high), "shot": say.shot(SHOTS[catalogue.shot[advice.stroke]])}
        lines.append(say("scout.advice_real", **counts, **of_shot))
    return Block(
        "card",
        say("scout.advice_title", stroke=advised),
        items=lines,
        example=number,
        label=say("report.play_example"),
    )


def _tactics(report: ScoutingReport) -> Section:
    say, found = words(), report.effects
    clear = sorted((effect for effect in found if effect.clear), key=lambda effect: -abs(effect.more.value))
    names = {effect.tactic: say(f"tactics.{effect.tactic}") for effect in found}
    if clear:
        change = signed(clear[0].more.value)
        lead = say("scout.tactics_lead", tactic=names[clear[0].tactic], change=change)
    else:
        lead = say("scout.tactics_none" if report.refits >= LEAST_REFITS else "scout.tactics_no_refits")
    rows = [charts.Bar(names[e.tactic], 100 * e.more.value, 100 * e.more.low, 100 * e.more.high, clear=e.clear) for e in found]
    share = 1.0 if report.factor is None else report.factor.value
    middle, less = STEPS.index(0.0), STEPS.index(-0.1)

    def reduced(values: F64) -> F64:
        """Changes at each step, reduced to what real matches realise, as in the chart."""
        return share * (values - values[middle])

    def fewer(effect: Effect) -> Cell:
        change = float(reduced((effect.serving + effect.receiving) / 2)[less])
        return Cell(signed(change), change)

    columns: list[Column[Effect]] = [
        Column(say("scout.tactics_head"), lambda e: name(names[e.tactic]), left=True, wrap=True),
        Column(say("scout.tactics_now"), lambda e: Cell(of_100(e.share), e.share)),
        Column(say("scout.tactics_often"), lambda e: Cell(say.number(e.often, ".1f"), e.often)),
        Column(say("scout.tactics_more"), lambda e: Cell(signed(e.more.value), e.more.value)),
        Column(say("scout.tactics_less"), fewer),
        Column(say("scout.tactics_clear"), lambda e: yes_or_no(e.clear)),
    ]
    assert report.outlook is not None
    at, weights = spread(report.outlook.deviation)
    data = {
        "steps": STEPS,
        "tactics": [{name: reduced(getattr(e, name)).round(6).tolist() for name in ("serving", "receiving")} for e in found],
        "base": {"serving": float(found[0].serving[middle]), "receiving": float(found[0].receiving[middle])},
        "spread": {"at": at.round(6).tolist(), "weights": weights.round(6).tolist()},
        "rules": dataclasses.asdict(BWF),
    }
    content = {
        "table": json.dumps(data),
        "low": round(100 * STEPS[0]),
        "high": round(100 * STEPS[-1]),
        "rally": of_100(report.outlook.rally.value, 1),
        "match": of_100(report.outlook.match.value, 1),
    }
    return Section(
        say("scout.tactics"),
        lead,
        [
            chart(charts.bars(rows, say("scout.tactics_chart")), say("scout.tactics_chart")),
            shown(table(found, columns)),
            Block("sliders", say("scout.sliders"), items=[names[effect.tactic] for effect in found], content=content),
        ],
    )


def _sure(report: ScoutingReport, gaps: Sequence[str]) -> Section:
    say = words()
    rows: list[tuple[str, str]] = []
    for known in (report.player, report.opponent):
        if known is not None:
            facts = {
                "strokes": say.number(known.strokes, ","),
                "matches": say.number(known.matches, ","),
                "since": say("report.unknown") if known.since is None else say.format_field(known.since, ""),
                "choices": say("report.yes" if known.imitated else "report.no"),
            }
            rows += [(say(f"scout.sure_{key}", name=known.name), fact) for key, fact in facts.items()]
    if report.player is not None:
        rows.append((say("scout.sure_refits"), f"{report.refits}"))
    rows.append((say("scout.sure_model"), f"{report.model[0]}, {report.model[1][:12]}"))
    columns: list[Column[tuple[str, str]]] = [
        Column(say("scout.sure_what"), lambda row: name(row[0]), left=True, wrap=True),
        Column(say("scout.sure_value"), lambda row: name(row[1]), left=True, wrap=True),
    ]
    blocks = [
        *map(text, (realised(report.factor), *gaps, say("scout.sure_observed"))),
        shown(table(rows, columns, say("scout.sure_table"))),
        text(say("scout.named")),
    ]
    return Section(say("scout.sure"), say("scout.sure_lead"), blocks)
