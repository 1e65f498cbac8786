"""State of a league: frozen policies by the hashes of their tables, their exact payoffs, learners, and the turns of a round."""

import dataclasses
import functools
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Final

import msgspec
import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.cluster import in_threads
from shuttle_marl.base.files import FileReadError, FractionOrZero, Sha256, StoredCount, read_json, replace_sealed
from shuttle_marl.exact.fixed_point import Odds
from shuttle_marl.exact.profile import evaluate
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.policy.computed import StoredPolicies
from shuttle_marl.training.league.config import LeagueTrainingError

TABLES: Final = "tables"
LEAGUE: Final = "league.json"
TOLERANCE: Final = 1e-5  # error bound of payoffs and exploitability, far below the noise of training
_POLICIES: Final = 256  # kept at most; each takes some megabytes


@dataclasses.dataclass(frozen=True, kw_only=True)
class Frozen:
    """A frozen policy."""

    name: str  # name, such as `bc`, `main-agent-0@3` (the first main agent after round 3) or `best-response:main-agent-0@3`
    role: str  # `given`, `main`, `main-exploiter`, `league-exploiter`, `best-response` or `oracle`
    round: StoredCount  # round after which it joined; 0 for initial policies
    hash: Sha256


class Payoffs:
    """Odds of pairs of policies, each solved once, when it is first needed; ``cells``: solved pairs, from :meth:`as_json`."""

    def __init__(self, tables: StoredPolicies, cells: Mapping[str, Sequence[float]] = {}) -> None:
        self._cells: dict[tuple[str, str], tuple[float, float]] = {}
        for pair, (first, second) in cells.items():
            a, _, b = pair.partition(" ")
            self._cells[a, b] = (float(first), float(second))
        self._policy = functools.lru_cache(_POLICIES)(tables.read)
        self.solved = 0  # number of solved pairs, without those in `cells`

    def as_json(self, retained: Collection[str]) -> dict[str, tuple[float, float]]:
        """Solved pairs of the given hashes: by two hashes, the probability that each wins a rally that it serves."""
        cells = sorted(self._cells.items())
        return {f"{a} {b}": (first, second) for (a, b), (first, second) in cells if a in retained and b in retained}

    def odds(self, policy: str, others: Iterable[str]) -> list[Odds]:
        """Odds of a policy against others, by hash."""
        others = list(others)
        missing = sorted({_pair(policy, other) for other in others if other != policy} - self._cells.keys())
        for chunk in (missing[i : i + 8] for i in range(0, len(missing), 8)):
            policies = [(self._policy(a), self._policy(b)) for a, b in chunk]
            self._cells.update(zip(chunk, in_threads(_serving_odds, policies), strict=True))
        self.solved += len(missing)
        return [self._odds(policy, other) for other in others]

    def _odds(self, policy: str, other: str) -> Odds:
        if policy == other:
            return Odds(serving=0.5, receiving=0.5, error_bound=TOLERANCE)  # zero-sum
        a, b = self._cells[_pair(policy, other)]
        mine, theirs = (a, b) if policy < other else (b, a)
        return Odds(serving=mine, receiving=1 - theirs, error_bound=TOLERANCE / 2)

    def values(self, hashes: Sequence[str]) -> F64:
        """``[N, N]`` value of a rally of the row against the column, averaged over both servers; antisymmetric."""
        out = np.zeros((len(hashes), len(hashes)))
        for i, policy in enumerate(hashes):
            out[i, :i] = [odds.value for odds in self.odds(policy, hashes[:i])]
        return np.asarray(out - out.T)

    def match_wins(self, policy: str, others: Sequence[str]) -> F64:
        """``[K]`` probabilities that a policy wins a match against others."""
        return np.array([odds.match() for odds in self.odds(policy, others)])


def _pair(a: str, b: str) -> tuple[str, str]:
    return (a, b) if a < b else (b, a)


def _serving_odds(pair: tuple[TabulatedPolicy, TabulatedPolicy]) -> tuple[float, float]:
    value = evaluate(*pair, tolerance=TOLERANCE)
    return value.odds(0).serving, value.odds(1).serving


@dataclasses.dataclass(frozen=True, kw_only=True)
class Turn:
    """Settings of one turn of a learner.

    Attributes:
        fractions: fraction of its rallies against each opponent; the rest, without ``response_fraction``, is self-play.
        remaining: fraction of the learner's schedule that remains at the start and at the end of the turn.
    """

    member: str  # name of the learner, such as `main-agent-0`
    round: int  # number of the round, counted from 1
    fresh: bool = True
    opponents: tuple[str, ...] = ()
    fractions: tuple[float, ...] = ()
    response_fraction: float = 0.0  # fraction of its rallies against the exact best response to it
    strokes: int  # minimum number of its strokes
    remaining: tuple[float, float] = (1.0, 1.0)
    seed: int = 0


@dataclasses.dataclass(frozen=True, kw_only=True)
class TurnResult:
    """Result of a turn."""

    member: str
    hash: Sha256
    strokes: StoredCount


@dataclasses.dataclass(kw_only=True)
class Member:
    """A learner.

    Attributes:
        hash: hash of its current table; empty before its first turn with new weights.
    """

    turns: StoredCount = 0  # number of turns with its current weights
    strokes: StoredCount = 0
    hash: Annotated[str, msgspec.Meta(pattern="^([0-9a-f]{64})?$")] = ""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Best:
    """The least exploitable main agent so far."""

    name: str  # name of the policy, such as `main-agent-0@3`
    hash: Sha256
    exploitability: float
    temperature: float  # softmax temperature of its network; 1 for a mixture


@dataclasses.dataclass(kw_only=True)
class LeagueState:
    """State between two rounds.

    Attributes:
        cells: solved payoffs, see :class:`Payoffs`.
        exhausted: whether the last best response of psro was in the population already, so that nothing changes any more.
    """

    round: StoredCount = 0
    population: list[Frozen] = dataclasses.field(default_factory=list)  # frozen policies, in the order in which they joined
    members: dict[str, Member] = dataclasses.field(default_factory=dict)
    cells: dict[str, tuple[FractionOrZero, FractionOrZero]] = dataclasses.field(default_factory=dict)
    best: Best | None = None  # least exploitable main agent; None before the first round
    exhausted: bool = False
    seconds: float = 0.0
    metrics: StoredCount = 0

    def save(self, folder: Path) -> None:
        """Write the state to the folder of its run."""
        replace_sealed(folder / LEAGUE, dataclasses.asdict(self))

    @classmethod
    def load(cls, folder: Path) -> "LeagueState":
        """The state in a folder; without a population if there is none. Raises LeagueTrainingError: the file is damaged."""
        path = folder / LEAGUE
        if not path.exists():
            return cls()
        try:
            return read_json(path, cls, sealed=True)
        except FileReadError as error:
            raise LeagueTrainingError(f"{path}: cannot be used ({error}); train again with --overwrite") from error
