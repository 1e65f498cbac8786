"""Models, court and tracks of a scene: what is written can be read, and keeps the Laws."""

import itertools
import re
from pathlib import Path

import numpy as np
import pygltflib as gltf
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation, Slerp

from shuttle_marl.base.arrays import F64
from shuttle_marl.scene.board import Camera, name_lines
from shuttle_marl.scene.mesh import GlbWriter, Mesh, glb, lathe, read_array, tube
from shuttle_marl.scene.models import court, racket, shuttle
from shuttle_marl.scene.motion import Track, tracks_of
from shuttle_marl.scene.write import percent
from shuttle_marl.staging import CORK, FEATHER, SHUTTLE_SCALE, Motion

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


def test_arrays_of_a_file_are_aligned() -> None:
    """Every array begins at a multiple of four bytes, and so does every row of a vertex attribute."""
    writer = GlbWriter()
    arrays = [np.array([[1, -127, 0], [0, 64, 127]], np.int8), np.array([1, 2, 3], "<u2"), np.array([7, 8, 9], np.uint8)]
    for array in arrays:
        writer.add(array, target=gltf.ARRAY_BUFFER if array.ndim == 2 else gltf.ELEMENT_ARRAY_BUFFER)
    document = gltf.GLTF2().load_from_bytes(writer.content(gltf.GLTF2()))
    assert [view.byteOffset % 4 for view in document.bufferViews] == [0, 0, 0]
    assert document.bufferViews[0].byteStride == 4
    for number, array in enumerate(arrays):
        np.testing.assert_array_equal(read_array(document, number), array)


def camera(phi: float, theta: float) -> Camera:
    return Camera(title="", board="", distance=2.0, phi=phi, theta=theta, fovy=90.0, target=(1.0, 2.0, 3.0))


@pytest.mark.parametrize(
    ("phi", "theta", "place"),
    [
        (90.0, 0.0, (2.0, 2.0, 3.5)),  # from behind seat 0: x to the right, z up
        (90.0, 90.0, (1.0, 1.0, 3.5)),  # from x < 0
        (90.0, 180.0, (0.0, 2.0, 3.5)),
        (0.0, 0.0, (2.0, 2.5, 3.0)),  # from above
        (45.0, 0.0, (2.0, 2 + 0.5 * np.sqrt(0.5), 3 + 0.5 * np.sqrt(0.5))),
    ],
)
def test_where_a_point_of_the_picture_is_on_the_court(phi: float, theta: float, place: tuple[float, float, float]) -> None:
    """At a field of view of 90 degrees the picture's half height is the distance."""
    assert camera(phi, theta).point(0.5, 0.25) == pytest.approx(place)


@pytest.mark.parametrize(
    ("name", "width", "lines"),
    [
        ("", 4, [""]),
        ("Anna", 4, ["Anna"]),
        ("Annas", 4, ["Ann", "as"]),
        ("Annabell", 4, ["Anna", "bell"]),
        ("Annabella", 4, ["Ann", "abe", "lla"]),
        ("Anna-Isabell", 4, ["Anna", "-Isa", "bell"]),
        ("Anna-Isabella", 4, ["Anna", "-Isa", "bel…"]),
    ],
)
def test_names_in_lines_of_equal_length(name: str, width: int, lines: list[str]) -> None:
    assert name_lines(name, width) == lines


def numbers(message: object) -> list[float]:
    """All numbers of a message, in the order of its fields."""
    return [float(x) for x in re.findall(r"(?<![\w.])-?\d+\.?\d*(?:e-?\d+)?", str(message))]


def boxes_of(entity: object) -> F64:
    """``[N, 6]`` centres and sizes of the boxes of an entity."""
    found = re.findall(r"CubePrimitive \{.*?position: Some\(Vector3 \{(.*?)\}.*?size: Some\(Vector3 \{(.*?)\}", str(entity))
    return np.array([numbers(f"{place} {size}") for place, size in found])


def test_lines_of_the_court_are_those_of_the_laws() -> None:
    """Law 1: 13.40 m by 6.10 m, lines of 4 cm that belong to the areas which they bound; posts of 1.55 m on the side lines."""
    ground, net = map(boxes_of, court(5))
    lines = []
    for side in (-1, 1):
        lines += [[side * x, 0, 0.04, 13.40] for x in (3.05 - 0.02, 2.59 - 0.02)]
        lines += [[0, side * y, 6.10, 0.04] for y in (6.70 - 0.02, 6.70 - 0.76, 1.98 + 0.02)]
        lines += [[0, side * (1.98 + 6.70) / 2, 0.04, 6.70 - 1.98]]
    assert_allclose(ground[2:, [0, 1, 3, 4]], lines, atol=1e-9)
    assert_allclose(net[-2:, [0, 2, 5]], [[-3.05, 0.775, 1.55], [3.05, 0.775, 1.55]])
    top = net[:-2, 2] + net[:-2, 5] / 2
    assert_allclose(top, 1.524 + 0.026 * (net[:-2, 0] / 3.05) ** 2, atol=2e-3)


def test_racket_and_shuttle_keep_the_laws() -> None:
    """Laws 2 and 4, in metres; the shuttle of a scene is drawn larger than it is."""
    cork, _, feathers = shuttle()
    assert 0.025 <= 2 * CORK <= 0.028
    (near, _, ahead), (far, wide, behind) = FEATHER
    assert 0.062 <= np.hypot(far - near, behind - ahead) <= 0.070
    assert 0.058 <= 2 * np.hypot(far, wide) <= 0.068
    assert np.hypot(*cork.vertices[:, :2].T).max() == pytest.approx(SHUTTLE_SCALE * CORK)
    assert len(feathers.vertices) == 16 * 4
    assert np.hypot(*feathers.vertices[:, :2].T).max() == pytest.approx(SHUTTLE_SCALE * np.hypot(far, wide))
    along = np.concatenate([mesh.vertices @ [0.6, 0.0, 0.8] for mesh in racket(np.array([0.6, 0, 0.8]), np.array([0.0, -1, 0]))])
    assert np.ptp(along) <= 0.680 + 0.01


def away(a: F64, b: F64, share: float, value: F64) -> float:
    """Distance of a value from the interpolated one, by scipy."""
    if len(a) == 3:
        return float(np.linalg.norm((1 - share) * a + share * b - value))
    between = Slerp([0, 1], Rotation.from_quat([a, b]))(share)
    return float((between.inv() * Rotation.from_quat(value)).magnitude())


@pytest.mark.parametrize("width", [3, 4])
@pytest.mark.parametrize("packet", [7, 1000])
def test_as_few_instants_as_possible_one_after_the_other(width: int, packet: int) -> None:
    """From each chosen instant to the farthest one between which all values are within the tolerance."""
    rng = np.random.default_rng(width)
    n, tolerance = 60, 0.08
    values = np.cumsum(rng.normal(0, 0.03, (n, width)), axis=0)
    values[20:30] = values[20]
    if width == 4:
        values += [0, 0, 0, 3]
        values /= np.linalg.norm(values, axis=1, keepdims=True)
    exact = np.zeros(n, dtype=bool)
    exact[[10, 43]] = True
    track = Track(child="", parent="", values=values, tolerance=tolerance, exact=exact)
    expected, first = [0], 0
    while first < n - 1:
        end = first + 1
        while end < n - 1 and not exact[end] and end % packet:
            inside = [
                away(values[first], values[end + 1], (k - first) / (end + 1 - first), values[k])
                for k in range(first + 1, end + 1)
            ]
            if max(inside) > tolerance:
                break
            end += 1
        expected.append(end)
        first = end
    assert track.instants(packet).tolist() == expected
    assert {10, 43, n - 1} <= set(expected)
    assert len(expected) < n / 1.5


def test_the_cork_flies_ahead() -> None:
    """From three frames after a contact to the next one."""
    motion = Motion.unpack((Path(__file__).parents[1] / "staging" / "golden" / "rally.smot").read_bytes())
    (track,) = (track for track in tracks_of(motion) if track.child == "shuttle")
    cork = Rotation.from_quat(track.values).as_matrix()[:, :, 2]
    seen = 0
    for first, last in itertools.pairwise(motion.contact_frame.tolist()):
        flight = slice(first + 3, last)
        way = motion.shuttle_velocity[flight].astype(float)
        assert_allclose(cork[flight], way / np.linalg.norm(way, axis=1, keepdims=True), atol=1e-3)
        seen += last - first - 3
    assert seen > 50
