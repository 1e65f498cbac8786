"""Models and pictures: what is written can be read, and what is drawn is where it should be."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from docs.tools.scene_file import SceneFile, read_glb
from shuttle_marl.scene.mesh import Mesh, glb, lathe, tube
from shuttle_marl.scene.write import percent

RED, DARK = (0.7, 0.04, 0.05), (0.03, 0.03, 0.05)


def same(a: Mesh, b: Mesh) -> None:
    np.testing.assert_allclose(a.vertices, b.vertices, atol=1e-6)
    np.testing.assert_allclose(a.normals, b.normals, atol=1e-6)
    assert np.array_equal(a.triangles, b.triangles)
    assert a.colour == b.colour
    assert a.two_sided == b.two_sided


@settings(max_examples=20, deadline=None)
@given(st.lists(st.tuples(st.floats(0.01, 1), st.floats(0.01, 1)), min_size=2, max_size=6), st.integers(3, 9))
def test_models_round_trip(steps: list[tuple[float, float]], sides: int) -> None:
    heights = np.cumsum([height for _, height in steps])
    body = lathe([(radius, height) for (radius, _), height in zip(steps, heights, strict=True)], RED, sides)
    pipe = tube(np.array([[0.0, 0, 0], [0, 1, 0.1], [0, 2, 0]]), 0.1, DARK, sides)
    for mesh, read in zip([body, pipe], read_glb(glb([body, pipe])), strict=True):
        same(mesh, read)


def test_surfaces_face_outwards() -> None:
    for mesh in (lathe([(1.0, 0.0), (1.0, 2.0)], RED), tube(np.array([[0.0, 0, 0], [0, 3, 0]]), 0.5, RED)):
        a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
        outside = mesh.normals[mesh.triangles].mean(axis=1)
        assert ((np.cross(b - a, c - a) * outside).sum(axis=1) > 0).all()


def test_a_picture_is_written_with_its_texts(scene_file: Path, tmp_path: Path) -> None:
    film = SceneFile(scene_file)
    film.save(tmp_path / "a.png", 1.5, width=320, height=180)
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
    assert film.end > film.start


@pytest.mark.parametrize(
    ("probability", "words"),
    [(0.0, "0 %"), (0.001, "under 1 %"), (0.006, "1 %"), (0.5, "50 %"), (0.994, "99 %"), (0.999, "over 99 %"), (1.0, "100 %")],
)
def test_no_probability_is_rounded_to_a_certainty(probability: float, words: str) -> None:
    assert percent(probability) == words
