"""Configuration of a tournament, and its entrants: tabulated, or called at every stroke if they read the score."""

import dataclasses
import json
from collections.abc import Callable, Sequence
from typing import Annotated, Any, Final, Literal

import msgspec
import numpy as np

from shuttle_marl.base.arrays import I32, Intp
from shuttle_marl.base.errors import ShuttleError, suggesting
from shuttle_marl.base.files import Count, CountOrZero, Seed
from shuttle_marl.base.runs import RunOptions
from shuttle_marl.game.pairs import pair_game
from shuttle_marl.game.policy import HistoryError, Policy, PolicyError, TabulatedPolicy, hash_of, reads_score, tabulate
from shuttle_marl.game.scoring import RulesName
from shuttle_marl.game.shipped import Profile, resolve_game
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel.matches import ask, ask_position
from shuttle_marl.policy import baselines, registry
from shuttle_marl.policy.foreign import POLICY_TIMEOUT
from shuttle_marl.policy.registry import resolve

MOST_MATCHES: Final = 10_000_000  # largest number of matches of a pairing, whose rallies are held in memory until it is finished
_OWN_PLAYERS: Final = 6  # number of individual players in the default pool; ``--pool`` takes any number
ANCHORS: Final = ("minimax", "best-response:bc")  # solved policies of the default pool, reference points of the scale
TRAINED: Final = ("a2c", "ppo", "sac", "ppo:self-play")


PAIRINGS: Final = "pairings.jsonl"
REPORT: Final = "report.json"

Format = Literal["round-robin", "swiss", "gauntlet"]


class LeagueError(ShuttleError):
    """A tournament with invalid options, or a run folder that cannot be used."""


@suggesting
@dataclasses.dataclass(frozen=True, kw_only=True)
class LeagueConfig(RunOptions):
    """A tournament: a round robin, in which every pair of entrants plays the same number of matches, or another format."""

    error = LeagueError

    pool: tuple[str, ...] = ()
    """Entrants by name (docs/league.md); default: the policies of the package."""
    matches: Annotated[int, msgspec.Meta(ge=2, le=MOST_MATCHES)] = 1000
    """Matches of every pair; even, because each is played twice with the same draws and the seats swapped."""
    format: Format = "round-robin"
    """Round robin: every pair. Gauntlet: the first entrant of the pool against every other. Swiss: rounds between entrants with
    similar scores."""
    rounds: CountOrZero = 0
    """Rounds of a Swiss tournament; 0: the binary logarithm of the number of entrants."""
    seed: Seed = 0
    """Random seed: the same seed gives the same rallies."""
    record: Literal["all", "none"] = "all"
    """Recorded rallies."""
    profile: Profile | None = None
    """The game of one discipline; default: the average of both."""
    players: tuple[str, str] | None = None
    """Two real players, in whose game every pairing is played: seats 0 and 1 have their skill, and each entrant plays both."""
    date: str | None = None
    """Day of the skill of the players, such as 2021-07-31; default: the last one known."""
    rules: RulesName = "21"
    """Points of a game: 21 (best of three, the rules of the sport), or its trials: 15 (best of three), 11 (best of five)."""
    exact: bool = True
    """Also compute exact results of every pair, and best responses; takes seconds per entrant."""
    workers: Annotated[int, msgspec.Meta(ge=1, le=256)] = 1
    """Threads that play pairings of policies with tables; results do not depend on it."""
    ray: str | None = None
    """Ray cluster that plays them instead: local, auto, HOST:PORT or ray://HOST:PORT (docs/cluster.md)."""
    batch: Count = 8192
    """Matches played in lockstep; affects speed and memory; results do not depend on it."""
    policy_timeout: float = POLICY_TIMEOUT
    """Seconds that a program may take for one stroke before it forfeits; 0 for no limit."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.matches % 2:
            raise LeagueError(f"--matches {self.matches}: expected an even number")
        if self.date is not None and self.players is None:
            raise LeagueError(f"--date {self.date}: is the day of the skill of --players; give both")
        twice = sorted({name for name in self.pool if self.pool.count(name) > 1})
        if twice:
            raise LeagueError(f"--pool names {', '.join(twice)} twice; name every entrant once")
        if self.rounds and self.format != "swiss":
            raise LeagueError(f"--rounds {self.rounds}: only with --format swiss")
        if len(self.pool) == 1:
            raise LeagueError(f"--pool {self.pool[0]}: a tournament needs two entrants or more")

    def fixed(self) -> dict[str, Any]:
        """All options that affect the results, as JSON."""
        names = ("pool", "matches", "format", "rounds", "seed", "record", "game", "profile", "rules")
        pair = ("players", "date") if self.players is not None else ()
        fixed: dict[str, Any] = json.loads(json.dumps({name: getattr(self, name) for name in (*names, *pair)}))
        return fixed

    def load(self) -> Game:
        """The game that is played. Raises GameError: the model does not exist, or has no skill of the players."""
        if self.players is None:
            return resolve_game(self.game, self.profile)
        return pair_game(*self.players, date=self.date, discipline=self.profile, game=self.game)


def default_pool(game: Game) -> tuple[str, ...]:
    """Behaviour-cloned players (the average and the first few individuals), scripted styles, random, trained agents, anchors.

    The anchors are reference points of the scale: perfect play, and the best response to ``bc``. Only policies that can play this
    game enter: players of its model, and agents that were trained on it.
    """
    names = registry.names(game.seats[0])
    bc = [name for name in names if name.partition(":")[0] == "bc" and name != baselines.REMEMBERING]
    others = ("attacking", "defensive", "safe", "random", *TRAINED, *ANCHORS)
    return (*bc[: 1 + _OWN_PLAYERS], *(name for name in others if name in names))


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Entrant:
    """One entrant."""

    name: str
    policy: Policy
    table: TabulatedPolicy | None = None  # the policy in every state; None if it reads the score or failed
    opposite: TabulatedPolicy | None = None  # the same at seat 1 of the game of a pair; None in other games
    failure: str = ""  # reason why the entrant forfeits every match; empty if it does not

    @property
    def hash(self) -> str:
        """SHA-256 of the table, or of those of both seats, hexadecimal; empty without one."""
        return "" if self.table is None else hash_of(self.table, self.opposite or self.table)


def enter(name: str, game: Game) -> Entrant:
    """Resolve an entrant that the user named, and evaluate it in every state.

    Raises:
        PolicyError: no policy has that name, or it reads the rally so far. A policy that raises or returns an invalid
            distribution is entered, and forfeits.
    """
    policies = [resolve(name, seat) for seat in dict.fromkeys(game.seats)]
    policy = policies[0]
    try:
        if reads_score(policy):
            return Entrant(name=name, policy=policy)
        first, *second = (tabulate(policy, seat) for policy, seat in zip(policies, game.seats, strict=False))
        return Entrant(name=name, policy=policy, table=first, opposite=second[0] if second else None)
    except HistoryError:
        raise
    except PolicyError as error:
        return Entrant(name=name, policy=policy, failure=str(error))


class ForfeitError(Exception):
    """An entrant failed while it played."""

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(f"{name}: {reason}")
        self.name, self.reason = name, reason


def seat_tables(game: Game, entrants: Sequence[Entrant]) -> list[TabulatedPolicy | None]:
    """Tables of all entrants, in the game of a pair first those of seat 0, then those of seat 1."""
    first = [entrant.table for entrant in entrants]
    return [*first, *(entrant.opposite for entrant in entrants)] if game.people is not None else first


class Strikers:
    """Chooses the strokes and positions of a batch in which any of the entrants may decide."""

    def __init__(self, game: Game, entrants: Sequence[Entrant]) -> None:
        self._game, self._entrants, self._tables = game, entrants, seat_tables(game, entrants)

    def choose(self, entrant: I32, state: I32, draw: I32, striker: I32, score: I32, *_: I32) -> Intp:
        """Strokes as :data:`shuttle_marl.kernel.matches.Choose`. Raises ForfeitError: a policy that reads the score failed."""
        return self._decide(TabulatedPolicy.choose, ask, entrant, state, draw, striker, score)

    def wait(self, entrant: I32, state: I32, draw: I32, receiver: I32, score: I32, *_: I32) -> Intp:
        """Positions as :data:`shuttle_marl.kernel.matches.Wait`. Raises ForfeitError: a policy that reads the score failed."""
        return self._decide(TabulatedPolicy.choose_position, ask_position, entrant, state, draw, receiver, score)

    def _decide(
        self,
        by_table: Callable[[TabulatedPolicy, I32, I32], Intp],
        by_policy: Callable[..., Intp],
        entrant: I32,
        state: I32,
        draw: I32,
        seat: I32,
        score: I32,
    ) -> Intp:
        found, n = np.empty(len(state), dtype=np.intp), len(self._entrants)
        number = entrant if self._game.people is None else entrant + n * seat
        for i in np.unique(number).tolist():
            at, table, entered = np.flatnonzero(number == i), self._tables[i], self._entrants[i % n]
            if table is not None:
                found[at] = by_table(table, state[at], draw[at])
                continue
            try:
                found[at] = by_policy(entered.policy, self._game.seats[i // n], state[at], draw[at], seat[at], score[:, at])
            except PolicyError as error:
                raise ForfeitError(entered.name, str(error)) from error
        return found
