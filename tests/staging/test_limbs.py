"""Arms and legs, bone by bone, and the steps of their solvers, beside numpy and scipy."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from shuttle_marl.base.arrays import F64
from shuttle_marl.staging import ATHLETES, SWEET_SPOT, load_skeleton
from shuttle_marl.staging import arm as arms
from shuttle_marl.staging import legs as limbs
from shuttle_marl.staging.arm import (
    ANGLES,
    LIMITS,
    RELAXED,
    Arm,
    Goal,
    arm_of,
    solve,
    solve_best,
    sweet_spot,
    sweet_spot_jacobian,
)
from shuttle_marl.staging.feet import Feet
from shuttle_marl.staging.rotation import from_yaw_pitch_roll

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


@pytest.mark.parametrize("name", ATHLETES)
def test_the_axes_of_an_arm(name: str) -> None:
    skeleton = load_skeleton(name)
    arm = arm_of(skeleton)
    axes = dict(zip(ANGLES, arm.axes, strict=True))
    upper, lower = (v / np.linalg.norm(v) for v in arm.offset[1:3])
    middle = np.array([0.80, 0.58, 0.12]) / np.linalg.norm([0.80, 0.58, 0.12])
    assert_allclose(np.linalg.norm(arm.axes, axis=1), 1, atol=1e-12)
    # The collar bone goes up and forward; the swing is across the arm, which is twisted about its length.
    assert about(axes["collar bone up"], 0.1)[2, 0] > 0.09
    assert about(axes["collar bone forward"], 0.1)[1, 0] > 0.09
    swings = np.array([axes["shoulder swing 1"], axes["shoulder swing 2"], middle])
    assert_allclose(swings @ swings.T, np.eye(3), atol=1e-12)
    assert abs(axes["shoulder swing 1"][2]) > 0.99, "the first swing is about a nearly vertical line"
    assert_allclose(axes["shoulder twist"], middle, atol=1e-12)
    assert_allclose(arm.to_middle @ upper, middle, atol=1e-12)
    # The elbow bends the forearm from straight upwards and inwards; wrist and forearm are at right angles.
    assert_allclose(axes["elbow bend"] @ np.array([upper, lower]).T, 0, atol=1e-12)
    assert np.cos(arm.rest_bend) == pytest.approx(upper @ lower)
    bent = arm.to_middle @ about(axes["elbow bend"], np.pi / 2 - arm.rest_bend) @ lower
    assert bent[2] > 0.5
    assert bent[0] < 0
    assert_allclose(axes["forearm pronation"], -lower, atol=1e-12)
    wrist = np.array([lower, axes["wrist deviation"], axes["wrist bend"]])
    assert_allclose(wrist @ wrist.T, np.eye(3), atol=1e-12)
    assert_allclose(np.cross(lower, axes["wrist deviation"]), axes["wrist bend"], atol=1e-12)
    assert axes["wrist deviation"] @ skeleton.grip_normal > 0
    assert_allclose(axes["grip roll"], skeleton.grip_axis)
    assert_allclose(arm.offset.sum(axis=0), skeleton.at("Racket") - skeleton.at("RightShoulder"), atol=1e-12)


def test_arms_stay_within_the_range_of_their_joints() -> None:
    """The limits in degrees; the swing of the shoulder is limited as a whole, whatever its direction."""
    limits = [(-10, 35), (-25, 30), None, None, (-95, 95), (0, 150), (-85, 85), (-70, 75), (-25, 40), (-80, 80)]
    arm = arm_of(MALE)
    for side, sign in ((0, -1.0), (1, 1.0)):
        beyond = np.full(10, sign * 9.0)
        found = np.degrees(arm.clipped(beyond[None]))[0]
        for k, limit in enumerate(limits):
            assert found[k] == pytest.approx(limit[side] if limit else sign * 125 / np.sqrt(2))
        again = beyond.copy()
        arms._clip(again)
        assert_allclose(np.degrees(again), found)
    inside = np.radians([1, 1, 100, -70, 1, 1, 1, 1, 1, 1])  # 122 degrees
    for q in (inside, np.zeros(10)):
        assert_allclose(arm.clipped(q[None])[0], q)
        again = q.copy()
        arms._clip(again)
        assert_allclose(again, q)


def test_the_shoulder_is_limited_in_each_frame() -> None:
    """Arms in several dimensions are those of each row."""
    arm, many = arm_of(MALE), np.random.default_rng(8).normal(0, 2, (2, 3, 10))
    assert_allclose(arm.clipped(many), [[arm.clipped(q[None])[0] for q in part] for part in many])


def test_the_solver_starts_from_poses_all_over_the_range_of_the_arm() -> None:
    """In degrees: hanging, out to all sides with a bent elbow, overhead, and across the body, with both grips."""
    found = np.degrees(arms.anywhere(2))
    expected = [
        (5, 5, 0, 0, 0, 60, 0, 0, 10, 0),
        (10, 10, -40, 60, 40, 60, 0, 0, 10, 0),
        (10, 10, 40, -40, -40, 80, 40, 0, 10, 0),
        (15, 5, 0, 70, -60, 90, -40, 0, 20, 0),
        (5, 10, 60, 0, 60, 100, 60, 0, 10, 40),
        (5, 10, -60, -30, 0, 40, -30, 0, 10, -40),
    ]
    assert_allclose(found[:, 0], expected)
    assert_allclose(found[:, 1], expected)
    assert (arm_of(MALE).clipped(np.radians(found)) == np.radians(found)).all()


def test_linear_equations_are_solved() -> None:
    rng = np.random.default_rng(0)
    square = rng.normal(size=(10, 10))
    square = square @ square.T + np.eye(10)
    right = rng.normal(size=10)
    assert_allclose(arms._cholesky_solve(square, right), np.linalg.solve(square, right), rtol=1e-9)


def test_equations_of_the_least_squares() -> None:
    """Residuals of point, shaft, normal and elbow with their weights; 0.03 is the weight of staying near the relaxed arm."""
    rng, arm, q = np.random.default_rng(1), arm_of(MALE), some_angles(1)[0]
    target, weights, reach = rng.normal(size=(4, 3)), np.array([8.0, 0.5, 0.4, 0.3]), 0.3

    def residual(angles: F64) -> F64:
        turns, places = bones_of(arm, angles)
        shaft, elbow = turns[4] @ arm.axis, places[2] - places[1]
        reached = [places[4] + reach * shaft, shaft, turns[4] @ arm.normal, elbow / np.linalg.norm(elbow)]
        return np.ravel(weights[:, None] * (target - reached))

    axes, pivots, jacobian, found = np.empty((10, 3)), np.empty((10, 3)), np.empty((12, 10)), np.empty(12)
    racket = arms._pose(q, arm, axes, pivots)[4]
    arms._residuals(arm, (target, weights, reach), racket, axes, pivots, jacobian, found)
    assert_allclose(found, residual(q), atol=1e-12)
    slope = np.stack([(residual(q - h) - residual(q + h)) / 2e-5 for h in 1e-5 * np.eye(10)], axis=1)
    assert_allclose(jacobian, slope, atol=1e-8)

    square, right = np.empty((10, 10)), np.empty(10)
    cost = arms._normal_equations(q, jacobian, found, square, right)
    assert cost == pytest.approx(found @ found + 0.03**2 * ((RELAXED - q) ** 2).sum())
    assert_allclose(square, jacobian.T @ jacobian + 0.03**2 * np.eye(10), atol=1e-12)
    assert_allclose(right, jacobian.T @ found + 0.03**2 * (RELAXED - q), atol=1e-12)
    assert_allclose(np.degrees(RELAXED), [5, 5, 0, 0, 0, 50, 0, -10, 5, 0])


def test_a_step_of_the_arm_ends_at_its_limits() -> None:
    """An angle at its limit that is pushed further stays, and the others move as if it was fixed; half a radian at most."""
    rng = np.random.default_rng(2)
    middle, damping = LIMITS.mean(axis=1) * (np.arange(10) > 4), 0.1
    square = rng.normal(size=(10, 10))
    square = square @ square.T + 5 * np.eye(10)
    for low, high in ((), ()), ((0,), (5, 7)), ((6, 9), (1,)):
        q, wanted = middle.copy(), rng.uniform(-0.2, 0.2, 10)
        q[list(low)], q[list(high)] = LIMITS[list(low), 0], LIMITS[list(high), 1]
        wanted[list(low)], wanted[list(high)] = -0.3, 0.3
        slope = (square + damping * np.eye(10)) @ wanted
        free = np.setdiff1d(np.arange(10), [*low, *high])
        expected = q.copy()
        expected[free] += np.linalg.solve((square + damping * np.eye(10))[np.ix_(free, free)], slope[free])
        assert np.abs(expected - q).max() < 0.5
        assert_allclose(arms._step(q, square, slope, damping), np.clip(expected, *LIMITS.T), atol=1e-12)
    # Away from its limit an angle moves freely.
    q, wanted = middle.copy(), np.zeros(10)
    q[[0, 5]], wanted[[0, 5]] = (LIMITS[0, 0], LIMITS[5, 1]), (0.2, -0.2)
    assert_allclose(arms._step(q, np.eye(10), (1 + damping) * wanted, damping), q + wanted, atol=1e-12)
    far = 2.0 * np.where(np.arange(10) == 4, 1, 0) - 2.0 * np.where(np.arange(10) == 6, 1, 0)
    assert_allclose(arms._step(middle, np.eye(10), far, 0.0)[[4, 6]], middle[[4, 6]] + [0.5, -0.5])


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
    hips, feet = limbs.settle(MALE, hips, root, feet)
    rotation, position = limbs.legs(MALE, hips, root, feet)
    assert np.median(limbs.strays(MALE, hips, root, feet)) < 1e-3
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


def test_an_ankle_of_a_raised_heel() -> None:
    """The foot turns about the joint of the toes, which stays at its height over the ball of the foot."""
    ball, heel = np.array([[1.0, 2.0, 0.5]]), np.array([0.0, -0.1, 0.06])
    for yaw, pitch, away in (
        (0.0, 0.0, (0.0, -0.1, 0.06)),
        (np.pi / 2, 0.0, (0.1, 0.0, 0.06)),
        (0.0, np.pi / 2, (0.0, 0.06, 0.1)),
    ):
        found = limbs._ankles(ball, np.array([yaw]), np.array([pitch]), heel, 0.02)
        assert_allclose(found, ball + away + [0, 0, 0.02], atol=1e-12)


def test_a_heel_rises_as_little_as_the_leg_needs() -> None:
    """In eighths of 62 degrees, up to that."""
    heel, ball, yaw, above = np.array([0.0, -0.14, 0.07]), np.zeros((25, 3)), np.full(25, 0.4), 0.02
    joint = np.column_stack([np.zeros(25), np.full(25, 0.2), np.linspace(0.8, 1.05, 25)])
    pitches = np.radians(62) * np.arange(9) / 8
    way = [limbs._ankles(ball, yaw, np.full(25, pitch), heel, above) - joint for pitch in pitches]
    near = np.linalg.norm(way, axis=2) <= 0.85
    expected = np.where(near.any(axis=0), pitches[near.argmax(axis=0)], pitches[-1])
    found = limbs._raised(joint, ball, yaw, heel, above, 0.85)
    assert_allclose(found, expected)
    assert len(set(found.round(6))) > 5


def test_the_shortest_rotation_between_two_directions() -> None:
    rng = np.random.default_rng(0)
    for _ in range(5):
        a, b = (tuple(v / np.linalg.norm(v)) for v in rng.normal(size=(2, 3)))
        turn = np.array(limbs._shortest_rotation(a, b))
        assert_allclose(turn @ a, b, atol=1e-12)
        assert np.linalg.norm(Rotation.from_matrix(turn).as_rotvec()) == pytest.approx(np.arccos(np.dot(a, b)))
    assert_allclose(limbs._shortest_rotation(a, a), np.eye(3), atol=1e-12)


def rows(matrix: F64) -> Any:
    return tuple(tuple(row) for row in matrix.tolist())


@pytest.mark.parametrize("side", ["Left", "Right"])
@pytest.mark.parametrize(
    ("forward", "outward", "twist", "limited"),
    [
        (40, 20, 30, (40, 20, 30)),
        (-40, -20, -30, (-40, -20, -30)),
        (150, 20, 0, (130, 20, 0)),
        (-60, 10, 0, (-45, 10, 0)),
        (30, 80, 0, (30, 65, 0)),
        (30, -60, 0, (30, -45, 0)),
        (30, 0, 80, (30, 0, 65)),
        (30, 0, -80, (30, 0, -65)),
    ],
)
def test_a_thigh_stays_in_the_hip_joint(
    side: str, forward: float, outward: float, twist: float, limited: tuple[float, float, float]
) -> None:
    """Angles in degrees: thigh forward, outward, turned outward."""
    leg = limbs._leg_of(MALE, side)
    thigh = leg.rest[0] / np.linalg.norm(leg.rest[0])
    root = about(np.array([0.6, 0.0, 0.8]), 0.7)

    def thigh_at(forward: float, outward: float, twist: float) -> F64:
        f, o, t = np.radians([forward, leg.sign * outward, leg.sign * twist])
        way = np.array([np.sin(o), np.cos(o) * np.sin(f), -np.cos(o) * np.cos(f)])
        axis = np.cross(thigh, way)
        swing = about(axis / np.linalg.norm(axis), np.arccos(thigh @ way))
        # Outwards is clockwise seen from above for the right leg, and the thigh points down.
        return root @ about(way, -t) @ swing

    found = limbs._limited_thigh(root, rows(thigh_at(forward, outward, twist)), tuple(thigh), leg)
    assert_allclose(found, thigh_at(*limited), atol=1e-6)


@pytest.mark.parametrize("side", ["Left", "Right"])
@pytest.mark.parametrize(
    ("up", "tilt", "outward", "limited"),
    [
        (30, 20, 30, (30, 20, 30)),
        (-30, -20, -30, (-30, -20, -30)),
        (60, 0, 0, (38, 0, 0)),
        (-80, 0, 0, (-55, 0, 0)),
        (0, 60, 0, (0, 45, 0)),
        (0, -60, 0, (0, -45, 0)),
        (0, 0, 70, (0, 0, 50)),
        (0, 0, -70, (0, 0, -50)),
    ],
)
def test_a_foot_stays_in_the_ankle(
    side: str, up: float, tilt: float, outward: float, limited: tuple[float, float, float]
) -> None:
    """Angles in degrees: toes up, foot tilted, foot turned, against the shank."""
    leg, shank = limbs._leg_of(MALE, side), about(np.array([0.6, 0.0, 0.8]), 0.5)

    def sole_at(up: float, tilt: float, outward: float) -> F64:
        u, t, o = np.radians([up, leg.sign * tilt, leg.sign * outward])
        return shank @ from_yaw_pitch_roll(*map(np.array, (o, -u, t)))

    found = limbs._limited_sole(rows(shank), rows(sole_at(up, tilt, outward)), leg)
    assert_allclose(found, sole_at(*limited), atol=1e-9)


def test_feet_are_farther_from_lower_hips() -> None:
    """The used length of a stretched leg, plus 9 cm of foot; hips at less than 37 cm do not make the leg longer."""
    reach = limbs.reach_of(MALE, np.array([0.9, 0.6, 0.1, 0.0, 3.0]))
    leg, size = 0.985 * sum(MALE.leg), MALE.scale
    for found, upright in zip(reach[:2], (0.9 - 0.17 * size, 0.6 - 0.17 * size), strict=True):
        assert np.hypot(found - 0.09 * size, upright) == pytest.approx(leg)
    assert reach[2] == reach[3] == pytest.approx(np.sqrt(leg**2 - (0.2 * size) ** 2) + 0.09 * size)
    assert reach[4] == pytest.approx(0.2 + 0.09 * size), "a foot may always be a little away"


def test_hips_sink_to_distant_feet_and_feet_pivot_with_the_hips() -> None:
    hips, root, feet = some_feet(60, 1)
    settled, moved = limbs.settle(MALE, hips, root, feet)
    heading = np.arctan2(-root[:, 0, 1], root[:, 1, 1])
    for foot, toe_out in ((0, 0.25), (1, -0.25)):
        off = (moved.yaw[foot] - heading - toe_out + np.pi) % (2 * np.pi) - np.pi
        assert np.abs(off).max() <= np.radians(48) + 1e-9
        inside = np.abs(feet.yaw[foot] - heading - toe_out) < np.radians(48)
        assert_allclose(moved.yaw[foot][inside], feet.yaw[foot][inside], atol=1e-12)
    assert (settled[:, 2] <= hips[:, 2]).all()
    assert (settled[:, :2] == hips[:, :2]).all()
    limit = 0.985 * sum(MALE.leg)
    heel = (MALE.at("RightFoot") - MALE.at("RightToeBase")) * [0, 1, 1]
    for foot, side in enumerate(("Left", "Right")):
        joint = settled + np.einsum("nij,j->ni", root, MALE.at(f"{side}UpLeg") - MALE.at("Hips"))
        ankle = limbs._ankles(moved.ball[foot], moved.yaw[foot], moved.pitch[foot], heel, float(MALE.at("RightToeBase")[2]))
        assert np.linalg.norm(ankle - joint, axis=1).max() <= limit + 1e-9
    # Feet in the air ask for nothing.
    high = hips + UP
    still, same = limbs.settle(MALE, high, root, feet._replace(planted=np.zeros((2, 60), dtype=bool)))
    assert (still == high).all()
    assert (same.pitch == 0).all()
    sunk, raised = limbs.settle(MALE, high, root, feet)
    assert (sunk[:, 2] < high[:, 2] - 0.5).all()
    assert_allclose(raised.pitch, np.radians(62))


def test_hips_sink_to_a_foot_far_away_and_thighs_point_ahead() -> None:
    """Beyond 97 % of the leg the distance over the floor no longer counts: a quarter of the leg stays for the height."""
    frames = 30
    hips, root = np.tile([0.0, 0.0, 0.92], (frames, 1)), np.tile(np.eye(3), (frames, 1, 1))
    ball = np.zeros((2, frames, 3))
    ball[0, :, 0], ball[1, :, 0] = -0.1, 0.1
    feet = Feet(ball, np.zeros((2, frames)), np.zeros((2, frames)), np.ones((2, frames), dtype=bool))
    settled, _ = limbs.settle(MALE, hips, root, feet)
    assert (settled == hips).all(), "within reach"
    rotation, _ = limbs.legs(MALE, hips, root, feet)
    assert (rotation[:, 0, :, 0, 0] > 0.99).all()
    ball[1, :, 1] = 2.0
    settled, raised = limbs.settle(MALE, hips, root, feet)
    limit = 0.985 * sum(MALE.leg)
    heel = (MALE.at("RightFoot") - MALE.at("RightToeBase")) * [0, 1, 1]
    ankle = limbs._ankles(ball[1], np.zeros(frames), raised.pitch[1], heel, float(MALE.at("RightToeBase")[2]))
    joint = settled[:, 2] + (MALE.at("RightUpLeg") - MALE.at("Hips"))[2]
    assert_allclose(joint - ankle[:, 2], limit * np.sqrt(1 - 0.97**2), atol=1e-9)
