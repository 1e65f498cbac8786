"""The shipped athletes fit the skeletons that the motions are made for."""

import json
import struct

import numpy as np
import pytest

from shuttle_marl.staging import ATHLETES, BONES, load_skeleton, model_file
from shuttle_marl.staging.library import library_of
from shuttle_marl.staging.motions import MOTIONS
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
