"""Inverse kinematics of the arm: it reaches what can be reached, and never breaks a limit."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.staging import SWEET_SPOT, load_skeleton
from shuttle_marl.staging.arm import LIMITS, SWING_LIMIT, Goal, anywhere, arm_of, solve, solve_best
from shuttle_marl.staging.arm_solver import SWING_1, SWING_2

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
