"""Settings of a tournament, the flags of its command line; and its entrants, as tables or as calls where they read the score."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import tyro

from shuttle_marl.arrays import I32, Intp
from shuttle_marl.errors import ShuttleError
from shuttle_marl.game.draws import CHOICE_ONE, chosen
from shuttle_marl.game.policy import Policy, PolicyError, reads_score
from shuttle_marl.game.shipped import Profile
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.kernel.lockstep import ask
from shuttle_marl.policy import registry
from shuttle_marl.policy.foreign import POLICY_TIMEOUT
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording import Sampling

MOST_MATCHES: Final = 10_000_000
"""Largest number of matches of a pairing: its rallies are kept in memory until it is finished."""
_MOST_WORKERS: Final = 256
_MOST_ELO: Final = 1000
_OWN_PLAYERS: Final = 6
"""So many players' own models are in the default pool; ``--pool`` takes any number."""
ANCHORS: Final = ("minimax", "best-response:bc")
"""Solved policies of the default pool, which no one trained: what all others are measured by."""
TRAINED: Final = ("a2c", "ppo", "sac", "ppo:self-play")
"""Trained agents of the default pool; see docs/training.md."""


Format = Literal["round-robin", "swiss", "gauntlet"]


class LeagueError(ShuttleError):
    """A tournament that cannot be played as asked, or a run folder that cannot be used."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class LeagueConfig:
    """A tournament: a round robin, in which every pair of entrants plays the same number of matches, or another form."""

    pool: tuple[str, ...] = ()
    """Entrants by name (see `docs/league.md`); without any: behaviour-cloned players, scripted styles, random, trained
    agents, and the solved anchors."""
    matches: int = 1000
    """Matches of every pair; an even number, because each is played twice with the seats swapped and the same draws."""
    format: Format = "round-robin"
    """Round robin: every pair. Gauntlet: the first entrant of the pool against each other. Swiss: rounds in which those play each
    other who have won about as much."""
    rounds: int = 0
    """Rounds of a Swiss tournament; 0: as many as halving the pool takes."""
    decide: float | None = None
    """Stop a pairing with an entrant that has no table as soon as a sequential test has decided who is better, with errors of 5 %
    where one is so many Elo points better; default: play all matches."""
    seed: int = 0
    """Names every random draw: the same seed gives the same rallies."""
    out: Path | None = None
    """Run folder; default runs/league-SEED, with a number behind it if that exists."""
    resume: bool = False
    """Continue the unfinished run in --out, or else the latest one of this seed."""
    extend: bool = False
    """Add entrants to the run in --out, with the same flags else: only the pairings that are missing are played."""
    overwrite: bool = False
    """Replace the run in --out."""
    record: str = "all"
    """Rallies that go into the rally log: all, none, or sample:N for one match in N, drawn at random."""
    game: str = "default"
    """Model whose game is played: a shipped one or a folder."""
    profile: Profile | None = None
    """The game of one discipline alone; default: the average of both."""
    exact: bool = True
    """Solve every pair, the best response to every entrant, and its style, beside what is sampled: seconds for each entrant."""
    away: bool = False
    """Solve all pairs in the refits of the game too: how the ranking holds if other matches had been recorded. Changes no
    other figure; takes some minutes."""
    holes: int = 0
    """Show in the report the states in which each of the best so many entrants loses most to its best response; takes a few
    seconds for each, and changes no figure."""
    workers: int = 1
    """Threads that play pairings of policies with tables side by side; changes speed, never a result."""
    ray: str | None = None
    """Play pairings of policies with tables on a Ray cluster: local (Ray on this machine), auto (the cluster that this machine
    belongs to), HOST:PORT of its head, or ray://HOST:PORT; changes speed, never a result. Then --workers does not count."""
    batch: int = 8192
    """Matches played in lock-step; changes speed and memory, never a result."""
    policy_timeout: float = POLICY_TIMEOUT
    """Seconds that a policy may take for one answer before it forfeits; 0 for no limit."""
    grown: tyro.conf.Suppress[tuple[int, ...]] = ()
    """Number of entrants each time before more were added; set by what continues a run."""

    def __post_init__(self) -> None:
        Sampling.parse(self.record)
        if not 2 <= self.matches <= MOST_MATCHES or self.matches % 2:
            raise LeagueError(f"--matches {self.matches}: expected an even number from 2 to {MOST_MATCHES:,}")
        if not 1 <= self.workers <= _MOST_WORKERS:
            raise LeagueError(f"--workers {self.workers}: expected 1 to {_MOST_WORKERS}")
        if not self.exact and (self.away or self.holes):
            raise LeagueError("--away and --holes: not with --no-exact, which leaves out what is solved")
        if self.holes < 0:
            raise LeagueError(f"--holes {self.holes}: expected 0 or more")
        if self.batch < 1:
            raise LeagueError(f"--batch {self.batch}: expected 1 or more")
        if not 0 <= self.seed < 1 << 63:
            raise LeagueError(f"--seed {self.seed}: expected a number from 0 up to 2^63")
        twice = sorted({name for name in self.pool if self.pool.count(name) > 1})
        if twice:
            raise LeagueError(f"--pool names {', '.join(twice)} twice; every entrant plays once against every other")
        if self.rounds < 0 or (self.rounds and self.format != "swiss"):
            raise LeagueError(f"--rounds {self.rounds}: expected 1 or more, with --format swiss; 0 for as many as are needed")
        if self.decide is not None and not 0 < self.decide <= _MOST_ELO:
            raise LeagueError(f"--decide {self.decide:g}: expected Elo points above 0, up to {_MOST_ELO}")
        if self.extend and (self.out is None or not self.pool):
            raise LeagueError("--extend adds the entrants of --pool to the run in --out; give both")
        if self.extend and (self.overwrite or self.format == "swiss"):
            raise LeagueError("--extend adds to a round robin or a gauntlet; it cannot be had with --overwrite or --format swiss")
        if len(self.pool) == 1 and not self.extend:
            raise LeagueError(f"--pool {self.pool[0]}: a tournament needs two entrants or more")
        if self.resume and self.overwrite:
            raise LeagueError("--resume continues a run and --overwrite replaces it; give one of them")

    def fixed(self) -> dict[str, Any]:
        """Everything that decides the results, as JSON."""
        kept = ("pool", "matches", "format", "rounds", "decide", "seed", "record", "game", "profile", "grown")
        fixed: dict[str, Any] = json.loads(json.dumps({name: getattr(self, name) for name in kept}))
        return fixed


def default_pool(game: Game) -> tuple[str, ...]:
    """Behaviour-cloned players (all together, and the first few on their own), scripted styles, random, trained agents, anchors.

    The anchors mark the ends of the scale: perfect play, and the best response to ``bc``. Only what can play this game enters:
    players of its model, and agents that were trained on it.
    """
    names = registry.names(game)
    bc = [name for name in names if name.partition(":")[0] == "bc"]
    others = ("attacking", "defensive", "safe", "random", *TRAINED, *ANCHORS)
    return (*bc[: 1 + _OWN_PLAYERS], *(name for name in others if name in names))


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Entrant:
    """One entrant.

    Attributes:
        name: as given in the pool.
        policy: the policy of that name.
        table: the policy on every state; None if it reads the score or failed.
        failure: why the entrant forfeits every match; empty if it does not.
    """

    name: str
    policy: Policy
    table: TabulatedPolicy | None = None
    failure: str = ""

    @property
    def hash(self) -> str:
        """SHA-256 of the table, hexadecimal; empty without one."""
        return "" if self.table is None else self.table.hash


def enter(name: str, game: Game) -> Entrant:
    """Find an entrant and evaluate it on every state.

    Raises:
        PolicyError: there is no policy of that name. One that raises or returns no distribution enters, and forfeits.
    """
    policy = resolve(name, game)
    try:
        if reads_score(policy):
            return Entrant(name=name, policy=policy)
        return Entrant(name=name, policy=policy, table=tabulate(policy, game, name))
    except PolicyError as error:
        return Entrant(name=name, policy=policy, failure=str(error))


class ForfeitError(Exception):
    """An entrant failed while it played."""

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(f"{name}: {reason}")
        self.name, self.reason = name, reason


class Strikers:
    """Decides the strokes of a batch in which any of the entrants may strike.

    The tables of all entrants lie one below the other, so one row read and one comparison decide a stroke.
    """

    def __init__(self, game: Game, entrants: Sequence[Entrant]) -> None:
        self._game, self._entrants = game, entrants
        self._sampled = [i for i, entrant in enumerate(entrants) if entrant.table is None and not entrant.failure]
        tables = [np.empty((0, 0), dtype=np.uint16) if e.table is None else e.table.padded for e in entrants]
        width = max(table.shape[1] for table in tables)
        self._rows = np.full((sum(map(len, tables)), width), CHOICE_ONE, dtype=np.uint16)
        self._first_row = np.cumsum([0, *map(len, tables)])[:-1].astype(np.int32)
        for first, table in zip(self._first_row, tables, strict=True):
            self._rows[first : first + len(table), : table.shape[1]] = table

    def choose(self, entrant: I32, state: I32, draw: I32, striker: I32, score: I32) -> Intp:
        """Index of the stroke that each striker plays among the legal ones; see :data:`shuttle_marl.kernel.lockstep.Choose`.

        Raises:
            ForfeitError: a policy that reads the score raised, or returned no distribution.
        """
        sampled = [i for i in self._sampled if (entrant == i).any()]
        if not sampled:
            return self._read(entrant, state, draw)
        k = np.empty(len(state), dtype=np.intp)
        rest = np.flatnonzero(~np.isin(entrant, sampled))
        k[rest] = self._read(entrant[rest], state[rest], draw[rest])
        for i in sampled:
            at = np.flatnonzero(entrant == i)
            k[at] = self._ask(i, state[at], draw[at], striker[at], score[:, at])
        return k

    def _read(self, entrant: I32, state: I32, draw: I32) -> Intp:
        return chosen(self._rows.take(self._first_row[entrant] + state, axis=0), draw)

    def _ask(self, i: int, state: I32, draw: I32, striker: I32, score: I32) -> Intp:
        entrant = self._entrants[i]
        try:
            return ask(entrant.policy, entrant.name, self._game, state, draw, striker, score)
        except PolicyError as error:
            raise ForfeitError(entrant.name, str(error)) from error
