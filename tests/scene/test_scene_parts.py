"""Parts of scenes by hand: messages, scoreboards, meshes, and the instants between which viewers interpolate."""

import itertools
import re
import types
from typing import Any

import numpy as np
import pygltflib as gltf
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation, Slerp

from shuttle_marl.base.arrays import F64
from shuttle_marl.scene import models, topics
from shuttle_marl.scene import motion as moving
from shuttle_marl.scene.board import CAMERAS, Camera, boards, name_lines
from shuttle_marl.scene.mesh import GlbWriter, Mesh, _rings, glb, joined, lathe, moved, normals_of, read_array, tube
from shuttle_marl.scene.models import court, players, racket, shuttle
from shuttle_marl.scene.rally_report import RallyReport, StagedRally
from shuttle_marl.staging import (
    BONES,
    CORK,
    FEATHER,
    RACKET_BUTT,
    RACKET_HEAD,
    RACKET_LENGTH,
    SHUTTLE_SCALE,
    SWEET_SPOT,
    load_skeleton,
)

RED, BLUE = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


def numbers(message: object) -> list[float]:
    """All numbers of a message, in the order of its fields."""
    return [float(x) for x in re.findall(r"(?<![\w.])-?\d+\.?\d*(?:e-?\d+)?", str(message))]


def test_messages_of_the_viewers() -> None:
    assert numbers(topics.stamp(3_000_000_007)) == [3, 7]
    assert numbers(topics.colour(0.1, 0.2, 0.3)) == [0.1, 0.2, 0.3, 1]
    assert numbers(topics.colour(0.1, 0.2, 0.3, 0.4)) == [0.1, 0.2, 0.3, 0.4]
    assert numbers(topics.point(np.array([1.0, 2.0, 3.0]))) == numbers(topics.vector((1, 2, 3))) == [1, 2, 3]
    assert numbers(topics.at((1, 2, 3))) == [1, 2, 3, 0, 0, 0, 1]
    when = topics.stamp(5)
    moved_by = topics.transform(when, "child", "parent", [1.0, 2.0, 3.0])
    turned_by = topics.transform(when, "child", "parent", [0.1, 0.2, 0.3, 0.4])
    assert numbers(moved_by) == [0, 5, 1, 2, 3, 0, 0, 0, 1]
    assert numbers(turned_by) == [0, 5, 0, 0, 0, 0.1, 0.2, 0.3, 0.4]
    assert re.findall(r'"(\w+)"', str(moved_by)) == ["parent", "child"]
    assert numbers(topics.box((1, 2, 3), (4, 5, 6), topics.colour(*RED))) == [1, 2, 3, 0, 0, 0, 1, 4, 5, 6, 1, 0, 0, 1]
    path, shades = np.array([[0.0, 1.0004, 2.0], [3.0, 4.0, 5.0]]), [topics.colour(*RED), topics.colour(*BLUE)]
    head = [0, 0, 0, 0, 0, 0, 1, 3, 0, 1, 2, 3, 4, 5]
    assert numbers(re.sub(r"type=\w+", "", str(topics.strip(path, shades[:1], 3.0)))) == [*head, 1, 0, 0, 1]
    two = numbers(re.sub(r"type=\w+", "", str(topics.strip(path, shades, 3.0))))
    assert two == [*head, 0, 0, 1, 1, 1, 0, 0, 1, 0, 0, 1, 1], "the last colour, and then one for each point"
    text = str(topics.label("Anna", (1, 2, 3), 16, shades[0]))
    assert numbers(text) == [1, 2, 3, 0, 0, 0, 1, 16, 1, 0, 0, 1]
    assert text.count("true") == 2, "it faces the viewer and keeps its size"
    assert "false" in str(topics.model([]))


def test_entities_replace_all_earlier_ones_and_unknown_numbers_are_left_out() -> None:
    time, topic, update = topics.entities_on("/x", 7, [])
    assert (time, topic) == (7, "/x")
    assert "All" in str(update)
    content = {"a": 1, "b": None, "c": float("nan"), "d": 0.0, "e": "nan", "f": False}
    assert topics.numbers_on("/y", 8, content) == (8, "/y", {"a": 1, "d": 0.0, "e": "nan", "f": False})
    time, topic, line = topics.log_line(9, "said", "umpire")
    assert (time, topic) == (9, "/log")
    assert re.findall(r'"(\w+)"', str(line)) == ["said", "umpire"]


def test_topics_write_in_the_order_of_time() -> None:
    written: list[tuple[Any, int]] = []
    channels = topics.Channels.__new__(topics.Channels)
    channels._channels = {"/a": types.SimpleNamespace(log=lambda message, log_time: written.append((message, log_time)))}
    channels.write([(3, "/a", {"x": 3}), (1, "/a", {"x": 1}), (3, "/a", {"x": 2})])
    assert written == [({"x": 1}, 1), ({"x": 3}, 3), ({"x": 2}, 3)]


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
    """At 90 degrees the picture's half height is the distance: half of it to the right, a quarter up."""
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


def a_report(**others: Any) -> RallyReport:
    played = types.SimpleNamespace(points=(20, 9), games=(1, 0), match=0)
    given = {"names": ("Anna", "B" * 25), "played": played, "winner": 1}
    made = RallyReport.__new__(RallyReport)
    vars(made).update(given | others)
    return made


def test_the_scoreboard_has_the_score_before_or_after_the_rally() -> None:
    report = a_report()
    for after, points in ((False, 9), (True, 10)):
        found = boards(report, 7, "drop to front, forehand\n" + "long " * 8, after=after, marked=1)
        assert [topic for _, topic, _ in found] == [camera.board for camera in CAMERAS]
        for (_, _, update), view in zip(found, CAMERAS, strict=True):
            (text,) = re.findall(r'text: "(.*?)"', str(update))
            rows = text.split("\\n")
            assert {len(row) for row in rows} == {28}
            assert [row.rstrip() for row in rows] == [
                "  Anna                 1  20",
                f"> BBBBBBBBBBBBB        0 {points:>3}",
                "  BBBBBBBBBBBB",
                "",
                "drop to front, forehand",
                "long long long long long",
                "long long long",
            ]
            assert f'frame_id: "{view.frame}"' in str(update)
            place = view.point(-0.95, 0.58)
            assert re.search(rf"x: {place[0]}, y: {place[1]}, z: {place[2]}", str(update))
    single = a_report(played=types.SimpleNamespace(points=(0, 0), games=(0, 0), match=0), names=("C" * 20, "Bea"))
    (text,) = re.findall(r'text: "(.*?)"', str(boards(single, 7, "serve")[0][2]))
    rows = [row.rstrip() for row in text.split("\\n")]
    assert rows == [f"  {'C' * 20}     0", "  Bea                      0", "", "serve", "", "", ""]


def test_scores_of_a_report() -> None:
    assert a_report().points_after == (20, 10)
    assert a_report(winner=0).points_after == (21, 9)
    for points, games, match, told in (
        ((0, 0), (0, 0), 0, False),
        ((0, 1), (0, 0), 0, True),
        ((0, 0), (0, 1), 0, True),
        ((0, 0), (0, 0), 2, True),
    ):
        assert a_report(played=types.SimpleNamespace(points=points, games=games, match=match)).in_match == told
    staged = StagedRally(report=a_report(), motion=types.SimpleNamespace(time=np.array([0.0, 1.5])), start=100)  # type: ignore[arg-type]
    assert staged.at(0.25) == 250_000_100
    assert staged.end == 1_500_000_100


def test_arrays_of_a_file_are_aligned_and_come_back() -> None:
    """Rows of vertex attributes are padded to four bytes, and every array begins at a multiple of four."""
    writer = GlbWriter()
    normals = np.array([[1, -127, 0], [0, 64, 127]], dtype=np.int8)
    weights = np.array([[255, 0, 51, 0]], dtype=np.uint8)
    arrays: list[tuple[Any, Any, Any]] = [
        (normals, {"target": gltf.ARRAY_BUFFER, "normalized": True}, normals / 127),
        (weights, {"target": gltf.ARRAY_BUFFER, "normalized": True}, weights / 255),
        (np.array([1, 2, 3], dtype="<u2"), {"target": gltf.ELEMENT_ARRAY_BUFFER}, [1, 2, 3]),
        (np.array([[0.5, -1.0, 2.0], [1.5, 0.0, -2.0]], dtype="<f4"), {"bounds": True}, [[0.5, -1.0, 2.0], [1.5, 0.0, -2.0]]),
        (np.eye(4, dtype="<f4").reshape(1, 16), {}, np.eye(4).reshape(1, 16)),
        (np.array([7, 8, 9], dtype=np.uint8), {}, [7, 8, 9]),
        (np.array([70000], dtype="<u4"), {}, [70000]),
    ]
    assert [writer.add(array, **options) for array, options, _ in arrays] == list(range(7))
    document = gltf.GLTF2().load_from_bytes(writer.content(gltf.GLTF2()))
    for number, (_, _, expected) in enumerate(arrays):
        assert_allclose(read_array(document, number), expected, atol=1e-7)
    views, accessors = document.bufferViews, document.accessors
    assert [view.byteStride for view in views] == [4, *[None] * 6]
    assert [view.byteOffset for view in views] == [0, 8, 12, 20, 44, 108, 112]
    assert [view.byteLength for view in views] == [8, 4, 6, 24, 64, 3, 4]
    assert [accessor.count for accessor in accessors] == [2, 1, 3, 2, 1, 3, 1]
    assert (accessors[3].min, accessors[3].max) == ([0.5, -1, -2], [1.5, 0, 2])
    assert [bool(accessor.normalized) for accessor in accessors] == [True, True, *[False] * 5]
    assert not accessors[0].min
    assert document.buffers[0].byteLength == 116


def test_a_body_of_revolution_and_a_tube() -> None:
    cone = lathe([(2.0, 0.0), (1.0, 1.0), (0.0, 2.0)], RED, 4)
    assert_allclose(
        cone.vertices[:8],
        [[2, 0, 0], [0, 2, 0], [-2, 0, 0], [0, -2, 0], [1, 0, 1], [0, 1, 1], [-1, 0, 1], [0, -1, 1]],
        atol=1e-12,
    )
    assert_allclose(cone.normals[4], [np.sqrt(0.5), 0, np.sqrt(0.5)])
    assert_allclose(cone.normals[5], [0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-12)
    assert cone.triangles.tolist() == _rings(3, 4).tolist()
    assert _rings(2, 3).tolist() == [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [2, 0, 3], [2, 3, 5]]
    for way in ((0.0, 2.0, 0.0), (0.0, 0.0, 2.0), (1.0, 1.0, 1.0)):
        path = np.array([(0.0, 0.0, 0.0), way])
        pipe, along = tube(path, 0.5, BLUE, 5), path[1] / np.linalg.norm(path[1])
        assert len(pipe.vertices) == 10
        for k in range(2):
            ring = pipe.vertices[5 * k : 5 * k + 5] - path[k]
            assert_allclose(np.linalg.norm(ring, axis=1), 0.5)
            assert_allclose(ring @ along, 0, atol=1e-12)
            assert_allclose(ring, 0.5 * pipe.normals[5 * k : 5 * k + 5], atol=1e-12)
            assert_allclose(np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1), np.sin(np.pi / 5))


def test_linear_colours_are_between_0_and_1() -> None:
    shades = [models.KITS, *(getattr(models, f"_{name}") for name in ("FRAME", "STRING", "CORK", "BAND", "FEATHER"))]
    found = np.concatenate([np.ravel(shade) for shade in shades])
    assert len(found) == 27
    assert 0 < found.min() < found.max() < 1


def test_meshes_of_one_colour_are_joined_and_moved() -> None:
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    up = normals_of(square, np.array([[0, 1, 2], [0, 2, 3]]))
    assert_allclose(up, np.tile([0, 0, 1.0], (4, 1)))
    roof = normals_of(np.array([[0.0, 0, 0], [2, 0, 0], [0, 1, 0], [0, 0, 3]]) + 5, np.array([[0, 1, 2], [0, 2, 3]]))
    assert_allclose(roof[0], np.array([3, 0, 2]) / np.sqrt(13), err_msg="the larger triangle counts more")
    one, other = (Mesh(vertices=square + k, normals=up, triangles=np.array([[0, 1, 2]]), colour=RED) for k in (0, 5))
    blue, both = (
        Mesh(vertices=square, normals=up, triangles=np.array([[0, 1, 2]]), colour=c, two_sided=s)
        for c, s in ((BLUE, False), (RED, True))
    )
    groups = joined([one, blue, other, both])
    assert [(mesh.colour, mesh.two_sided, len(mesh.vertices)) for mesh in groups] == [
        (RED, False, 8),
        (BLUE, False, 4),
        (RED, True, 4),
    ]
    assert groups[0].triangles.tolist() == [[0, 1, 2], [4, 5, 6]]
    assert_allclose(groups[0].vertices[4:], square + 5)
    turn = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    found = moved(one, turn, np.array([0.0, 0, 7]))
    assert_allclose(found.vertices[2], [1, 0, 8], atol=1e-12)
    assert_allclose(found.normals[0], [0, -1, 0], atol=1e-12)
    document = gltf.GLTF2().load_from_bytes(glb([one, both]))
    assert [material.doubleSided for material in document.materials] == [False, True]
    assert document.scenes[0].nodes == [0]
    look = document.materials[0].pbrMetallicRoughness
    assert (look.baseColorFactor, look.metallicFactor, look.roughnessFactor) == ([1, 0, 0, 1], 0, 0.8)


def test_racket_and_shuttle_keep_the_laws() -> None:
    """Laws 2 and 4, in metres; the shuttle of a scene is 1.9 times as large."""
    assert (RACKET_LENGTH, RACKET_BUTT, SWEET_SPOT, RACKET_HEAD[1]) == (0.675, -0.1, 0.45, 0.105)
    assert RACKET_HEAD[0] == pytest.approx(RACKET_LENGTH + RACKET_BUTT - SWEET_SPOT)
    assert 0.025 <= 2 * CORK <= 0.028
    (near, narrow, ahead), (far, wide, behind) = FEATHER
    assert (near, narrow, ahead, far, wide, behind) == (0.012, 0.0015, 0.013, 0.032, 0.0075, 0.076)
    assert 0.062 <= np.hypot(far - near, behind - ahead) <= 0.070
    assert 0.058 <= 2 * np.hypot(far, wide) <= 0.068
    cork, _, feathers = shuttle()
    assert SHUTTLE_SCALE == 1.9
    assert cork.vertices[:, 2].max() == pytest.approx(1.9 * 0.012)
    assert np.hypot(*cork.vertices[:, :2].T).max() == pytest.approx(1.9 * CORK)
    assert len(feathers.vertices) == 16 * 4
    assert feathers.vertices[:, 2].min() == pytest.approx(-1.9 * behind)
    assert np.hypot(*feathers.vertices[:, :2].T).max() == pytest.approx(1.9 * np.hypot(far, wide))


def away(a: F64, b: F64, share: float, value: F64) -> float:
    """Distance of a value from the interpolated one, by scipy."""
    if len(a) == 3:
        return float(np.linalg.norm((1 - share) * a + share * b - value))
    between = Slerp([0, 1], Rotation.from_quat([a, b]))(share)
    return float((between.inv() * Rotation.from_quat(value)).magnitude())


def test_distances_from_what_a_viewer_interpolates() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        share = rng.uniform()
        a, b, value = rng.normal(size=(3, 3))
        assert moving._distance(a, b, share, value) == pytest.approx(away(a, b, share, value))
        a = rng.normal(size=4)
        a /= np.linalg.norm(a)
        near = a + 0.1 * rng.normal(size=(2, 4))
        b, value = near / np.linalg.norm(near, axis=1, keepdims=True)
        for sign in (1.0, -1.0):
            for other in (1.0, -1.0):
                found = moving._distance(a, sign * b, share, other * value)
                assert found == pytest.approx(away(a, b, share, value), rel=0.02)
        assert moving._distance(a, a, share, a) == pytest.approx(0, abs=1e-9)
        wide = rng.normal(size=4)
        wide /= np.linalg.norm(wide)
        assert moving._distance(a, wide, share, Slerp([0, 1], Rotation.from_quat([a, wide]))(share).as_quat()) < 1e-6


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
    track = moving.Track(child="", parent="", values=values, tolerance=tolerance, exact=exact)
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


def test_directions_between_two_others() -> None:
    x, y = np.eye(3)[:2]
    for share, degrees in ((0.0, 0), (0.25, 22.5), (1.0, 90)):
        assert_allclose(moving._between(x, y, share), [np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0], atol=1e-12)
    for a in (x, np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.6, 0.8])):
        half = moving._between(a, -a, 0.5)
        assert abs(half @ a) < 1e-9
        assert np.linalg.norm(half) == pytest.approx(1)
        assert_allclose(moving._between(a, a, 0.5), a, atol=1e-9)
    assert_allclose(moving._rounded(np.array([1 / 16384, 1.4 / 16384, 0.6 / 16384])), np.array([1, 1, 1]) / 16384)


def test_reach_of_everything_attached_to_a_joint() -> None:
    skeleton = load_skeleton("male")
    rest, parents = skeleton.rest_pose(right_handed=True), skeleton.parents(right_handed=True)
    reach = dict(zip(BONES, moving._reach(rest, parents), strict=True))

    def far(*bones: str) -> float:
        ends = [rest[BONES.index(bone)] for bone in bones]
        return sum(float(np.linalg.norm(b - a)) for a, b in itertools.pairwise(ends))

    assert reach["Racket"] == 0.675
    assert reach["LeftHand"] == reach["Head"] == reach["LeftToeBase"] == 0.25
    assert reach["RightHand"] == pytest.approx(far("RightHand", "Racket") + 0.675)
    assert reach["RightArm"] == pytest.approx(far("RightArm", "RightForeArm", "RightHand", "Racket") + 0.675)
    assert reach["LeftUpLeg"] == pytest.approx(far("LeftUpLeg", "LeftLeg", "LeftFoot", "LeftToeBase") + 0.25)
    chain = ("Hips", "Spine", "Spine1", "Spine2", "RightShoulder", "RightArm", "RightForeArm", "RightHand", "Racket")
    assert reach["Hips"] == pytest.approx(far(*chain) + 0.675)


def flying(velocity: F64, contacts: list[int], end: float) -> Any:
    trajectory = types.SimpleNamespace(end_time=np.array([end]))
    return types.SimpleNamespace(fps=50, shuttle_velocity=velocity, contact_frame=np.array(contacts), trajectory=trajectory)


def test_the_cork_points_forward() -> None:
    """Down in the hand; it turns within three frames of a contact, keeps its direction when slow, and lies flat after the end."""
    velocity = np.zeros((60, 3))
    velocity[5:20], velocity[20:40], velocity[40:] = [0.0, 10.0, 0.0], [0.0, -6.0, -8.0], [0.0, -0.2, 0.0]
    turns = moving._heading(flying(velocity, [5, 20], 0.8))
    cork = turns[:, :, 2]
    assert_allclose(np.swapaxes(turns, 1, 2) @ turns, np.tile(np.eye(3), (60, 1, 1)), atol=1e-9)
    assert_allclose(np.linalg.det(turns), 1)
    assert_allclose(cork[:5], np.tile([0, 0, -1.0], (5, 1)), atol=1e-12)
    for k, degrees in enumerate((15, 45, 75)):  # from down to forward
        assert_allclose(cork[5 + k], [0, np.sin(np.radians(degrees)), -np.cos(np.radians(degrees))], atol=1e-9)
    assert_allclose(cork[8:20], np.tile([0, 1.0, 0], (12, 1)), atol=1e-9)
    assert_allclose(cork[23:40], np.tile([0, -0.6, -0.8], (17, 1)), atol=1e-9)
    angle = np.degrees(np.arccos(-0.6))
    for k, share in enumerate((1 / 6, 1 / 2, 5 / 6)):
        assert np.degrees(np.arccos(cork[20 + k, 1])) == pytest.approx(share * angle)
    assert_allclose(cork[40], [0, -0.6, -0.8], atol=1e-9)
    half = 0.5 * np.array([0, -0.6, -0.8]) + 0.5 * np.array([0, -1.0, 0])
    assert_allclose(cork[45], half / np.linalg.norm(half), atol=1e-5)
    assert_allclose(cork[50:], np.tile([0, -1.0, 0], (10, 1)), atol=1e-5)
    slow = moving._heading(flying(np.tile([0.0, 0.29, 0.0], (30, 1)), [2], 9.0))
    assert_allclose(slow[:, :, 2], np.tile([0, 0, -1.0], (30, 1)), atol=1e-9)
    quick = moving._heading(flying(np.tile([0.0, 0.31, 0.0], (30, 1)), [2], 9.0))
    assert_allclose(quick[6:, :, 2], np.tile([0, 1.0, 0], (24, 1)), atol=1e-9)


def test_the_trail_of_the_shuttle() -> None:
    """Places every 0.08 s of the last 0.48 s, and those of contacts; every second frame, and three frames from a contact on."""
    frames = np.arange(61)
    place = np.column_stack([np.zeros(61), 0.1 * np.maximum(frames - 11, 0), np.ones(61)])
    place[50:] = place[50]
    motion = types.SimpleNamespace(fps=50, time=frames / 50, shuttle=place.astype(np.float32), contact_frame=np.array([11]))
    staged = StagedRally(report=a_report(), motion=motion, start=0)  # type: ignore[arg-type]
    found = {time // 20_000_000: str(update) for time, _, update in moving._trail(staged)}
    assert [frame for frame in found if frame < 20] == [0, 12, 13, 14, 16, 18], "and once that there is none before the serve"

    def path(text: str) -> list[float]:
        points = re.search(r"points: \[(.*?)\]", text)
        return [float(y) for y in re.findall(r"Point3 { x: \S+ y: (\S+), z", points[1])]

    assert_allclose(path(found[20]), [0.0, 0.1, 0.5, 0.9], atol=1e-3)
    assert_allclose(path(found[40]), [0.5, 0.9, 1.3, 1.7, 2.1, 2.5, 2.9], atol=1e-3)
    fades = [float(a) for a in re.findall(r"a: (\S+?) }", re.search(r"colors: \[(.*?)\]", found[40])[1])]
    assert_allclose(fades, [round(0.95 * (1 - (40 - k) / 24), 2) for k in range(16, 41, 4)], atol=1e-9)
    assert "gap" in found[40]
    assert "gap" not in found[56], "at rest"
    assert "trail" in found[56]
    assert 'id: "trail"' not in found.get(58, "") or len(path(found[58])) > 1


def test_states_are_told_every_second_frame_and_at_the_end() -> None:
    frames = 12
    hips = np.zeros((frames, 2, 23, 3))
    hips[:, 0, 0, 1], hips[:, 1, 0, 0] = -3 + 0.1 * np.arange(frames), 0.02 * np.arange(frames)
    trajectory = types.SimpleNamespace(end_time=np.array([0.1, 0.16]))
    velocity = np.tile([0.0, 3.0, 4.0], (frames, 1))
    shuttle_at = np.tile([0.1, 0.2004, 0.3], (frames, 1))
    motion = types.SimpleNamespace(
        fps=50, time=np.arange(frames) / 50, position=hips, shuttle=shuttle_at, shuttle_velocity=velocity,
        contact_frame=np.array([3, 5]), trajectory=trajectory,
    )  # fmt: skip
    played = types.SimpleNamespace(striker=np.array([1, 0]))
    found = list(moving._states(StagedRally(report=a_report(names=("Anna", "Bea"), played=played), motion=motion, start=0)))  # type: ignore[arg-type]
    assert [time // 20_000_000 for time, _, _ in found] == [0, 2, 4, 6, 8, 10, 11]
    contents: list[Any] = [message for _, _, message in found]
    assert [content["phase"] for content in contents] == [
        *["before the serve"] * 2, "Bea struck", "Anna struck", "Anna struck", "over", "over"
    ]  # fmt: skip
    assert contents[1]["shuttle"] == {"x": 0.1, "y": 0.2, "z": 0.3, "speed": 5.0}
    assert contents[1]["player_0"] == {"x": 0.0, "y": -2.8, "speed": 5.0}
    assert contents[1]["player_1"] == {"x": 0.04, "y": 0.0, "speed": 1.0}


def test_parts_of_a_racket_and_a_shuttle() -> None:
    """Strings lie in the plane of the head, within its ellipse; vanes stand around the cork."""
    shaft, normal = np.array([0.6, 0.0, 0.8]), np.array([0.0, -1.0, 0.0])
    across = np.cross(normal, shaft)
    grip, rod, head, strings = (mesh.vertices @ np.column_stack([across, normal, shaft]) for mesh in racket(shaft, normal))
    assert (grip[:, 2].min(), grip[:, 2].max()) == pytest.approx((-0.10, 0.11))
    assert np.hypot(grip[:, 0], grip[:, 1]).max() == pytest.approx(0.016)
    assert (rod[:, 2].min(), rod[:, 2].max()) == pytest.approx((0.10, 0.45 - RACKET_HEAD[0]))
    assert np.hypot(rod[:, 0], rod[:, 1]).max() == pytest.approx(0.008)
    radius = np.hypot(head[:, 0] / 0.105, (head[:, 2] - 0.45) / 0.125)
    assert radius.min() > 0.93
    assert radius.max() < 1.07
    assert np.abs(head[:, 1]).max() <= 0.006 + 1e-12
    assert (head[:, 2].max(), head[:, 0].max()) == pytest.approx((0.575 + 0.006, 0.105 + 0.006), abs=2e-3)
    assert len(strings) == 22 * 2 * 4
    middles = strings.reshape(44, 4, 3).mean(axis=1)
    assert_allclose(np.hypot(middles[:, 0] / 0.105, (middles[:, 2] - 0.45) / 0.125), 1, atol=1e-9)
    assert_allclose(np.linalg.norm(strings.reshape(44, 4, 3) - middles[:, None], axis=2), 0.0009)
    along, sideways = middles[:22], middles[22:]
    assert_allclose(along[::2, 0], np.linspace(-0.86, 0.86, 11) * 0.105, atol=1e-9)
    assert_allclose(sideways[::2, 2] - 0.45, np.linspace(-0.86, 0.86, 11) * 0.125, atol=1e-9)
    assert_allclose(along[::2, 0], along[1::2, 0], atol=1e-9)
    _, band, feathers = shuttle()
    assert (band.vertices[:, 2].min(), band.vertices[:, 2].max()) == pytest.approx((-1.9 * 0.014, -1.9 * 0.010))
    assert np.hypot(*band.vertices[:, :2].T) == pytest.approx(1.9 * 1.02 * CORK)
    vanes = feathers.vertices.reshape(16, 4, 3) / 1.9
    for k, vane in enumerate(vanes):
        turn = Rotation.from_euler("z", 360 * k / 16, degrees=True).as_matrix()
        expected = [[0.012, -0.0015, -0.013], [0.012, 0.0015, -0.013], [0.032, 0.0075, -0.076], [0.032, -0.0075, -0.076]]
        assert_allclose(vane, expected @ turn.T, atol=1e-12)
    assert feathers.two_sided
    a, b, c = (feathers.vertices[feathers.triangles[:, k]] for k in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    assert areas.sum() == pytest.approx(16 * 1.9**2 * np.hypot(0.020, 0.063) * 0.009), "trapezia"
    facing = (np.cross(b - a, c - a) * feathers.normals[feathers.triangles[:, 0]]).sum(axis=1)
    assert (facing > 0).all()


def boxes_of(entity: object) -> F64:
    """``[N, 6]`` centres and sizes of the boxes of an entity."""
    found = re.findall(r"CubePrimitive \{.*?position: Some\(Vector3 \{(.*?)\}.*?size: Some\(Vector3 \{(.*?)\}", str(entity))
    return np.array([numbers(f"{place} {size}") for place, size in found])


def test_lines_of_the_court_are_those_of_the_laws() -> None:
    """Law 1: 13.40 m by 6.10 m, lines of 4 cm that belong to the areas which they bound."""
    ground, net = court(5)
    assert ["frame_locked=true" in str(entity) for entity in (ground, net)] == [True, True]
    found = boxes_of(ground)
    assert_allclose(found[0], [0, 0, -0.065, 10.1, 17.4, 0.1])
    assert_allclose(found[1], [0, 0, -0.0075, 7.1, 14.6, 0.015])
    expected = []
    for side in (-1, 1):
        expected += [[side * x, 0, 0.04, 13.40] for x in (3.05 - 0.02, 2.59 - 0.02)]
        expected += [[0, side * y, 6.10, 0.04] for y in (6.70 - 0.02, 6.70 - 0.76, 1.98 + 0.02)]
        expected += [[0, side * (1.98 + 6.70) / 2, 0.04, 6.70 - 1.98]]
    assert_allclose(found[2:, [0, 1, 3, 4]], expected, atol=1e-9)
    assert_allclose(found[2:, [2, 5]], [[0.0015, 0.003]] * 12)
    cloth = boxes_of(net)
    tape, posts = cloth[:-2], cloth[-2:]
    assert_allclose(posts, [[-3.05, 0, 0.775, 0.04, 0.04, 1.55], [3.05, 0, 0.775, 0.04, 0.04, 1.55]])
    assert len(tape) == 9
    assert tape[:, 3].sum() == pytest.approx(6.10 + 9 * 0.002)
    ends = np.linspace(-3.05, 3.05, 10)
    top = 1.524 + 0.026 * (ends / 3.05) ** 2
    assert_allclose(tape[:, 0], (ends[1:] + ends[:-1]) / 2, atol=1e-9)
    assert_allclose(tape[:, 2], (top[1:] + top[:-1]) / 2 - 0.0375, atol=1e-9)
    assert_allclose(tape[:, 4:], [[0.02, 0.075]] * 9)
    (strands,) = re.findall(r"points: \[(.*?)\]", str(net))
    points = np.array(numbers(strands.replace("Point3", ""))).reshape(-1, 3)
    upright, level = points[:164].reshape(82, 2, 3), points[164:].reshape(11, 9, 2, 3)
    assert_allclose(upright[:, 0, 0], np.linspace(-3.05, 3.05, 82), atol=1e-9)
    assert_allclose(upright[:, 0, 2] - upright[:, 1, 2], 0.76)
    assert_allclose(upright[:, 0, 2], 1.524 + 0.026 * (upright[:, 0, 0] / 3.05) ** 2)
    assert_allclose(level[:, 0, 0, 2], 1.55 - np.linspace(0, 0.76, 11))
    assert_allclose(level[0, :, 0, 0], ends[:-1], atol=1e-9)
    assert_allclose(level[0, :, 1, 0], ends[1:], atol=1e-9)


def test_models_follow_the_bones_and_shadows_lie_below() -> None:
    skeleton = load_skeleton("male")
    motion = types.SimpleNamespace(
        hands=("right", "left"), skeletons=(skeleton, skeleton), racket=lambda seat: skeleton.racket(right_handed=not seat)
    )
    found = {re.search(r'frame_id="(.*?)"', str(entity))[1]: str(entity) for entity in players(5, motion, ("Anna", "Bea"))}  # type: ignore[arg-type]
    bones = {f"{seat}/{bone}" for seat in (0, 1) for bone in BONES}
    assert {"shuttle", "shadow_0", "shadow_1", "shadow_shuttle", "0/name", "1/name"} <= set(found)
    assert set(found) - bones == {"shuttle", "shadow_0", "shadow_1", "shadow_shuttle", "0/name", "1/name"}
    assert {"0/Racket", "1/Racket", "0/Head", "1/LeftFoot"} <= set(found)
    for name, width in (("shadow_0", 0.62), ("shadow_1", 0.62), ("shadow_shuttle", 0.16)):
        (size,) = re.findall(r"size: Some\(Vector3 \{(.*?)\}", found[name])
        assert numbers(size) == [width, width, 0.002]
        assert "bottom_scale: 1.0, top_scale: 1.0" in found[name]
    assert ('text: "Anna"' in found["0/name"], 'text: "Bea"' in found["1/name"]) == (True, True)


def walking(ends_changed: bool) -> tuple[Any, F64]:
    """A motion of twenty frames in which both players and the shuttle drift, and their hips turn."""
    n, rng = 20, np.random.default_rng(0)
    skeleton = load_skeleton("male")
    rotation = Rotation.random(n * 46, random_state=0).as_quat().reshape(n, 2, 23, 4)
    rally = types.SimpleNamespace(
        ends_changed=ends_changed, striker=np.array([0, 1]), facing=lambda seat: 1.0 if bool(seat) == ends_changed else -1.0
    )
    motion = types.SimpleNamespace(
        fps=50, time=np.arange(n) / 50, rotation=rotation, position=rng.normal(size=(n, 2, 23, 3)),
        shuttle=rng.normal(size=(n, 3)), shuttle_velocity=rng.normal(size=(n, 3)), contact_frame=np.array([4, 11]),
        trajectory=types.SimpleNamespace(rally=rally, end_time=np.array([0.22, 0.3])),
        parents=lambda seat: skeleton.parents(right_handed=True), rest=lambda seat: skeleton.rest_pose(right_handed=True),
    )  # fmt: skip
    return motion, rotation


@pytest.mark.parametrize("ends_changed", [False, True])
def test_frames_of_reference_give_the_bones_again(ends_changed: bool) -> None:
    motion, rotation = walking(ends_changed)
    tracks = {track.child: track for track in moving.tracks_of(motion)}
    rest, parents = motion.rest(0), motion.parents(0)
    half_turn = np.diag([-1.0, -1.0, 1.0]) if ends_changed else np.eye(3)
    assert_allclose(Rotation.from_quat(tracks["play"].values[3]).as_matrix(), half_turn, atol=1e-9)
    reach = moving._reach(rest, parents)
    for seat in (0, 1):
        turns: list[F64] = []
        for bone, name in enumerate(BONES):
            track = tracks[f"{seat}/{name}"]
            own = Rotation.from_quat(track.values[7]).as_matrix()
            parent = parents[bone]
            if parent < 0:
                assert track.parent == f"player_{seat}"
                turns.append(half_turn @ own)
            elif bone == BONES.index("Racket"):
                turns.append(turns[parent] @ own)
            else:
                assert track.parent == f"{seat}.{bone}"
                turns.append(turns[parent] @ own)
            assert_allclose(turns[-1], Rotation.from_quat(rotation[7, seat, bone]).as_matrix(), atol=2e-3)
            assert track.tolerance == pytest.approx(0.008 / reach[bone])
            assert np.flatnonzero(track.exact).tolist() == [(4, 11)[seat]]
        place = tracks[f"player_{seat}"]
        assert (place.parent, place.tolerance) == ("play", 0.008)
        assert_allclose(place.values @ half_turn, motion.position[:, seat, 0], atol=1e-4)
        above = tracks[f"{seat}/name"]
        assert (above.parent, above.tolerance, above.exact.any()) == ("court", 0.02, False)
        assert_allclose(above.values, motion.position[:, seat, BONES.index("Head")] + [[0, 0, 0.42]], atol=1e-4)
        shadow = tracks[f"shadow_{seat}"]
        assert shadow.tolerance == 0.02
        assert_allclose(shadow.values, motion.position[:, seat, 0] * [[1, 1, 0]] + [[0, 0, 0.012]], atol=1e-4)
    assert_allclose(tracks["shuttle_place"].values, motion.shuttle, atol=1e-4)
    assert np.flatnonzero(tracks["shuttle_place"].exact).tolist() == [4, 11]
    assert tracks["shuttle"].tolerance == pytest.approx(0.08)
    assert_allclose(Rotation.from_quat(tracks["shuttle"].values).as_matrix(), moving._heading(motion), atol=1e-3)
    assert_allclose(tracks["shadow_shuttle"].values[:, :2], motion.shuttle[:, :2], atol=1e-4)


def test_joints_are_where_the_bones_begin_on_their_parents() -> None:
    motion, _ = walking(False)
    time, topic, message = moving.joint_message(9, motion)
    assert (time, topic) == (9, "/tf_static")
    found = re.findall(r'parent_frame_id: "(.*?)", child_frame_id: "(.*?)", translation: Some\(Vector3 \{(.*?)\}', str(message))
    assert len(found) == 44
    rest, parents = motion.rest(0), motion.parents(0)
    for (parent, child, place), bone in zip(found[:22], range(1, 23), strict=True):
        assert (parent, child) == (f"0/{BONES[parents[bone]]}", f"0.{bone}")
        assert_allclose(numbers(place), rest[bone] - rest[parents[bone]], atol=1e-4)
    assert found[22][1] == "1.1"
