"""Staged rallies for the tests of the staging: few, because each takes half a second."""

import dataclasses

import pytest

from shuttle_marl.court.staging import Motion, stage
from shuttle_marl.game.rally import Rally
from tests.staging.played import self_play_rallies

HANDS = (("right", "right"), ("left", "right"), ("right", "left"), ("left", "left"))


@pytest.fixture(scope="session")
def played() -> list[Rally]:
    return self_play_rallies("bc", 40, seed=11)


@pytest.fixture(scope="session")
def motions(played: list[Rally]) -> list[Motion]:
    """Eight rallies: both hands, both athletes."""
    athletes = (("male", "female"), ("female", "male"))
    handed = [dataclasses.replace(rally, hands=HANDS[i % 4]) for i, rally in enumerate(played[:8])]
    return [stage(rally, seed=i, athletes=athletes[i % 2]) for i, rally in enumerate(handed)]
