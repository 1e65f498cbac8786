"""Vectors and rotations of compiled code and of arrays, beside those of numpy and scipy; trunks, fingers and models."""

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from shuttle_marl.base.arrays import F64
from shuttle_marl.staging import ATHLETES, BONES, StagingError, finger_pose, linear, load_skeleton, model_file, rotation
from shuttle_marl.staging.skeleton import FLIP, MIRROR, SPINE_LIMITS, chest_of, collar_of, trunk

RIGHTWARDS, FORWARD, UP = np.eye(3)


def random(*shape: int) -> F64:
    return np.random.default_rng(7).normal(size=shape)


def by_scipy(yaw: float, pitch: float, roll: float) -> F64:
    """Turn left about the vertical, then bow about the line to the left, then lean about the line ahead."""
    turns = [Rotation.from_rotvec(v).as_matrix() for v in (yaw * UP, -pitch * RIGHTWARDS, roll * FORWARD)]
    return turns[0] @ turns[1] @ turns[2]


A, B = random(2, 3)
M, N = random(2, 3, 3)
AXIS = A / np.linalg.norm(A)
ACROSS = B - (B @ AXIS) * AXIS
ACROSS /= np.linalg.norm(ACROSS)


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (linear.add(A, B), A + B),
        (linear.sub(A, B), A - B),
        (linear.scaled(3.0, A), 3 * A),
        (linear.over(A, 4.0), A / 4),
        (linear.dot(A, B), A @ B),
        (linear.cross(A, B), np.cross(A, B)),
        (linear.unit(A), AXIS),
        (linear.unit(1e-6 * A), AXIS),
        (linear.unit(np.zeros(3)), np.zeros(3)),
        (linear.transposed(M), M.T),
        (linear.mat_vec(M, A), M @ A),
        (linear.mat_mul(M, N), M @ N),
        (linear.orthonormal_frame(A, B), np.column_stack([AXIS, ACROSS, np.cross(AXIS, ACROSS)])),
        (rotation.frame(A, B), np.column_stack([AXIS, ACROSS, np.cross(AXIS, ACROSS)])),
        (rotation.cross(M, N), np.cross(M, N)),
        (rotation.unit(np.stack([A, 1e-6 * A, np.zeros(3)])), [AXIS, AXIS, np.zeros(3)]),
        (rotation.apply(np.stack([M, N]), np.stack([A, B])), [M @ A, N @ B]),
    ],
)
def test_vectors_and_matrices_are_those_of_numpy(found: F64, expected: F64) -> None:
    assert_allclose(np.array(found), expected, rtol=1e-12, atol=1e-15)


def test_vectors_and_matrices_are_written() -> None:
    vector, matrix = np.zeros(3), np.zeros((3, 3))
    linear.put_vec((1.0, 2.0, 3.0), vector)
    linear.put_mat(M, matrix)
    assert vector.tolist() == [1, 2, 3]
    assert (matrix == M).all()


@pytest.mark.parametrize("angle", [-2.5, -0.4, 0.0, 1.1, 3.0])
def test_rotations_are_those_of_scipy(angle: float) -> None:
    assert_allclose(linear.rotation_about(AXIS, angle), Rotation.from_rotvec(angle * AXIS).as_matrix(), atol=1e-14)
    for other in (0.3, -1.2):
        angles = angle, other, angle - other
        assert_allclose(linear.from_yaw_pitch_roll(*angles), by_scipy(*angles), atol=1e-14)
        many = rotation.from_yaw_pitch_roll(*(np.array([x, 0.0]) for x in angles))
        assert_allclose(many, [by_scipy(*angles), np.eye(3)], atol=1e-14)


def test_a_quarter_turn_left_a_bow_forward_and_a_lean_to_the_right() -> None:
    quarter, zero = np.array(np.pi / 2), np.zeros(())
    assert_allclose(rotation.turned(np.pi / 2) @ FORWARD, -RIGHTWARDS, atol=1e-15)
    assert_allclose(rotation.from_yaw_pitch_roll(zero, quarter, zero) @ UP, FORWARD, atol=1e-15)
    assert_allclose(rotation.from_yaw_pitch_roll(zero, zero, quarter) @ UP, RIGHTWARDS, atol=1e-15)


def test_quaternions_of_all_turns_of_a_cube_and_near_half_turns() -> None:
    """Each of the four components is the largest one somewhere; half turns have no positive w."""
    signs = itertools.product((1.0, -1.0), repeat=3)
    cube = [np.diag(s)[list(p)] for s in signs for p in itertools.permutations(range(3))]
    turns = [turn for turn in cube if np.linalg.det(turn) > 0]
    turns += [Rotation.from_rotvec((np.pi - 0.01) * side * axis).as_matrix() for axis in (*np.eye(3), AXIS) for side in (1, -1)]
    found = rotation.quaternion(np.array(turns))
    assert len(turns) == 32
    assert (found[:, 3] >= 0).all()
    assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-15)
    assert_allclose(Rotation.from_quat(found).as_matrix(), turns, atol=1e-14)


def test_the_spine_bends_by_a_third_at_each_of_its_bones() -> None:
    skeleton = load_skeleton("male")
    hips, angles = random(4, 3), 0.6 * random(4, 7)
    turns, places = trunk(skeleton, hips, angles)
    chest, collar = chest_of(skeleton, hips, np.column_stack([angles, np.ones((4, 20))]))
    mirrored, left = chest_of(skeleton, hips, angles, free=True)
    for n, (_, *a) in enumerate(angles):
        turn, place = by_scipy(*a[:3]), hips[n]
        for k, bone in enumerate(("Hips", "Spine", "Spine1", "Spine2")):
            if k:
                place = place + turn @ (skeleton.at(bone) - skeleton.at(("Hips", "Spine", "Spine1")[k - 1]))
                turn = turn @ by_scipy(*(np.array(a[3:]) / 3))
            assert_allclose(turns[k, n], turn, atol=1e-14)
            assert_allclose(places[k, n], place, atol=1e-14)
        shoulders = [place + turn @ (skeleton.at(f"{side}Shoulder") - skeleton.at("Spine2")) for side in ("Right", "Left")]
        assert_allclose(chest[n], turn, atol=1e-14)
        assert_allclose(collar[n], shoulders[0], atol=1e-14)
        assert_allclose(collar_of(skeleton, turn, place), shoulders[0], atol=1e-14)
        # The free arm is the racket arm in a mirror.
        assert_allclose(mirrored[n] * np.outer(FLIP, FLIP), turn, atol=1e-14)
        assert_allclose(left[n], shoulders[1] * [-1, 1, 1], atol=1e-14)


def test_the_chest_turns_leans_and_bows_as_far_as_a_spine() -> None:
    assert np.degrees(SPINE_LIMITS).round(9).tolist() == [[-45, 45], [-30, 60], [-35, 35]]


@pytest.mark.parametrize("name", ATHLETES)
def test_a_left_hander_is_the_mirror_image(name: str) -> None:
    skeleton = load_skeleton(name)
    right, left = (skeleton.rest_pose(right_handed=right_handed) for right_handed in (True, False))
    for bone, place in zip(BONES, right, strict=True):
        other = bone.replace("Right", "*").replace("Left", "Right").replace("*", "Left")
        assert_allclose(left[BONES.index(other)], place * [-1, 1, 1])
        assert MIRROR[BONES.index(bone)] == BONES.index(other)
        for right_handed in (True, False):
            parent = skeleton.parents(right_handed=right_handed)[BONES.index(bone)]
            hand = "RightHand" if right_handed else "LeftHand"
            assert parent == (BONES.index(hand) if bone == "Racket" else skeleton.parent[BONES.index(bone)])
    for of_right, of_left in zip(skeleton.racket(right_handed=True), skeleton.racket(right_handed=False), strict=True):
        assert_allclose(of_left, of_right * [-1, 1, 1])
    thigh, shank = skeleton.leg
    assert thigh == pytest.approx(np.linalg.norm(skeleton.at("RightLeg") - skeleton.at("RightUpLeg")))
    assert shank == pytest.approx(np.linalg.norm(skeleton.at("RightFoot") - skeleton.at("RightLeg")))
    assert skeleton.scale == pytest.approx(skeleton.height / 1.787)
    assert 1.6 < skeleton.height < 1.9


@pytest.mark.parametrize("right_handed", [True, False])
def test_one_hand_is_closed_around_the_grip_and_the_other_is_open(right_handed: bool) -> None:
    """Turns of all joints of a finger, one after the other: a fist folds the fingers by more than 150 degrees."""
    pose = finger_pose("male", right_handed=right_handed)
    assert len(pose) == 30
    for side in ("Right", "Left"):
        closed = (side == "Right") == right_handed
        bends = {}
        for finger in ("Index", "Middle", "Ring", "Pinky"):
            turns = Rotation.from_quat([pose[f"{side}Hand{finger}{k}"] for k in (1, 2, 3)])
            bends[finger] = np.degrees(turns.magnitude()).sum()
            # Both hands close towards the thighs when the arms hang at rest: mirror images of one another.
            assert_allclose(
                turns.as_quat()[:, :3], np.linalg.norm(turns.as_quat()[:, :3], axis=1)[:, None] * curl(side), atol=1e-9
            )
        expected = (146, 178, 186, 182) if closed else (50, 60, 68, 72)
        assert_allclose(list(bends.values()), expected, atol=1e-9)
        thumb = Rotation.from_quat([pose[f"{side}HandThumb{k}"] for k in (1, 2, 3)])
        assert_allclose(np.degrees(thumb.magnitude()), (26, 20, 10) if closed else (6, 8, 6), atol=1e-9)


def curl(side: str) -> F64:
    """Direction about which the fingers of the male athlete bend."""
    quaternion = finger_pose("male", right_handed=True)["RightHandIndex1"]
    direction = quaternion[:3] / np.linalg.norm(quaternion[:3])
    return direction if side == "Right" else direction * [1, -1, -1]


def test_athletes_that_there_are_not() -> None:
    for load in (load_skeleton, model_file):
        with pytest.raises(StagingError, match="expected one of male, female"):
            load("robot")
    assert model_file("female").name == "female.glb"
