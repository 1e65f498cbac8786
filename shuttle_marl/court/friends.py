"""Games of two persons by a link: each chooses on a page of their own, and the server alone knows what both chose.

A stroke is played once its striker has chosen it and its receiver, where they have a choice, a position. Until then no page
receives anything that depends on the choice of the other person, and until the match is over none receives the seed of outcomes.
"""

import dataclasses
import hmac
import secrets
import threading
import time
from typing import Final

from msgspec.structs import replace

from shuttle_marl.court import WatchError
from shuttle_marl.court.match import CourtRally, Match, PolicyTables
from shuttle_marl.court.messages import FriendReply, FriendRequest, Query
from shuttle_marl.court.plan import DUEL, Person, Plan, Side
from shuttle_marl.game.rally import stepper_of

MAX_GAMES: Final = 64  # maximum number of games of a server
FORGOTTEN: Final = 3600.0  # time without a request after which a game makes room for a new one [s]
AWAY: Final = 8.0  # time without a request after which a person is away [s]; pages ask about once a second
_NOBODY: Final = Side(policy="bc")  # stands for a person in the plan: the values of strokes are those of average pros


@dataclasses.dataclass
class _Game:
    """A game: the plan of its match holds the strokes that are played, ``pending`` the choices of seats for the next one."""

    match: Match
    rally: CourtRally
    keys: list[str] = dataclasses.field(default_factory=list)
    seen: list[float] = dataclasses.field(default_factory=list)
    pending: dict[int, int] = dataclasses.field(default_factory=dict)

    @property
    def over(self) -> bool:
        return self.rally.winner is not None and self.rally.score.after(self.rally.winner).over


class Friends:
    """The games of a server; calls from several threads are answered one after the other."""

    def __init__(self, policies: PolicyTables) -> None:
        self._policies = policies
        self._games: dict[str, _Game] = {}
        self._lock = threading.Lock()

    def answer(self, asked: FriendRequest) -> FriendReply:
        """Open a game, take a seat, choose, or ask how a game stands. Raises WatchError: the choice is not legal."""
        with self._lock:
            now = time.monotonic()
            token = asked.token or self._open(now)
            if token is None:
                return FriendReply(refused="full")
            game = self._games.get(token)
            if game is None:
                return FriendReply(refused="unknown")
            key = asked.key or self._sit(game, now)
            seat = None if key is None else _seat(game, key)
            if key is None or seat is None:
                return FriendReply(refused="taken")
            game.seen[seat] = now
            at = (game.rally.number, len(game.rally))
            if asked.choice is not None and (asked.rally, asked.stroke) == at and seat not in game.pending:
                self._choose(game, seat, asked.choice)
            there = len(game.keys) > 1
            away = there and now - game.seen[1 - seat] > AWAY
            return FriendReply(
                token=token,
                key=key,
                seat=seat,
                friend="away" if away else "here" if there else "absent",
                rally=game.rally.number,
                strokes=len(game.rally),
                chosen=seat in game.pending,
                plan=game.match.plan if game.over else None,
            )

    def seen_by(self, query: Query) -> Query:
        """A request about the game of a seat as one about its plan, which holds no choice that is still hidden.

        Raises WatchError: nobody plays there.
        """
        with self._lock:
            friend = query.friend
            game = None if friend is None else self._games.get(friend.token)
            seat = None if friend is None or game is None else _seat(game, friend.key)
            if game is None or seat is None:
                raise WatchError("this game with a friend is not known here; open its link again")
            return replace(query, plan=game.match.plan, person=_person(seat), friend=None, tried={})

    def _open(self, now: float) -> str | None:
        """Token of a new game; None: there are too many."""
        if len(self._games) >= MAX_GAMES:
            oldest = min(self._games, key=lambda token: max(self._games[token].seen))
            if now - max(self._games[oldest].seen) < FORGOTTEN:
                return None
            del self._games[oldest]
        token = secrets.token_urlsafe(16)
        match = Match(Plan(seed=secrets.randbelow(1 << 53), sides=(_NOBODY, _NOBODY), points=DUEL), self._policies)
        self._games[token] = _Game(match, match.rally(0, _person(0)))
        return token

    @staticmethod
    def _sit(game: _Game, now: float) -> str | None:
        """Key of the next free seat; None: both are taken."""
        if len(game.keys) == 2:
            return None
        game.keys.append(secrets.token_urlsafe(16))
        game.seen.append(now)
        return game.keys[-1]

    def _choose(self, game: _Game, seat: int, choice: int) -> None:
        rally, stepper = game.rally, stepper_of(self._policies.game)
        state, striker = rally.turn, 1 - rally.chooser if rally.receives else rally.chooser
        if state is None:
            return
        receives, waits = seat != striker, stepper.chooses_position(state)
        if not (waits and stepper.is_feasible(state, choice) if receives else stepper.is_legal(state, choice)):
            raise WatchError(f"rally {rally.number + 1}: the choice {choice} for stroke {len(rally) + 1} is not possible there")
        game.pending[seat] = choice
        if len(game.pending) < 1 + waits:
            return
        number, at, plan = rally.number, len(rally), game.match.plan
        chosen = {**plan.chosen.get(number, {}), at: game.pending[striker]}
        waited = {**plan.waited.get(number, {}), **({at: game.pending[1 - striker]} if waits else {})}
        game.pending.clear()
        plan = replace(plan, chosen={**plan.chosen, number: chosen}, waited={**plan.waited, number: waited})
        game.match = Match(plan, self._policies)
        game.rally = game.match.rally(number, _person(0))
        if game.rally.winner is not None and not game.over:
            game.rally = game.match.rally(number + 1, _person(0))


def _person(seat: int) -> Person:
    return Person(seat=seat, rally=0, stroke=0, friend=True)


def _seat(game: _Game, key: str) -> int | None:
    return next((seat for seat, known in enumerate(game.keys) if hmac.compare_digest(known, key)), None)
