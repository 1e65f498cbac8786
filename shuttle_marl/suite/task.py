"""The interface of a task: cases, what a method plays in each, and exact scores of what it played.

A run is a set of *units*, one for each case and seed. In a unit the method is called once, and its outcome is stored: tables of
policies and, for some tasks, answers in JSON. Scores are a function of the case and the stored outcome alone, so everyone can
recompute them.

A point is one rally in a hundred. What is played is worth the rallies that it wins against an opponent who is restricted to a
policy with probability :data:`WEIGHT` at each choice, and else makes the choice that is worst for it (Johanson et al., NeurIPS
2007). The **gain** is that worth above the one of perfect play. The restricted response has the largest gain of any kind of play,
see :func:`shuttle_marl.exact.optimal.restricted_value`.
"""

import abc
import dataclasses
import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.files import content_hash
from shuttle_marl.exact import restricted_response
from shuttle_marl.exact.odds import best_odds, pair_odds, restricted_odds
from shuttle_marl.exact.profile import PairPolicy, tabulated_pairs
from shuttle_marl.game.layout import observations
from shuttle_marl.game.policy import GamePolicy, States, TabulatedPolicy, tabulate
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.foreign import FunctionPolicy, blaming
from shuttle_marl.policy.registry import resolve
from shuttle_marl.suite.options import Access, Split, SuiteError


@dataclasses.dataclass(frozen=True, kw_only=True)
class Case:
    """One part of a task."""

    name: str  # unique within the task and the split
    stratum: str = ""  # exchangeable cases share it, see `aggregate`; empty: it is alone
    counts: bool = True  # whether its scores count in the aggregates; controls do not
    budget: int = 0  # number of strokes; 0: the task has no budgets
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)  # what the task needs to set the case up, as JSON


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Outcome:
    """What a method produced in a unit.

    Attributes:
        answers: JSON values by name, for tasks that score more than policies.
    """

    policies: Mapping[str, TabulatedPolicy] = dataclasses.field(default_factory=dict)  # tables by role, such as `player`
    answers: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    strokes: int | None = None  # strokes that the learner declares to have used; None: unknown or not applicable


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Arena:
    """Game and split of a run; values that several cases share are computed once."""

    game: Game
    model: str = "default"  # name or folder of the model of the game
    base: str = ""  # hash of the game of the model; that of `game`, unless the split has a game drawn at random
    split: Split = "dev"
    quick: bool = False
    budget: int | None = None  # cases of this budget only; None: all
    seed: str | None = None  # of the split round

    def policy(self, name: str) -> TabulatedPolicy:
        """Table of a policy by name."""
        return named_table(self.game, name)


@functools.lru_cache(maxsize=64)
def named_table(game: Game, name: str) -> TabulatedPolicy:
    """Table of a policy by name."""
    return tabulate(resolve(name, game), game)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Setting:
    """The argument of a method."""

    game: Game
    model: str  # name or folder of the model; the game of the setting differs from its game where that is drawn
    seed: int
    folder: Path  # folder for files of the method; it may hold those of an interrupted call

    def policy(self, name: str) -> TabulatedPolicy:
        """Table of a policy by name, such as ``random``."""
        return named_table(self.game, name)


class Task(abc.ABC):
    """A versioned task. Its docstring says what is given, what is scored, and the budget, in one sentence each."""

    name: ClassVar[str]
    protocol: ClassVar[str]  # what a method is called with and returns, in one line
    metric: ClassVar[str]  # entry of the scores that ranks methods
    unit: ClassVar[str] = "points"  # unit of the metric; a point is one rally in a hundred
    zero: ClassVar[str]  # what 0 of the metric is
    not_proved: ClassVar[str]  # what a score does not prove
    higher_is_better: ClassVar[bool] = True
    recovery: ClassVar[bool] = False  # whether the game is the one with recovery, in which the receiver's position is hidden
    hidden: ClassVar[tuple[str, ...]] = ()  # what a player of the task does not know
    access: ClassVar[Access] = "tables"  # the least that a method has to read
    entrance: ClassVar[bool] = False  # whether simple rules come near the optimum; scored apart from the other tasks
    budgets: ClassVar[tuple[int, ...]] = ()  # strokes that a learner may play, which methods declare; each has a board of its own
    seeds: ClassVar[int] = 3  # default number of seeds
    variants: ClassVar[Mapping[str, str]] = {}  # variant of the model of a split, such as the game of one discipline
    drawn: ClassVar[Mapping[str, float]] = {"round": 0.5}  # splits whose game is drawn, with this deviation: `drawn_game`
    roles: ClassVar[tuple[str, ...]] = ("player",)  # roles of the policies of an outcome
    answers: ClassVar[tuple[str, ...]] = ()  # names of the answers of an outcome
    optimum: ClassVar[float | None] = None  # score of perfect play; None: the score ``best`` of a unit, if there is one

    @property
    def question(self) -> str:
        """The first line of the docstring."""
        return (self.__doc__ or "").partition("\n")[0].rstrip(".").replace("``", "`")

    @property
    def about(self) -> str:
        """The docstring in one line."""
        return " ".join((self.__doc__ or "").replace("``", "").split())

    def cases(self, arena: Arena) -> list[Case]:
        """Cases of the split, or those of one budget. Raises SuiteError: there is none of this budget."""
        found = self.all_cases(arena)
        if arena.budget is not None and arena.budget not in (budgets := sorted({case.budget for case in found} - {0})):
            raise SuiteError(f"--budget {arena.budget}: {self.name} has {', '.join(map(str, budgets)) or 'no budgets'}")
        return [case for case in found if arena.budget in (None, case.budget)]

    @abc.abstractmethod
    def all_cases(self, arena: Arena) -> list[Case]:
        """Cases of the split, of all budgets."""

    @abc.abstractmethod
    def play(self, arena: Arena, case: Case, method: Any, seed: int, folder: Path) -> Outcome:
        """Call the method in a case.

        Args:
            case: one of :meth:`cases`.
            method: see :func:`shuttle_marl.suite.method.find`.
            folder: folder for files of the method, which may contain those of an interrupted call.

        Raises:
            PolicyError, SuiteError: the method failed, or returned something illegal.
        """

    @abc.abstractmethod
    def score(self, arena: Arena, case: Case, seed: int, outcome: Outcome) -> dict[str, float]:
        """Scores of an outcome by name, :attr:`metric` among them. Raises SuiteError: something is lacking, or illegal."""

    @abc.abstractmethod
    def given(self, arena: Arena, case: Case, seed: int) -> Iterable[str]:
        """Hashes of everything that a unit gives to a method or scores with, except the game."""

    def fingerprint(self, arena: Arena, case: Case, seed: int) -> str:
        """SHA-256 of the game, the name of the case and what it gives; two units are the same if they agree."""
        parts = [arena.game.hash, self.name, case.name, *self.given(arena, case, seed)]
        return content_hash("\n".join(parts).encode())


def required(outcome: Outcome, role: str = "player") -> TabulatedPolicy:
    """The policy of a role. Raises SuiteError: the outcome has none."""
    if role not in outcome.policies:
        raise SuiteError(f"no policy {role!r} is stored; run the method again")
    return outcome.policies[role]


def table_of(player: Any, game: Game, name: str) -> TabulatedPolicy:
    """The table of what a method returned: a policy, the name of one, or an object with ``table`` or ``act``.

    Args:
        player: a policy; a name of the registry, such as ``agent:FOLDER``; an object with an attribute ``table``, which is one
            of these; or one with ``act(observation, mask)``, which chooses one stroke for an observation.

    Raises:
        PolicyError: the policy raises, reads the score, or is no distribution over the legal strokes.
        SuiteError: it is none of these.
    """
    with blaming(f"the method of {name}: the table of its player"):
        player = getattr(player, "table", player)
    if isinstance(player, str):
        player = resolve(player, game)
    if isinstance(player, PairPolicy):
        return tabulated_pairs(dataclasses.replace(player, game=game))
    if not hasattr(player, "probabilities") and callable(getattr(player, "act", None)):
        player = FunctionPolicy(functools.partial(_acted, player.act, game))
    if callable(getattr(player, "probabilities", None)):
        called = player if isinstance(player, TabulatedPolicy | GamePolicy) else GamePolicy(player, game, name)
        return tabulate(called, game)
    raise SuiteError(f"the method of {name} returned a {type(player).__name__}; expected a policy, its name, or act or table")


def _acted(act: Callable[[Any, Any], Any], game: Game, states: States) -> F64:
    """``[B, n]`` probability 1 for the stroke that a player chooses for each observation."""
    p = np.zeros((len(states), game.n_strokes))
    for row, seen in enumerate(observations(game, states.state)):
        p[row, int(act(seen, states.mask[row]))] = 1.0
    return p


POINTS: Final = 100.0  # points of certainty
WEIGHT: Final = 0.75  # restriction of the opponent in the objective
STEPS: Final = (0.0, 0.25, 0.5, WEIGHT, 0.9, 1.0)  # restrictions of the points of a frontier
_DIGITS: Final = 5  # decimal places of a frontier, which are exact; + 0.0 makes 0.0 of -0.0


def exploitabilities(policies: Sequence[TabulatedPolicy], *, tolerance: float) -> list[float]:
    """Points above half of the rallies that the best response to each policy wins, at least 0."""
    return [POINTS * max(0.0, odds.rally - 0.5) for odds in best_odds(policies, tolerance=tolerance)]


def gains(
    arena: Arena,
    played: Sequence[tuple[TabulatedPolicy, TabulatedPolicy]],
    *,
    rallies: Sequence[int] | None = None,
    p: float = WEIGHT,
    tolerance: float,
) -> tuple[float, float]:
    """The gain of what was played, and the largest possible one, in points; 0 is perfect play.

    Args:
        arena: has perfect play.
        played: a policy and its opponent, one pair after the other.
        rallies: for how many rallies each pair played; None: equally many.
        p: restriction of the opponent.
        tolerance: largest acceptable error bound of a value.
    """
    opponents = [opponent for _, opponent in played]
    perfect = [arena.policy("minimax")] * len(played)
    worth, zero, most = (
        POINTS * float(np.average([odds.rally for odds in restricted_odds(pairs, p, tolerance=tolerance)], weights=rallies))
        for pairs in (played, [*zip(perfect, opponents, strict=True)], [(None, each) for each in opponents])
    )
    return worth - zero, most - zero


def frontier(arena: Arena, opponent: TabulatedPolicy, *, tolerance: float) -> list[dict[str, float]]:
    """The restricted response to an opponent for each of :data:`STEPS`, in points of rallies.

    Returns:
        ``p``; ``score``: rallies won against the opponent, above those that perfect play wins; ``exploitability``, see
        :func:`exploitabilities`; and ``gain``, see :func:`gains`.
    """
    players = [restricted_response(opponent, p, tolerance=tolerance).policy for p in STEPS]
    perfect, *won = (odds.rally for odds in pair_odds([(each, opponent) for each in (arena.policy("minimax"), *players)]))
    risks = exploitabilities(players, tolerance=tolerance)
    return [
        {
            "p": p,
            "score": round(POINTS * (rally - perfect), _DIGITS) + 0.0,
            "exploitability": round(risk, _DIGITS) + 0.0,
            "gain": round(gains(arena, [(player, opponent)], tolerance=tolerance)[0], _DIGITS) + 0.0,
        }
        for p, player, rally, risk in zip(STEPS, players, won, risks, strict=True)
    ]
