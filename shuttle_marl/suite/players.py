"""The tasks ``exploit-v0`` and ``equilibrium-v0``: players that are trained, and scored by exact values."""

import dataclasses
import operator
from collections.abc import Iterable
from pathlib import Path
from typing import Any, ClassVar

from shuttle_marl.exact.match import normalised_score
from shuttle_marl.game.tables import Game
from shuttle_marl.suite.method import Method, made
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.task import (
    QUICK_STROKES,
    Arena,
    Case,
    Outcome,
    Task,
    best_against,
    exploitability,
    odds_against,
    required,
    table_of,
)

_REFERENCE = "bc"


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlayerSetting:
    """Setting of ``exploit`` and ``equilibrium``, the argument of a method.

    Attributes:
        game: the tables; environments take it as ``game``.
        model: name or folder of its model.
        opponent: name of the opponent to train against; None: there is none, both sides may be played.
        budget: strokes of the learner.
        seed: random seed.
        folder: folder for files of the method; it may hold those of an interrupted call.
    """

    game: Game
    model: str
    opponent: str | None
    budget: int
    seed: int
    folder: Path


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Trained:
    """A trained player with the strokes that it used, for methods that return more than a player.

    Attributes:
        player: see :func:`shuttle_marl.suite.task.table_of`.
        strokes: strokes of the learner.
        curve: score after so many strokes, as pairs.
    """

    player: Any
    strokes: int | None = None
    curve: tuple[tuple[int, float], ...] = ()


def outcome_of(result: Any, game: Game, name: str, budget: int | None) -> Outcome:
    """The outcome of a method that returned a player.

    Raises:
        SuiteError: it used more than its budget, or did not return a player.
        PolicyError: see :func:`shuttle_marl.suite.task.table_of`.
    """
    trained = result if isinstance(result, Trained) else Trained(player=result)
    try:
        strokes = None if trained.strokes is None else operator.index(trained.strokes)
        curve = tuple((int(used), float(score)) for used, score in trained.curve)
    except (TypeError, ValueError) as error:
        raise SuiteError(
            f"the method of {name} returned strokes {trained.strokes!r}; expected a whole number ({error})"
        ) from error
    used = [0 if strokes is None else strokes, *(used for used, _ in curve)]
    if min(used) < 0 or (budget is not None and max(used) > budget):
        limit = "" if budget is None else f"; the budget is {budget:,}"
        raise SuiteError(f"the method of {name} used {max(used, key=abs):,} strokes of the learner{limit}")
    return Outcome(policies={"player": table_of(trained.player, game, name)}, strokes=strokes, curve=curve)


class _PlayerTask(Task):
    protocol: ClassVar[str] = "method(setting: PlayerSetting) -> a player: policy, name, or object with act or table"

    def play(self, arena: Arena, case: Case, method: Method, seed: int, folder: Path) -> Outcome:
        setting = PlayerSetting(
            game=arena.game,
            model=arena.model,
            opponent=case.options.get("opponent"),
            budget=case.budget,
            seed=seed,
            folder=folder,
        )
        return outcome_of(made(method, setting, self.name), arena.game, self.name, setting.budget)

    def given(self, arena: Arena, case: Case, seed: int) -> Iterable[str]:  # noqa: ARG002
        opponent = case.options.get("opponent")
        return () if opponent is None else (arena.policy(opponent).hash,)


class Exploit(_PlayerTask):
    """Beat a fixed opponent that may be played during training.

    Given: the game and one opponent, an imitated player or a scripted style. Budget: 10^5, 10^6 or 10^7 strokes of the learner.
    Score: fraction of rallies won, scaled so that 0 is the imitated average player (bc) and 1 the best response.
    """

    name = "exploit-v0"
    access = "opponent"
    budgets = (10**5, 10**6, 10**7)
    optimum = 1.0
    target = "1.0 at 10^5 strokes at an exploitability below .05; a constant list of strokes reaches about 0.9 against bc"

    def all_cases(self, arena: Arena) -> list[Case]:
        """Each opponent with each budget."""
        if arena.split == "dev":
            opponents = ["safe", *(f"bc:{player}" for player in arena.players[:1])]
        else:
            opponents = ["bc", "attacking", "defensive", *(f"bc:{player}" for player in arena.players[:2])]
        budgets = (QUICK_STROKES,) if arena.quick else self.budgets
        return [
            Case(name=f"{opponent}/{budget:,}", budget=budget, options={"opponent": opponent})
            for opponent in opponents[: 1 if arena.quick else None]
            for budget in budgets
        ]

    def score(self, arena: Arena, case: Case, seed: int, outcome: Outcome) -> dict[str, float]:  # noqa: ARG002
        """Normalised score, fraction of rallies won, and exploitability."""
        player, opponent = required(outcome), arena.policy(case.options["opponent"])
        odds, reference, best = (
            odds_against(player, opponent),
            odds_against(arena.policy(_REFERENCE), opponent),
            best_against(opponent),
        )
        score = normalised_score(odds.rally, reference.rally, best.rally, error_bound=best.error_bound + reference.error_bound)
        if score is None:
            raise SuiteError(f"{case.name}: {_REFERENCE} is a best response to this opponent, so there is nothing to score")
        return {"score": score, "rally_win": odds.rally, "exploitability": exploitability(player)}


class Equilibrium(_PlayerTask):
    """Learn to play without weaknesses.

    Given: the game, both sides. Budget: 10^6, 10^7 or 10^8 strokes. Score: exploitability, the gain of the best response to the
    player, from 0 (perfect play) to 1. The dev split is the game of one discipline.
    """

    name = "equilibrium-v0"
    budgets = (10**6, 10**7, 10**8)
    metric = "exploitability"
    higher_is_better = False
    optimum = 0.0
    variants: ClassVar = {"dev": "women"}
    target = "below 0.001 at 10^7 strokes"

    def all_cases(self, arena: Arena) -> list[Case]:
        """Each budget."""
        budgets = (QUICK_STROKES,) if arena.quick else self.budgets
        return [Case(name=f"{budget:,}", budget=budget) for budget in budgets]

    def score(self, arena: Arena, case: Case, seed: int, outcome: Outcome) -> dict[str, float]:  # noqa: ARG002
        """Exploitability, and fraction of rallies won against bc."""
        player = required(outcome)
        return {"exploitability": exploitability(player), "rally_win": odds_against(player, arena.policy(_REFERENCE)).rally}
