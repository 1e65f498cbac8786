"""Tournaments between policies: schedule, results, ratings with intervals, and the run folder.

Names are imported when first used: the statistics take longer to import than a command's help.
"""

from typing import TYPE_CHECKING

from shuttle_marl.base.extras import lazily

if TYPE_CHECKING:
    from shuttle_marl.league.entrants import LeagueConfig, LeagueError, default_pool
    from shuttle_marl.league.run import LeagueRun, run_league

__all__ = ["LeagueConfig", "LeagueError", "LeagueRun", "default_pool", "run_league"]

__getattr__, __dir__ = lazily(__name__)
