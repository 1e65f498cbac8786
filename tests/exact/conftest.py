"""The shipped game, solved once."""

import pytest
from value_iteration import ValueIteration

from shuttle_marl.exact import Solution, solve
from shuttle_marl.game.rally import Game
from shuttle_marl.game.shipped import default_game
from shuttle_marl.game.table import TabulatedPolicy
from shuttle_marl.policy.bc import load


@pytest.fixture(scope="session")
def shipped() -> Game:
    """The shipped game."""
    return default_game()


@pytest.fixture(scope="session")
def solution(shipped: Game) -> Solution:
    """The shipped game, solved."""
    return solve(shipped)


@pytest.fixture(scope="session")
def bc(shipped: Game) -> TabulatedPolicy:
    """The behaviour-cloned average player."""
    return load(None, shipped)


@pytest.fixture(scope="session")
def oracle(shipped: Game) -> ValueIteration:
    """An independent solver of the shipped game."""
    return ValueIteration(shipped)
