"""Staged rallies in the pages of reports: the program of the live court, motions and values, as in a page that it saves."""

import base64
import dataclasses
import functools
import gzip
import json
from collections.abc import Iterable, Sequence
from typing import Final

from shuttle_marl import __version__
from shuttle_marl.base.errors import ShuttleError, printable
from shuttle_marl.court import messages
from shuttle_marl.court.building import BuildError, build
from shuttle_marl.court.match import CourtRally, PolicyTables, play_rally
from shuttle_marl.court.plan import Plan
from shuttle_marl.court.recorded import LogRallies, RealRallies, Recorded
from shuttle_marl.court.staging import stage
from shuttle_marl.court.staging.skeleton import model_file
from shuttle_marl.court.values import ELITE, StrokeValues, hall_facts, rally_facts
from shuttle_marl.game.draws import stream
from shuttle_marl.game.pairs import looks_of
from shuttle_marl.game.scoring import Score
from shuttle_marl.game.tables import Game
from shuttle_marl.reports import Players
from shuttle_marl.reports.advice import Advice, Meeting
from shuttle_marl.reports.coach import Source, hidden
from shuttle_marl.reports.html import Viewer
from shuttle_marl.reports.match import MatchReport
from shuttle_marl.reports.pages import Clips
from shuttle_marl.reports.scouting import ScoutingReport

_FPS: Final = 25  # frames per second; the page interpolates, and motions are half as large
_MOST_BYTES: Final = 1_100_000  # largest total size of the motions; later examples are left out
_ATTEMPTS: Final = 3000


def _packed(content: bytes) -> str:
    return base64.b64encode(gzip.compress(content, mtime=0)).decode()


def viewer() -> Viewer:
    """The program of the live court, for pages that contain rallies. Raises BuildError: it is not built, and cannot be."""
    folder = build()
    script, style = ((folder / name).read_text(encoding="utf-8") for name in ("watch.js", "watch.css"))
    return Viewer(script=script.replace("</script", "<\\/script").replace("<!--", "<\\!--"), style=style.replace("</", "<\\/"))


def shared(rallies: Sequence[CourtRally], game: Game, players: Players | None) -> tuple[str, int]:
    """Rallies, in the order of their numbers, as the content of a saved page of the live court; None: imitated players.

    Returns:
        JSON without characters that end a script element, and the number of rallies that it contains.
    """
    values, replies, size, count = StrokeValues(PolicyTables(game)), {}, 0, 0
    shown: dict[str, None] = {}
    for number, rally in enumerate(rallies):
        motion = stage(rally, seed=rally.key, athletes=rally.athletes, fps=_FPS)
        reply = messages.RallyReply(rally_facts(game, rally, motion))
        packed = _packed(messages.encode_reply(0, reply, [motion.pack(0)]))
        size += len(packed)
        if size > _MOST_BYTES:
            break
        replies[f"rally {number}"] = packed
        analysis = values.analysis(rally, players or values.imitated())
        replies[f"analysis {number}"] = _packed(messages.encode_reply(0, analysis))
        shown |= dict.fromkeys(rally.athletes)
        count += 1
    hello = messages.Hello(
        version=__version__,
        game=game.hash[:12],
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


def staged_advice(advised: Iterable[Advice], pair: Game, home: Meeting, names: tuple[str, str]) -> list[CourtRally]:
    """A simulated rally for each advice: the situation occurs, and seat 0 of the imitated players plays the advised stroke."""
    found: list[CourtRally] = []
    looks = looks_of(pair, names)._asdict()

    @functools.cache
    def rally(number: int) -> CourtRally:
        return play_rally(pair, home.policies, stream(0, 0, number), (0, names, Score(server=number % 2)), {})

    for place, advice in enumerate(advised):
        wanted, shortest = set(advice.states.tolist()), None
        for number in range(_ATTEMPTS):
            one = rally(number)
            here = [i for i, s in enumerate(one.states(pair) % pair.n_base_states) if one.striker[i] == 0 and int(s) in wanted]
            if not here or (shortest is not None and here[0] >= shortest[1]):
                continue
            shortest = (number, here[0])
            if here[0] <= 4:
                break
        if shortest is None:
            raise ShuttleError(f"advice {place + 1}: no example in {_ATTEMPTS:,} rallies")
        number, stroke = shortest
        about = (place, names, Score(server=number % 2))
        played = play_rally(pair, home.policies, stream(0, 0, number), about, {stroke: advice.stroke})
        found.append(dataclasses.replace(played, **looks))
    return found


def scout_clips(report: ScoutingReport) -> Clips:
    """An example of each piece of advice."""
    if not report.advice or report.pair is None or report.home is None or report.player is None:
        return Clips()
    try:
        program = viewer()
    except BuildError as error:
        return Clips(reason=str(error))
    names = printable(report.player.name), printable(report.opponent.name)
    rallies = staged_advice(report.advice, report.pair, report.home, names)
    players = Players(tables=report.home.policies, value=report.home.value)
    return Clips(content=shared(rallies, report.pair, players)[0], viewer=program)


def match_clips(report: MatchReport, source: Source) -> Clips:
    """The key moments of a match, and where its rallies are on the live court. Raises WatchError: the file has no whole rally."""
    found: Recorded
    if source.strokes is None:
        found, numbers = LogRallies(source.path, source.game), dict(enumerate(source.numbers))
    else:
        found = RealRallies(source.path, source.game.seats[0], source.strokes)
        of_key = found.numbers(str(source.match))
        numbers = {i: of_key[row.key] for i, row in enumerate(report.rallies) if row.key in of_key}
    listed = {} if source.mapped or source.anonymous else numbers
    try:
        program = viewer()
    except BuildError as error:
        return Clips(reason=str(error), numbers=listed)
    moments = [i for i in report.moments if i in numbers]
    staged = [found.rally(numbers[i]) for i in moments]
    game = report.game if source.policies is None else hidden(source.game, source.people, report.players)
    if source.anonymous:
        staged = [dataclasses.replace(rally, names=report.players) for rally in staged]
    content, count = shared(staged, game, source.policies)
    return Clips(content=content, viewer=program, shown=moments[:count], numbers=listed)
