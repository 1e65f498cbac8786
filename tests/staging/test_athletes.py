"""The shipped athletes fit the skeletons that the motions are made for."""

import json
import struct

import numpy as np
import pytest

from experiments.athletes.gltf import MATERIALS
from shuttle_marl.staging import ATHLETES, BONES, finger_pose, load_skeleton, model_file
from shuttle_marl.staging.skeleton import FOLDER, MIRROR


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


@pytest.mark.parametrize("name", ATHLETES)
def test_model_is_dressed_and_licensed(name: str) -> None:
    found = document(name)
    assert {material["name"] for material in found["materials"]} == set(MATERIALS)
    assert "CC0" in found["asset"]["copyright"]
    assert "CC0 1.0" in (FOLDER / "LICENSE-CC0.md").read_text(encoding="utf-8")
    triangles = sum(found["accessors"][p["indices"]]["count"] // 3 for p in found["meshes"][0]["primitives"])
    assert 20_000 < triangles < 35_000


@pytest.mark.parametrize("name", ATHLETES)
def test_skeleton_is_its_own_mirror_image_but_for_the_racket(name: str) -> None:
    rest = load_skeleton(name).rest
    both = [i for i, bone in enumerate(BONES) if bone != "Racket"]
    np.testing.assert_allclose(rest[both], (rest[MIRROR] * (-1, 1, 1))[both], atol=2e-3)
    assert 1.6 < load_skeleton(name).height < 1.95


@pytest.mark.parametrize("right_handed", [True, False])
def test_the_hand_that_plays_is_closed(right_handed: bool) -> None:
    pose = finger_pose("male", right_handed=right_handed)
    bend = {side: 2 * np.degrees(np.arccos(pose[f"{side}HandMiddle1"][3])) for side in ("Right", "Left")}
    assert (bend["Right"] > bend["Left"]) == right_handed
