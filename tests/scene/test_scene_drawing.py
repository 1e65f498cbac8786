"""Models: what is written can be read."""

import numpy as np
import pygltflib as gltf
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.scene.mesh import Mesh, glb, lathe, read_array, tube
from shuttle_marl.scene.write import percent

RED, DARK = (0.7, 0.04, 0.05), (0.03, 0.03, 0.05)


def is_in(document: gltf.GLTF2, primitive: gltf.Primitive, mesh: Mesh) -> None:
    for written, number in ((mesh.vertices, primitive.attributes.POSITION), (mesh.normals, primitive.attributes.NORMAL)):
        read = read_array(document, number)
        np.testing.assert_allclose(written, np.stack([read[:, 0], -read[:, 2], read[:, 1]], axis=1), atol=1e-6)  # z is up
    assert np.array_equal(mesh.triangles, read_array(document, primitive.indices).reshape(-1, 3))
    material = document.materials[primitive.material]
    assert tuple(material.pbrMetallicRoughness.baseColorFactor) == (*mesh.colour, 1)
    assert material.doubleSided == mesh.two_sided


@settings(max_examples=20, deadline=None)
@given(st.lists(st.tuples(st.floats(0.01, 1), st.floats(0.01, 1)), min_size=2, max_size=6), st.integers(3, 9))
def test_models_round_trip(steps: list[tuple[float, float]], sides: int) -> None:
    heights = np.cumsum([height for _, height in steps])
    body = lathe([(radius, height) for (radius, _), height in zip(steps, heights, strict=True)], RED, sides)
    pipe = tube(np.array([[0.0, 0, 0], [0, 1, 0.1], [0, 2, 0]]), 0.1, DARK, sides)
    document = gltf.GLTF2().load_from_bytes(glb([body, pipe]))
    for mesh, primitive in zip([body, pipe], document.meshes[0].primitives, strict=True):
        is_in(document, primitive, mesh)


def test_surfaces_face_outwards() -> None:
    for mesh in (lathe([(1.0, 0.0), (1.0, 2.0)], RED), tube(np.array([[0.0, 0, 0], [0, 3, 0]]), 0.5, RED)):
        a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
        outside = mesh.normals[mesh.triangles].mean(axis=1)
        assert ((np.cross(b - a, c - a) * outside).sum(axis=1) > 0).all()


@pytest.mark.parametrize(
    ("probability", "words"),
    [(0.0, "0 %"), (0.001, "under 1 %"), (0.006, "1 %"), (0.5, "50 %"), (0.994, "99 %"), (0.999, "over 99 %"), (1.0, "100 %")],
)
def test_no_probability_is_rounded_to_a_certainty(probability: float, words: str) -> None:
    assert percent(probability) == words
