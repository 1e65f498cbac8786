"""Matches played stroke by stroke on request of a page: by policies, by a person, or by both.

A rally depends on the plan and its number alone, so a link reproduces it. Random numbers are those of ``match_v0``: by seed,
match 0, rally and stroke.
"""

import dataclasses
import itertools
import threading
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import U64
from shuttle_marl.base.errors import printable
from shuttle_marl.court import WatchError
from shuttle_marl.court.plan import Person, Plan, Side
from shuttle_marl.court.policies import PolicyTables
from shuttle_marl.game.draws import choice_draw, draw, first_server, outcome_draw, position_draw, stream
from shuttle_marl.game.pairs import looks_of
from shuttle_marl.game.policy import Policy
from shuttle_marl.game.rally import Rally, choose, stepper_of
from shuttle_marl.game.rules import RETURNED_BELOW
from shuttle_marl.game.scoring import Score
from shuttle_marl.game.tables import ROOT, Game

PERSON: Final = "you"
"""Name under which a person plays."""
FRIEND: Final = "friend"
"""Name of another person at the other seat."""
_SEEDS: Final = 4096


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class CourtRally(Rally):
    """A rally as the page shows it; one that continues waits for the choice of a person.

    Attributes:
        names: printable names of the players at seats 0 and 1.
        athletes: ``male`` or ``female``, of seats 0 and 1.
        turn: state in which a person has to choose; None: the rally is over.
        receives: whether they are the receiver there, of a stroke that is not told, and choose a position if they can.
        chosen: numbers of the strokes that no policy chose.
        key: random seed of the staging.
    """

    names: tuple[str, str]
    athletes: tuple[str, str] = ("male", "male")
    score: Score
    turn: int | None = None
    receives: bool = False
    chosen: tuple[int, ...] = ()
    key: int

    @property
    def chooser(self) -> int:
        """Seat that has to choose at ``turn``."""
        return (self.server + len(self) + self.receives) % 2

    def chooses(self, game: Game) -> bool:
        """Whether a person has a choice at ``turn``."""
        return self.turn is not None and (not self.receives or stepper_of(game).chooses_position(self.turn))

    @classmethod
    def at(cls, score: Score, **fields: Any) -> "CourtRally":
        """A rally at a score, which says who serves, the points and games, and the ends."""
        known: dict[str, Any] = {
            "server": score.server,
            "points": score.points,
            "games": score.games,
            "ends_changed": score.ends_changed,
        }
        return cls(score=score, **known, **fields)


class Match:
    """The rallies of a plan, played as far as requested."""

    def __init__(self, plan: Plan, policies: PolicyTables) -> None:
        self.plan, self._policies = plan, policies
        self._scores = [Score(server=int(first_server(draw(stream(plan.seed, 0, 0), 0))[0]), rules=plan.rules)]
        self._lock = threading.Lock()

    def rally(self, number: int, person: Person | None = None) -> CourtRally:
        """A rally by its number, from 0.

        Args:
            person: person who plays instead of a policy; a rally in which they have to choose ends with their turn.

        Raises:
            WatchError: the match was over before, an earlier rally is not finished, or a chosen stroke or position is not legal.
            PolicyError: a policy cannot be loaded.
        """
        with self._lock:
            while len(self._scores) <= number and not self._scores[-1].over:
                before = self._play(len(self._scores) - 1, person)
                if before.winner is None:
                    raise WatchError(f"rally {before.number + 1} is not finished; choose there")
                self._scores.append(before.score.after(before.winner))
        if number >= len(self._scores) or self._scores[number].over:
            raise WatchError(f"rally {number + 1}: the match was over before")
        return self._play(number, person)

    def _play(self, number: int, person: Person | None) -> CourtRally:
        sides = self.plan.sides_in(number)
        policies = self._policies.between(sides)
        names = [side_name(side) for side in sides]
        if person is not None and number >= person.rally:
            names[person.seat] = PERSON
            if person.friend:
                names[1 - person.seat] = FRIEND
        rally = play_rally(
            policies.game,
            (policies.policy(sides[0], 0), policies.policy(sides[1], 1)),
            stream(self.plan.seed, 0, number),
            (number, (names[0], names[1]), self._scores[number]),
            self.plan.chosen_in(number),
            person,
            waited=self.plan.waited_in(number),
        )
        looks = looks_of(policies.game, (sides[0].policy, sides[1].policy))
        return dataclasses.replace(rally, **looks._asdict())


def play_rally(
    game: Game,
    policies: tuple[Policy, Policy],
    key: U64,
    about: tuple[int, tuple[str, str], Score],
    chosen: Mapping[int, int],
    person: Person | None = None,
    begun: tuple[Rally, int] | None = None,
    waited: Mapping[int, int] | None = None,
) -> CourtRally:
    """Play a rally to its end, or to the turn of a person.

    Args:
        key: ``[1]`` key of the random numbers.
        about: number of the rally, names of the players, score before the rally.
        chosen: catalogue index of the strokes that no policy chooses, by their number.
        begun: a rally, and the number of its strokes that are kept.
        waited: positions of the receivers that no policy places, by the number of the stroke.

    Raises:
        WatchError: a chosen stroke is not legal, or a position not feasible.
    """
    number, names, score = about
    stepper = stepper_of(game)
    strokes: list[int] = []
    hurried: list[bool] = []
    positions: list[int] = []
    state, ending = ROOT, RETURNED_BELOW
    turn, receives = None, False
    if begun is not None:
        rally, kept = begun
        strokes, hurried = rally.stroke[:kept].tolist(), rally.hurried[:kept].tolist()
        positions = [] if rally.waited is None else rally.waited[:kept].tolist()
        state = int(rally.states(game)[kept])
    for i in itertools.count(len(strokes)):
        striker = (score.server + i) % 2
        receiver = 1 - striker
        bits = draw(key, i)
        if i in chosen:
            stroke = chosen[i]
            if not stepper.is_legal(state, stroke):
                raise WatchError(f"rally {number + 1}: the stroke chosen as number {i + 1} is not legal there")
        elif person is not None and person.chooses(number, i, striker):
            turn, receives = state, striker != person.seat
            break
        else:
            policy, tables = policies[striker], game.seats[striker]
            stroke = choose(policy, tables, state, int(choice_draw(bits)[0]), score.seen_by(striker), strokes)
        position = stepper.only_position(state)
        if stepper.chooses_position(state):
            if waited and i in waited:
                position = waited[i]
                if not stepper.is_feasible(state, position):
                    raise WatchError(f"rally {number + 1}: the position chosen for stroke {i + 1} is not feasible there")
            elif person is not None and person.chooses(number, i, receiver):
                turn, receives = state, True
                break
            else:
                policy, tables = policies[receiver], game.seats[receiver]
                drawn = int(position_draw(bits)[0])
                position = choose(policy, tables, state, drawn, score.seen_by(striker), strokes, waits=True) - tables.n_strokes
        if position is not None:
            positions.append(position)
        strokes.append(stroke)
        hurried.append(stepper.is_hurried(state))
        played, state = stepper.step(state, striker, stroke, int(outcome_draw(bits)[0]), position)
        ending = played.outcome
        if ending < RETURNED_BELOW:
            break
    return CourtRally.at(
        score,
        catalogue=game.catalogue,
        stroke=np.array(strokes, dtype=np.int64),
        hurried=np.array(hurried, dtype=np.bool_),
        ending=ending,
        number=number,
        names=names,
        turn=turn,
        receives=receives,
        # Positions of the kept strokes are unknown if the log has none.
        waited=np.array(positions, np.int64) if game.recovery is not None and len(positions) == len(strokes) else None,
        chosen=tuple(i for i in sorted(chosen) if i < len(strokes)),
        key=int(key[0] >> np.uint64(1)),
    )


def seed_of_line(game: Game, line: Sequence[int]) -> int | None:
    """The first seed of a match whose first rally seat 0 serves and in which all strokes of a line are legal and returned.

    Returns:
        The seed; None if none of the first 4,096 has such a rally.
    """
    stepper = stepper_of(game)
    for seed in range(_SEEDS):
        if int(first_server(draw(stream(seed, 0, 0), 0))[0]):
            continue
        key, state = stream(seed, 0, 0), ROOT
        for i, stroke in enumerate(line):
            if not stepper.is_legal(state, stroke):
                break
            played, state = stepper.step(state, i % 2, stroke, int(outcome_draw(draw(key, i))[0]))
            if played.outcome < RETURNED_BELOW:
                break
        else:
            return seed
    return None


def side_name(side: Side) -> str:
    """Printable name of a player."""
    if side.temperature == 1:
        return printable(side.policy)
    return f"{printable(side.policy)}@{'greedy' if side.temperature == 0 else format(side.temperature, 'g')}"
