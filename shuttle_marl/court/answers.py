"""Replies to the requests of pages; a request names all it needs, so pages can reconnect and share links."""

import contextlib
import dataclasses
import gzip
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import content_hash
from shuttle_marl.court import WatchError, messages, staging
from shuttle_marl.court.friends import Friends
from shuttle_marl.court.match import CourtRally, Match, MatchLog, OnceCache, PolicyTables, play_rally
from shuttle_marl.court.messages import RallyReply
from shuttle_marl.court.plan import LADDER, Plan
from shuttle_marl.court.recorded import LogRallies, RealRallies, Recorded
from shuttle_marl.court.tagging import TagFile, suggestions
from shuttle_marl.court.values import ELITE, StrokeValues, hall_facts, rally_facts
from shuttle_marl.game.court import Hands
from shuttle_marl.game.draws import stream
from shuttle_marl.game.pairs import game_of_people, looks_of
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.policy import registry
from shuttle_marl.reports.rally import Players, decision, match_win_after
from shuttle_marl.reports.rating import MARKS, Rating

FIRST_RALLY: Final = Path(__file__).with_name("first_rally.bin")


class FirstRally(Struct, frozen=True):
    """The first rally of the default match, staged in advance; ``key``: of what it depends on. A server whose compiled code is
    not cached needs half a minute before it can stage a rally; the page shows this one at once.
    ``python -m docs.tools.first_rally`` writes the file again, after a change of the game, of the agents or of the staging."""

    key: str
    reply: RallyReply
    motion: bytes


def first_key(game: Game, plan: Plan, athletes: tuple[str, str] | None = None, hands: Hands | None = None) -> str:
    """Hash of the game, the plan of the match, and the appearance of the players, as for :class:`Answers`."""
    first, second = plan.sides_in(0)
    looks = looks_of(game, (first.policy, second.policy))
    return content_hash(msgspec.json.encode([game.hash, plan.key.decode(), athletes or looks.athletes, hands or looks.hands]))


def shipped_rally(key: str) -> FirstRally | None:
    """The shipped rally; None: it is another one."""
    found = msgspec.msgpack.decode(gzip.decompress(FIRST_RALLY.read_bytes()), type=FirstRally)
    return found if found.key == key else None


_PATIENCE: Final = 10.0  # maximum time that a new server waits for its first page before it compiles [s]
_TOLD, _MOMENTS = 5e-4, 5  # least cost of a stroke, in matches won, that pages show; number of costliest strokes


class Answers:
    """Answers the requests of pages.

    Args:
        plan: the match of a page that names none.
        athletes: ``male`` or ``female``, of seats 0 and 1; None: as the players are.
        hands: ``right`` or ``left``, of seats 0 and 1; None: those of the players.
        recorded: recorded rallies to show instead of matches.
        log: log of the rallies that a person plays; None: not recorded.
        tags: the video that is tagged, instead of rallies; None: none.
        shipped: the first rally of the plan, staged in advance; None: it is staged when it is requested.
    """

    def __init__(
        self,
        policies: PolicyTables,
        plan: Plan,
        *,
        athletes: tuple[str, str] | None = None,
        hands: Hands | None = None,
        recorded: Recorded | None = None,
        first: int = 0,
        log: MatchLog | None = None,
        tags: TagFile | None = None,
        shipped: FirstRally | None = None,
    ) -> None:
        self._game, self._policies, self._plan = policies.game, policies, plan
        self._recorded, self._first_shown = recorded, first
        self._values, self._athletes, self._hands, self._log = StrokeValues(policies), athletes, hands, log
        self._staging = threading.Lock()  # staging uses one core; two at a time would delay both
        self._overviews, self._motions = OnceCache(16), OnceCache(16)
        self._matches, self._packed = OnceCache(64), OnceCache(8)
        self._pairs = OnceCache(3)  # games of hundreds of megabytes each
        self._tags, self._shipped, self._friends = tags, shipped, Friends(policies)
        self._shown = threading.Event()

    def __call__(self, request: messages.Request) -> bytes:
        """The encoded reply to a request. Raises ShuttleError: it cannot be answered."""
        if isinstance(request, messages.Query) and request.friend is not None:
            if isinstance(request, messages.OptionsRequest):
                raise WatchError("there are no hints in a game with a friend")
            request = self._friends.seen_by(request)
        if isinstance(request, messages.RallyRequest):
            reply, motion = self.rally(request)
            return messages.encode_reply(request.id, reply, [motion])
        if not isinstance(request, messages.HelloRequest):
            self._shown.set()
        answer: dict[type[messages.Request], Callable[[Any], Struct]] = {
            messages.HelloRequest: lambda _: self.hello(),
            messages.AnalysisRequest: self._analysis,
            messages.OptionsRequest: self._options,
            messages.StylesRequest: self._styles,
            messages.MatchRequest: self.match,
            messages.RatingRequest: self._rating,
            messages.FriendRequest: self._friends.answer,
            messages.TagRequest: self._tag,
            messages.SuggestRequest: self._suggest,
        }
        return messages.encode_reply(request.id, answer[type(request)](request))

    def match(self, request: messages.MatchRequest) -> messages.MatchReply:
        """Overview of a match."""
        whole = request.plan is not None and request.person is None and not request.partial
        about = replace(request, id=0, rally=0 if whole else request.rally)
        found: messages.MatchReply = self._overviews.get(msgspec.json.encode(about), lambda: self._overview(about))
        return found

    def length(self, plan: Plan) -> int:
        """Number of rallies of a match between policies."""
        return sum(1 for _ in self._rallies_of(messages.MatchRequest(id=0, plan=plan, rally=0)))

    def warm(self) -> None:
        """Compute the first rally and its analysis, so that no page waits for them. A page that shows the shipped rally comes
        first: compiling would delay its picture."""
        if self._shipped is not None:
            self._shown.wait(_PATIENCE)
        about = messages.RallyRequest(id=0, plan=None if self._recorded else self._plan, rally=self._first_shown)
        for request in (about, messages.AnalysisRequest(id=0, plan=about.plan, rally=about.rally)):
            with contextlib.suppress(ShuttleError):  # the page that asks receives the error
                self(request)

    def hello(self) -> messages.Hello:
        """Reply to the first request of a page: the hall, the policies, and the rallies that are shown."""
        recorded, known = self._recorded, registry.names(self._game.seats[0])
        return messages.Hello(
            hall=hall_facts(),
            policies=list(dict.fromkeys([*(side.policy for side in self._plan.sides), *known])),
            plan=self._plan,
            recorded=None
            if recorded is None
            else messages.RecordedFacts(recorded.title, recorded.count, self._first_shown, recorded.matches),
            tag=None if self._tags is None else self._tags.facts(),
            ladder=[name for name in LADDER if name in known],
        )

    def rally(self, request: messages.RallyRequest) -> tuple[messages.RallyReply, bytes]:
        """A rally, and its packed motion."""
        if self._shipped is not None and request == messages.RallyRequest(id=request.id, plan=self._plan, rally=0):
            return self._shipped.reply, self._shipped.motion
        self._shown.set()
        rally = self._played(request)
        motion, begun = self._motion(request, rally)
        person = request.person
        # Of two persons, the log is that of the one who opened the game.
        played = person is not None and not (person.practice or (person.friend and person.seat))
        if played and self._log is not None and request.plan is not None:
            self._log.add(request.plan, rally)
        # A page that has the motion up to the branch needs only the frames after it.
        first = begun if request.have else 0
        packed: bytes = self._packed.get((motion, first), lambda: motion.pack(first))
        return messages.RallyReply(rally_facts(self._values_of(request).game, rally, motion)), packed

    def _analysis(self, query: messages.Query) -> messages.Analysis:
        return self._values_of(query).analysis(self._played(query), self._players(query))

    def _tag(self, request: messages.TagRequest) -> messages.Saved:
        if self._tags is None:
            raise WatchError("this server tags no video; load the page again")
        return self._tags.save(request)

    def _suggest(self, request: messages.SuggestRequest) -> messages.Suggestions:
        return messages.Suggestions(
            suggestions(self._game.seats[0], self._policies.policy(ELITE), request.line, request.receivers)
        )

    def _options(self, query: messages.Query) -> messages.OptionsReply:
        rally = self._played(query)
        if rally.turn is None:
            raise WatchError("the rally is over; there is nothing to choose")
        values = self._values_of(query)
        if rally.receives:
            return messages.OptionsReply([], values.positions(rally.turn, rally.chooser))
        choice = decision(values.game, rally.turn, rally.chooser, self._players(query))
        return messages.OptionsReply(values.options(rally, choice, limit=len(choice.stroke)), [])

    def _overview(self, query: messages.MatchRequest) -> messages.MatchReply:
        """The overview of a match, with the costliest of the strokes that are marked as mistakes. The cost of a stroke is its
        loss times the difference that the rally makes to the probability of winning the match."""
        rows: list[messages.MatchRally] = []
        costly: list[messages.Moment] = []
        marks: tuple[Counter[str], Counter[str]] = (Counter(), Counter())
        sound: tuple[list[bool], list[bool]] = ([], [])
        after: float | None = None
        for rally in self._rallies_of(query):
            one = replace(query, rally=rally.number)
            players, winner = self._players(one), rally.winner
            if winner is None or players.value is None:
                break
            values = self._values_of(one).analysis(rally, players)
            won, lost = match_win_after(players.value, rally.points, rally.games, rally.score.rules)
            swing = np.abs(np.diff([*(value.win for value in values.strokes), float(winner == 0)])).max()
            win, size, seats = round(values.strokes[0].match, 5), len(rally), rally.striker.tolist()
            row = (rally.number, win, rally.points, rally.games, seats[0], winner, size, round(float(swing), 5))
            rows.append(messages.MatchRally(*row))
            after = round((won, lost)[winner], 5)
            for i, (value, seat) in enumerate(zip(values.strokes, seats, strict=True)):
                marks[seat][value.mark] += 1
                shot = SHOTS[rally.catalogue.shot[rally.stroke[i]]]
                if value.change is not None:
                    if "?" in value.mark:
                        cost = value.loss * (won - lost)
                        told = cost if cost >= _TOLD else None
                        costly.append(messages.Moment(rally.number, i, seat, shot, value.mark, value.change, told))
                    sound[seat].append("?" not in value.mark)
        costly.sort(key=lambda moment: (-(moment.cost or 0.0), moment.change))
        means = [float(np.mean(part)) if part else None for part in sound]
        return messages.MatchReply(
            rallies=rows,
            win_after=after,
            moments=costly[:_MOMENTS],
            accuracy=(means[0], means[1]),
            marks=([marks[0][mark] for mark in MARKS], [marks[1][mark] for mark in MARKS]),
        )

    def _rallies_of(self, query: messages.MatchRequest) -> Iterator[CourtRally]:
        ends = query.partial or query.person is not None
        number = 0 if self._recorded is None or query.plan is not None else _first_of(self._recorded, query.rally)
        before: CourtRally | None = None
        while query.plan is not None or self._recorded is None or number < self._recorded.count:
            rally = self._played(replace(query, rally=number, tried={}))
            if rally.winner is None or (before is not None and not _continues(before, rally)):
                return
            yield rally
            if rally.score.after(rally.winner).over or (ends and number >= query.rally):
                return
            before, number = rally, number + 1

    @staticmethod
    def _rating(asked: messages.RatingRequest) -> messages.RatingReply:
        before = Rating(points=asked.points, deviation=asked.deviation, volatility=asked.volatility)
        after = before.after(asked.scores)
        return messages.RatingReply(after.points, after.deviation, after.volatility, after.interval)

    def _styles(self, query: messages.Query) -> messages.Styles:
        if query.plan is None:
            raise WatchError("styles exist for policies only; request them for a match")
        return self._values_of(query).styles(query.plan.sides_in(query.rally))

    def _played(self, query: messages.Query) -> CourtRally:
        if (plan := query.plan) is not None:
            match = self._matches.get(plan.key, lambda: Match(plan, self._policies))
            return self._shown_as(match.rally(query.rally, query.person))
        if self._recorded is None:
            raise WatchError("this server shows no recorded rallies; load the page again")
        rally = self._shown_as(self._recorded.rally(query.rally))
        if not query.tried:
            return rally
        k = min(query.tried)
        first, second = self._players(query).tables
        if first is None or second is None:
            raise WatchError("the policies of this rally are unknown; nothing can be tried")
        about = rally.number, rally.names, rally.score
        waited = {i: -1 - choice for i, choice in query.tried.items() if choice < 0}
        chosen = {i: choice for i, choice in query.tried.items() if choice >= 0}
        kept = {k: int(rally.stroke[k])} if k < len(rally) else {}
        game, key = self._values_of(query).game, stream(rally.key, k)
        branch = play_rally(game, (first, second), key, about, kept | chosen, begun=(rally, k), waited=waited)
        tried = tuple(i for i in branch.chosen if i in chosen)
        return dataclasses.replace(branch, key=rally.key, hands=rally.hands, athletes=rally.athletes, chosen=tried)

    def _shown_as(self, rally: CourtRally) -> CourtRally:
        return dataclasses.replace(rally, hands=self._hands or rally.hands, athletes=self._athletes or rally.athletes)

    def _players(self, query: messages.Query) -> Players:
        if query.plan is not None:
            return self._values_of(query).players(query.plan.sides_in(query.rally))
        if isinstance(self._recorded, LogRallies) and (found := self._recorded.players(query.rally)) is not None:
            return found
        # Rallies of unknown players have the values of imitated ones.
        return self._values_of(query).imitated()

    def _values_of(self, query: messages.Query) -> StrokeValues:
        """Values of strokes in the game of a rally. It is that of the sides of a match, and of the two people who played a real
        rally, if the model has their skill."""
        if query.plan is not None:
            policies = self._policies.between(query.plan.sides_in(query.rally))
            same = policies is self._policies
            return self._values if same else self._pairs.get(policies.game.hash, lambda: StrokeValues(policies))
        if not isinstance(self._recorded, RealRallies) or self._game.people is not None:
            return self._values
        people = self._recorded.people(query.rally)

        def values() -> StrokeValues:
            game = game_of_people(self._game.seats[0], people.names, people.date)
            return self._values if game is None else StrokeValues(PolicyTables(game))

        return self._pairs.get(people, values)

    def _motion(self, query: messages.Query, rally: CourtRally) -> tuple[staging.Motion, int]:
        """The motion of a rally, and its first frame that differs from the motion that it continues."""

        def compute() -> tuple[staging.Motion, int]:
            branch = _branch(query, rally)
            if branch is None:
                with self._staging:
                    return staging.stage(rally, seed=rally.key, athletes=rally.athletes), 0
            before, stroke = branch
            begun, _ = self._motion(before, self._played(before))
            with self._staging:
                motion = staging.continue_motion(begun, rally, seed=rally.key, from_stroke=stroke)
            return motion, int(motion.contact_frame[stroke - 1]) + 1 if stroke else len(begun.time)

        # Where a person chose strokes, the motion depends on when they did, because frames that were shown do not change.
        since = query.person.stroke if query.person is not None and query.person.rally == rally.number else 0
        strokes = rally.stroke.tobytes(), rally.hurried.tobytes(), rally.waited.tobytes()
        court = rally.server, rally.from_right, rally.ends_changed, rally.hands, rally.athletes
        key = (rally.key, court, strokes, rally.ending, rally.turn, rally.chosen, query.person is not None, since)
        return self._motions.get(key, compute)


def _continues(before: CourtRally, rally: CourtRally) -> bool:
    earlier, later = ((sum(one.games), sum(one.points)) for one in (before, rally))
    return before.names == rally.names and earlier < later


def _first_of(recorded: Recorded, number: int) -> int:
    while number > 0 and _continues(recorded.rally(number - 1), recorded.rally(number)):
        number -= 1
    return number


def _branch(query: messages.Query, rally: CourtRally) -> tuple[messages.Query, int] | None:
    """The rally whose motion a rally continues, and the first stroke that differs; None: it continues none."""
    plan, person = query.plan, query.person
    if plan is None:
        if not query.tried:
            return None
        last = max(query.tried)
        return replace(query, tried={k: stroke for k, stroke in query.tried.items() if k != last}), last
    if choices := [k for k in (*rally.chosen, *plan.waited_in(query.rally)) if k < len(rally)]:
        return replace(query, plan=plan.without(query.rally, max(choices))), max(choices)
    if person is not None and person.rally == query.rally and rally.turn is not None and person.stroke:
        return replace(query, person=None), len(rally)
    return None
