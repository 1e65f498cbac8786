"""Replies to the requests of pages. A request names all it needs, so pages can reconnect and share links."""

import contextlib
import dataclasses
from typing import Final

from msgspec.structs import replace

from shuttle_marl import __version__
from shuttle_marl.analysis.rally import Players
from shuttle_marl.errors import ShuttleError
from shuttle_marl.game.draws import stream
from shuttle_marl.policy import registry
from shuttle_marl.staging import Motion
from shuttle_marl.watch import WatchError
from shuttle_marl.watch.facts import hall_facts, rally_facts
from shuttle_marl.watch.match import CourtRally, Match, play_rally
from shuttle_marl.watch.match_log import MatchLog
from shuttle_marl.watch.messages import (
    AnalysisRequest,
    Hello,
    HelloRequest,
    OptionsReply,
    OptionsRequest,
    Query,
    RallyReply,
    RallyRequest,
    RecordedFacts,
    Reply,
    Request,
    Styles,
    encode_reply,
)
from shuttle_marl.watch.plan import Plan
from shuttle_marl.watch.policies import OnceCache, PolicyTables
from shuttle_marl.watch.recorded import Recorded
from shuttle_marl.watch.stager import Stager
from shuttle_marl.watch.stroke_values import ELITE, StrokeValues

_MAX_MATCHES: Final = 64
_MAX_PACKED: Final = 8


class Answers:
    """Answers the requests of pages.

    Args:
        policies: policies of the game.
        plan: the match of a page that names none.
        stager: stages the rallies.
        recorded: recorded rallies to show instead of matches.
        first: number of the rally that is shown first.
        log: log of the rallies that a person plays; None: not recorded.
    """

    def __init__(
        self,
        policies: PolicyTables,
        plan: Plan,
        stager: Stager,
        *,
        recorded: Recorded | None = None,
        first: int = 0,
        log: MatchLog | None = None,
    ) -> None:
        self._game, self._policies, self._plan = policies.game, policies, plan
        self._recorded, self._first_shown = recorded, first
        self._values, self._stager, self._log = StrokeValues(policies), stager, log
        self._matches, self._packed = OnceCache(_MAX_MATCHES), OnceCache(_MAX_PACKED)

    def __call__(self, request: Request) -> bytes:
        """The encoded reply to a request.

        Raises:
            ShuttleError: it cannot be answered.
        """
        reply, body = self._reply(request)
        return encode_reply(request.id, reply, [body])

    def _reply(self, request: Request) -> tuple[Reply, bytes]:
        if isinstance(request, HelloRequest):
            return self._hello(), b""
        if isinstance(request, RallyRequest):
            return self._rally(request)
        if isinstance(request, AnalysisRequest):
            return self._values.analysis(self._played(request), self._players(request)), b""
        if isinstance(request, OptionsRequest):
            return self._options(request), b""
        return self._styles(request), b""

    def warm(self) -> None:
        """Compute the first rally and its analysis, so that no page waits for them."""
        plan = None if self._recorded else self._plan
        for kind in (RallyRequest, AnalysisRequest):
            with contextlib.suppress(ShuttleError):  # the page that asks receives the error
                self._reply(kind(id=0, plan=plan, rally=self._first_shown))

    def _hello(self) -> Hello:
        recorded = self._recorded
        return Hello(
            version=__version__,
            game=self._game.hash[:12],
            hall=hall_facts(),
            policies=list(dict.fromkeys([*(side.policy for side in self._plan.sides), *registry.names(self._game)])),
            plan=self._plan,
            recorded=None if recorded is None else RecordedFacts(recorded.title, recorded.count, self._first_shown),
        )

    def _rally(self, request: RallyRequest) -> tuple[RallyReply, bytes]:
        rally = self._played(request)
        motion = self._motion(request, rally)
        if self._log is not None and request.plan is not None and request.person is not None:
            self._log.add(request.plan, rally)
        # A page that has the motion up to the branch needs only the frames after it.
        first = self._first_frame(request, rally, motion) if request.have else 0
        packed: bytes = self._packed.get((motion, first), lambda: motion.pack(first))
        return RallyReply(rally_facts(self._game, rally, motion)), packed

    def _options(self, query: Query) -> OptionsReply:
        rally = self._played(query)
        if rally.turn is None:
            raise WatchError("the rally is over; there is nothing to choose")
        choice = self._values.decision(rally.turn, (rally.server + len(rally)) % 2, self._players(query))
        return OptionsReply(self._values.options(choice, limit=len(choice.stroke)))

    def _styles(self, query: Query) -> Styles:
        if query.plan is None:
            raise WatchError("styles exist for policies only; request them for a match")
        return self._values.styles(query.plan.sides_in(query.rally))

    def _played(self, query: Query) -> CourtRally:
        if (plan := query.plan) is not None:
            match = self._matches.get(plan.key, lambda: Match(plan, self._game, self._policies))
            return match.rally(query.rally, query.person)
        if self._recorded is None:
            raise WatchError("this server shows no recorded rallies; load the page again")
        rally = self._recorded.rally(query.rally)
        if not query.tried:
            return rally
        k = min(query.tried)
        first, second = self._players(query).tables
        if first is None or second is None:
            raise WatchError("the policies of this rally are unknown; no stroke can be tried")
        chosen = {**dict(enumerate(rally.stroke[:k].tolist())), **query.tried}
        about = rally.number, rally.names, rally.score
        branch = play_rally(self._game, (first, second), stream(rally.key, k), about, chosen)
        return dataclasses.replace(branch, key=rally.key, chosen=tuple(sorted(query.tried)))

    def _players(self, query: Query) -> Players:
        if query.plan is not None:
            return self._values.players(query.plan.sides_in(query.rally))
        found = None if self._recorded is None else self._recorded.players(query.rally)
        # Rallies of unknown players have the values of imitated elite players.
        return found or self._values.players((ELITE, ELITE))

    def _motion(self, query: Query, rally: CourtRally) -> Motion:
        def compute() -> Motion:
            branch = _branch(query, rally)
            if branch is None:
                return self._stager.stage(rally)
            before, stroke = branch
            return self._stager.stage(rally, self._motion(before, self._played(before)), stroke)

        return self._stager.cached(rally, query.person, compute)

    def _first_frame(self, query: Query, rally: CourtRally, motion: Motion) -> int:
        """First frame that differs from the motion that this one continues."""
        branch = _branch(query, rally)
        if branch is None:
            return 0
        before, stroke = branch
        if stroke:
            return int(motion.contact_frame[stroke - 1]) + 1
        return len(self._motion(before, self._played(before)).time)


def _branch(query: Query, rally: CourtRally) -> tuple[Query, int] | None:
    """The rally whose motion a rally continues, and the first stroke that differs; None: it continues none."""
    plan, person = query.plan, query.person
    if plan is None:
        if not query.tried:
            return None
        last = max(query.tried)
        return replace(query, tried={k: stroke for k, stroke in query.tried.items() if k != last}), last
    if rally.chosen:
        return replace(query, plan=plan.without(query.rally, rally.chosen[-1])), rally.chosen[-1]
    if person is not None and person.rally == query.rally and rally.turn is not None and person.stroke:
        return replace(query, person=None), len(rally)
    return None
