"""Arms and legs: bones from joint angles or targets, within the limits of the joints.

The shoulder is a swing (a rotation vector across the arm) after a twist about the arm, so that no pose of a player is near a
singularity; other joints are hinges, and the roll of the handle changes the grip. Inverse kinematics is damped least squares
(Buss & Kim 2005; damping by Marquardt 1963, without which rounding decides where an arm stops), each step within the limits.
"""

import functools
import math
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.compiling import compiled
from shuttle_marl.court.staging import geometry
from shuttle_marl.court.staging.feet import Feet
from shuttle_marl.court.staging.geometry import (
    Mat,
    Vec,
    add,
    cross_of,
    dot,
    frame_of,
    mat_mul,
    mat_vec,
    over,
    put_mat,
    put_vec,
    rotation_about,
    scaled,
    sub,
    transposed,
    turned_by,
    unit_of,
)
from shuttle_marl.court.staging.skeleton import LEFT, RIGHT, SWEET_SPOT, Skeleton

# Angles: collar bone up and forward, two of the shoulder's swing, its twist, elbow, forearm, two of the wrist, and the grip.
RAISE, FORWARD, SWING_1, SWING_2, TWIST, ELBOW, PRONATION, BEND, DEVIATION, ROLL = range(10)
LIMITS: Final[F64] = np.radians(  # normal range of motion (AAOS 1965), wrists as measured in racket players [rad]
    [(-10, 35), (-25, 30), (-125, 125), (-125, 125), (-95, 95), (0, 150), (-85, 85), (-70, 75), (-25, 40), (-80, 80)]
)
SWING_LIMIT: Final = np.radians(125)  # greatest angle between the upper arm and its middle direction [rad]
MIDDLE: Final = geometry.unit(np.array([0.80, 0.58, 0.12]))  # the middle direction of the upper arm, seen from the chest
RELAXED: Final[F64] = np.radians([5, 5, 0, 0, 0, 50, 0, -10, 5, 0])  # preferred angles of the solver [rad]
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
_BEGINS: Final = (RAISE, TWIST, ELBOW, BEND, ROLL)  # angles at whose pivots the bones begin
_N, _ROWS = 10, 12  # angles of one arm, and residuals: three each for point, shaft, normal and elbow
_DAMPING, _LEAST_DAMPING = 1e-2, 1e-4
_HOLD: Final = 0.03  # weight of staying near `RELAXED`


class ArmPose(NamedTuple):
    """Bones of N arms, all in the frame of the chest."""

    rotation: F64  # [5, N, 3, 3] of collar bone, upper arm, forearm, hand, racket
    position: F64  # [5, N, 3] start of each, relative to the collar bone at rest
    axes: F64  # [N, 10, 3] axis about which each angle turns what hangs on it
    pivot: F64  # [N, 10, 3] a point on that axis


class Arm(NamedTuple):
    """The right arm of a skeleton, in the frame of the chest (axes of the body, origin where the collar bone begins)."""

    axes: F64  # [10, 3] axis of each angle in its own frame; the last one is the shaft
    offset: F64  # [4, 3] from collar bone to shoulder, elbow, hand and grip at rest [m]
    to_middle: F64  # [3, 3] rotation of the arm at rest into MIDDLE
    rest_bend: float  # bend of the elbow at rest [rad]
    normal: F64  # [3] side of the strings that a forehand strikes with, at rest

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
    """The arm of a skeleton."""
    collar, shoulder, elbow, hand, grip = (
        skeleton.at(b) for b in ("RightShoulder", "RightArm", "RightForeArm", "RightHand", "Racket")
    )
    offset = np.array([shoulder - collar, elbow - shoulder, hand - elbow, grip - hand])
    upper, lower = geometry.unit(offset[1]), geometry.unit(offset[2])
    hinge, normal = geometry.unit(np.cross(upper, lower)), skeleton.grip_normal
    # The wrist bends about the line across the hand and deviates about the line through the palm.
    palm = geometry.unit(normal - (normal @ lower) * lower)
    across = geometry.unit(np.cross(lower, palm))
    swing = geometry.frame(MIDDLE, np.array([0.0, 0.0, 1.0]))[:, 1:].T
    up, forward = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    return Arm(
        axes=np.array([up, forward, *swing, MIDDLE, hinge, -lower, across, palm, skeleton.grip_axis]),
        offset=offset,
        # Turns the arm at rest into the middle direction, the elbow's hinge so that the forearm bends upwards and inwards.
        to_middle=geometry.frame(MIDDLE, np.array([0.28, -0.53, 0.71])) @ geometry.frame(upper, hinge).T,
        rest_bend=float(np.arccos(upper @ lower)),
        normal=normal,
    )


class Goal(NamedTuple):
    """Goals of N arms, in the frame of the chest; arrays without N are goals of all of them."""

    point: F64  # [N, 3] target of the point at reach along the shaft
    elbow: F64  # [N, 3] direction from the shoulder to the elbow
    weight: F64 | tuple[float, float, float, float]  # [N, 4] of point (1/m), shaft, normal, elbow
    reach: F64 | float = 0.0  # [N] 0 for the middle of the grip, SWEET_SPOT for the strings
    shaft: F64 = np.zeros(3)  # [N, 3] direction of the shaft
    normal: F64 = np.zeros(3)  # [N, 3] direction of the side of the strings that a forehand strikes with


@compiled
def _hinged(chain: Mat, axis: F64, angle: float, out: F64) -> Mat:
    put_vec(mat_vec(chain, axis), out)
    return mat_mul(chain, rotation_about(axis, angle))


@compiled
def _pose(q: F64, arm: Arm, axes: F64, pivots: F64) -> tuple[Mat, Mat, Mat, Mat, Mat]:
    """Forward kinematics of one arm with ``[10]`` angles: collar bone, upper arm, forearm, hand and racket. ``[10, 3]`` axes of
    the angles and a point on each are written: the first is the origin, the last the middle of the grip."""
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
    for k in range(_N):
        q[k] = min(max(q[k], LIMITS[k, 0]), LIMITS[k, 1])
    length = math.sqrt(q[SWING_1] * q[SWING_1] + q[SWING_2] * q[SWING_2])
    if length > SWING_LIMIT:
        q[SWING_1] *= SWING_LIMIT / length
        q[SWING_2] *= SWING_LIMIT / length


@compiled
def _residuals(arm: Arm, goal: tuple[F64, F64, float], racket: Mat, axes: F64, pivots: F64, jacobian: F64, residual: F64) -> None:
    """Weighted residuals ``[12]`` of one arm to a goal, and their Jacobian ``[12, 10]``. ``goal``: ``[4, 3]`` point, shaft,
    normal, elbow, their ``[4]`` weights, and distance of the point from the grip [m]."""
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
    damped, right = square.copy(), slope.copy()
    for i in range(_N):
        damped[i, i] += damping
    move = _cholesky_solve(damped, right)
    # Angles pushed against their limits are fixed, and the step is solved again for the others.
    for i in range(_N):
        if (q[i] <= LIMITS[i, 0] + 1e-9 and move[i] < 0) or (q[i] >= LIMITS[i, 1] - 1e-9 and move[i] > 0):
            for k in range(_N):
                damped[i, k], damped[k, i] = 0.0, 0.0
            damped[i, i], right[i] = 1.0, 0.0
    move = _cholesky_solve(damped, right)
    for i in range(_N):
        move[i] = q[i] + min(max(move[i], -0.5), 0.5)
    _clip(move)
    return move


@compiled
def _solve(angles: F64, target: F64, weight: F64, reach: F64, arm: Arm, rounds: int) -> None:
    axes, pivots = np.empty((_N, 3)), np.empty((_N, 3))
    jacobian, residual = np.empty((_ROWS, _N)), np.empty(_ROWS)
    square, slope = np.empty((_N, _N)), np.empty(_N)
    new_square, new_slope = np.empty((_N, _N)), np.empty(_N)
    for n in range(len(angles)):
        q, goal, damping = angles[n], (target[n], weight[n], reach[n]), _DAMPING
        _residuals(arm, goal, _pose(q, arm, axes, pivots)[4], axes, pivots, jacobian, residual)
        cost = _normal_equations(q, jacobian, residual, square, slope)
        for _ in range(rounds):
            to, change = _step(q, square, slope, damping), 0.0
            for k in range(_N):
                change = max(change, abs(to[k] - q[k]))
            _residuals(arm, goal, _pose(to, arm, axes, pivots)[4], axes, pivots, jacobian, residual)
            new = _normal_equations(to, jacobian, residual, new_square, new_slope)
            if new < cost:
                # Plain loops: numba compiles an assignment of arrays in seconds.
                for k in range(_N):
                    q[k] = to[k]
                square, new_square, slope, new_slope, cost = new_square, square, new_slope, slope, new
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
    """Inverse kinematics: ``[N, 10]`` angles within the limits closest to the goals, from initial ones [rad]."""
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
    shaft, upper = pose.rotation[4] @ arm.axis, geometry.unit(pose.position[2] - pose.position[1])
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
    return geometry.cross(pose.axes, sweet_spot(arm, pose)[:, None] - pose.pivot).transpose(0, 2, 1)


KNEE_LIMITS: Final = tuple(np.radians((2.0, 150.0)))  # limits of the bend of the knee [rad]
HIP_LIMITS: Final = np.radians([(-45, 130), (-45, 65), (-65, 65)])  # thigh forward, outward, turned outward [rad]
ANKLE_LIMITS: Final = np.radians([(-55, 38), (-45, 45), (-50, 50)])  # toes up, foot tilted, turned [rad]
TOE_LIMITS: Final = np.radians((-25.0, 70.0))  # toes bent up against the foot [rad]
_OUT, _FOLDED = 0.10, 0.45  # outward turn of the knees, and least share of the length of a leg between hip and ankle
_ROUNDS, _LIFTS = 4, 12  # maximum numbers of solutions of a leg in a frame, and of further ones for toes under the floor
_UNDER, _DROP = 1e-3, 8  # depth of toes under the floor [m], and half width of the window in which hips sink [frames]
_USED: Final = 0.985  # used fraction of the length of a leg: knees never lock
_HEELS: Final = np.linspace(0, np.radians(62), 9)  # pitches of a raised heel [rad]
_TURN: Final = np.radians(48)


class _Leg(NamedTuple):
    rest: F64  # [3, 3] from hip to knee, to ankle, to toes at rest [m]
    aligned: F64  # [2, 3, 3] frames of thigh and shank at rest
    thigh: float
    shank: float
    toe_height: float
    sign: float  # 1 for the right leg, -1 for the left one


@functools.cache
def _leg_of(skeleton: Skeleton, side: str) -> _Leg:
    rest = np.diff([skeleton.at(f"{side}{bone}") for bone in ("UpLeg", "Leg", "Foot", "ToeBase")], axis=0)
    aligned = geometry.frame(rest[:2], np.array([1.0, 0.0, 0.0]))
    return _Leg(rest, aligned, *skeleton.leg, _toe_height(skeleton), 1.0 if side == "Right" else -1.0)


@compiled
def _ankle(ball: F64, sole: Mat, heel: F64 | Vec, above: float) -> Vec:
    """The ankle of a foot that stands on its ball; ``sole`` is the rotation of the foot."""
    x, y, z = add(mat_vec(sole, heel), ball)
    return x, y, z + above


@compiled
def _raised(joint: F64, ball: F64, yaw: F64, heel: F64, above: float, limit: float) -> F64:
    """``[F]`` least pitch by which each heel has to be raised for the leg to reach the foot, the greatest if none does."""
    out = np.empty(len(joint))
    for f in range(len(joint)):
        out[f] = _HEELS[-1]
        for angle in _HEELS:
            way = sub(_ankle(ball[f], turned_by(yaw[f], angle, 0.0), heel, above), joint[f])
            if dot(way, way) <= limit * limit:
                out[f] = angle
                break
    return out


@compiled
def _ankles(ball: F64, yaw: F64, pitch: F64, heel: F64, above: float) -> F64:
    out = np.empty_like(ball)
    for f in range(len(ball)):
        put_vec(_ankle(ball[f], turned_by(yaw[f], pitch[f], 0.0), heel, above), out[f])
    return out


@compiled
def _shortest_rotation(a: Vec, b: Vec) -> Mat:
    axis = cross_of(a, b)
    sine = math.sqrt(dot(axis, axis))
    return rotation_about(unit_of(axis), 0.0 if sine < 1e-12 else math.atan2(sine, dot(a, b)))


@compiled
def _within(x: float, limits: F64) -> float:
    return min(max(x, limits[0]), limits[1])


@compiled
def _limited_thigh(root: F64, upper: Mat, thigh: Vec, leg: _Leg) -> Mat:
    """The rotation of a thigh within the range of the hip joint; ``thigh`` is its direction at rest."""
    relative = mat_mul(transposed(root), upper)
    way = mat_vec(relative, thigh)
    # The twist is the rotation of an axis across the thigh that remains after the shortest rotation.
    side = unit_of(sub((1.0, 0.0, 0.0), scaled(thigh[0], thigh)))
    turned, swung = mat_vec(relative, side), mat_vec(_shortest_rotation(thigh, way), side)
    forward, right = math.atan2(way[1], -way[2]), math.asin(min(max(way[0], -1.0), 1.0))
    twist = -math.atan2(dot(cross_of(swung, turned), way), dot(swung, turned))
    limits, sign = HIP_LIMITS, leg.sign
    new_forward, new_right = _within(forward, limits[0]), sign * _within(sign * right, limits[1])
    new_twist = sign * _within(sign * twist, limits[2])
    if max(abs(new_forward - forward), abs(new_right - right), abs(new_twist - twist)) <= 1e-9:
        return upper
    level = math.cos(new_right)
    way = (math.sin(new_right), level * math.sin(new_forward), -level * math.cos(new_forward))
    return mat_mul(root, mat_mul(rotation_about(way, -new_twist), _shortest_rotation(thigh, way)))


@compiled
def _limited_sole(shank: Mat, wanted: Mat, leg: _Leg) -> Mat:
    up, tilt, outward, sign = ANKLE_LIMITS[0], ANKLE_LIMITS[1], ANKLE_LIMITS[2], leg.sign
    back = transposed(shank)
    # Rising about the ball comes first: far outside the range the three angles would not be independent.
    normal = mat_vec(transposed(wanted), back[2])
    bent = math.atan2(normal[1], normal[2])
    joint = mat_mul(back, mat_mul(wanted, turned_by(0.0, bent - _within(bent, up), 0.0)))
    twist = math.atan2(-joint[0][1], joint[1][1])
    bow = -math.asin(min(max(joint[2][1], -1.0), 1.0))
    lean = math.atan2(-joint[2][0], joint[2][2])
    limited = turned_by(sign * _within(sign * twist, outward), -_within(-bow, up), sign * _within(sign * lean, tilt))
    return mat_mul(shank, limited)


@compiled
def _solve_leg(joint: F64, root: F64, sole: Mat, target: Vec, leg: _Leg) -> tuple[Mat, Mat, Vec, Vec]:
    """Thigh, shank, knee and ankle of a leg that reaches for a target with its ankle: inverse kinematics of two bones."""
    thigh, shank = leg.thigh, leg.shank
    down = sub(target, joint)
    length = math.sqrt(dot(down, down))
    reach = min(max(length, _FOLDED * (thigh + shank)), _USED * (thigh + shank))
    down = over(down, length)
    # Knees point between where the hips and where the toes point.
    right, ahead, _ = transposed(root)
    aim = add(add(scaled(0.8, unit_of((sole[0][1], sole[1][1], 0.0))), ahead), scaled(leg.sign * _OUT, right))
    aim = transposed(frame_of(down, aim))[1]
    along = (thigh**2 - shank**2 + reach**2) / (2 * reach)
    upper = add(scaled(along, down), scaled(math.sqrt(max(thigh**2 - along**2, 0.0)), aim))
    lower = sub(scaled(reach, down), upper)
    hinge = cross_of(down, aim)
    first = mat_mul(frame_of(upper, hinge), transposed(leg.aligned[0]))
    second = mat_mul(frame_of(lower, hinge), transposed(leg.aligned[1]))
    # The shank keeps its bend against the thigh when the hip joint limits the thigh.
    bend = mat_mul(transposed(first), second)
    first = _limited_thigh(root, first, unit_of(leg.rest[0]), leg)
    second = mat_mul(first, bend)
    knee = add(joint, mat_vec(first, leg.rest[0]))
    return first, second, knee, add(knee, mat_vec(second, leg.rest[1]))


@compiled
def _solve_legs(joint: F64, root: F64, ball: F64, yaw: F64, pitch: F64, leg: _Leg, rotation: F64, position: F64) -> None:
    """Bones ``[4, F, 3, 3]`` and ``[4, F, 3]`` of one leg of :func:`legs`, from the hip joint ``[F, 3]`` on, written."""
    heel = (0.0, -leg.rest[2, 1], -leg.rest[2, 2])
    for f in range(len(joint)):
        floor = turned_by(yaw[f], pitch[f], 0.0)
        sole, raised = floor, 0.0
        for step in range(_ROUNDS + _LIFTS):
            target = add(_ankle(ball[f], sole, heel, leg.toe_height), (0.0, 0.0, raised))
            thigh, shank, knee, ankle = _solve_leg(joint[f], root[f], floor, target, leg)
            limited = _limited_sole(shank, floor, leg)
            change = 0.0
            for i in range(3):
                for j in range(3):
                    change = max(change, abs(limited[i][j] - sole[i][j]))
            sole = limited
            toe = add(ankle, mat_vec(sole, leg.rest[2]))
            # Where the ankle does not let the sole follow the floor, the leg is solved again; where the hip presses the toes
            # under the floor, it is drawn up.
            if change <= (1e-4 if step else 1e-6) or step >= _ROUNDS - 1:
                under = leg.toe_height - toe[2]
                if under <= _UNDER:
                    break
                raised += 1.5 * under
        bend = _within(-math.asin(min(max(sole[2][1], -1.0), 1.0)), TOE_LIMITS)
        toes = mat_mul(sole, turned_by(0.0, -bend, 0.0))
        places = (add(joint[f], (0.0, 0.0, 0.0)), knee, ankle, toe)
        turns = (thigh, shank, sole, toes)
        for k in range(4):
            put_mat(turns[k], rotation[k, f])
            put_vec(places[k], position[k, f])


def reach_of(skeleton: Skeleton, height: F64) -> F64:
    """``[F]`` largest horizontal distance of the ball of a foot from the hips at heights ``[F]`` of the hips [m]."""
    size = skeleton.scale
    upright = np.maximum(height - 0.17 * size, 0.2 * size)
    return np.sqrt(np.maximum((_USED * sum(skeleton.leg)) ** 2 - upright**2, 0.04)) + 0.09 * size


def settle(skeleton: Skeleton, hips: F64, root: F64, feet: Feet) -> tuple[F64, Feet]:
    """Raise heels and lower the hips ``[F, 3]``, whose rotation is ``root``, until every planted foot is within reach."""
    limit, heel, above = _USED * sum(skeleton.leg), _heel(skeleton), _toe_height(skeleton)
    yaw = feet.yaw.copy()
    heading = np.arctan2(root[:, 1, 1], root[:, 0, 1]) - np.pi / 2
    pitch = feet.pitch.copy()
    drop = np.zeros(len(hips))
    for foot, side in ((LEFT, "Left"), (RIGHT, "Right")):
        # A planted foot pivots on its ball when the hips turn beyond the range of the hip joint.
        toe_out = 0.25 if foot == LEFT else -0.25
        off = (yaw[foot] - heading - toe_out + np.pi) % (2 * np.pi) - np.pi
        yaw[foot] = heading + toe_out + np.clip(off, -_TURN, _TURN)
        joint = hips + geometry.apply(root, skeleton.at(f"{side}UpLeg") - skeleton.at("Hips"))
        needed = _raised(joint, feet.ball[foot], yaw[foot], heel, above, limit) * feet.planted[foot]
        pitch[foot] = np.where(feet.planted[foot], geometry.smooth(geometry.widen(needed, 3), 3), pitch[foot])
        ankle = _ankles(feet.ball[foot], yaw[foot], pitch[foot], heel, above)
        flat = np.minimum(np.hypot(*(ankle - joint)[:, :2].T), 0.97 * limit)
        height = ankle[:, 2] + np.sqrt(limit**2 - flat**2)
        drop = np.where(feet.planted[foot], np.maximum(drop, joint[:, 2] - height), drop)
    # The maximum filter is as wide as the mean, so that the drop is nowhere too small.
    drop = geometry.smooth(geometry.widen(drop, _DROP), _DROP)
    lowered = hips.copy()
    lowered[:, 2] -= drop
    return lowered, feet._replace(yaw=yaw, pitch=pitch)


def legs(skeleton: Skeleton, hips: F64, root: F64, feet: Feet) -> tuple[F64, F64]:
    """Bones of both legs; knees bend forward over the toes.

    The sole follows the floor as far as the ankle allows; beyond that it tilts or rises about the ball.

    Returns:
        ``[2, 4, F, 3, 3]`` rotations of UpLeg, Leg, Foot, ToeBase, left and right, and ``[2, 4, F, 3]`` where they begin [m].
    """
    rotation, position = np.empty((2, 4, len(hips), 3, 3)), np.empty((2, 4, len(hips), 3))
    for foot, side in ((LEFT, "Left"), (RIGHT, "Right")):
        joint = hips + geometry.apply(root, skeleton.at(f"{side}UpLeg") - skeleton.at("Hips"))
        ball, yaw, pitch = feet.ball[foot], feet.yaw[foot], feet.pitch[foot]
        _solve_legs(joint, root, ball, yaw, pitch, _leg_of(skeleton, side), rotation[foot], position[foot])
    return rotation, position


def strays(skeleton: Skeleton, hips: F64, root: F64, feet: Feet) -> F64:
    """``[2, F]`` distance of the ball of each foot from its place on the floor, because of the limits of the leg [m]."""
    rotation, position = legs(skeleton, hips, root, feet)
    ball = position[:, 2] - geometry.apply(rotation[:, 2], _heel(skeleton))
    return np.asarray(np.linalg.norm((ball - feet.ball)[..., :2], axis=-1))


def _toe_height(skeleton: Skeleton) -> float:
    return float(skeleton.at("RightToeBase")[2])


def _heel(skeleton: Skeleton) -> F64:
    """``[3]`` from the joint of the toes to the ankle, for a foot that points forward [m]."""
    heel = skeleton.at("RightFoot") - skeleton.at("RightToeBase")
    return heel * np.array([0.0, 1.0, 1.0])
