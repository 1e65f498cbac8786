"""Training of a league: main agents and exploiters learn from each other, earlier policies and exact best responses.

See ``docs/league_training.md``. Modules: settings (``config``), state and payoffs (``population``), the turns of a round
(``schedule``), a turn of one learner (``turns``), and the run (``run``). Names are imported lazily: PyTorch is slow to import.
"""

from typing import TYPE_CHECKING

from shuttle_marl.base.extras import lazily

if TYPE_CHECKING:
    from shuttle_marl.training.league.config import LeagueTrainingConfig, LeagueTrainingError
    from shuttle_marl.training.league.run import LeagueTraining, train_league

__all__ = ["LeagueTraining", "LeagueTrainingConfig", "LeagueTrainingError", "train_league"]

__getattr__, __dir__ = lazily(__name__)
