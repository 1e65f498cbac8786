"""Tournaments between policies: schedule, results, ratings with intervals, and the run folder."""

from shuttle_marl.league.entrants import LeagueConfig, LeagueError, default_pool
from shuttle_marl.league.ratings import bradley_terry
from shuttle_marl.league.run import LeagueRun, run_league

__all__ = ["LeagueConfig", "LeagueError", "LeagueRun", "bradley_terry", "default_pool", "run_league"]
