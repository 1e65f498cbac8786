"""Staged rallies as the content of a page, as in a saved page of the live court, and rallies that show a habit."""

import base64
import dataclasses
import gzip
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from shuttle_marl.base.errors import printable
from shuttle_marl.court import messages
from shuttle_marl.court.match import CourtRally, PolicyTables, play_rally
from shuttle_marl.court.plan import Plan
from shuttle_marl.court.recorded import RealRallies
from shuttle_marl.court.staging import stage
from shuttle_marl.court.staging.skeleton import model_file
from shuttle_marl.court.values import ELITE, StrokeValues, hall_facts, rally_facts
from shuttle_marl.data.upstream import date_of
from shuttle_marl.dynamics.habits import plays_of_strokes, questions
from shuttle_marl.game.draws import stream
from shuttle_marl.game.pairs import game_of_people, looks_of
from shuttle_marl.game.scoring import Score
from shuttle_marl.game.stroke import HEIGHTS, SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.reports import Players
from shuttle_marl.reports.habits import Habit
from shuttle_marl.reports.pages import Example
from shuttle_marl.reports.scouting import ScoutingReport, imitated

_FPS: Final = 25  # frames per second; the page interpolates, and motions are half as large
_MOST_BYTES: Final = 1_100_000  # largest total size of the motions; later examples are left out
_ATTEMPTS: Final = 300
_LONG: Final = 15  # most strokes of an example
_EXAMPLES: Final = 2


def _packed(content: bytes) -> str:
    return base64.b64encode(gzip.compress(content, mtime=0)).decode()


def shared(rallies: Sequence[tuple[CourtRally, Game]], players: Players | None) -> tuple[str, int]:
    """Rallies, in the order of their numbers, each with its game, as the content of a saved page of the live court.

    Args:
        players: of all of them; None: imitated players.

    Returns:
        JSON without characters that end a script element, and the number of rallies that it contains.
    """
    values, replies, size, count = dict[str, StrokeValues](), {}, 0, 0
    shown: dict[str, None] = {}
    for number, (rally, game) in enumerate(rallies):
        motion = stage(rally, seed=rally.key, athletes=rally.athletes, fps=_FPS)
        reply = messages.RallyReply(rally_facts(game, rally, motion))
        packed = _packed(messages.encode_reply(0, reply, [motion.pack(0)]))
        size += len(packed)
        if size > _MOST_BYTES:
            break
        replies[f"rally {number}"] = packed
        valued = values.setdefault(game.hash, StrokeValues(PolicyTables(game)))
        analysis = valued.analysis(rally, players or valued.imitated())
        replies[f"analysis {number}"] = _packed(messages.encode_reply(0, analysis))
        shown |= dict.fromkeys(rally.athletes)
        count += 1
    hello = messages.Hello(
        hall=hall_facts(),
        policies=[ELITE.policy],
        plan=Plan(seed=0, sides=(ELITE, ELITE)),
        recorded=messages.RecordedFacts("", count, 0, []),
        ladder=[],
    )
    content = {
        "hello": _packed(messages.encode_reply(0, hello)),
        "replies": replies,
        "models": {name: _packed(model_file(name).read_bytes()) for name in shown},
    }
    return json.dumps(content), count


def _imitated(pair: Game, names: tuple[str, str], habit: Habit) -> CourtRally | None:
    """A short rally of imitated players in which seat 1 plays what a habit says; None: none is found."""
    policies, looks = imitated(pair), looks_of(pair, names)._asdict()
    about, height = (*habit.about, "", "")[:2]
    for number in range(_ATTEMPTS):
        rally = play_rally(pair, policies, stream(0, 0, number), (number, names, Score(server=number % 2)), {})
        if len(rally) > _LONG:
            continue
        shots = [SHOTS[shot] for shot in rally.catalogue.shot[rally.stroke]]
        contact = [HEIGHTS[c] for c in pair.contact(rally.states(pair)[: len(shots)])]
        for i in range(habit.kind != "serve", len(shots)):
            came = not about or (shots[i - 1] == about and height in ("", contact[i]))
            if rally.striker[i] == 1 and shots[i] == habit.answer and came and (habit.kind != "third" or i == 2):
                return dataclasses.replace(rally, **looks)
    return None


def _recorded(strokes: pa.Table, game: Game, habit: Habit, opponent: str) -> tuple[CourtRally, Game, Example] | None:
    """The last whole rally of a player that shows a habit, and where it stands; None: there is none."""
    ((asked, answer),) = (
        each for each in questions(plays_of_strokes(strokes)) if (each[0].kind, each[0].about) == (habit.kind, habit.about)
    )
    shown = (answer == asked.answers.index(habit.answer)) & (strokes["player"].to_numpy(zero_copy_only=False) == opponent)
    for row in np.flatnonzero(shown)[::-1].tolist():
        match, game_number, rally_number = (strokes[name][row].as_py() for name in ("match", "game", "rally"))
        found = RealRallies(Path(match), game, strokes.filter(pc.equal(strokes["match"], match)))
        number = found.numbers(match).get((game_number, rally_number))
        if number is not None and len(rally := found.rally(number)) <= _LONG:
            people = found.people(number).names
            points = rally.score.points if people[0] == opponent else rally.score.points[::-1]
            pair = game_of_people(game, people, date_of(match))
            return rally, game if pair is None else pair, Example(match=match, people=people, game=game_number, points=points)
    return None


def habits_shown(report: ScoutingReport, strokes: pa.Table | None) -> tuple[str, list[Example]]:
    """A rally for each of the first sure habits of the opponent, as the content of a page, and what each shows; ``report``: with
    a player and a pair; ``strokes``: annotated matches (None: both are imitated)."""
    assert report.player is not None
    assert report.pair is not None
    names = printable(report.player.name), printable(report.opponent.name)
    rallies, examples = list[tuple[CourtRally, Game]](), list[Example]()
    for number, each in enumerate(report.page1.of(1, "habit")):
        habit, found = each.figure, None
        assert isinstance(habit, Habit)
        if strokes is not None:
            found = _recorded(strokes, report.pair.average, habit, report.opponent.name)
        elif habit.answer in SHOTS and (rally := _imitated(report.pair, names, habit)) is not None:
            found = rally, report.pair, Example()
        if found is not None:
            rallies.append(found[:2])
            examples.append(found[2]._replace(statement=number))
        if len(rallies) == _EXAMPLES:
            break
    return (shared(rallies, None)[0], examples) if rallies else ("", [])
