"""A small game with everything that the shipped one has, solved once, and its average player."""

import pytest

from shuttle_marl.exact import Solution, solve
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.baselines import load
from tests.reduced import reduced_game


@pytest.fixture(scope="session")
def small() -> Game:
    """The game."""
    return reduced_game()


@pytest.fixture(scope="session")
def solution(small: Game) -> Solution:
    """The game, solved."""
    return solve(small)


@pytest.fixture(scope="session")
def bc(small: Game) -> TabulatedPolicy:
    """The behaviour-cloned average player."""
    return load(None, small)
