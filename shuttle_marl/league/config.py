"""Configuration of a tournament: the flags of the command line."""

import dataclasses
import json
from pathlib import Path
from typing import Any, Final

from shuttle_marl.errors import ShuttleError
from shuttle_marl.policy import registry
from shuttle_marl.policy.time_limit import POLICY_TIMEOUT
from shuttle_marl.recording import Sampling

MOST_MATCHES: Final = 10_000_000
"""Largest number of matches of a pairing: its rallies are kept in memory until it is finished."""
_OWN_PLAYERS: Final = 6
"""So many players' own models are in the default pool; ``--pool`` takes any number."""
ANCHORS: Final = ("minimax", "best-response:bc")
"""Solved policies of the default pool, which no one trained: what all others are measured by."""
TRAINED: Final = ("a2c", "ppo", "sac", "ppo:self-play")
"""Trained agents of the default pool; see docs/training.md."""


class LeagueError(ShuttleError):
    """A tournament that cannot be played as asked, or a run folder that cannot be used."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class LeagueConfig:
    """A round robin: every pair of entrants plays the same number of matches."""

    pool: tuple[str, ...] = ()
    """Entrants by name (see `docs/league.md`); without any: behaviour-cloned players, scripted styles, random, trained
    agents, and the solved anchors."""
    matches: int = 1000
    """Matches of every pair; an even number, because each is played twice with the seats swapped and the same draws."""
    seed: int = 0
    """Names every random draw: the same seed gives the same rallies."""
    out: Path | None = None
    """Run folder; default runs/league-SEED, with a number behind it if that exists."""
    resume: bool = False
    """Continue the unfinished run in --out, or else the latest one of this seed."""
    overwrite: bool = False
    """Replace the run in --out."""
    record: str = "all"
    """Rallies that go into the rally log: all, none, or sample:N for one match in N, drawn at random."""
    game: str = "default"
    """Model whose game is played: a shipped one or a folder."""
    batch: int = 8192
    """Matches played in lock-step; changes speed and memory, never a result."""
    policy_timeout: float = POLICY_TIMEOUT
    """Seconds that a policy may take for one answer before it forfeits; 0 for no limit."""

    def __post_init__(self) -> None:
        Sampling.parse(self.record)
        if not 2 <= self.matches <= MOST_MATCHES or self.matches % 2:
            raise LeagueError(f"--matches {self.matches}: expected an even number from 2 to {MOST_MATCHES:,}")
        if self.batch < 1:
            raise LeagueError(f"--batch {self.batch}: expected 1 or more")
        if not 0 <= self.seed < 1 << 63:
            raise LeagueError(f"--seed {self.seed}: expected a number from 0 up to 2^63")
        twice = sorted({name for name in self.pool if self.pool.count(name) > 1})
        if twice:
            raise LeagueError(f"--pool names {', '.join(twice)} twice; every entrant plays once against every other")
        if len(self.pool) == 1:
            raise LeagueError(f"--pool {self.pool[0]}: a round robin needs two entrants or more")
        if self.resume and self.overwrite:
            raise LeagueError("--resume continues a run and --overwrite replaces it; give one of them")

    def fixed(self) -> dict[str, Any]:
        """Everything that decides the results, as JSON: pool, matches, seed, record, game."""
        kept = ("pool", "matches", "seed", "record", "game")
        fixed: dict[str, Any] = json.loads(json.dumps({name: getattr(self, name) for name in kept}))
        return fixed


def default_pool() -> tuple[str, ...]:
    """Behaviour-cloned players (all together, and the first few on their own), scripted styles, random, trained agents, anchors.

    The anchors mark the ends of the scale: perfect play, and the best response to ``bc``.
    """
    names = registry.names()
    bc = [name for name in names if name.partition(":")[0] == "bc"]
    others = ("attacking", "defensive", "safe", "random", *TRAINED, *ANCHORS)
    return (*bc[: 1 + _OWN_PLAYERS], *(name for name in others if name in names))
