"""The racket arm: joint angles to bones and back, within the limits of the joints.

Ten angles: two of the collar bone, three of the shoulder, one each of elbow and forearm, two of the wrist, and the roll of
the handle in the fingers, which is how a player changes the grip. The shoulder is a swing (a rotation vector across the arm,
from an arm held out to the right and forward) after a twist about the arm, so that no pose that a player takes lies near a
singularity. All other joints are hinges. The free arm is the mirror image of the same model.

Inverse kinematics is damped least squares with the geometric Jacobian (Buss & Kim 2005), each step clipped to the limits.
"""

import dataclasses
import functools
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.staging.arm_solver import SWING_1, SWING_2, ArmConstants, ArmGoals, pose_arms, solve_arms
from shuttle_marl.staging.rotation import cross, frame, unit
from shuttle_marl.staging.skeleton import SWEET_SPOT, Skeleton

LIMITS: Final[F64] = np.radians(
    [(-10, 35), (-25, 30), (-125, 125), (-125, 125), (-95, 95), (0, 150), (-85, 85), (-70, 75), (-25, 40), (-80, 80)]
)
"""``[10, 2]`` least and greatest angle [rad]. Elbow, forearm and wrist: the normal range of motion (American Academy of
Orthopaedic Surgeons 1965), ulnar deviation and extension as measured in racket players; wrist bend is positive towards the
palm, deviation towards the little finger, pronation positive."""
SWING_LIMIT: Final = np.radians(125)
"""Greatest angle between the upper arm and its middle direction [rad]."""
MIDDLE: Final = unit(np.array([0.80, 0.58, 0.12]))
"""The middle direction of the upper arm, seen from the chest."""
RELAXED: Final[F64] = np.radians([5, 5, 0, 0, 0, 50, 0, -10, 5, 0])
"""Preferred angles of the solver [rad]."""

_STARTS: Final[F64] = np.radians(
    [
        (5, 5, 0, 0, 0, 60, 0, 0, 10, 0),
        (10, 10, -40, 60, 40, 60, 0, 0, 10, 0),
        (10, 10, 40, -40, -40, 80, 40, 0, 10, 0),
        (15, 5, 0, 70, -60, 90, -40, 0, 20, 0),
        (5, 10, 60, 0, 60, 100, 60, 0, 10, 40),
        (5, 10, -60, -30, 0, 40, -30, 0, 10, -40),
    ]
)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ArmPose:
    """Bones of N arms, all in the frame of the chest.

    Attributes:
        rotation: ``[5, N, 3, 3]`` of collar bone, upper arm, forearm, hand, racket.
        position: ``[5, N, 3]`` start of each, relative to the collar bone at rest.
        axes: ``[N, 10, 3]`` axis about which each angle turns what hangs on it.
        pivot: ``[N, 10, 3]`` a point on that axis.
    """

    rotation: F64
    position: F64
    axes: F64
    pivot: F64


class Arm:
    """The right arm of a skeleton, in the frame of the chest (axes of the body, origin where the collar bone begins)."""

    def __init__(self, skeleton: Skeleton) -> None:
        collar, shoulder, elbow, hand, grip = (
            skeleton.at(b) for b in ("RightShoulder", "RightArm", "RightForeArm", "RightHand", "Racket")
        )
        self.origin = collar
        self.offset = np.array([shoulder - collar, elbow - shoulder, hand - elbow, grip - hand])
        upper, lower = unit(self.offset[1]), unit(self.offset[2])
        self.hinge = unit(np.cross(upper, lower))
        self.rest_bend = float(np.arccos(upper @ lower))
        self.lower = lower
        self.axis, self.normal = skeleton.grip_axis, skeleton.grip_normal
        # The wrist bends about the line across the hand and deviates about the line through the palm.
        self.palm = unit(self.normal - (self.normal @ lower) * lower)
        self.across = unit(np.cross(lower, self.palm))
        # Turns the arm at rest into the middle direction, the elbow's hinge so that the forearm bends upwards and inwards.
        self.to_middle = frame(MIDDLE, np.array([0.28, -0.53, 0.71])) @ frame(upper, self.hinge).T
        self.swing = frame(MIDDLE, np.array([0.0, 0.0, 1.0]))[:, 1:].T
        up, forward = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0])
        fixed = [up, forward, *self.swing, MIDDLE, self.hinge, -lower, self.across, self.palm, self.axis]
        self.constants = ArmConstants(
            axes=np.array(fixed),
            offset=self.offset,
            to_middle=self.to_middle.copy(),
            rest_bend=self.rest_bend,
            string_normal=self.normal.copy(),
            limits=LIMITS,
            relaxed=RELAXED,
            swing_limit=float(SWING_LIMIT),
        )

    def pose(self, angles: F64) -> ArmPose:
        """The bones for ``[N, 10]`` angles [rad]."""
        n = len(angles)
        pose = ArmPose(
            rotation=np.empty((5, n, 3, 3)), position=np.empty((5, n, 3)), axes=np.empty((n, 10, 3)), pivot=np.empty((n, 10, 3))
        )
        pose_arms(np.ascontiguousarray(angles), self.constants, pose.rotation, pose.position, pose.axes, pose.pivot)
        return pose

    def clipped(self, angles: F64) -> F64:
        """Angles moved into the limits."""
        out = np.clip(angles, LIMITS[:, 0], LIMITS[:, 1])
        swing = np.linalg.norm(out[..., SWING_1 : SWING_2 + 1], axis=-1, keepdims=True)
        out[..., SWING_1 : SWING_2 + 1] *= np.minimum(1, SWING_LIMIT / np.maximum(swing, 1e-9))
        return out


@functools.cache
def arm_of(skeleton: Skeleton) -> Arm:
    """The arm model of a skeleton; built once."""
    return Arm(skeleton)


class Goal(NamedTuple):
    """Goals of N arms, in the frame of the chest; arrays without N are goals of all of them.

    Attributes:
        point: ``[N, 3]`` target of the point at ``reach`` along the shaft.
        elbow: ``[N, 3]`` direction from the shoulder to the elbow.
        weight: ``[N, 4]`` of point (1/m), shaft, normal, elbow.
        reach: ``[N]`` 0 for the middle of the grip, SWEET_SPOT for the strings.
        shaft: ``[N, 3]`` direction of the shaft.
        normal: ``[N, 3]`` direction of the side of the strings that a forehand strikes with.
    """

    point: F64
    elbow: F64
    weight: F64 | tuple[float, float, float, float]
    reach: F64 | float = 0.0
    shaft: F64 = np.zeros(3)
    normal: F64 = np.zeros(3)


def solve(arm: Arm, goal: Goal, start: F64, rounds: int = 40, hold: float = 0.03) -> F64:
    """Inverse kinematics: ``[N, 10]`` angles within the limits closest to the goals.

    Args:
        start: ``[N, 10]`` initial angles [rad].
        rounds: maximum number of steps.
        hold: weight of staying near :data:`RELAXED`.
    """
    x = np.ascontiguousarray(arm.clipped(np.array(start, dtype=np.float64)))
    target = np.stack([goal.point, goal.shaft, goal.normal, goal.elbow], axis=1)
    goals = ArmGoals(*(np.ascontiguousarray(part, dtype=np.float64) for part in (target, goal.weight, goal.reach)))
    solve_arms(x, goals, arm.constants, rounds, hold)
    return x


def anywhere(n: int) -> F64:
    """``[6, n, 10]`` initial poses spread over the range of the arm [rad]."""
    return np.repeat(_STARTS[:, None], n, axis=1)


def solve_best(arm: Arm, goal: Goal, starts: F64, rounds: int = 40) -> F64:
    """Best solution of :func:`solve` from several starts ``[S, N, 10]``, by point, shaft and elbow."""
    s, n = starts.shape[:2]
    many = Goal(*(np.concatenate([part] * s) for part in goal))
    solved = solve(arm, many, starts.reshape(s * n, -1), rounds=rounds)
    pose = arm.pose(solved)
    shaft, upper = pose.rotation[4] @ arm.axis, unit(pose.position[2] - pose.position[1])
    errors = (pose.position[4] + np.expand_dims(many.reach, -1) * shaft - many.point, shaft - many.shaft, upper - many.elbow)
    weights = np.asarray(many.weight)[:, (0, 1, 3)]
    cost = (np.stack([np.linalg.norm(e, axis=1) for e in errors], axis=1) * weights) ** 2
    best = cost.sum(axis=1).reshape(s, n).argmin(axis=0)
    return solved.reshape(s, n, -1)[best, np.arange(n)]


def sweet_spot(arm: Arm, pose: ArmPose) -> F64:
    """``[N, 3]`` middle of the strings."""
    return pose.position[4] + SWEET_SPOT * pose.rotation[4] @ arm.axis


def sweet_spot_jacobian(arm: Arm, angles: F64) -> F64:
    """``[N, 3, 10]`` Jacobian of the middle of the strings."""
    pose = arm.pose(angles)
    return cross(pose.axes, sweet_spot(arm, pose)[:, None] - pose.pivot).transpose(0, 2, 1)
