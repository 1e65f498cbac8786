"""Reports of matches and of pairs, recounted: what contradicts, what is advised by chance, raw names, sections, and seconds.

    python -m experiments.reports [--data DATA] [--pairs N] [--json]

Without ``--data`` the folder in the environment variable SHUTTLESET is used, or the simulated sample of the repository. Reports
of all matches, and of the pairs of players with most strokes, are written in all languages. The rules that no report breaks are
:data:`shuttle_marl.reports.habits.RULES`; here each is checked by a plain count of the strokes.
"""

import collections
import html
import itertools
import os
import re
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from docs.tools.results import show
from shuttle_marl.commands.cli import entry_point
from shuttle_marl.data import REASONS, Outcome, read_matches
from shuttle_marl.data.schema import rally_numbers
from shuttle_marl.dynamics.features import hurry_of, marked_rows
from shuttle_marl.dynamics.habits import NONE, Plays, plays_of, questions
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.pairs import load_skill
from shuttle_marl.game.shipped import model_folder, resolve_game
from shuttle_marl.game.stroke import N_SERVES, SHOTS
from shuttle_marl.reports.coach import Source
from shuttle_marl.reports.habits import RULES
from shuttle_marl.reports.languages import LANGUAGES, speaking
from shuttle_marl.reports.match import MatchReport, match_report, matches_in
from shuttle_marl.reports.pages import match_page, scouting_page
from shuttle_marl.reports.scouting import players_of, scout
from shuttle_marl.reports.summary import with_hands_of_model, won_or_lost
from shuttle_marl.reports.words import words

SAMPLE: Final = Path(__file__).parents[1] / "datasets" / "sample" / "strokes.parquet"
CHANCE: Final = 0.05
ENDED: Final = {Outcome.WINNER: "player", Outcome.FAULT: "opponent"}  # who won the rally, of its last stroke
Place = tuple[str | None, str | None, str, bool]  # of an incoming stroke: its shot type and area, the contact, whether in a hurry
Stroke = tuple[str, str | None]  # shot type and area; None: any


class Counted:
    """Strokes of some matches, to be counted without the code of the reports."""

    def __init__(self, strokes: pa.Table) -> None:
        self.plays: Plays = plays_of(marked_rows(strokes, hurry_of(resolve_game(None))))
        self.player, self.opponent = (strokes[name].to_pylist() for name in ("player", "opponent"))
        self.won, self.rally = won_or_lost(strokes).tolist(), rally_numbers(strokes).tolist()

    def results(self, player: str | None, opponent: str | None) -> dict[Place, dict[str, list[int]]]:
        """By situation and shot type, rallies won and lost by its last stroke there, of a player to an opponent (None: any)."""
        plays, last = self.plays, dict[tuple[Any, ...], tuple[str, int]]()
        columns = (plays.incoming, plays.met, plays.contact, plays.hurried, plays.shot)
        for i, (came, met, contact, hurried, shot) in enumerate(zip(*(column.tolist() for column in columns), strict=True)):
            place: Place | None = None
            if came == NONE and shot < N_SERVES:
                place = (None, None, "below", False)
            elif came < NONE and min(met, contact, hurried) >= 0:
                place = (SHOTS[came], AREAS[met], ("below", "above")[contact], hurried == 1)
            mine = player in (None, self.player[i]) and opponent in (None, self.opponent[i])
            if place is not None and mine and self.won[i] == self.won[i]:
                last[place, self.rally[i]] = (SHOTS[shot], int(self.won[i]))
        found: dict[Place, dict[str, list[int]]] = collections.defaultdict(lambda: collections.defaultdict(lambda: [0, 0]))
        for (place, _), (shot, won) in last.items():
            found[place][shot][1 - won] += 1
        return found

    def share(self, figure: Mapping[str, Any], player: str) -> tuple[int, float]:
        """Strokes of a player that a question asks about, and the share of an answer."""
        mine = np.array([name == player for name in self.player])
        asked = next(
            each for each in questions(self.plays) if each[0].kind == figure["kind"] and [*each[0].about] == figure["about"]
        )
        answers = asked[1][mine & (asked[1] >= 0)]
        return len(answers), float((answers == asked[0].answers.index(figure["answer"])).mean())


def points_of(strokes: pa.Table, first: str, second: str) -> tuple[int, int]:
    """Points of all games of two players, and those of the first one, by the last row of each rally."""
    games: dict[tuple[str, int], dict[int, dict[str, Any]]] = collections.defaultdict(dict)
    both = pa.array([first, second])
    played = strokes.filter(pc.and_(*(pc.is_in(strokes[name], value_set=both) for name in ("player", "opponent"))))
    for row in played.to_pylist():
        games[row["match"], row["game"]][row["rally"]] = row
    total = won = 0
    for (match, game), rallies in games.items():
        points = {first: 0, second: 0}
        for row in rallies.values():
            told = {row["player"]: row["points"], row["opponent"]: row["points_opponent"]}
            if None not in told.values():
                points = told
            elif row["outcome"] in ENDED:
                points[row[ENDED[row["outcome"]]]] += 1
        following = games.get((match, game + 1), {})
        target, cap = {"21": (21, 30), "15": (15, 21), "11": (11, 15)}[(row["rules"] or "21")[:2]]
        low, high = sorted(points.values())
        leader = max(points, key=lambda name: points[name])
        over, ending = (top == cap or (top >= target and top - low >= 2) for top in (high, high + 1))
        # The rules tell the last rally if the leader, who needed one, served first in the next game, or if there is none.
        served = following.get(1)
        leads = served is None or served["player" if served["stroke"] % 2 else "opponent"] == leader
        stopped = REASONS[row["reason"]] == "stopped" and not following
        points[leader] += not over and ending and leads and not stopped
        total += sum(points.values())
        won += points[first]
    return total, won


def _said(figures: Mapping[str, Any]) -> Iterator[tuple[Place, int, Stroke, Stroke | None, bool]]:
    """Advice of a report: situation, player, the stroke, the one that it replaces, and whether to play it."""
    for each in figures["page1"]:
        if each["kind"] in ("do", "dont"):
            at, shot = each["figure"]["situation"], each["figure"]["shot"]
            place = at["shot"], at["area"], at["contact"], at["hurried"]
            yield place, each["player"], (shot, None), None, each["kind"] == "do"
    for each in figures.get("choices", ()):
        came = (None, None) if each["incoming"] is None else each["incoming"].split(":")[:2]
        better, played = (tuple(each[name].split(":")[:2]) for name in ("better", "played"))
        height = "above" if each["contact"] and each["incoming"] else "below"
        yield (*came, height, each["hurried"]), each["player"], better, played, True


def contradictions(figures: Mapping[str, Any], counted: Counted, players: tuple[str, str], *, match: bool) -> Iterator[str]:
    """What breaks the first, second and fourth of the rules in a report."""
    said = [*_said(figures)]
    results = [counted.results(player, None) if match else counted.results(None, players[1]) for player in players]
    for each, (place, player, better, worse, play) in enumerate(said):
        here = results[player].get(place, {})
        one = here.get(better[0], [0, 0])
        other = (
            here.get(worse[0], [0, 0]) if worse else np.sum([n for shot, n in here.items() if shot != better[0]], axis=0).tolist()
        )
        if sum(one) and sum(other) and (1 if play else -1) * (one[0] * sum(other) - other[0] * sum(one)) < 0:
            yield f"results: {players[player]} {place} {better} {one}, {worse} {other}"
        for near, who, stroke, instead, do in said[each + 1 :]:
            if (near[:3], who) == (place[:3], player):
                same = stroke[0] == better[0] and (None in (stroke[1], better[1]) or stroke[1] == better[1])
                split = play and do and stroke[0] == better[0] and None not in (stroke[1], better[1]) and stroke[1] != better[1]
                crossed = [pair for pair in ((better, instead), (stroke, worse)) if pair[1] and pair[0] == pair[1]]
                if split or (same and play != do) or crossed:
                    yield f"advice: {players[player]} {place} {better} and {stroke}"
    for each in figures["page1"]:
        figure, name = each["figure"], players[each["player"]]
        if each["kind"] == "habit":
            strokes, share = counted.share(figure, name)
            if (strokes, round(share, 6)) != (each["count"], round(each["value"], 6)):
                yield f"shares: {name} {figure}, counted {strokes} {share}"
        if each["kind"] == "wait" and figure["wait"] not in figures["waits"]:
            yield f"places: {name} {figure}"
        if each["kind"] in ("do", "dont"):
            place = tuple(figure["situation"].values())
            here = results[each["player"]].get(place, {})
            if here.get(figure["shot"], [0, 0])[0] != figure["won"] or sum(here[figure["shot"]]) != figure["rallies"]:
                yield f"counts: {name} {figure}"


def words_of(page: bytes) -> str:
    """The visible text of a page."""
    text = re.sub(r"<(script|style|title)\b.*?</\1>|<[^>]+>", " ", page.decode(), flags=re.DOTALL)
    return re.sub(r"\s+", " ", html.unescape(text))


def raw_names(text: str, names: Sequence[str]) -> list[str]:
    """Identifiers in the text of a page, which are no words."""
    known = {name for name in (*names, *SHOTS, *AREAS) if "-" in name}
    found = [name for name in known if re.search(rf"(?<![\w-]){re.escape(name)}(?![\w-])", text)]
    for own in ("shuttle_marl", *(name for name in names if "_" in name)):
        text = text.replace(own, "")
    return found + re.findall(r"\w+_\w+", text)


def _numbers(report: MatchReport, strokes: pa.Table) -> Iterator[str]:
    """What breaks the last rule in a report of a match."""
    first, second = report.players
    numbers, played = [row.number for row in report.rallies], sum(map(sum, report.score))
    if numbers != sorted(set(numbers)) or numbers[-1] > played:
        yield f"numbers: {numbers[-1]} of {played}"
    if points_of(strokes, first, second) != (played, sum(game[0] for game in report.score)):
        yield f"points: {report.score}"


def reports(*, data: Path | None = None, pairs: int = 20, json: bool = False) -> None:
    """Write and recount the reports.

    Args:
        data: annotated matches; default: see above.
        pairs: number of pairs of players.
        json: print JSON.
    """
    path = data or Path(os.environ.get("SHUTTLESET") or SAMPLE)
    strokes = with_hands_of_model(read_matches(path), load_skill(model_folder()))
    names = strokes["player"].unique().to_pylist()
    found, raw, chance = list[str](), list[str](), list[str]()
    seconds: dict[str, list[float]] = {"match": [], "scouting": []}
    sections = {kind: collections.Counter[str]() for kind in seconds}
    statements = collections.Counter[str]()

    def read(kind: str, figures: Mapping[str, Any], write: Any, title: str) -> None:
        for language in LANGUAGES:
            with speaking(language):
                page = write()
            raw.extend(f"{title}, {language}: {name}" for name in raw_names(words_of(page), names))
            if language == LANGUAGES[0]:
                headings = re.findall(r"<h2>(.*?)</h2>", page.decode())
                people = figures.get("players") or [each["name"] for each in (figures["player"], figures["opponent"])]
                told = [re.escape(html.escape(words().player(name))) for name in people]
                sections[kind].update({re.sub("|".join(told), "…", heading) for heading in headings})
        statements.update(each["kind"] for each in figures["page1"])
        dos = [each for each in figures["page1"] if each["kind"] in ("do", "dont")]
        chance.extend(f"{title}: {each['text']}" for each in dos if not each["q"] <= CHANCE or "situation" not in each["figure"])

    for name in matches_in(strokes):
        begun = time.process_time()
        played = strokes.filter(pc.equal(strokes["match"], name))
        report = match_report(played)
        figures = report.as_json()
        source = Source(path=path, game=resolve_game(None), match=name, people=report.players, strokes=strokes)
        match_page(report, source)
        seconds["match"].append(time.process_time() - begun)
        read("match", figures, lambda report=report, source=source: match_page(report, source), name)
        broken = (*contradictions(figures, Counted(played), report.players, match=True), *_numbers(report, played))
        found += [f"{name}: {each}" for each in broken]
    whole = {kind: strokes.filter(pc.equal(strokes["discipline"], kind)) for kind in strokes["discipline"].unique().to_pylist()}
    counted = {kind: Counted(part) for kind, part in whole.items()}
    listed = [each for each in players_of() if each.name in names]
    size = {each.name: each.strokes for each in listed}
    alike = [(a.name, b.name) for a, b in itertools.combinations(listed, 2) if a.discipline == b.discipline]
    for player, opponent in sorted(alike, key=lambda pair: -size[pair[0]] - size[pair[1]])[:pairs]:
        begun = time.process_time()
        told = scout(opponent, player, data=strokes)
        figures, title = told.as_json(), f"{player} against {opponent}"
        scouting_page(told)
        seconds["scouting"].append(time.process_time() - begun)
        read("scouting", figures, lambda told=told: scouting_page(told), title)
        kind = {"men": "MS", "women": "WS"}[told.discipline]
        found += [f"{title}: {each}" for each in contradictions(figures, counted[kind], (player, opponent), match=False)]
        assert told.met is not None
        if points_of(strokes, player, opponent) != told.met[:2]:
            found.append(f"{title}: points {told.met}")
    result = {
        "data": path.name,
        "matches": len(seconds["match"]),
        "pairs": len(seconds["scouting"]),
        "languages": len(LANGUAGES),
        "rules": RULES,
        "contradictions": len(found),
        "insignificant_dos": len(chance),
        "raw_names": len(raw),
        "statements": dict(statements),
        "sections": {
            kind: {name: n / max(1, len(seconds[kind])) for name, n in part.most_common()} for kind, part in sections.items()
        },
        "seconds": {kind: float(np.mean(part)) if part else None for kind, part in seconds.items()},
        "found": [*found, *chance, *raw],
    }
    show(result, "reports", as_json=json)


main = entry_point(reports, "python -m experiments.reports", __doc__ or "")


if __name__ == "__main__":
    sys.exit(main())
