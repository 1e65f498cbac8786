"""The task ``robust-v0``: play that holds in refits of the game on resampled matches."""

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar

from shuttle_marl.exact import moved
from shuttle_marl.exact.known import best_odds, pair_odds
from shuttle_marl.game.shipped import drawn_game, refits_of
from shuttle_marl.game.tables import Game
from shuttle_marl.suite.exploit import outcome_of
from shuttle_marl.suite.method import Method, made
from shuttle_marl.suite.options import Split, SuiteError
from shuttle_marl.suite.population import rng_of
from shuttle_marl.suite.task import Arena, Case, Outcome, Setting, Task, required

_REFERENCE = "bc"
_SIGMA = 0.1
"""Spread of the hidden games, about that of the refits."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class RobustSetting(Setting):
    """Setting of ``robust``, the argument of a method.

    Attributes:
        refits: some refits of the game; it is scored in others.
    """

    refits: tuple[Game, ...]


class Robust(Task):
    """Play well in a game that is known with errors.

    Given: the game and half of its refits on resampled matches. Score: the fraction of rallies won against the best response in
    the other refits, on average and at worst; also the same against bc. The dev split uses the given half alone,
    and the hidden one has games drawn around the game.
    """

    name = "robust-v0"
    metric = "mean"
    splits: ClassVar[tuple[Split, ...]] = ("dev", "test", "hidden")
    seeds = 1
    protocol: ClassVar[str] = "method(setting: RobustSetting) -> a player: policy, name, or object with act or table"
    target = "above minimax of the average game"

    def all_cases(self, arena: Arena) -> list[Case]:  # noqa: ARG002
        """One."""
        return [Case(name="refits")]

    def play(self, arena: Arena, case: Case, method: Method, seed: int, folder: Path) -> Outcome:  # noqa: ARG002
        """Call the method."""
        setting = RobustSetting(game=arena.game, refits=refits(arena)[0], seed=seed, folder=folder)
        return outcome_of(made(method, setting, self.name), arena.game, self.name, None)

    def given(self, arena: Arena, case: Case, seed: int) -> Iterable[str]:  # noqa: ARG002
        """The refits."""
        return [game.hash for part in refits(arena) for game in part]

    def score(self, arena: Arena, case: Case, seed: int, outcome: Outcome) -> dict[str, float]:  # noqa: ARG002
        """Worst and mean results against the best response and against bc; exploitability in the game itself."""
        player, reference, games = required(outcome), arena.policy(_REFERENCE), refits(arena)[1]
        guaranteed = list(self.parts(arena, case, outcome).values())
        won = [odds.rally for odds in pair_odds([(moved(player, game), moved(reference, game)) for game in games])]
        return {
            "mean": sum(guaranteed) / len(games),
            "worst": min(guaranteed),
            "rally_win_worst": min(won),
            "rally_win_mean": sum(won) / len(games),
            "exploitability": best_odds([player])[0].value,
        }

    def parts(self, arena: Arena, case: Case, outcome: Outcome) -> dict[str, float]:  # noqa: ARG002
        """Result in each refit."""
        player, games = required(outcome), refits(arena)[1]
        odds = best_odds([moved(player, game) for game in games])
        return {game.hash[:12]: 1 - each.rally for game, each in zip(games, odds, strict=True)}


def refits(arena: Arena) -> tuple[tuple[Game, ...], tuple[Game, ...]]:
    """Refits in the setting of a method, and refits of the score.

    Raises:
        SuiteError: the game has fewer than two refits.
    """
    found = refits_of(arena.game)
    if len(found) < 2:
        raise SuiteError("robust-v0 needs a game with two refits or more on resampled matches")
    half = len(found) // 2
    if arena.split == "hidden":
        rng = rng_of(Robust.name, arena.split, arena.beacon, "refits")
        return found[:half], tuple(drawn_game(arena.game, rng, _SIGMA) for _ in range(half))
    return (found[: half // 2], found[half // 2 : half]) if arena.split == "dev" else (found[:half], found[half:])
