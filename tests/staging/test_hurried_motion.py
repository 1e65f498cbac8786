"""Hurried strikers are staged as such, and within all limits."""

import dataclasses

import numpy as np
import pytest

from shuttle_marl.base.arrays import F64
from shuttle_marl.game.rally.record import Rally
from shuttle_marl.staging import Motion, stage

RALLIES = 16
NEAR = 0.15
"""Distance from the place of the contact within which a player has arrived [m]."""
HANDS = (("right", "right"), ("left", "right"))
ATHLETES = (("male", "female"), ("female", "male"))


def with_hurried(rally: Rally, hurried: bool) -> Rally:
    """The rally with all strikers hurried but the server, or none."""
    return dataclasses.replace(rally, hurried=(np.arange(len(rally)) > 0) & hurried)


def staged(rallies: list[Rally], hurried: bool) -> list[Motion]:
    return [
        stage(with_hurried(rally, hurried), seed=i, handedness=HANDS[i % 2], athletes=ATHLETES[i // 2 % 2])
        for i, rally in enumerate(rallies[:RALLIES])
    ]


@pytest.fixture(scope="module")
def calm(played: list[Rally]) -> list[Motion]:
    return staged(played, False)


@pytest.fixture(scope="module")
def hurried(played: list[Rally]) -> list[Motion]:
    return staged(played, True)


def seen(motions: list[Motion]) -> F64:
    """``[2, 4]`` means over all returns from below and from above.

    Time from the arrival to the contact [s], speed of the hips at the contact [m/s], height of the contact, and its distance
    from the hips over the floor [m].
    """
    found: tuple[list[list[float]], list[list[float]]] = ([], [])
    for motion in motions:
        rally = motion.trajectory.rally
        for i in range(1, len(rally)):
            hips = motion.position[:, rally.striker[i], 0, :2].astype(float)
            before, at = motion.contact_frame[i - 1], motion.contact_frame[i]
            away = np.linalg.norm(hips[before : at + 1] - hips[at], axis=1) > NEAR
            since = np.argmax(away[::-1]) if away.any() else len(away)
            speed = np.linalg.norm(hips[at + 1] - hips[at - 1]) * motion.fps / 2
            reach = np.linalg.norm(motion.shuttle[at, :2] - hips[at])
            found[rally.catalogue.height[rally.stroke[i]]].append(
                [since / motion.fps, float(speed), motion.shuttle[at, 2], float(reach)]
            )
    return np.array([np.mean(rows, axis=0) for rows in found])


def test_hurried_strikers_arrive_later_and_reach_further(calm: list[Motion], hurried: list[Motion]) -> None:
    early, speed, height, reach = np.moveaxis(seen(hurried) - seen(calm), -1, 0)
    assert (early < -0.03).all()
    assert (speed > 0.2).all()
    assert (height < -0.05).all()
    assert reach[0] > 0.03, "strokes from below; overhead strokes reach upwards"
