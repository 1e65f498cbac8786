"""The shipped athletes: models, skeletons, hands, and key poses."""

import json
import struct

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from shuttle_marl.court.staging import BONES, StagingError, model_file
from shuttle_marl.court.staging.poses import MOTIONS, library_of
from shuttle_marl.court.staging.skeleton import ATHLETES, finger_pose, load_skeleton
from tests import golden


def document(name: str) -> dict:
    content = model_file(name).read_bytes()
    assert content[:4] == b"glTF"
    (length,) = struct.unpack_from("<I", content, 12)
    return json.loads(content[20 : 20 + length])


@pytest.mark.parametrize("name", ATHLETES)
def test_bones_of_the_model_are_where_the_skeleton_has_them(name: str) -> None:
    nodes = document(name)["nodes"]
    parent = {child: i for i, node in enumerate(nodes) for child in node.get("children", ())}
    skeleton = load_skeleton(name)
    for i, node in enumerate(nodes):
        if node["name"] not in BONES:
            continue
        place, at = np.zeros(3), i
        while at in parent:
            place += nodes[at].get("translation", (0, 0, 0))
            at = parent[at]
        x, y, z = place
        np.testing.assert_allclose(skeleton.at(node["name"]), (-x, z, y), atol=2e-5)


def test_key_poses_are_those_that_somebody_looked_at() -> None:
    library = library_of(load_skeleton("male"))
    others = ("ready", "wait", "rest", "wins", "loses")
    strokes = {
        f"{motion}, {i}": pose for motion, poses in zip(MOTIONS, library.stroke, strict=True) for i, pose in enumerate(poses)
    }
    contacts = {f"{motion}, contact": points for motion, points in zip(MOTIONS, library.contact, strict=True)}
    golden.check("poses", strokes | contacts | {name: getattr(library, name) for name in others}, 1e-5)


@pytest.mark.parametrize("name", ATHLETES)
def test_a_left_hander_is_the_mirror_image(name: str) -> None:
    skeleton = load_skeleton(name)
    right, left = (skeleton.rest_pose(right_handed=right_handed) for right_handed in (True, False))
    for bone, place in zip(BONES, right, strict=True):
        other = bone.replace("Right", "*").replace("Left", "Right").replace("*", "Left")
        assert_allclose(left[BONES.index(other)], place * [-1, 1, 1])
        for right_handed in (True, False):
            parent = skeleton.parents(right_handed=right_handed)[BONES.index(bone)]
            hand = "RightHand" if right_handed else "LeftHand"
            assert parent == (BONES.index(hand) if bone == "Racket" else skeleton.parent[BONES.index(bone)])
    for of_right, of_left in zip(skeleton.racket(right_handed=True), skeleton.racket(right_handed=False), strict=True):
        assert_allclose(of_left, of_right * [-1, 1, 1])
    assert 1.6 < skeleton.height < 1.9


def test_athletes_that_there_are_not() -> None:
    for load in (load_skeleton, model_file):
        with pytest.raises(StagingError, match="expected one of male, female"):
            load("robot")
    assert model_file("female").name == "female.glb"


@pytest.mark.parametrize("right_handed", [True, False])
def test_one_hand_holds_the_grip(right_handed: bool) -> None:
    pose = finger_pose("male", right_handed=right_handed)
    for side in ("Right", "Left"):
        for finger in ("Index", "Middle", "Ring", "Pinky"):
            bends = Rotation.from_quat([pose[f"{side}Hand{finger}{k}"] for k in (1, 2, 3)]).magnitude()
            folded = np.degrees(bends).sum()
            assert folded > 140 if (side == "Right") == right_handed else folded < 80
