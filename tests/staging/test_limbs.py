"""Arms and legs beside chains of scipy's rotations."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from shuttle_marl.base.arrays import F64
from shuttle_marl.court.staging.feet import Feet
from shuttle_marl.court.staging.geometry import from_yaw_pitch_roll
from shuttle_marl.court.staging.limbs import (
    LIMITS,
    RELAXED,
    SWING_1,
    SWING_2,
    SWING_LIMIT,
    Arm,
    Goal,
    anywhere,
    arm_of,
    legs,
    settle,
    solve,
    solve_best,
    strays,
    sweet_spot,
    sweet_spot_jacobian,
)
from shuttle_marl.court.staging.skeleton import SWEET_SPOT, load_skeleton

RIGHTWARDS, FORWARD, UP = np.eye(3)


MALE = load_skeleton("male")


def about(axis: F64, angle: float) -> F64:
    return Rotation.from_rotvec(angle * axis).as_matrix()


def some_angles(n: int, seed: int = 3) -> F64:
    """Angles of arms well within the limits."""
    rng = np.random.default_rng(seed)
    return arm_of(MALE).clipped(LIMITS.mean(axis=1) + 0.4 * rng.uniform(-1, 1, (n, 10)) * np.ptp(LIMITS, axis=1))


def bones_of(arm: Arm, q: F64) -> tuple[list[F64], list[F64]]:
    """Rotations of collar bone, upper arm, forearm, hand and racket, and where they begin: joint by joint."""
    raised, forward, one, two, twist, elbow, pronation, bend, deviation, roll = q
    axes = arm.axes
    collar = about(axes[1], forward) @ about(axes[0], raised)
    swing = Rotation.from_rotvec(one * axes[2] + two * axes[3]).as_matrix()
    upper = collar @ swing @ about(axes[4], twist) @ arm.to_middle
    forearm = upper @ about(axes[5], elbow - arm.rest_bend) @ about(axes[6], pronation / 2)
    hand = forearm @ about(axes[6], pronation / 2) @ about(axes[7], bend) @ about(axes[8], deviation)
    turns = [collar, upper, forearm, hand, hand @ about(axes[9], roll)]
    places = [np.zeros(3)]
    for turn, offset in zip(turns, arm.offset, strict=False):
        places.append(places[-1] + turn @ offset)
    return turns, places


def test_an_arm_is_a_chain_of_hinges() -> None:
    """Half of the pronation is seen in the middle of the forearm."""
    arm, angles = arm_of(MALE), np.concatenate([some_angles(8), np.zeros((1, 10))])
    pose = arm.pose(angles)
    for n, q in enumerate(angles):
        turns, places = bones_of(arm, q)
        assert_allclose(pose.rotation[:, n], turns, atol=1e-12)
        assert_allclose(pose.position[:, n], places, atol=1e-12)
        assert_allclose(sweet_spot(arm, pose)[n], places[4] + SWEET_SPOT * turns[4] @ arm.axis, atol=1e-12)


def test_slopes_of_the_strings_are_those_of_small_changes() -> None:
    arm, angles, h = arm_of(MALE), some_angles(6), 1e-5
    found = sweet_spot_jacobian(arm, angles)
    for k in range(10):
        step = h * (np.arange(10) == k)
        ends = [sweet_spot(arm, arm.pose(angles + sign * step)) for sign in (1, -1)]
        assert_allclose(found[:, :, k], (ends[0] - ends[1]) / (2 * h), atol=1e-8)


def test_the_arm_comes_to_rest_where_no_small_change_is_better() -> None:
    """The best of several starts; weights of the point, in metres, are much larger than those of directions."""
    arm, rng = arm_of(MALE), np.random.default_rng(4)
    goal = Goal(
        point=rng.uniform(0.2, 0.6, (5, 3)),
        elbow=np.tile(RIGHTWARDS, (5, 1)),
        weight=np.tile((8.0, 0.5, 0.4, 0.3), (5, 1)),
        reach=np.full(5, SWEET_SPOT),
        shaft=np.tile(UP, (5, 1)),
        normal=np.tile(FORWARD, (5, 1)),
    )

    def cost(n: int, q: F64) -> float:
        turns, places = bones_of(arm, q)
        shaft, elbow = turns[4] @ arm.axis, places[2] - places[1]
        point = 8.0 * (places[4] + SWEET_SPOT * shaft - goal.point[n])
        away = 0.5 * (shaft - UP), 0.4 * (turns[4] @ arm.normal - FORWARD), 0.3 * (elbow / np.linalg.norm(elbow) - RIGHTWARDS)
        return float(sum(v @ v for v in (point, *away)) + 0.03**2 * ((q - RELAXED) ** 2).sum())

    found = solve(arm, goal, np.tile(RELAXED, (5, 1)), rounds=60)
    for n, q in enumerate(found):
        best = cost(n, q)
        near = np.clip(q + 0.01 * np.r_[np.eye(10), -np.eye(10)], *LIMITS.T)
        assert min(cost(n, other) for other in near) > best - 2e-5
        assert best < cost(n, RELAXED)
    starts = np.stack([found, some_angles(5), np.tile(RELAXED, (5, 1))])
    many = solve_best(arm, goal, starts, rounds=0)
    assert_allclose(many, found)


def some_feet(n: int, seed: int = 0) -> tuple[F64, F64, Feet]:
    """Hips, their rotation, and feet under them, some out of reach."""
    rng = np.random.default_rng(seed)
    hips = np.column_stack([rng.normal(0, 0.1, (n, 2)), rng.uniform(0.7, 0.95, n)])
    root = from_yaw_pitch_roll(rng.normal(0, 0.3, n), rng.normal(0.1, 0.1, n), rng.normal(0, 0.05, n))
    ball = np.zeros((2, n, 3))
    ball[..., :2] = np.array([[-0.15, 0.05], [0.15, 0.05]])[:, None] + rng.normal(0, 0.1, (2, n, 2))
    return hips, root, Feet(ball, rng.normal(0, 0.3, (2, n)), np.zeros((2, n)), np.ones((2, n), dtype=bool))


def test_feet_stand_where_they_are_placed_and_bones_keep_their_lengths() -> None:
    hips, root, feet = some_feet(40)
    hips, feet = settle(MALE, hips, root, feet)
    rotation, position = legs(MALE, hips, root, feet)
    assert np.median(strays(MALE, hips, root, feet)) < 1e-3
    for foot, (side, sign) in enumerate((("Left", -1), ("Right", 1))):
        bones = [f"{side}{bone}" for bone in ("UpLeg", "Leg", "Foot", "ToeBase")]
        start = hips + np.einsum("nij,j->ni", root, MALE.at(bones[0]) - MALE.at("Hips"))
        assert_allclose(position[foot, 0], start, atol=1e-12)
        for k in range(3):
            way = np.einsum("nij,j->ni", rotation[foot, k], MALE.at(bones[k + 1]) - MALE.at(bones[k]))
            assert_allclose(position[foot, k + 1], position[foot, k] + way, atol=1e-12)
        turned = np.swapaxes(rotation[foot], -1, -2) @ rotation[foot]
        assert_allclose(turned, np.broadcast_to(np.eye(3), turned.shape), atol=1e-9)
        # Knees point ahead, toes lie on the floor.
        knee = np.einsum("nji,nj->ni", root, position[foot, 1] - position[foot, 0])
        ankle = np.einsum("nji,nj->ni", root, position[foot, 2] - position[foot, 0])
        assert (knee[:, 1] > (knee[:, 2] / ankle[:, 2] * ankle[:, 1])).all()
        assert (position[foot, 3, :, 2] > MALE.at("RightToeBase")[2] - 2e-3).all()
        assert sign * np.median(knee[:, 0]) > 0


ANGLES = st.lists(st.floats(0.02, 0.98), min_size=10, max_size=10)


def angles_of(shares: list[float]) -> np.ndarray:
    low, high = LIMITS.T
    return arm_of(load_skeleton("male")).clipped((low + np.array(shares) * (high - low))[None])


def goal_at(angles: np.ndarray, weight: tuple[float, float, float, float]) -> Goal:
    """Reach of an arm with these angles, as a goal."""
    arm = arm_of(load_skeleton("male"))
    pose = arm.pose(angles)
    shaft, normal = pose.rotation[4] @ arm.axis, pose.rotation[4] @ arm.normal
    elbow = pose.position[2] - pose.position[1]
    return Goal(
        point=pose.position[4] + SWEET_SPOT * shaft,
        reach=np.full(len(angles), SWEET_SPOT),
        shaft=shaft,
        normal=normal,
        elbow=elbow / np.linalg.norm(elbow, axis=1, keepdims=True),
        weight=np.tile(weight, (len(angles), 1)),
    )


def test_what_can_be_reached_is_reached() -> None:
    rng = np.random.default_rng(5)
    arm = arm_of(load_skeleton("male"))
    angles = arm.clipped(rng.uniform(LIMITS[:, 0], LIMITS[:, 1], (300, 10)))
    goal = goal_at(angles, (60.0, 0.1, 0.05, 0.05))
    pose = arm.pose(solve_best(arm, goal, anywhere(300), rounds=40))
    miss = np.linalg.norm(pose.position[4] + SWEET_SPOT * pose.rotation[4] @ arm.axis - goal.point, axis=1)
    assert np.quantile(miss, 0.95) < 0.01
    assert np.median(miss) < 0.001


@settings(max_examples=40, deadline=None)
@given(ANGLES, st.tuples(*[st.floats(-1.5, 1.5)] * 3), st.tuples(*[st.floats(-1, 1)] * 3))
def test_no_goal_makes_the_arm_break_its_limits(shares: list[float], point: tuple[float, ...], shaft: tuple[float, ...]) -> None:
    arm = arm_of(load_skeleton("female"))
    direction = np.array([shaft]) + np.array([[0.0, 0.0, 1.5]])
    goal = Goal(
        point=np.array([point]),
        reach=np.array([SWEET_SPOT]),
        shaft=direction / np.linalg.norm(direction),
        normal=np.array([[0.0, 1.0, 0.0]]),
        elbow=np.array([[1.0, 0.0, 0.0]]),
        weight=np.array([[8.0, 0.5, 0.5, 0.3]]),
    )
    found = solve(arm, goal, angles_of(shares), rounds=15)
    assert np.isfinite(found).all()
    assert (found >= LIMITS[:, 0] - 1e-9).all()
    assert (found <= LIMITS[:, 1] + 1e-9).all()
    assert np.linalg.norm(found[0, SWING_1 : SWING_2 + 1]) <= SWING_LIMIT + 1e-9
