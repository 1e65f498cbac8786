"""Measures of life on cases built by hand: each sees what it is for."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from benchmarks.motion_life import Life, measure_life, summary_of_life
from benchmarks.motion_metrics import measure, summary
from shuttle_marl.game.stroke import NET_SHOTS, SHOTS
from shuttle_marl.staging import Motion
from shuttle_marl.staging.rotation import about, matrix, quaternion
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


def test_a_stiff_jump_shows_in_the_vertical_acceleration(motion: Motion) -> None:
    seat, frame = int(motion.trajectory.rally.striker[1]), int(motion.contact_frame[1])
    position = motion.position.copy()
    t = motion.time - motion.time[frame]
    position[:, seat, 0, 2] = 0.9 + 0.5 * 20 * np.clip(t, 0, 0.1) ** 2  # 20 m/s² upwards, then a dead stop
    life = measure_life(dataclasses.replace(motion, position=position))
    assert life.vertical_acceleration[1] > 60
    position[:, seat, 0, 2] = 0.9 + 0.5 * 20 * np.minimum(t, 0) ** 2
    life = measure_life(dataclasses.replace(motion, position=position))
    assert life.vertical_acceleration[1] == pytest.approx(20, rel=0.05)


@pytest.mark.parametrize("sink", [0.0, 0.02, 0.15])
def test_how_far_a_landing_sinks(motion: Motion, sink: float) -> None:
    seat, frame = int(motion.trajectory.rally.striker[2]), int(motion.contact_frame[2])
    position = motion.position.copy()
    t = motion.time - motion.time[frame]
    floor = motion.skeletons[seat].at("RightToeBase")[2]
    for foot in ("LeftToeBase", "RightToeBase"):
        position[:, seat, BONE[foot], 2] = floor + np.where(t < 0.11, 0.2, 0.0)
    position[:, seat, 0, 2] = 1.0 - sink * np.clip((t - 0.12) / 0.2, 0, 1)
    life = measure_life(dataclasses.replace(motion, position=position))
    assert life.airborne[2]
    assert life.landing_sink[2] == pytest.approx(sink, abs=1e-3)
    position[:, seat, BONE["LeftToeBase"], 2] = floor
    assert not measure_life(dataclasses.replace(motion, position=position)).airborne[2]


def test_players_like_statues_are_seen(motion: Motion) -> None:
    still = dataclasses.replace(motion, position=np.repeat(motion.position[:1], len(motion.time), axis=0))
    life = measure_life(still)
    assert life.still == life.waiting > 50
    swaying = still.position.copy()
    swaying[:, :, BONE["Head"], 0] += 0.01 * np.sin(12 * motion.time)[:, None]
    life = measure_life(dataclasses.replace(still, position=swaying))
    assert 0 < life.still < 0.3 * life.waiting


@pytest.mark.parametrize("length", [0.1, 0.6])
def test_tripping_is_told_from_steps(motion: Motion, length: float) -> None:
    """Both feet land in turn, every tenth frame, as the hips travel."""
    position, planted = motion.position.copy(), np.ones_like(motion.planted)
    frames = np.arange(len(motion.time))
    position[:, :, 0, 0], position[:, :, 0, 1] = (length / 10 * frames)[:, None], 0.0
    planted[frames % 20 < 4, :, 0] = False
    planted[(frames + 10) % 20 < 4, :, 1] = False
    life = measure_life(dataclasses.replace(motion, position=position, planted=planted))
    assert np.median(life.step_length) == pytest.approx(length, rel=1e-3)


def test_hands_that_whirl_are_counted(motion: Motion) -> None:
    rotation = motion.rotation.copy()
    side = "Right" if motion.handedness[0] == "right" else "Left"
    hand, fore = BONE[f"{side}Hand"], BONE[f"{side}ForeArm"]
    turn = about(np.array([1.0, 0.0, 0.0]), np.radians(2100) * motion.time)
    rotation[:, 0, hand] = quaternion(matrix(rotation[:, 0, fore]) @ turn)
    life = measure_life(dataclasses.replace(motion, rotation=rotation))
    assert life.fast_wrist >= len(motion.time) - 1
    assert life.player_frames == 2 * len(motion.time)


def test_net_shots_with_the_elbow_up_or_the_racket_down(motions: list[Motion]) -> None:
    kinds = [SHOTS.index(name) for name in NET_SHOTS]
    for motion in motions:
        rally = motion.trajectory.rally
        early = np.isin(rally.catalogue.shot[rally.stroke], kinds) & (motion.trajectory.contact[:, 2] > 1.2)
        if early.any():
            break
    i = int(np.flatnonzero(early)[0])
    seat, frame = int(rally.striker[i]), int(motion.contact_frame[i])
    side = "Right" if motion.handedness[seat] == "right" else "Left"
    position, rotation = motion.position.copy(), motion.rotation.copy()
    shoulder, elbow = BONE[f"{side}Arm"], BONE[f"{side}ForeArm"]
    for above in (-0.1, 0.1):
        position[frame, seat, elbow, 2] = position[frame, seat, shoulder, 2] + above
        life = measure_life(dataclasses.replace(motion, position=position))
        assert life.high_net_shot[i]
        assert life.high_elbow[i] == (above > 0)
    shaft = motion.racket(seat)[0]
    for up in (1.0, -1.0):
        # The shortest turn of the shaft onto the vertical.
        axis = np.cross(shaft, [0, 0, up])
        turn = about(axis / np.linalg.norm(axis), np.arctan2(np.linalg.norm(axis), shaft[2] * up))
        rotation[frame, seat, RACKET] = quaternion(turn)
        life = measure_life(dataclasses.replace(motion, rotation=rotation))
        assert life.hanging_racket[i] == (up < 0)


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
