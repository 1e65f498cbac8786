"""Matches that are played stroke by stroke as a page asks for them: by policies, by a person, or by both.

A rally depends on the plan and its number alone, so whatever has been seen can be seen again, by anyone with the link. Draws
are those of ``match_v0``: by seed, match 0, rally and stroke.
"""

import dataclasses
import itertools
import threading
from collections.abc import Mapping
from typing import Final

import numpy as np

from shuttle_marl.arrays import I32, U64
from shuttle_marl.errors import printable
from shuttle_marl.game.draws import choice_draw, draw, outcome_draw, stream
from shuttle_marl.game.policy import Policy, States, checked_probabilities, drawn_strokes
from shuttle_marl.game.rules import FAULT, RETURNED_BELOW, WINNER, strike
from shuttle_marl.game.scoring import BWF, Rules, count_rally
from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.watch import WatchError
from shuttle_marl.watch.plan import Plan, Side
from shuttle_marl.watch.tables import Tables

PERSON: Final = "you"
"""Name under which a person plays."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Score:
    """The score before a rally.

    Attributes:
        points: of seats 0 and 1 in the current game.
        games: won by seats 0 and 1.
        finished: points of the games before, seat 0 first.
        server: seat that serves.
        over: whether the match is over; then there is no rally.
        rules: when a game and the match are won.
    """

    points: tuple[int, int] = (0, 0)
    games: tuple[int, int] = (0, 0)
    finished: tuple[tuple[int, int], ...] = ()
    server: int = 0
    over: bool = False
    rules: Rules = BWF

    def seen_by(self, seat: int) -> tuple[int, int, int, int]:
        """Points of a seat, of the other one, games of the seat, of the other one."""
        return self.points[seat], self.points[1 - seat], self.games[seat], self.games[1 - seat]

    def after(self, winner: int) -> "Score":
        """The score after a rally that a seat won."""
        points, games = [*self.points], [*self.games]
        counted = count_rally(points[winner], points[1 - winner], games[winner], self.rules)
        points[winner], games[winner] = counted.points, counted.games
        finished = (*self.finished, (points[0], points[1])) if counted.game_won else self.finished
        return Score(
            points=(0, 0) if counted.game_won else (points[0], points[1]),
            games=(games[0], games[1]),
            finished=finished,
            server=winner,
            over=bool(counted.match_won),
            rules=self.rules,
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Rally:
    """A rally as it was played, or as far as it was.

    Attributes:
        number: in its match, or in its log.
        names: of the players at seats 0 and 1, as they are shown.
        score: before it.
        stroke: catalogue index of every stroke.
        state: in which each stroke was struck.
        ending: FAULT or WINNER, which the last stroke was; None: the rally continues, and a person has to choose.
        turn: the state in which they have to; None: the rally is over.
        chosen: numbers of the strokes that no policy chose.
        key: names the draws of the staging.
    """

    number: int
    names: tuple[str, str]
    score: Score
    stroke: tuple[int, ...]
    state: tuple[int, ...]
    ending: int | None
    turn: int | None = None
    chosen: tuple[int, ...] = ()
    key: int

    @property
    def server(self) -> int:
        """Seat that serves."""
        return self.score.server

    def striker(self, i: int) -> int:
        """Seat that strikes the i-th stroke."""
        return (self.server + i) % 2

    @property
    def winner(self) -> int | None:
        """Seat that won it, None while it continues."""
        if self.ending is None:
            return None
        last = self.striker(len(self.stroke) - 1)
        return last if self.ending == WINNER else 1 - last


@dataclasses.dataclass(frozen=True, kw_only=True)
class Person:
    """A person who plays.

    Attributes:
        seat: 0 or 1.
        rally: the rally in which they take over.
        stroke: the first stroke of it that is theirs to choose, if it is their turn then.
    """

    seat: int
    rally: int
    stroke: int

    def chooses(self, rally: int, stroke: int, striker: int) -> bool:
        """Whether they choose a stroke."""
        return striker == self.seat and (rally, stroke) >= (self.rally, self.stroke)


class Match:
    """The rallies of a plan, played as far as anyone asked.

    Args:
        plan: of the match.
        game: the tables.
        tables: the policies as tables.
    """

    def __init__(self, plan: Plan, game: Game, tables: Tables) -> None:
        self.plan, self._game, self._tables = plan, game, tables
        # Bit 16 of the first draw, as in every match.
        first = int(draw(stream(plan.seed, 0, 0), 0)[0] >> np.uint64(16)) & 1
        self._scores = [Score(server=first)]
        self._lock = threading.Lock()

    def rally(self, number: int, person: Person | None = None) -> Rally:
        """A rally by its number, from 0.

        Args:
            number: which one.
            person: who plays for a policy; a rally in which they have not chosen ends with their turn.

        Raises:
            WatchError: the match was over before, a rally before is not finished, or a chosen stroke is not legal.
            PolicyError: a policy cannot be made.
        """
        with self._lock:
            while len(self._scores) <= number and not self._scores[-1].over:
                before = self._play(len(self._scores) - 1, person)
                if before.winner is None:
                    raise WatchError(f"rally {before.number + 1} is not finished; choose a stroke there")
                self._scores.append(before.score.after(before.winner))
        if number >= len(self._scores) or self._scores[number].over:
            raise WatchError(f"rally {number + 1}: the match was over before")
        return self._play(number, person)

    def _play(self, number: int, person: Person | None) -> Rally:
        sides = self.plan.sides_in(number)
        names = [side_name(side) for side in sides]
        if person is not None and number >= person.rally:
            names[person.seat] = PERSON
        return play_rally(
            self._game,
            (self._tables.policy(sides[0]), self._tables.policy(sides[1])),
            stream(self.plan.seed, 0, number),
            number,
            (names[0], names[1]),
            self._scores[number],
            self.plan.chosen_in(number),
            person,
        )


def play_rally(
    game: Game,
    policies: tuple[Policy, Policy],
    key: U64,
    number: int,
    names: tuple[str, str],
    score: Score,
    chosen: Mapping[int, int],
    person: Person | None = None,
) -> Rally:
    """Play a rally to its end, or to the turn of a person.

    Args:
        game: the tables.
        policies: of seats 0 and 1.
        key: ``[1]`` of its draws.
        number: of the rally.
        names: of the players.
        score: before it.
        chosen: catalogue index of the strokes that no policy chooses, by their number.
        person: who plays for a policy.

    Raises:
        WatchError: a chosen stroke is not legal.
    """
    strokes: list[int] = []
    states: list[int] = []
    state, ending = ROOT, None
    for i in itertools.count():
        striker = (score.server + i) % 2
        bits = draw(key, i)
        if i in chosen:
            rank = int(game.rank(state, chosen[i])) if chosen[i] < game.n_strokes else -1
            if rank < 0:
                raise WatchError(f"rally {number + 1}: the stroke chosen as number {i + 1} is not legal there")
        elif person is not None and person.chooses(number, i, striker):
            break
        else:
            rank = _choice(game, policies[striker], state, score.seen_by(striker), choice_draw(bits))
        strokes.append(int(game.stroke_at(state, rank)))
        states.append(state)
        outcome, following = strike(game, np.array([state]), np.array([rank]), outcome_draw(bits))
        if outcome[0] < RETURNED_BELOW:
            ending = FAULT if outcome[0] == FAULT else WINNER
            break
        state = int(following[0])
    return Rally(
        number=number,
        names=names,
        score=score,
        stroke=tuple(strokes),
        state=tuple(states),
        ending=ending,
        turn=state if ending is None else None,
        chosen=tuple(i for i in sorted(chosen) if i < len(strokes)),
        key=int(key[0] >> np.uint64(1)),
    )


def _choice(game: Game, policy: Policy, state: int, score: tuple[int, int, int, int], number: I32) -> int:
    """Position of the stroke that a draw chooses in a state, as :func:`shuttle_marl.game.draws.chosen` has it."""
    if isinstance(policy, TabulatedPolicy):
        return int(np.searchsorted(policy.cumulative[game.pairs_of(state)], number[0], side="right"))
    states = States(game=game, state=np.array([state], dtype=np.int32), score=np.array([score], dtype=np.int16))
    stroke = drawn_strokes(checked_probabilities(policy, states, type(policy).__name__), number)
    return int(game.rank(state, stroke)[0])


def side_name(side: Side) -> str:
    """Name of a side as it is shown."""
    if side.temperature == 1:
        return printable(side.policy)
    return f"{printable(side.policy)}@{'greedy' if side.temperature == 0 else format(side.temperature, 'g')}"
