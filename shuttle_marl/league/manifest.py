"""Everything one needs to know to get the same run again."""

from collections.abc import Sequence
from typing import Any, Final

from shuttle_marl import runs
from shuttle_marl.game.rally import Game
from shuttle_marl.league.config import LeagueConfig
from shuttle_marl.league.entrants import Entrant

_PACKAGES: Final = ("numpy", "scipy", "numba", "pyarrow", "mcap", "zstandard")
"""Packages whose versions can change a file of the run."""


def manifest(config: LeagueConfig, game: Game, entrants: Sequence[Entrant]) -> dict[str, Any]:
    """The manifest of a run that starts now."""
    return {
        "status": "running",
        "seed": config.seed,
        **runs.describe(_PACKAGES),
        "game": {"model": config.game, "hash": game.hash, "catalogue": game.catalogue.version},
        "policies": {entrant.name: entrant.hash for entrant in entrants},
    }
