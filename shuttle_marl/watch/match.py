"""Matches played stroke by stroke on request of a page: by policies, by a person, or by both.

A rally depends on the plan and its number alone, so a link reproduces it. Random numbers are those of ``match_v0``: by seed,
match 0, rally and stroke.
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
from shuttle_marl.game.rules import RETURNED_BELOW, strike
from shuttle_marl.game.scoring import BWF, Rules, count_rally
from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.rally.record import Rally
from shuttle_marl.watch import WatchError
from shuttle_marl.watch.plan import Person, Plan, Side
from shuttle_marl.watch.policies import PolicyTables

PERSON: Final = "you"
"""Name under which a person plays."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Score:
    """The score before a rally.

    Attributes:
        points: points of seats 0 and 1 in the current game.
        games: games won by seats 0 and 1.
        finished: points of finished games, seat 0 first.
        server: seat that serves.
        over: whether the match is over.
        rules: rules of the match.
    """

    points: tuple[int, int] = (0, 0)
    games: tuple[int, int] = (0, 0)
    finished: tuple[tuple[int, int], ...] = ()
    server: int = 0
    over: bool = False
    rules: Rules = BWF

    def seen_by(self, seat: int) -> tuple[int, int, int, int]:
        """Points of a seat and of the opponent, games of the seat and of the opponent."""
        return self.points[seat], self.points[1 - seat], self.games[seat], self.games[1 - seat]

    def after(self, winner: int) -> "Score":
        """The score after a rally won by a seat."""
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


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class CourtRally(Rally):
    """A rally as the page shows it; one that continues waits for the stroke of a person.

    Attributes:
        names: printable names of the players at seats 0 and 1.
        score: score before the rally.
        turn: state in which a person has to choose; None: the rally is over.
        chosen: numbers of the strokes that no policy chose.
        key: random seed of the staging.
    """

    names: tuple[str, str]
    score: Score
    turn: int | None = None
    chosen: tuple[int, ...] = ()
    key: int


class Match:
    """The rallies of a plan, played as far as requested.

    Args:
        plan: plan of the match.
        game: tables of the game.
        policies: policies of the players.
    """

    def __init__(self, plan: Plan, game: Game, policies: PolicyTables) -> None:
        self.plan, self._game, self._policies = plan, game, policies
        # Bit 16 of the first random number, as in every match.
        first = int(draw(stream(plan.seed, 0, 0), 0)[0] >> np.uint64(16)) & 1
        self._scores = [Score(server=first)]
        self._lock = threading.Lock()

    def rally(self, number: int, person: Person | None = None) -> CourtRally:
        """A rally by its number, from 0.

        Args:
            number: number of the rally.
            person: person who plays instead of a policy; a rally in which they have to choose ends with their turn.

        Raises:
            WatchError: the match was over before, an earlier rally is not finished, or a chosen stroke is not legal.
            PolicyError: a policy cannot be loaded.
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

    def _play(self, number: int, person: Person | None) -> CourtRally:
        sides = self.plan.sides_in(number)
        names = [side_name(side) for side in sides]
        if person is not None and number >= person.rally:
            names[person.seat] = PERSON
        return play_rally(
            self._game,
            (self._policies.policy(sides[0]), self._policies.policy(sides[1])),
            stream(self.plan.seed, 0, number),
            (number, (names[0], names[1]), self._scores[number]),
            self.plan.chosen_in(number),
            person,
        )


def play_rally(
    game: Game,
    policies: tuple[Policy, Policy],
    key: U64,
    about: tuple[int, tuple[str, str], Score],
    chosen: Mapping[int, int],
    person: Person | None = None,
) -> CourtRally:
    """Play a rally to its end, or to the turn of a person.

    Args:
        game: tables of the game.
        policies: policies of seats 0 and 1.
        key: ``[1]`` key of the random numbers.
        about: number of the rally, names of the players, score before the rally.
        chosen: catalogue index of the strokes that no policy chooses, by their number.
        person: person who plays instead of a policy.

    Raises:
        WatchError: a chosen stroke is not legal.
    """
    number, names, score = about
    strokes: list[int] = []
    state, ending = ROOT, RETURNED_BELOW
    turn: int | None = None
    for i in itertools.count():
        striker = (score.server + i) % 2
        bits = draw(key, i)
        if i in chosen:
            rank = int(game.rank(state, chosen[i])) if chosen[i] < game.n_strokes else -1
            if rank < 0:
                raise WatchError(f"rally {number + 1}: the stroke chosen as number {i + 1} is not legal there")
        elif person is not None and person.chooses(number, i, striker):
            turn = state
            break
        else:
            rank = _choice(game, policies[striker], state, score.seen_by(striker), choice_draw(bits))
        strokes.append(int(game.stroke_at(state, rank)))
        outcome, following = strike(game, np.array([state]), np.array([rank]), outcome_draw(bits))
        ending, state = int(outcome[0]), int(following[0])
        if ending < RETURNED_BELOW:
            break
    return CourtRally(
        catalogue=game.catalogue,
        server=score.server,
        stroke=np.array(strokes, dtype=np.int64),
        ending=ending,
        points=score.points,
        games=score.games,
        number=number,
        names=names,
        score=score,
        turn=turn,
        chosen=tuple(i for i in sorted(chosen) if i < len(strokes)),
        key=int(key[0] >> np.uint64(1)),
    )


def _choice(game: Game, policy: Policy, state: int, score: tuple[int, int, int, int], number: I32) -> int:
    """Position of the stroke that a random number selects in a state, as :func:`shuttle_marl.game.draws.chosen` does."""
    if isinstance(policy, TabulatedPolicy):
        return int(np.searchsorted(policy.cumulative[game.pairs_of(state)], number[0], side="right"))
    states = States(game=game, state=np.array([state], dtype=np.int32), score=np.array([score], dtype=np.int16))
    stroke = drawn_strokes(checked_probabilities(policy, states, type(policy).__name__), number)
    return int(game.rank(state, stroke)[0])


def side_name(side: Side) -> str:
    """Printable name of a player."""
    if side.temperature == 1:
        return printable(side.policy)
    return f"{printable(side.policy)}@{'greedy' if side.temperature == 0 else format(side.temperature, 'g')}"
