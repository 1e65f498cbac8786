"""Answers to the requests of pages: each names what it wants in full, so pages can come, leave and share links as they like."""

import contextlib
import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, Final

from shuttle_marl import __version__
from shuttle_marl.errors import ShuttleError
from shuttle_marl.game.draws import stream
from shuttle_marl.policy import registry
from shuttle_marl.staging import Motion
from shuttle_marl.watch import WatchError
from shuttle_marl.watch.diary import Diary
from shuttle_marl.watch.match import Match, Person, Rally, play_rally
from shuttle_marl.watch.plan import MOST_CHOSEN, MOST_NUMBERS, MOST_RALLIES, Plan, Side, parse_chosen, whole
from shuttle_marl.watch.recorded import Recorded
from shuttle_marl.watch.stager import Stager
from shuttle_marl.watch.tables import Kept, Tables
from shuttle_marl.watch.telling import hall_facts, message, rally_facts
from shuttle_marl.watch.worth import ELITE, Players, Worth

_MOST_MATCHES: Final = 64
_MOST_PACKED: Final = 8

Facts = dict[str, Any]


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Wanted:
    """The rally that a request is about.

    Attributes:
        number: of the rally.
        plan: of its match; None: it was recorded.
        person: who plays for a policy.
        tried: strokes of a recorded rally that are replaced, by their number.
    """

    number: int
    plan: Plan | None
    person: Person | None
    tried: tuple[tuple[int, int], ...] = ()


class Answers:
    """Knowledge and actions of a server.

    Args:
        tables: of the game and its policies.
        sides: who plays when a page is opened.
        seed: of the first match.
        stager: stages the rallies.
        recorded: rallies to show instead of matches.
        first: number of the rally that is shown first.
        diary: where rallies go that a person played; None: they are not kept.
    """

    def __init__(
        self,
        tables: Tables,
        sides: tuple[Side, Side],
        seed: int,
        stager: Stager,
        *,
        recorded: Recorded | None = None,
        first: int = 0,
        diary: Diary | None = None,
    ) -> None:
        self._game, self._tables = tables.game, tables
        self._sides, self._seed, self._recorded, self._first_shown = sides, seed, recorded, first
        self._worth, self._stager, self._diary = Worth(tables), stager, diary
        self._matches, self._packed = Kept(_MOST_MATCHES), Kept(_MOST_PACKED)
        self._known: dict[str, Callable[[Mapping[str, Any]], tuple[Facts, list[bytes]]]] = {
            "hello": self._hello,
            "rally": self._rally,
            "analysis": self._analysis,
            "options": self._options,
            "styles": self._styles,
        }

    def __call__(self, request: Mapping[str, Any]) -> bytes:
        """The reply to a request.

        Raises:
            ShuttleError: it is not understood, or cannot be answered.
        """
        operation = self._known.get(request["op"])
        if operation is None:
            raise WatchError("a request for something unknown; load the page again")
        facts, parts = operation(request)
        return message({"id": request["id"], **facts}, parts)

    def warm(self) -> None:
        """Do once what takes longest the first time, so that no page waits for it."""
        for operation in (self._rally, self._analysis):
            plan = None if self._recorded else {"seed": self._seed, "sides": [dataclasses.asdict(side) for side in self._sides]}
            with contextlib.suppress(ShuttleError):  # a page that asks for it is told
                operation({"plan": plan, "rally": self._first_shown})

    def _hello(self, _: Mapping[str, Any]) -> tuple[Facts, list[bytes]]:
        shown = dict.fromkeys([*(side.policy for side in self._sides), *registry.names(self._game)])
        recorded = self._recorded
        return {
            "version": __version__,
            "game": self._game.hash[:12],
            "hall": hall_facts(),
            "policies": list(shown),
            "plan": {"seed": self._seed, "sides": [dataclasses.asdict(side) for side in self._sides]},
            "recorded": None
            if recorded is None
            else {"title": recorded.title, "count": recorded.count, "first": self._first_shown},
        }, []

    def _rally(self, request: Mapping[str, Any]) -> tuple[Facts, list[bytes]]:
        wanted = _wanted(request)
        rally = self._played(wanted)
        motion = self._motion(wanted, rally)
        if self._diary is not None and wanted.plan is not None and wanted.person is not None:
            self._diary.keep(wanted.plan, rally)
        # A page that has the motion up to the branch needs only what follows.
        first = self._first(wanted, rally, motion) if request.get("have") is True else 0
        packed: bytes = self._packed.get((motion, first), lambda: motion.pack(first))
        return {"rally": rally_facts(self._game, rally, motion)}, [packed]

    def _analysis(self, request: Mapping[str, Any]) -> tuple[Facts, list[bytes]]:
        wanted = _wanted(request)
        return self._worth.analysis(self._played(wanted), self._players(wanted)), []

    def _options(self, request: Mapping[str, Any]) -> tuple[Facts, list[bytes]]:
        """The worth of every stroke that a person can choose now."""
        wanted = _wanted(request)
        rally = self._played(wanted)
        if rally.turn is None:
            raise WatchError("the rally is over; there is nothing to choose")
        seat = rally.striker(len(rally.stroke))
        decision = self._worth.decision(rally.turn, seat, self._players(wanted))
        return {"options": self._worth.options(decision, seat, most=len(decision.strokes))}, []

    def _styles(self, request: Mapping[str, Any]) -> tuple[Facts, list[bytes]]:
        wanted = _wanted(request)
        if wanted.plan is None:
            raise WatchError("styles are those of policies; ask for them in a match")
        return self._worth.styles(wanted.plan.sides_in(wanted.number)), []

    def _played(self, wanted: _Wanted) -> Rally:
        if wanted.plan is not None:
            return self._match(wanted.plan).rally(wanted.number, wanted.person)
        if self._recorded is None:
            raise WatchError("this server shows no recorded rallies; load the page again")
        rally = self._recorded.rally(wanted.number)
        if not wanted.tried:
            return rally
        k = min(number for number, _ in wanted.tried)
        players = self._players(dataclasses.replace(wanted, tried=()))
        chosen = {**dict(enumerate(rally.stroke[:k])), **dict(wanted.tried)}
        key = stream(rally.key, k)
        again = play_rally(self._game, players.tables, key, rally.number, rally.names, rally.score, chosen)
        return dataclasses.replace(again, key=rally.key, chosen=tuple(number for number, _ in wanted.tried))

    def _players(self, wanted: _Wanted) -> Players:
        if wanted.plan is not None:
            return self._worth.players(wanted.plan.sides_in(wanted.number))
        found = None if self._recorded is None else self._recorded.players(wanted.number)
        # Of players who are not known, values are those of imitated elite players.
        return found or self._worth.players((ELITE, ELITE))

    def _motion(self, wanted: _Wanted, rally: Rally) -> Motion:
        def make() -> Motion:
            branch = _branch(wanted, rally)
            if branch is None:
                return self._stager.stage(rally)
            before, stroke = branch
            return self._stager.stage(rally, self._motion(before, self._played(before)), stroke)

        return self._stager.kept(rally, wanted.person, make)

    def _first(self, wanted: _Wanted, rally: Rally, motion: Motion) -> int:
        """The first frame that is not that of the motion which this one continues."""
        branch = _branch(wanted, rally)
        if branch is None:
            return 0
        before, stroke = branch
        if stroke:
            return int(motion.contact_frame[stroke - 1]) + 1
        return len(self._motion(before, self._played(before)).time)

    def _match(self, plan: Plan) -> Match:
        return self._matches.get(plan, lambda: Match(plan, self._game, self._tables))


def _branch(wanted: _Wanted, rally: Rally) -> tuple[_Wanted, int] | None:
    """The rally whose motion a rally continues, and the first stroke that is another one; None: it continues none."""
    plan, person = wanted.plan, wanted.person
    if plan is None:
        if not wanted.tried:
            return None
        *others, (stroke, _) = sorted(wanted.tried)
        return dataclasses.replace(wanted, tried=tuple(others)), stroke
    if rally.chosen:
        return dataclasses.replace(wanted, plan=plan.without(wanted.number, rally.chosen[-1])), rally.chosen[-1]
    if person is not None and (person.rally, rally.turn is None) == (wanted.number, False) and person.stroke:
        return dataclasses.replace(wanted, person=None), len(rally.stroke)
    return None


def _wanted(request: Mapping[str, Any]) -> _Wanted:
    number = whole(request.get("rally"), "the number of a rally", MOST_NUMBERS)
    if request.get("plan") is None:
        return _Wanted(number=number, plan=None, person=None, tried=parse_chosen(request.get("tried", {})))
    whole(number, "the number of a rally", MOST_RALLIES)
    return _Wanted(number=number, plan=Plan.parse(request["plan"]), person=_person(request.get("person")))


def _person(raw: Any) -> Person | None:
    """A person who plays, from ``{"seat": S, "rally": R, "stroke": K}``; None: no person does.

    Raises:
        WatchError: it is something else.
    """
    if raw is None:
        return None
    if not isinstance(raw, dict) or raw.keys() != {"seat", "rally", "stroke"}:
        raise WatchError("a person plays at a seat, from a rally and a stroke on")
    return Person(
        seat=whole(raw["seat"], "a seat", 2),
        rally=whole(raw["rally"], "the number of a rally", MOST_RALLIES),
        stroke=whole(raw["stroke"], "the number of a stroke", MOST_CHOSEN),
    )
