"""State of a league between rounds, in one file, and the turns of a round."""

import dataclasses
from pathlib import Path
from typing import Annotated, Final

import msgspec

from shuttle_marl.base.files import FileReadError, Fraction, Sha256, StoredCount, read_json, replace_sealed
from shuttle_marl.training.league.config import LeagueTrainingError
from shuttle_marl.training.league.population import Frozen

LEAGUE: Final = "league.json"
"""File of the state in the folder of a run."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Turn:
    """Settings of one turn of a learner.

    Attributes:
        member: name of the learner, such as ``main-agent-0``.
        round: number of the round, counted from 1.
        fractions: fraction of its rallies against each opponent; the rest, without ``response_fraction``, is self-play.
        response_fraction: fraction of its rallies against the exact best response to it.
        strokes: minimum number of its strokes; None: limited by ``seconds``.
        seconds: time for learning; preparation and saving are not included.
        remaining: fraction of the learner's schedule that remains at the start and at the end of the turn.
    """

    member: str
    round: int
    fresh: bool = True
    opponents: tuple[str, ...] = ()
    fractions: tuple[float, ...] = ()
    response_fraction: float = 0.0
    strokes: int | None = None
    seconds: float | None = None
    remaining: tuple[float, float] = (1.0, 1.0)
    seed: int = 0


@dataclasses.dataclass(frozen=True, kw_only=True)
class TurnResult:
    """Result of a turn."""

    member: str
    hash: Sha256
    strokes: StoredCount
    seconds: float
    iterations: StoredCount


@dataclasses.dataclass(kw_only=True)
class Member:
    """A learner.

    Attributes:
        turns: number of turns with its current weights.
        hash: hash of its current table; empty before its first turn with new weights.
    """

    turns: StoredCount = 0
    strokes: StoredCount = 0
    hash: Annotated[str, msgspec.Meta(pattern="^([0-9a-f]{64})?$")] = ""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Best:
    """The least exploitable main agent so far.

    Attributes:
        name: name of the policy, such as ``main-agent-0@3``.
        temperature: softmax temperature of its network; 1 for a mixture.
    """

    name: str
    hash: Sha256
    exploitability: float
    temperature: float


@dataclasses.dataclass(kw_only=True)
class LeagueState:
    """State between two rounds.

    Attributes:
        population: frozen policies, in the order in which they joined.
        cells: solved payoffs, see :class:`~shuttle_marl.training.league.population.Payoffs`.
        best: least exploitable main agent; None before the first round.
        exhausted: whether the last best response of psro was in the population already, so that nothing changes any more.
        overhead: seconds of the last round in which its main agent did not learn.
    """

    round: StoredCount = 0
    population: list[Frozen] = dataclasses.field(default_factory=list)
    members: dict[str, Member] = dataclasses.field(default_factory=dict)
    cells: dict[str, tuple[Fraction, Fraction]] = dataclasses.field(default_factory=dict)
    best: Best | None = None
    exhausted: bool = False
    seconds: float = 0.0
    overhead: float = 0.0
    metrics: StoredCount = 0

    def save(self, folder: Path) -> None:
        """Write the state to the folder of its run."""
        replace_sealed(folder / LEAGUE, dataclasses.asdict(self))

    @classmethod
    def load(cls, folder: Path) -> "LeagueState":
        """The state in a folder; without a population if there is none.

        Raises:
            LeagueTrainingError: the file is damaged.
        """
        path = folder / LEAGUE
        if not path.exists():
            return cls()
        try:
            return read_json(path, cls, sealed=True)
        except FileReadError as error:
            raise LeagueTrainingError(f"{path}: cannot be used ({error}); train again with --overwrite") from error
