"""Policies as tables, their values against each other, and the solved game; made once, kept while they are in use.

A page names policies, so a name is resolved as one from a file (no module is imported, no file opened), unless the user named it
on the command line.
"""

import threading
from collections.abc import Callable, Hashable, Sequence
from typing import Any, Final, TypeVar

from shuttle_marl.exact import ProfileValue, Solution, Visits, evaluate, solve, visits
from shuttle_marl.game.policy import Policy, TemperedPolicy
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.policy.registry import resolve, resolve_recorded
from shuttle_marl.watch.plan import Side

T = TypeVar("T")

_MOST_TABLES: Final = 12
_MOST_VALUES: Final = 24


class Kept:
    """Results that are made once, even if several threads ask at the same time; the longest unused ones are dropped.

    Args:
        most: how many are kept.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._entries: dict[Hashable, tuple[threading.Lock, list[Any]]] = {}
        self._lock = threading.Lock()

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """The result of a key, made by ``make`` if it is not there. An error is raised again for everyone who asks later."""
        with self._lock:
            entry = self._entries.pop(key, None) or (threading.Lock(), [])
            self._entries[key] = entry
            while len(self._entries) > self._most:
                self._entries.pop(next(iter(self._entries)))
        lock, made = entry
        with lock:
            if not made:
                made.append(make())
            result: T = made[0]
            return result


class Tables:
    """Policies of one game.

    Args:
        game: the tables of the game.
        trusted: names that the user gave, which may be modules and files.
    """

    def __init__(self, game: Game, trusted: Sequence[str] = ()) -> None:
        self.game = game
        self._trusted = frozenset(trusted)
        self._policies, self._tables = Kept(_MOST_TABLES), Kept(_MOST_TABLES)
        self._values, self._visits, self._solution = Kept(_MOST_VALUES), Kept(_MOST_VALUES), Kept(1)

    def of(self, side: Side) -> TabulatedPolicy:
        """The table of a side.

        Raises:
            PolicyError: there is no such policy, it may not be named by a page, or it reads the score.
        """
        return self._tables.get(side, lambda: tabulate(self.policy(side), self.game, side.policy))

    def policy(self, side: Side) -> Policy:
        """The policy of a side, to be asked in single states: a table of all of them would take longer.

        Raises:
            PolicyError: there is no such policy, or it may not be named by a page.
        """
        return self._policies.get(side, lambda: self._resolved(side))

    def _resolved(self, side: Side) -> Policy:
        policy = (resolve if side.policy in self._trusted else resolve_recorded)(side.policy, self.game)
        return policy if side.temperature == 1 else TemperedPolicy(policy, side.temperature)

    def values(self, sides: tuple[Side, Side]) -> ProfileValue:
        """Exact values of seat 0 against seat 1."""
        return self._values.get(sides, lambda: evaluate(self.of(sides[0]), self.of(sides[1])))

    @property
    def solution(self) -> Solution:
        """The solved game."""
        return self._solution.get(self.game.hash, lambda: solve(self.game))

    def visits(self, sides: tuple[Side, Side]) -> Visits:
        """Expected visits of seat 0 against seat 1 in a rally, both serving equally often."""
        return self._visits.get(sides, lambda: visits(self.of(sides[0]), self.of(sides[1])))
