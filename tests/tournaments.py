"""Tournaments for tests that look at their rallies and results only."""

import dataclasses
from collections.abc import Sequence

import pytest

from shuttle_marl.game.rally import Game
from shuttle_marl.league import LeagueConfig, LeagueRun, run_league
from shuttle_marl.league import run as module
from shuttle_marl.league.entrants import Entrant
from shuttle_marl.league.ranking import ExactOdds, exact_odds


def play_league(config: LeagueConfig) -> LeagueRun:
    """A tournament as the league plays it, but for exact figures and styles, which take seconds and have their own tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "exact_odds", _unsolved)
        patch.setattr(module, "styles", lambda game, tables: {})
        return run_league(config)


def _unsolved(game: Game, entrants: Sequence[Entrant], _: Sequence[Game]) -> ExactOdds:
    return exact_odds(game, [dataclasses.replace(entrant, table=None) for entrant in entrants])
