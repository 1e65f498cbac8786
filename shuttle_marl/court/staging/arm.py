"""The racket arm: joint angles to bones and back, within the limits of the joints.

Ten angles: two of the collar bone, three of the shoulder, one each of elbow and forearm, two of the wrist, and the roll of
the handle in the fingers, which is how a player changes the grip. The shoulder is a swing (a rotation vector across the arm,
from an arm held out to the right and forward) after a twist about the arm, so that no pose that a player takes lies near a
singularity. All other joints are hinges. The free arm is the mirror image of the same model.

Inverse kinematics is damped least squares with the geometric Jacobian (Buss & Kim 2005), each step clipped to the limits. A
step that does not bring the arm nearer is taken again with more damping (Marquardt 1963): without that the arm jumps between
its limits where no pose reaches the goal, and rounding decides where it stops.
"""

import functools
import math
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.compiling import compiled
from shuttle_marl.court.staging.linear import Mat, add, dot, mat_mul, mat_vec, over, put_mat, put_vec, rotation_about, scaled, sub
from shuttle_marl.court.staging.linear import cross as cross_of
from shuttle_marl.court.staging.rotation import cross, frame, unit
from shuttle_marl.court.staging.skeleton import SWEET_SPOT, Skeleton

ANGLES: Final = (
    "collar bone up",
    "collar bone forward",
    "shoulder swing 1",
    "shoulder swing 2",
    "shoulder twist",
    "elbow bend",
    "forearm pronation",
    "wrist bend",
    "wrist deviation",
    "grip roll",
)
"""Names of the angles."""
RAISE, FORWARD, SWING_1, SWING_2, TWIST, ELBOW, PRONATION, BEND, DEVIATION, ROLL = range(10)

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


_N: Final = 10
_BEGINS: Final = (RAISE, TWIST, ELBOW, BEND, ROLL)
"""Angles at whose pivots the bones begin."""
_ROWS: Final = 12
"""Residuals of one arm: three each for point, shaft, normal and elbow."""
_DAMPING, _LEAST_DAMPING = 1e-2, 1e-4
"""First and least damping of the steps."""
_HOLD: Final = 0.03
"""Weight of staying near :data:`RELAXED`."""


class ArmPose(NamedTuple):
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


class Arm(NamedTuple):
    """The right arm of a skeleton, in the frame of the chest (axes of the body, origin where the collar bone begins).

    Attributes:
        axes: ``[10, 3]`` axis of each angle in its own frame; the last one is the shaft.
        offset: ``[4, 3]`` from collar bone to shoulder, elbow, hand and grip at rest [m].
        to_middle: ``[3, 3]`` rotation of the arm at rest into :data:`MIDDLE`.
        rest_bend: bend of the elbow at rest [rad].
        normal: ``[3]`` side of the strings that a forehand strikes with, at rest.
    """

    axes: F64
    offset: F64
    to_middle: F64
    rest_bend: float
    normal: F64

    @property
    def axis(self) -> F64:
        """``[3]`` direction of the shaft at rest."""
        return self.axes[ROLL]

    def pose(self, angles: F64) -> ArmPose:
        """The bones for ``[N, 10]`` angles [rad]."""
        return _posed(np.ascontiguousarray(angles), self)

    def clipped(self, angles: F64) -> F64:
        """Angles moved into the limits."""
        out = np.clip(angles, LIMITS[:, 0], LIMITS[:, 1])
        swing = np.linalg.norm(out[..., SWING_1 : SWING_2 + 1], axis=-1, keepdims=True)
        out[..., SWING_1 : SWING_2 + 1] *= np.minimum(1, SWING_LIMIT / np.maximum(swing, 1e-9))
        return out


@functools.cache
def arm_of(skeleton: Skeleton) -> Arm:
    """The arm model of a skeleton; built once."""
    collar, shoulder, elbow, hand, grip = (
        skeleton.at(b) for b in ("RightShoulder", "RightArm", "RightForeArm", "RightHand", "Racket")
    )
    offset = np.array([shoulder - collar, elbow - shoulder, hand - elbow, grip - hand])
    upper, lower = unit(offset[1]), unit(offset[2])
    hinge, normal = unit(np.cross(upper, lower)), skeleton.grip_normal
    # The wrist bends about the line across the hand and deviates about the line through the palm.
    palm = unit(normal - (normal @ lower) * lower)
    across = unit(np.cross(lower, palm))
    swing = frame(MIDDLE, np.array([0.0, 0.0, 1.0]))[:, 1:].T
    up, forward = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    return Arm(
        axes=np.array([up, forward, *swing, MIDDLE, hinge, -lower, across, palm, skeleton.grip_axis]),
        offset=offset,
        # Turns the arm at rest into the middle direction, the elbow's hinge so that the forearm bends upwards and inwards.
        to_middle=frame(MIDDLE, np.array([0.28, -0.53, 0.71])) @ frame(upper, hinge).T,
        rest_bend=float(np.arccos(upper @ lower)),
        normal=normal,
    )


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


@compiled
def _hinged(chain: Mat, axis: F64, angle: float, out: F64) -> Mat:
    """A rotation followed by one about a hinge, whose axis is written to ``out``."""
    put_vec(mat_vec(chain, axis), out)
    return mat_mul(chain, rotation_about(axis, angle))


@compiled
def _pose(q: F64, arm: Arm, axes: F64, pivots: F64) -> tuple[Mat, Mat, Mat, Mat, Mat]:
    """Forward kinematics of one arm with ``[10]`` angles: collar bone, upper arm, forearm, hand and racket.

    ``[10, 3]`` axes of the angles and a point on each are written: the first is the origin, the last the middle of the grip.
    """
    fixed = arm.axes
    raised = rotation_about(fixed[FORWARD], q[FORWARD])
    put_vec(fixed[FORWARD], axes[FORWARD])
    collar = _hinged(raised, fixed[RAISE], q[RAISE], axes[RAISE])
    # The swing is a rotation vector across the middle direction; its two axes turn with it.
    swing = add(scaled(q[SWING_1], fixed[SWING_1]), scaled(q[SWING_2], fixed[SWING_2]))
    angle = math.sqrt(dot(swing, swing))
    safe = max(angle, 1e-6)
    swung = mat_mul(collar, rotation_about(over(swing, safe), safe if angle > 1e-6 else 0.0))
    first, second = (1.0 - math.cos(safe)) / safe**2, (safe - math.sin(safe)) / safe**3
    for k in (SWING_1, SWING_2):
        across = cross_of(swing, fixed[k])
        along = add(add(fixed[k], scaled(first, across)), scaled(second, cross_of(swing, across)))
        put_vec(mat_vec(collar, along), axes[k])
    upper = mat_mul(_hinged(swung, fixed[TWIST], q[TWIST], axes[TWIST]), arm.to_middle)
    bent = _hinged(upper, fixed[ELBOW], q[ELBOW] - arm.rest_bend, axes[ELBOW])
    forearm = _hinged(bent, fixed[PRONATION], q[PRONATION] / 2, axes[PRONATION])
    pronated = mat_mul(forearm, rotation_about(fixed[PRONATION], q[PRONATION] / 2))
    wrist = _hinged(pronated, fixed[BEND], q[BEND], axes[BEND])
    hand = _hinged(wrist, fixed[DEVIATION], q[DEVIATION], axes[DEVIATION])
    racket = _hinged(hand, fixed[ROLL], q[ROLL], axes[ROLL])
    begins = mat_vec(collar, arm.offset[0])
    elbow = add(begins, mat_vec(upper, arm.offset[1]))
    ends = add(elbow, mat_vec(forearm, arm.offset[2]))
    grip = add(ends, mat_vec(hand, arm.offset[3]))
    origin = (0.0, 0.0, 0.0)
    points = (origin, origin, begins, begins, begins, elbow, elbow, ends, ends, grip)
    for k in range(_N):
        put_vec(points[k], pivots[k])
    return collar, upper, forearm, hand, racket


@compiled
def _cholesky_solve(square: F64, right: F64) -> F64:
    """Solve ``square @ x = right``, symmetric positive definite."""
    factor, x = square.copy(), right.copy()
    for j in range(_N):
        for k in range(j):
            factor[j, j] -= factor[j, k] * factor[j, k]
        factor[j, j] = math.sqrt(factor[j, j])
        for i in range(j + 1, _N):
            for k in range(j):
                factor[i, j] -= factor[i, k] * factor[j, k]
            factor[i, j] /= factor[j, j]
    for i in range(_N):
        for k in range(i):
            x[i] -= factor[i, k] * x[k]
        x[i] /= factor[i, i]
    for i in range(_N - 1, -1, -1):
        for k in range(i + 1, _N):
            x[i] -= factor[k, i] * x[k]
        x[i] /= factor[i, i]
    return x


@compiled
def _clip(q: F64) -> None:
    """Move ``[10]`` angles into their limits, in place."""
    for k in range(_N):
        q[k] = min(max(q[k], LIMITS[k, 0]), LIMITS[k, 1])
    length = math.sqrt(q[SWING_1] * q[SWING_1] + q[SWING_2] * q[SWING_2])
    if length > SWING_LIMIT:
        q[SWING_1] *= SWING_LIMIT / length
        q[SWING_2] *= SWING_LIMIT / length


@compiled
def _residuals(arm: Arm, goal: tuple[F64, F64, float], racket: Mat, axes: F64, pivots: F64, jacobian: F64, residual: F64) -> None:
    """Weighted residuals ``[12]`` of one arm to a goal, and their Jacobian ``[12, 10]``.

    Args:
        goal: ``[4, 3]`` point, shaft, normal and elbow, their ``[4]`` weights, and the distance of the point from the grip [m].
    """
    target, weights, reach = goal
    shaft, elbow = mat_vec(racket, arm.axes[ROLL]), sub(pivots[ELBOW], pivots[TWIST])
    point = add(pivots[ROLL], scaled(reach, shaft))
    reached = (point, shaft, mat_vec(racket, arm.normal), over(elbow, math.sqrt(dot(elbow, elbow))))
    for k in range(4):
        weight = weights[k]
        for i in range(3):
            residual[3 * k + i] = weight * (target[k, i] - reached[k][i])
        for j in range(_N):
            change = cross_of(axes[j], sub(point, pivots[j]) if k == 0 else reached[k])
            for i in range(3):
                jacobian[3 * k + i, j] = weight * change[i] if k < 3 or j < ELBOW else 0.0


@compiled
def _normal_equations(q: F64, jacobian: F64, residual: F64, square: F64, slope: F64) -> float:
    """Write the normal equations of the residuals and of staying near :data:`RELAXED`; return the sum of squares."""
    cost = 0.0
    for k in range(_ROWS):
        cost += residual[k] * residual[k]
    for i in range(_N):
        for j in range(i + 1):
            total = 0.0
            for k in range(_ROWS):
                total += jacobian[k, i] * jacobian[k, j]
            square[i, j] = total
            square[j, i] = total
        square[i, i] += _HOLD * _HOLD
        off = RELAXED[i] - q[i]
        cost += _HOLD * _HOLD * off * off
        slope[i] = _HOLD * _HOLD * off
        for k in range(_ROWS):
            slope[i] += jacobian[k, i] * residual[k]
    return cost


@compiled
def _step(q: F64, square: F64, slope: F64, damping: float) -> F64:
    """``[10]`` angles after a damped step from ``q``, within the limits."""
    damped, right = square.copy(), slope.copy()
    for i in range(_N):
        damped[i, i] += damping
    move = _cholesky_solve(damped, right)
    # Angles pushed against their limits are fixed, and the step is solved again for the others.
    for i in range(_N):
        if (q[i] <= LIMITS[i, 0] + 1e-9 and move[i] < 0) or (q[i] >= LIMITS[i, 1] - 1e-9 and move[i] > 0):
            damped[i, :], damped[:, i], damped[i, i], right[i] = 0.0, 0.0, 1.0, 0.0
    move = _cholesky_solve(damped, right)
    for i in range(_N):
        move[i] = q[i] + min(max(move[i], -0.5), 0.5)
    _clip(move)
    return move


@compiled
def _solve(angles: F64, target: F64, weight: F64, reach: F64, arm: Arm, rounds: int) -> None:
    """The Levenberg-Marquardt method of :func:`solve` for each row of ``angles``, in place."""
    axes, pivots = np.empty((_N, 3)), np.empty((_N, 3))
    jacobian, residual = np.empty((_ROWS, _N)), np.empty(_ROWS)
    square, slope = np.empty((_N, _N)), np.empty(_N)
    new_square, new_slope = np.empty((_N, _N)), np.empty(_N)
    for n in range(len(angles)):
        q, goal, damping = angles[n], (target[n], weight[n], reach[n]), _DAMPING
        _residuals(arm, goal, _pose(q, arm, axes, pivots)[4], axes, pivots, jacobian, residual)
        cost = _normal_equations(q, jacobian, residual, square, slope)
        for _ in range(rounds):
            to = _step(q, square, slope, damping)
            change = np.abs(to - q).max()
            _residuals(arm, goal, _pose(to, arm, axes, pivots)[4], axes, pivots, jacobian, residual)
            new = _normal_equations(to, jacobian, residual, new_square, new_slope)
            if new < cost:
                q[:], square[:], slope[:], cost = to, new_square, new_slope, new
                damping = max(damping / 4, _LEAST_DAMPING)
            else:
                damping *= 8
            if change < 2e-4:
                break


@compiled
def _posed(angles: F64, arm: Arm) -> ArmPose:
    n = len(angles)
    pose = ArmPose(np.empty((5, n, 3, 3)), np.empty((5, n, 3)), np.empty((n, _N, 3)), np.empty((n, _N, 3)))
    for i in range(n):
        turns = _pose(angles[i], arm, pose.axes[i], pose.pivot[i])
        for k in range(5):
            put_mat(turns[k], pose.rotation[k, i])
            put_vec(pose.pivot[i, _BEGINS[k]], pose.position[k, i])
    return pose


def solve(arm: Arm, goal: Goal, start: F64, rounds: int = 40) -> F64:
    """Inverse kinematics: ``[N, 10]`` angles within the limits closest to the goals.

    Args:
        start: ``[N, 10]`` initial angles [rad].
    """
    x = np.ascontiguousarray(arm.clipped(np.array(start, dtype=np.float64)))
    target = np.stack([goal.point, goal.shaft, goal.normal, goal.elbow], axis=1)
    weight, reach = (np.ascontiguousarray(part, dtype=np.float64) for part in (goal.weight, goal.reach))
    _solve(x, target, weight, reach, arm, rounds)
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
