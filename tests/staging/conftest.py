"""Staged rallies for the tests of the staging: few, because each takes half a second."""

import pytest

from shuttle_marl.game import default_game
from shuttle_marl.policy.registry import resolve
from shuttle_marl.staging import Motion, PlayedRally, play_rallies, stage

HANDS = (("right", "right"), ("left", "right"), ("right", "left"), ("left", "left"))


@pytest.fixture(scope="session")
def played() -> list[PlayedRally]:
    game = default_game()
    policy = resolve("bc", game)
    return play_rallies(game, (policy, policy), 40, seed=11)


@pytest.fixture(scope="session")
def motions(played: list[PlayedRally]) -> list[Motion]:
    """Eight rallies: both hands, both athletes."""
    athletes = (("male", "female"), ("female", "male"))
    return [stage(rally, seed=i, handedness=HANDS[i % 4], athletes=athletes[i % 2]) for i, rally in enumerate(played[:8])]
