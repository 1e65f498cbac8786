"""Rallies whose outcomes come from the fitted modules, stroke by stroke, and not from tables compiled from them.

It is slower by two orders of magnitude and the same game: a test compares its numbers with the tables.
"""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from shuttle_marl.base.arrays import U8, U16
from shuttle_marl.base.errors import OptionError
from shuttle_marl.base.pytorch import own_settings
from shuttle_marl.dynamics.compiled import Support, pair_probabilities, rounded
from shuttle_marl.dynamics.fit import THREADS
from shuttle_marl.dynamics.fitted import FittedModels
from shuttle_marl.dynamics.make import load_support
from shuttle_marl.game.rally.stepper import Stepper
from shuttle_marl.game.shipped import origin_of
from shuttle_marl.game.tables import Game
from shuttle_marl.game.thresholds import with_fault_odds


class ModelStepper(Stepper):
    """Plays the layout of a game with the probabilities of its models; :func:`model_stepper` shares one per model.

    Args:
        support: support in the data of the models.
    """

    def __init__(self, game: Game, models: FittedModels, support: Support) -> None:
        super().__init__(game)
        self._models, self._support = models, support
        self._row = functools.lru_cache(maxsize=4096)(self._evaluated)
        self._limits = 2 * [[_Rows(3, functools.partial(self._limits_at, odds)) for odds in game.fault_odds.tolist()]]
        self._hurry = 2 * [_Rows(2, lambda row: self._row(row)[1])]

    def __reduce__(self) -> tuple[Any, ...]:
        return model_stepper, (self.game,)

    def _limits_at(self, odds: int, row: int) -> U16:
        return with_fault_odds(self._row(row)[0], odds)

    def _evaluated(self, row: int) -> tuple[U16, U8]:
        """Thresholds ``[3]`` at effort 0 and chances of a hurried receiver ``[2]`` of a base pair."""
        state = int(self.game.base_pair_state[row])
        late = self.is_hurried(state)
        calm = row - (int(self.game.base_pair_start[state] - self.game.base_pair_start[state - 2]) if late else 0)
        with own_settings(THREADS):
            limits, hurry = rounded(pair_probabilities(self._models, self.game, self._support, np.array([calm])))
        return limits[int(late)], hurry[int(late)]


class _Rows:
    """A table that computes its rows when they are read; indexed as if it were flat."""

    def __init__(self, width: int, row: Callable[[int], U16 | U8]) -> None:
        self._width, self._row = width, row

    def __getitem__(self, entry: int) -> int:
        row, column = divmod(entry, self._width)
        return int(self._row(row)[column])


@functools.lru_cache(maxsize=2)
def model_stepper(game: Game) -> ModelStepper:
    """The stepper of the models that a game was compiled from.

    Raises:
        OptionError: a game without models: of other tables, a variant of a model, of a pair, or with recovery.
        ModelError: the models cannot be read.
    """
    origin = origin_of(game)
    if origin is None or origin.variant is not None or game.recovery is not None or game.people is not None:
        raise OptionError(
            "outcomes='models': only the game of a model has some, such as default; variants of it, pairs, and the "
            "game with recovery are tables made from these"
        )
    return ModelStepper(game, FittedModels.load(origin.folder), load_support(origin.folder))
