"""Training of a league: main agents and exploiters that learn from each other, from the past and from exact best responses.

See ``docs/league_training.md``. The modules: settings (:mod:`~shuttle_marl.training.league.config`), opponents
(:mod:`~shuttle_marl.training.league.matchmaking`), the policies so far and what they win against each other
(:mod:`~shuttle_marl.training.league.population`), policies made from others (:mod:`~shuttle_marl.training.league.mixtures`), the
turns of a round (:mod:`~shuttle_marl.training.league.schedule`), a turn of one learner
(:mod:`~shuttle_marl.training.league.turns`), and the run (:mod:`~shuttle_marl.training.league.run`).

Names are imported when first used, because PyTorch takes longer to import than a command's help.
"""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from shuttle_marl.training.league.config import LeagueTrainingConfig, LeagueTrainingError
    from shuttle_marl.training.league.run import LeagueTraining, train_league

__all__ = ["LeagueTraining", "LeagueTrainingConfig", "LeagueTrainingError", "train_league"]

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={"config": ("LeagueTrainingConfig", "LeagueTrainingError"), "run": ("LeagueTraining", "train_league")},
)
