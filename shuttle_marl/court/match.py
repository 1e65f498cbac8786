"""Matches played stroke by stroke on request of a page, by policies, by a person, or by both; their policies and their log.

A rally depends on the plan and its number alone, with the random numbers of ``match_v0``. Pages are untrusted: a policy that
they name is resolved without importing modules or opening files, unless the user gave it on the command line.
"""

import dataclasses
import itertools
import threading
import time
import zlib
from collections import OrderedDict
from collections.abc import Callable, Collection, Hashable, Mapping
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np

from shuttle_marl.base.arrays import I64, U64
from shuttle_marl.base.errors import printable
from shuttle_marl.court import WatchError
from shuttle_marl.court.plan import Person, Plan, Side
from shuttle_marl.exact import ProfileValue, Solution, Visits, evaluate, solve, visits
from shuttle_marl.game.draws import choice_draw, draw, first_server, outcome_draw, position_draw, stream
from shuttle_marl.game.pairs import game_between, looks_of
from shuttle_marl.game.policy import Policy, TabulatedPolicy, TemperedPolicy, tabulate
from shuttle_marl.game.rally import Rallies, Rally, choose, columns_of, stepper_of, stroke_dtype
from shuttle_marl.game.rules import RETURNED_BELOW
from shuttle_marl.game.scoring import Score
from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.policy import baselines
from shuttle_marl.policy.registry import resolve, resolve_recorded
from shuttle_marl.recording.header import LogHeader, Pair, Player
from shuttle_marl.recording.recorder import RallyRecorder

T = TypeVar("T")


class OnceCache:
    """Least-recently-used cache that computes each result once, even if several threads request it at the same time."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._entries: dict[Hashable, tuple[threading.Lock, list[Any]]] = {}
        self._lock = threading.Lock()

    def get(self, key: Hashable, compute: Callable[[], T]) -> T:
        """The result of a key, computed if it is not cached; errors are not cached."""
        with self._lock:
            entry = self._entries.pop(key, None) or (threading.Lock(), [])
            self._entries[key] = entry
            while len(self._entries) > self._size:
                self._entries.pop(next(iter(self._entries)))
        lock, results = entry
        with lock:
            if not results:
                results.append(compute())
            result: T = results[0]
            return result


class PolicyTables:
    """Policies of one game; ``trusted`` names, which the user gave, may name modules and files."""

    def __init__(self, game: Game, trusted: Collection[str] = ()) -> None:
        self.game = game
        self._trusted = frozenset(trusted)
        self._policies, self._tables = OnceCache(12), OnceCache(12)
        self._values, self._visits = OnceCache(24), OnceCache(24)
        self._solution, self._opposite = OnceCache(1), OnceCache(1)

    def between(self, sides: tuple[Side, Side]) -> "PolicyTables":
        """The policies of the game in which two sides meet: these ones, but between persons whose hands differ."""
        game = game_between(self.game, (sides[0].policy, sides[1].policy))
        return self if game is self.game else self._opposite.get(game.hash, lambda: PolicyTables(game, self._trusted))

    def table(self, side: Side, seat: int = 0) -> TabulatedPolicy:
        """The tabulated policy of a side at a seat; for ``bc:history``, which has no table, that of ``bc``. Raises PolicyError:
        the policy is unknown, may not be named by a page, or reads the score or the rally so far."""
        if side.policy == baselines.REMEMBERING:
            side = Side(policy="bc", temperature=side.temperature)
        game = self.game.seats[seat]  # the same for both, unless it is that of a pair
        return self._tables.get((side, game.hash), lambda: tabulate(self.policy(side, seat), game))

    def policy(self, side: Side, seat: int = 0) -> Policy:
        """The policy of a side at a seat, for single states: tabulating all states would take longer. Raises PolicyError: the
        policy is unknown, or may not be named by a page."""
        game = self.game.seats[seat]

        def resolved() -> Policy:
            policy = (resolve if side.policy in self._trusted else resolve_recorded)(side.policy, game)
            return policy if side.temperature == 1 else TemperedPolicy(policy, side.temperature)

        return self._policies.get((side, game.hash), resolved)

    def values(self, sides: tuple[Side, Side]) -> ProfileValue:
        """Exact values of seat 0 against seat 1."""
        return self._values.get(sides, lambda: evaluate(self.table(sides[0], 0), self.table(sides[1], 1)))

    @property
    def solution(self) -> Solution:
        """The solved game."""
        return self._solution.get(self.game.hash, lambda: solve(self.game))

    def visits(self, sides: tuple[Side, Side]) -> Visits:
        """Expected visits of seat 0 against seat 1 in a rally, both serving equally often."""
        return self._visits.get(sides, lambda: visits(self.table(sides[0], 0), self.table(sides[1], 1)))


def staging_key(header: LogHeader, rally: Rallies) -> int:
    """Random seed of the staging of a rally: a function of its content, independent of its position in a log."""
    strokes = zlib.crc32(rally.stroke.astype("<u2").tobytes())
    return int(stream(header.seed, int(rally.match[0]), int(rally.rally[0]), strokes)[0] >> np.uint64(1))


PERSON, FRIEND = "you", "friend"  # names of a person, and of another person at the other seat


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class CourtRally(Rally):
    """A rally as the page shows it; one that continues waits for the choice of a person."""

    names: tuple[str, str]  # printable, of seats 0 and 1
    athletes: tuple[str, str] = ("male", "male")
    score: Score
    turn: int | None = None  # state in which a person has to choose; None: the rally is over
    receives: bool = False  # they are the receiver there, of a stroke that is not told, and choose a position if they can
    chosen: tuple[int, ...] = ()  # numbers of the strokes that no policy chose
    key: int  # random seed of the staging

    @property
    def chooser(self) -> int:
        """Seat that has to choose at ``turn``."""
        return (self.server + len(self) + self.receives) % 2

    def chooses(self, game: Game) -> bool:
        """Whether a person has a choice at ``turn``."""
        return self.turn is not None and (not self.receives or stepper_of(game).chooses_position(self.turn))

    @classmethod
    def at(cls, score: Score, game: Game, *, waited: I64, **fields: Any) -> "CourtRally":
        """A rally at a score, which says who serves, the points and games, and the ends; positions are shown if all are known."""
        known: dict[str, Any] = {name: getattr(score, name) for name in ("server", "points", "games", "ends_changed")}
        shown = game.hides and bool((waited >= 0).all())
        return cls(score=score, catalogue=game.catalogue, waited=waited if shown else np.full_like(waited, -1), **known, **fields)


class Match:
    """The rallies of a plan, played as far as requested."""

    def __init__(self, plan: Plan, policies: PolicyTables) -> None:
        self.plan, self._policies = plan, policies
        self._scores = [Score(server=int(first_server(draw(stream(plan.seed, 0, 0), 0))[0]), rules=plan.rules)]
        self._lock = threading.Lock()

    def rally(self, number: int, person: Person | None = None) -> CourtRally:
        """A rally by its number, from 0; ``person``: person who plays instead of a policy; a rally in which they have to choose
        ends with their turn. Raises WatchError: the match was over before, an earlier rally is not finished, or a chosen stroke
        or position is not legal. Raises PolicyError: a policy cannot be loaded."""
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
        names = [_side_name(side) for side in sides]
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
    """Play a rally to its end, or to the turn of a person. Raises WatchError: a chosen stroke or position is not legal.

    Args:
        key: ``[1]`` key of the random numbers.
        about: number of the rally, names of the players, score before the rally.
        chosen, waited: catalogue indices of strokes, and positions of receivers, that no policy chooses, by number of the stroke.
        begun: a rally, and the number of its strokes that are kept.
    """
    number, names, score = about
    stepper = stepper_of(game)
    strokes, hurried, positions = list[int](), list[bool](), list[int]()
    state, ending = ROOT, RETURNED_BELOW
    turn, receives = None, False
    if begun is not None:
        rally, kept = begun
        strokes, hurried = rally.stroke[:kept].tolist(), rally.hurried[:kept].tolist()
        positions = rally.waited[:kept].tolist()
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
        if position is None:
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
        positions.append(position)
        strokes.append(stroke)
        hurried.append(stepper.is_hurried(state))
        played, state = stepper.step(state, striker, stroke, int(outcome_draw(bits)[0]), position)
        ending = played.outcome
        if ending < RETURNED_BELOW:
            break
    return CourtRally.at(
        score,
        game,
        stroke=np.array(strokes, dtype=np.int64),
        hurried=np.array(hurried, dtype=np.bool_),
        ending=ending,
        number=number,
        names=names,
        turn=turn,
        receives=receives,
        waited=np.array(positions, np.int64),
        chosen=tuple(i for i in sorted(chosen) if i < len(strokes)),
        key=int(key[0] >> np.uint64(1)),
    )


def _side_name(side: Side) -> str:
    if side.temperature == 1:
        return printable(side.policy)
    return f"{printable(side.policy)}@{'greedy' if side.temperature == 0 else format(side.temperature, 'g')}"


_MOST_OPEN: Final = 8  # maximum number of open logs: pages in several tabs play matches in turn


class MatchLog:
    """Records finished rallies in a folder that the first one creates; :meth:`close` finishes the open logs."""

    def __init__(self, folder: Path, policies: PolicyTables) -> None:
        self._folder, self._policies = folder, policies
        self._open: OrderedDict[object, RallyRecorder] = OrderedDict()
        self._recorded: set[tuple[object, int]] = set()
        self._lock = threading.Lock()
        self._started, self._count = time.strftime("%Y%m%d-%H%M%S"), 0

    def add(self, plan: Plan, rally: CourtRally) -> None:
        """Record a rally if it is finished and not recorded yet. Raises RecordingError: the log cannot be written."""
        winner = rally.winner
        if winner is None:
            return
        match = (plan.seed, plan.points, rally.names, plan.sides_in(rally.number))
        with self._lock:
            if (match, rally.number) in self._recorded:
                return
            recorder = self._recorder(match, plan, rally)
            recorder.add(self._row(self._policies.game, rally, winner))
            recorder.flush(sync=False)
            self._recorded.add((match, rally.number))

    def close(self) -> None:
        """Finish the open logs."""
        with self._lock:
            while self._open:
                self._open.popitem()[1].close()

    def _recorder(self, match: object, plan: Plan, rally: CourtRally) -> RallyRecorder:
        if match in self._open:
            self._open.move_to_end(match)
            return self._open[match]
        if len(self._open) == _MOST_OPEN:
            self._open.popitem(last=False)[1].close()
        sides = plan.sides_in(rally.number)
        policies = self._policies.between(sides)
        players = tuple(
            Player(name=name)
            if name in (PERSON, FRIEND) or side.policy == baselines.REMEMBERING
            else Player(name=name, hash=policies.table(side, seat).hash)
            for seat, (name, side) in enumerate(zip(rally.names, sides, strict=True))
        )
        header = LogHeader(
            seed=plan.seed,
            game=policies.game.hash,
            strokes=rally.catalogue.names,
            policies=players,
            draws="match_v0",
            rules=plan.rules,
            pair=Pair.of(policies.game),
            columns=columns_of(policies.game),
        )
        self._count += 1
        self._folder.mkdir(parents=True, exist_ok=True)
        recorder = RallyRecorder.create(self._folder / f"played-{self._started}-{self._count}.mcap", header)
        self._open[match] = recorder
        return recorder

    @staticmethod
    def _row(game: Game, rally: CourtRally, winner: int) -> Rallies:
        return Rallies.of(
            game,
            pairing=np.zeros(1, np.uint32),
            match=np.zeros(1, np.uint32),
            rally=np.array([rally.number], np.uint16),
            policy=np.array([[0, 1]], np.uint16),
            server=np.array([rally.server], np.uint8),
            winner=np.array([winner], np.uint8),
            reason=np.array([rally.ending], np.uint8),
            score=np.array([[*rally.points, *rally.games]], np.uint8),
            length=np.array([len(rally)], np.int32),
            stroke=rally.stroke.astype(stroke_dtype(len(rally.catalogue))),
            hurried=rally.hurried.astype(np.uint8),
            waited=rally.waited.astype(np.int8),
        )
