"""Answers to the requests of pages: each names what it wants in full, so pages can come, leave and share links as they like."""

from collections.abc import Callable, Mapping
from typing import Any, Final

from shuttle_marl import __version__
from shuttle_marl.game.rally import Game
from shuttle_marl.policy import registry
from shuttle_marl.watch import WatchError
from shuttle_marl.watch.match import Match, Person
from shuttle_marl.watch.plan import MOST_CHOSEN, MOST_RALLIES, Plan, Side, whole
from shuttle_marl.watch.stager import Stager
from shuttle_marl.watch.tables import Kept, Tables
from shuttle_marl.watch.telling import hall_facts, message, rally_facts
from shuttle_marl.watch.worth import Worth

_MOST_MATCHES: Final = 64

Facts = dict[str, Any]


class Answers:
    """What a server knows and does.

    Args:
        game: the tables.
        sides: who plays when a page is opened.
        seed: of the first match.
        athletes: of seats 0 and 1.
        hands: with which seats 0 and 1 play.
    """

    def __init__(
        self, game: Game, sides: tuple[Side, Side], seed: int, athletes: tuple[str, str], hands: tuple[str, str]
    ) -> None:
        self._game, self._sides, self._seed = game, sides, seed
        self._tables = Tables(game, [side.policy for side in sides])
        self._worth = Worth(self._tables)
        self._stager = Stager(game, athletes, hands)
        self._matches = Kept(_MOST_MATCHES)
        self._known: dict[str, Callable[[Mapping[str, Any]], tuple[Facts, list[bytes]]]] = {
            "hello": self._hello,
            "rally": self._rally,
            "analysis": self._analysis,
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

    def _hello(self, _: Mapping[str, Any]) -> tuple[Facts, list[bytes]]:
        shown = dict.fromkeys([*(side.policy for side in self._sides), *registry.names(self._game)])
        facts = {
            "version": __version__,
            "game": self._game.hash[:12],
            "hall": hall_facts(),
            "policies": list(shown),
            "plan": {"seed": self._seed, "sides": [{"policy": s.policy, "temperature": s.temperature} for s in self._sides]},
        }
        return facts, []

    def _rally(self, request: Mapping[str, Any]) -> tuple[Facts, list[bytes]]:
        rally = self._match(request).rally(_number(request), _person(request.get("person")))
        motion = self._stager.motion(rally)
        return {"rally": rally_facts(self._game, rally, motion)}, [] if motion is None else [motion.pack()]

    def _analysis(self, request: Mapping[str, Any]) -> tuple[Facts, list[bytes]]:
        rally = self._match(request).rally(_number(request), _person(request.get("person")))
        plan = Plan.parse(request.get("plan"))
        return self._worth.analysis(rally, self._worth.players(plan.sides_in(rally.number))), []

    def _styles(self, request: Mapping[str, Any]) -> tuple[Facts, list[bytes]]:
        return self._worth.styles(Plan.parse(request.get("plan")).sides_in(_number(request))), []

    def _match(self, request: Mapping[str, Any]) -> Match:
        plan = Plan.parse(request.get("plan"))
        found: Match = self._matches.get(plan, lambda: Match(plan, self._game, self._tables))
        return found


def _number(request: Mapping[str, Any]) -> int:
    return whole(request.get("rally"), "the number of a rally", MOST_RALLIES)


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
