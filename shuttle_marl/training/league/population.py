"""Population of a league: frozen policies, stored by the hashes of their tables, and their exact payoffs."""

import collections
import dataclasses
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.cluster import in_threads
from shuttle_marl.base.files import Sha256, StoredCount
from shuttle_marl.exact.match import Odds
from shuttle_marl.exact.profile import InducedChain, evaluate_chains, induced
from shuttle_marl.policy.computed import StoredPolicies

TABLES: Final = "tables"
"""Folder of the tables in the folder of a run."""
TOLERANCE: Final = 1e-5
"""Error bound of payoffs and exploitability, far below the noise of training."""
_CHAIN_BYTES: Final = 2 << 30
"""Memory of the cache of induced chains."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Frozen:
    """A frozen policy.

    Attributes:
        name: name, such as ``bc``, ``main-agent-0@3`` (the first main agent after round 3) or ``best-response:main-agent-0@3``.
        role: ``given``, ``main``, ``main-exploiter``, ``league-exploiter``, ``best-response`` or ``oracle``.
        round: round after which it joined; 0 for initial policies.
    """

    name: str
    role: str
    round: StoredCount
    hash: Sha256


class Payoffs:
    """Odds of pairs of policies, each solved once, when it is first needed.

    Args:
        cells: solved pairs, from :meth:`as_json`.
    """

    def __init__(self, tables: StoredPolicies, cells: Mapping[str, Sequence[float]] = {}) -> None:
        self._tables = tables
        self._cells: dict[tuple[str, str], tuple[float, float]] = {}
        for pair, (first, second) in cells.items():
            a, _, b = pair.partition(" ")
            self._cells[a, b] = (float(first), float(second))
        self._chains: collections.OrderedDict[str, InducedChain] = collections.OrderedDict()
        self.solved = 0
        """Number of solved pairs, without those in ``cells``."""

    def as_json(self, retained: Collection[str]) -> dict[str, tuple[float, float]]:
        """Solved pairs of the given hashes: by two hashes, the probability that each wins a rally that it serves."""
        cells = sorted(self._cells.items())
        return {f"{a} {b}": (first, second) for (a, b), (first, second) in cells if a in retained and b in retained}

    def odds(self, policy: str, others: Iterable[str]) -> list[Odds]:
        """Odds of a policy against others, by hash."""
        others = list(others)
        missing = sorted({_pair(policy, other) for other in others} - self._cells.keys())
        missing = [pair for pair in missing if pair[0] != pair[1]]
        for chunk in (missing[i : i + 8] for i in range(0, len(missing), 8)):
            chains = [(self._chain(a), self._chain(b)) for a, b in chunk]
            for pair, odds in zip(chunk, in_threads(_serving_odds, chains), strict=True):
                self._cells[pair] = odds
                self.solved += 1
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

    def _chain(self, name: str) -> InducedChain:
        if name in self._chains:
            self._chains.move_to_end(name)
            return self._chains[name]
        chain = self._chains[name] = induced(self._tables.read(name))
        while len(self._chains) > 2 and sum(map(_bytes, self._chains.values())) > _CHAIN_BYTES:
            self._chains.popitem(last=False)
        return chain


def _pair(a: str, b: str) -> tuple[str, str]:
    return (a, b) if a < b else (b, a)


def _serving_odds(chains: tuple[InducedChain, InducedChain]) -> tuple[float, float]:
    value = evaluate_chains(*chains, tolerance=TOLERANCE)
    return value.odds(0).serving, value.odds(1).serving


def _bytes(chain: InducedChain) -> int:
    return sum({id(part): part.nbytes for part in chain.chance}.values())
