"""Strokes to analyse: of a tournament between policies, as a log and as a stroke table with values."""

from pathlib import Path

import pyarrow as pa
import pytest

from shuttle_marl.analysis import add_values, strokes_of
from shuttle_marl.game import default_game
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.policy.registry import resolve


@pytest.fixture(scope="session")
def bc() -> TabulatedPolicy:
    game = default_game()
    return tabulate(resolve("bc", game), game)


@pytest.fixture(scope="session")
def tournament(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rally log of bc, attacking and random; read-only."""
    from shuttle_marl.league import LeagueConfig
    from tests.tournaments import play_league

    config = LeagueConfig(pool=("bc", "attacking", "random"), matches=6, out=tmp_path_factory.mktemp("played") / "run")
    return play_league(config).folder / "rallies.mcap"


@pytest.fixture(scope="session")
def valued(tournament: Path, bc: TabulatedPolicy) -> pa.Table:
    return add_values(strokes_of(tournament, rallies=10**9), bc)
