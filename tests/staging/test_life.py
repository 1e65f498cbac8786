"""Measures of life on cases built by hand: each sees what it is for."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from benchmarks.motion_life import Life, measure_life, summary_of_life
from benchmarks.motion_metrics import measure, summary
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.staging import Motion
from shuttle_marl.staging.rotation import about, matrix
from shuttle_marl.staging.skeleton import BONE, SWEET_SPOT

RACKET = BONE["Racket"]


@pytest.fixture(scope="module")
def motion(motions: list[Motion]) -> Motion:
    """A rally with some strokes."""
    return next(motion for motion in motions if len(motion.contact_frame) > 5)


def moved(motion: Motion, strings: Callable[[np.ndarray], np.ndarray], stroke: int) -> Life:
    """Measures with the strings of a stroke where a function of the seconds since the contact puts them."""
    seat, frame = int(motion.trajectory.rally.striker[stroke]), int(motion.contact_frame[stroke])
    rotation, position = motion.rotation.copy(), motion.position.copy()
    rotation[:, seat, RACKET] = rotation[frame, seat, RACKET]
    shaft = matrix(rotation[frame, seat, RACKET]) @ motion.racket(seat)[0]
    position[:, seat, RACKET] = strings(motion.time - motion.time[frame]) - SWEET_SPOT * shaft
    return measure_life(dataclasses.replace(motion, rotation=rotation, position=position))


def leaving(motion: Motion, stroke: int) -> np.ndarray:
    """Velocity of the shuttle off the racket."""
    return motion.trajectory.flight.at(stroke, np.array([0.0]))[1][0]


@pytest.mark.parametrize(("share", "turn"), [(0.6, 0.0), (0.1, 0.0), (0.5, 90.0), (0.5, 180.0)])
def test_ratio_and_direction_of_an_impact(motion: Motion, share: float, turn: float) -> None:
    way = share * about(np.array([0.0, 0.0, 1.0]), np.radians(turn)) @ (leaving(motion, 2) * [1, 1, 0])
    life = moved(motion, lambda t: t[:, None] * way, 2)
    flat = np.hypot(*leaving(motion, 2)[:2]) / np.linalg.norm(leaving(motion, 2))
    assert life.impact_ratio[2] == pytest.approx(share * flat, rel=1e-3)
    assert life.impact_cosine[2] == pytest.approx(np.cos(np.radians(turn)) * flat, abs=1e-3)


@pytest.mark.parametrize("late", [-0.06, -0.013, 0.0, 0.04])
def test_a_racket_that_is_fastest_too_early_or_too_late(motion: Motion, late: float) -> None:
    """The integral of a bell around the instant; with frames of 20 ms it is found within a few."""

    def strings(t: np.ndarray) -> np.ndarray:
        return np.outer(np.arctan((t - late) / 0.05), [0.0, 1.0, 0.0])

    assert moved(motion, strings, 3).impact_peak[3] == pytest.approx(late, abs=0.004)


def test_the_summary_takes_medians_by_shot_type_and_shares(motions: list[Motion]) -> None:
    found = [measure(motion) for motion in motions]
    figures = summary(found)
    lives = [metrics.life for metrics in found]
    shot = np.concatenate([life.shot for life in lives])
    ratio = np.concatenate([life.impact_ratio for life in lives])
    for name, value in figures["impact_ratio"].items():
        assert value == pytest.approx(np.median(ratio[shot == SHOTS.index(name)]))
    assert figures["still_share"] == pytest.approx(sum(life.still for life in lives) / sum(life.waiting for life in lives))
    assert figures["wrist_speed"] == sum(life.fast_wrist for life in lives) / sum(life.player_frames for life in lives)
    assert summary_of_life(lives).items() <= figures.items()
