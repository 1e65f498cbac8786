"""Settings of league training. This module does not import torch."""

import dataclasses
import os
from typing import Annotated, Final, Literal, get_args

import msgspec

from shuttle_marl.base.files import Count, CountOrZero, FractionOrZero, Positive, Weight
from shuttle_marl.training.config import RunConfig, TrainingError

Variant = Literal["plain", "fictitious", "prioritised", "psro"]
Algorithm = Literal["ppo", "a2c", "sac"]
Oracle = Literal["exact", "ppo", "a2c", "sac"]
MetaSolver = Literal["nash", "linear"]

VARIANTS: Final[tuple[Variant, ...]] = get_args(Variant)
POOL: Final = ("bc", "attacking", "defensive", "safe")
MOST_WORKERS: Final = 1024
_MOST_ROUNDS: Final = 60


class LeagueTrainingError(TrainingError):
    """A league that cannot be trained or resumed."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class LeagueTrainingConfig(RunConfig):
    """Settings of league training, see ``docs/league_training.md``."""

    error = LeagueTrainingError

    variant: Variant = "prioritised"
    """Opponents of the main agents: themselves (plain), also earlier policies (fictitious, prioritised), or psro."""
    strokes: Count = 300_000_000
    """Strokes of each main agent."""
    rounds: Count | None = None
    """Rounds of the run; policies are frozen and saved after each. Default: one per 30 million strokes, from 6 to 60; 60 of psro
    with an exact oracle, where nothing learns."""
    learner: Algorithm = "ppo"
    """Algorithm of the learners."""
    oracle: Oracle = "exact"
    """Oracle of psro: the exact best response, or a learner that trains against the meta-strategy."""
    meta_solver: MetaSolver | None = None
    """Meta-strategy of psro over the population: Nash equilibrium, or linear (the k-th policy counts k times). Default: nash, and
    linear in the game with recovery."""
    main_agents: Annotated[int, msgspec.Meta(ge=1, le=16)] = 1
    """Number of main agents; the first is evaluated."""
    main_exploiters: Annotated[int, msgspec.Meta(ge=0, le=16)] = 1
    """Number of learners that train against the main agents (fictitious and prioritised)."""
    league_exploiters: Annotated[int, msgspec.Meta(ge=0, le=16)] = 1
    """Number of learners that train against the whole population (fictitious and prioritised)."""
    exploiter_fraction: FractionOrZero = 0.25
    """Strokes of an exploiter, as a fraction of those of a main agent."""
    patience: Count = 4
    """Turns after which an exploiter is reset to new weights; it is reset earlier if it succeeds."""
    response_fraction: FractionOrZero = 0.2
    """Fraction of a main agent's rallies against the exact best response to it (not plain)."""
    past_fraction: FractionOrZero = 0.2
    """Fraction of a main agent's rallies against earlier policies (not plain); the rest is self-play."""
    max_opponents: Annotated[int, msgspec.Meta(ge=1, le=64)] = 8
    """Maximum number of earlier policies that a learner plays in one turn."""
    update_interval: Count = 60
    """Iterations between updates of the best response to a main agent."""
    pool: tuple[str, ...] | None = None
    """Names of the initial policies (docs/league.md); default: bc and the scripted styles."""
    entropy: Weight = 0.1
    """Weight of the entropy bonus of ppo and a2c; decays linearly to 0."""
    learning_rate: Positive | None = None
    """Initial learning rate; default: that of the algorithm."""
    width: Count = 64
    """Units of each layer of the networks."""
    batch: CountOrZero = 0
    """Strokes in the first iteration; 0: the default of the algorithm."""
    workers: Annotated[int, msgspec.Meta(ge=1, le=MOST_WORKERS)] = min(2, os.cpu_count() or 1)
    """Number of worker processes; it does not change the result."""
    ray: str | None = None
    """Ray cluster that replaces the workers: local, auto, HOST:PORT or ray://HOST:PORT (docs/cluster.md)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.response_fraction + self.past_fraction > 1:
            flags = f"--response-fraction {self.response_fraction} --past-fraction {self.past_fraction}"
            raise LeagueTrainingError(f"{flags}: expected fractions that add up to 1 or less")
        if self.pool is not None and not self.pool:
            raise LeagueTrainingError("--pool: expected one or more policies")

    @property
    def exact_oracle(self) -> bool:
        """Whether nothing learns: psro with an exact oracle."""
        return self.variant == "psro" and self.oracle == "exact"

    @property
    def algorithm(self) -> Algorithm:
        """Algorithm of the learners."""
        return self.learner if self.variant != "psro" or self.oracle == "exact" else self.oracle

    @property
    def n_rounds(self) -> int:
        """Number of rounds."""
        return self.rounds or (_MOST_ROUNDS if self.exact_oracle else min(_MOST_ROUNDS, max(6, round(self.strokes / 3e7))))
