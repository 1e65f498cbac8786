"""Tabulated policies, their values against each other, and the solved game, computed once and cached.

Pages name policies and are untrusted: a name is resolved without importing modules or opening files, unless the user gave it on
the command line.
"""

import threading
from collections.abc import Callable, Collection, Hashable
from typing import Any, Final, TypeVar

from shuttle_marl.court.plan import Side
from shuttle_marl.exact import ProfileValue, Solution, Visits, evaluate, solve, visits
from shuttle_marl.game.pairs import game_between
from shuttle_marl.game.policy import Policy, TemperedPolicy
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.policy import baselines
from shuttle_marl.policy.registry import resolve, resolve_recorded

T = TypeVar("T")

_MAX_TABLES: Final = 12
_MAX_VALUES: Final = 24


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
    """Policies of one game.

    Args:
        trusted: names that the user gave, which may name modules and files.
    """

    def __init__(self, game: Game, trusted: Collection[str] = ()) -> None:
        self.game = game
        self._trusted = frozenset(trusted)
        self._policies, self._tables = OnceCache(_MAX_TABLES), OnceCache(_MAX_TABLES)
        self._values, self._visits, self._solution = OnceCache(_MAX_VALUES), OnceCache(_MAX_VALUES), OnceCache(1)
        self._opposite = OnceCache(1)

    def between(self, sides: tuple[Side, Side]) -> "PolicyTables":
        """The policies of the game in which two sides meet: these ones, but between persons whose hands differ."""
        game = game_between(self.game, (sides[0].policy, sides[1].policy))
        return self if game is self.game else self._opposite.get(game.hash, lambda: PolicyTables(game, self._trusted))

    def table(self, side: Side, seat: int = 0) -> TabulatedPolicy:
        """The tabulated policy of a side at a seat; for ``bc:history``, which has no table, that of ``bc``.

        Raises:
            PolicyError: the policy is unknown, may not be named by a page, or reads the score or the rally so far.
        """
        if side.policy == baselines.REMEMBERING:
            side = Side(policy="bc", temperature=side.temperature)
        game = self.game.seats[seat]  # the same for both, unless it is that of a pair
        return self._tables.get((side, game.hash), lambda: tabulate(self.policy(side, seat), game))

    def policy(self, side: Side, seat: int = 0) -> Policy:
        """The policy of a side at a seat, for single states: tabulating all states would take longer.

        Raises:
            PolicyError: the policy is unknown, or may not be named by a page.
        """
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
