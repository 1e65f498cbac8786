"""Tournaments for tests that look at their rallies and results only."""

import dataclasses

from shuttle_marl.league import LeagueConfig, LeagueRun, run_league


def play_league(config: LeagueConfig) -> LeagueRun:
    """A tournament without exact figures and styles, which take seconds and have their own tests."""
    return run_league(dataclasses.replace(config, exact=False))
