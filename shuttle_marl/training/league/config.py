"""Settings of league training. No torch here."""

import dataclasses
import json
import os
import re
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_args

from shuttle_marl.game.shipped import Profile
from shuttle_marl.training.config import (
    Count,
    CountOrZero,
    FractionOrZero,
    Positive,
    TrainingError,
    Weight,
    Within,
    bounds_of,
)

Way = Literal["plain", "fictitious", "prioritised", "psro"]
Algorithm = Literal["ppo", "a2c", "sac"]
Oracle = Literal["exact", "ppo", "a2c", "sac"]
Meta = Literal["nash", "uniform", "alpha-rank"]

WAYS: Final[tuple[Way, ...]] = get_args(Way)
POOL: Final = ("bc", "attacking", "defensive", "safe")
"""Policies that are there from the beginning, where the game has them."""
MOST_WORKERS: Final = 1024
_NOT_DECISIVE: Final = ("out", "resume", "overwrite", "workers", "ray")
_SECONDS: Final = {"s": 1, "m": 60, "h": 3600}


class LeagueTrainingError(TrainingError):
    """A league that cannot be trained, or continued."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class LeagueTrainingConfig:
    """Settings of league training."""

    way: Way = "prioritised"
    """Opponents of the main agents: plain (themselves alone), fictitious (also all policies so far alike), prioritised (also
    those they lose to), or psro (a best response to the meta-strategy joins in every round)."""
    budget: str | None = None
    """Time for all, as in 90s, 5m or 1h; default 5m where --strokes is not given."""
    strokes: Count | None = None
    """Budget in strokes of each main agent instead of time: then a seed decides the result."""
    rounds: Count | None = None
    """Rounds into which the budget is cut; after each, policies and payoffs are frozen and all is saved. Default: one for every
    30 seconds or 30 million strokes, from 6 to 60 (psro with an exact oracle: until time is up). With a budget of time there are
    fewer where what comes between turns takes long."""
    learner: Algorithm = "ppo"
    """Algorithm of the learners."""
    oracle: Oracle = "exact"
    """Origin of the policies that join in psro: the exact best response, or a learner that trains against the meta-strategy."""
    meta: Meta = "nash"
    """Meta-strategy of psro over the policies so far: an equilibrium, all alike, or alpha-rank."""
    main_agents: Annotated[int, Within(low=1, high=16, text="a whole number from 1 to 16")] = 1
    """Main agents, the first of which is evaluated."""
    main_exploiters: Annotated[int, Within(low=0, high=16, text="a whole number from 0 to 16")] = 1
    """Learners that train against the main agents alone (fictitious and prioritised)."""
    league_exploiters: Annotated[int, Within(low=0, high=16, text="a whole number from 0 to 16")] = 1
    """Learners that train against all policies so far (fictitious and prioritised)."""
    exploiter_share: FractionOrZero = 0.25
    """Time or strokes of an exploiter, as a share of those of a main agent."""
    patience: Count = 4
    """Turns after which an exploiter begins again with new weights, or earlier when it gains most of what can be gained."""
    responses: FractionOrZero = 0.2
    """Share of a main agent's rallies against the exact best response to it, solved again and again (not plain)."""
    past: FractionOrZero = 0.2
    """Share of a main agent's rallies against the policies so far (not plain); the rest are against itself."""
    opponents: Annotated[int, Within(low=1, high=64, text="a whole number from 1 to 64")] = 8
    """Most policies so far that a learner meets in one turn."""
    renew: Count = 60
    """Iterations after which the best response to a main agent is solved again."""
    pool: tuple[str, ...] | None = None
    """Policies that are there from the beginning, by name (docs/league.md); default: bc and the scripted styles."""
    seed: Annotated[int, Within(low=0, high=(1 << 63) - 1, text="a whole number from 0 up to 2^63")] = 0
    """Names every random draw."""
    entropy: Weight = 0.1
    """Weight of the entropy bonus of ppo and a2c; falls linearly to 0."""
    learning_rate: Positive | None = None
    """Learning rate at the start; default: that of the algorithm."""
    width: Count = 64
    """Numbers in a layer of the networks."""
    batch: CountOrZero = 0
    """Strokes in the first iteration; 0: that of the algorithm."""
    workers: Annotated[int, Within(low=1, high=MOST_WORKERS, text="a whole number from 1 to 1,024")] = min(2, os.cpu_count() or 1)
    """Processes that train side by side; with --strokes they change no result."""
    ray: str | None = None
    """Train side by side on a Ray cluster: local (Ray on this machine), auto (the cluster that this machine belongs to),
    HOST:PORT of its head, or ray://HOST:PORT; with --strokes it changes no result. Then --workers does not count."""
    game: str = "default"
    """Model whose game is played: a shipped one or a folder."""
    profile: Profile | None = None
    """The game of one discipline alone; default: the average of both."""
    out: Path | None = None
    """Run folder; default runs/league-training, with a number behind it if that exists."""
    resume: bool = False
    """Continue the run in --out (or the default folder) after its last round."""
    overwrite: bool = False
    """Replace the run in --out."""

    def __post_init__(self) -> None:
        for name, (whole, bounds) in bounds_of(type(self)).items():
            value = getattr(self, name)
            if value is not None and (value not in bounds or (whole and not isinstance(value, int))):
                raise LeagueTrainingError(f"--{name.replace('_', '-')} {value}: expected {bounds.text}")
        if self.budget is not None and self.strokes is not None:
            raise LeagueTrainingError("--budget and --strokes: give one of them")
        if self.responses + self.past > 1:
            raise LeagueTrainingError(f"--responses {self.responses} --past {self.past}: expected shares of 1 in all")
        if self.resume and self.overwrite:
            raise LeagueTrainingError("--resume continues a run and --overwrite replaces it; give one of them")
        if self.exact_oracle and self.strokes is not None and self.rounds is None:
            raise LeagueTrainingError("--strokes: nothing learns in psro with exact best responses; give --budget or --rounds")
        if self.pool is not None and not self.pool:
            raise LeagueTrainingError("--pool: expected one policy or more")
        _ = self.seconds

    @property
    def seconds(self) -> float | None:
        """Budget of time; None where it is one of strokes, or of rounds of exact best responses.

        Raises:
            LeagueTrainingError: it is no time.
        """
        if self.strokes is not None or (self.exact_oracle and self.budget is None and self.rounds is not None):
            return None
        found = re.fullmatch(r"(\d+(?:\.\d+)?)([smh])", self.budget or "5m")
        if found is None or not float(found[1]):
            raise LeagueTrainingError(f"--budget {self.budget}: expected a time, as in 90s, 5m or 1h")
        return float(found[1]) * _SECONDS[found[2]]

    @property
    def exact_oracle(self) -> bool:
        """Whether nothing learns: psro with exact best responses."""
        return self.way == "psro" and self.oracle == "exact"

    @property
    def algorithm(self) -> Algorithm:
        """Algorithm of the learners of this way."""
        return self.learner if self.way != "psro" or self.oracle == "exact" else self.oracle

    @property
    def n_rounds(self) -> int | None:
        """Rounds; None: as many as the time allows."""
        if self.rounds is not None:
            return self.rounds
        if self.exact_oracle:
            return None
        size = self.strokes / 3e7 if self.strokes is not None else (self.seconds or 0) / 30
        return min(60, max(6, round(size)))

    def fixed(self) -> dict[str, Any]:
        """Settings that decide the result, as JSON."""
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name not in _NOT_DECISIVE}
        decisive: dict[str, Any] = json.loads(json.dumps(fields))
        return decisive
