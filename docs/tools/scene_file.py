"""Pictures of a scene file, drawn from its messages without a viewer, for documentation and tests.

Supports the messages of this package's scenes: models, boxes, cylinders, lines, texts, and transforms.
"""

import bisect
import functools
import io
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import pygltflib as gltf
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from scipy.spatial.transform import Rotation

from docs.tools.raster import Camera, Canvas, linear
from shuttle_marl.base.arrays import F64, U8
from shuttle_marl.scene import SceneError
from shuttle_marl.scene.mesh import Mesh, lathe, read_array
from shuttle_marl.scene.topics import BOARDS, WORLD
from shuttle_marl.staging.rotation import exponential, matrix

Pose = tuple[F64, F64]
Words = tuple[str, tuple[float, float], float, tuple[float, float, float]]

BACKGROUND: Final = (0.010, 0.013, 0.020)
_BOX_CELL: Final = 1.0
_WINDOW: Final = 620.0
_SCHEMAS: Final = ("foxglove.SceneUpdate", "foxglove.FrameTransforms")
_LIST: Final = 2
"""Enumeration value of line lists in the schema; 0 is a strip."""


class SceneFile:
    """A scene file that can be drawn.

    Args:
        path: the file.

    Attributes:
        start: time of the first message [ns].
        end: time of the last message [ns].

    Raises:
        SceneError: the file cannot be read or holds no scene.
    """

    def __init__(self, path: Path) -> None:
        self._messages: list[tuple[int, str, bytes]] = []
        self._decoders: dict[str, Callable[[bytes], Any]] = {}
        decoders = DecoderFactory()
        try:
            reader = make_reader(io.BytesIO(path.read_bytes()))
            for schema, channel, message in reader.iter_messages():
                if schema is None or schema.name not in _SCHEMAS:
                    continue
                if channel.topic not in self._decoders:
                    decoder = decoders.decoder_for(channel.message_encoding, schema)
                    if decoder is None:
                        raise SceneError(f"{path}: {channel.topic} is written in {channel.message_encoding}, expected protobuf")
                    self._decoders[channel.topic] = decoder
                self._messages.append((message.log_time, channel.topic, message.data))
        except OSError as error:
            raise SceneError(f"{path}: cannot be read ({error.strerror})") from error
        except (McapError, struct.error) as error:
            raise SceneError(f"{path}: no scene ({error})") from error
        if not self._messages:
            raise SceneError(f"{path}: holds no scene")
        self.start, self.end = self._messages[0][0], self._messages[-1][0]

    def picture(self, seconds: float, *, camera: Camera | None = None, width: int = 1280, height: int = 720) -> U8:
        """``[height, width, 3]`` picture at a time from the start [s], without texts."""
        return self._draw(seconds, camera or Camera(), width, height)[0]

    def save(self, path: Path, seconds: float, *, camera: Camera | None = None, width: int = 1280, height: int = 720) -> None:
        """Write the picture at a time from the start [s], with texts, as a PNG file."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415  an extra
        from matplotlib.figure import Figure  # noqa: PLC0415

        image, words = self._draw(seconds, camera or Camera(), width, height)
        figure = Figure(figsize=(width / 100, height / 100), dpi=100)
        FigureCanvasAgg(figure)
        axes = figure.add_axes((0, 0, 1, 1))
        axes.imshow(image, interpolation="nearest", aspect="auto")
        axes.set_axis_off()
        axes.set_xlim(-0.5, width - 0.5)
        axes.set_ylim(height - 0.5, -0.5)
        for text, (x, y), size, colour in words:
            box = {"facecolor": "black", "alpha": 0.7, "edgecolor": "none", "pad": 2}
            axes.text(
                x, y, text, fontsize=size * 0.72, color=colour, ha="center", va="center", family="DejaVu Sans Mono", bbox=box
            )
        figure.savefig(path, metadata={"Software": None})

    def _board(self, last: dict[str, bytes], width: int, height: int) -> list[Words]:
        if BOARDS[0] not in last:
            return []
        texts = [text for entity in self._decoders[BOARDS[0]](last[BOARDS[0]]).entities for text in entity.texts]
        return [(t.text, (0.18 * width, 0.19 * height), t.font_size * height / _WINDOW, _rgb(t.color)) for t in texts]

    def _draw(self, seconds: float, camera: Camera, width: int, height: int) -> tuple[U8, list[Words]]:
        last: dict[str, bytes] = {}
        until = self.start + round(seconds * 1e9)
        for time, topic, data in self._messages:
            if time > until:
                break
            last[topic] = data
        # Only the scoreboard of the first camera is drawn, in its corner of the picture.
        newest = [self._decoders[topic](message) for topic, message in last.items() if topic not in BOARDS]
        transforms: dict[str, list[Any]] = {}
        for message in newest:
            for moved in getattr(message, "transforms", ()):
                transforms.setdefault(moved.child_frame_id, []).append(moved)
        frames = {name: (moves[0].parent_frame_id, _interpolated(moves, until)) for name, moves in transforms.items()}
        canvas = Canvas(width, height, camera, BACKGROUND)
        words = self._board(last, width, height)
        late: list[Any] = []
        for message in newest:
            for entity in getattr(message, "entities", ()):
                pose = _against_world(frames, entity.frame_id)
                for model in entity.models:
                    for mesh in _model(model.data):
                        _paint(canvas, mesh, pose, np.array([*mesh.colour, 1.0]))
                for shape in (*entity.cubes, *entity.cylinders):
                    mesh = _box(shape) if hasattr(shape, "size") and not hasattr(shape, "top_scale") else _cylinder(shape)
                    colour = _colour(shape.color)
                    if colour[3] < 1:
                        late.append((mesh, _chained(pose, _pose_of(shape.pose)), colour))
                    else:
                        _paint(canvas, mesh, _chained(pose, _pose_of(shape.pose)), colour)
                for line in entity.lines:
                    late.append((line, pose, None))
                words += [found for text in entity.texts if (found := _words(text, pose, camera, width, height))]
        for thing, pose, colour in late:
            if colour is None:
                _draw_line(canvas, thing, pose)
            else:
                _paint(canvas, thing, pose, colour)
        return canvas.image(), words


def _paint(canvas: Canvas, mesh: Mesh, pose: Pose, colour: F64) -> None:
    turn, place = pose
    canvas.triangles(mesh.vertices @ turn.T + place, mesh.normals @ turn.T, mesh.triangles, colour)


def _draw_line(canvas: Canvas, line: Any, pose: Pose) -> None:
    points = np.array([(p.x, p.y, p.z) for p in line.points]) @ pose[0].T + pose[1]
    one = _colour(line.color)
    colours = linear(np.array([(c.r, c.g, c.b, c.a) for c in line.colors])) if line.colors else np.tile(one, (len(points), 1))
    # The canvas has twice the resolution of the picture.
    width = 2 * line.thickness
    if line.type == _LIST:
        for a in range(0, len(points) - 1, 2):
            canvas.line(points[a : a + 2], colours[a : a + 2], width)
    else:
        canvas.line(points, colours, width)


def _words(text: Any, pose: Pose, camera: Camera, width: int, height: int) -> Words | None:
    place = _chained(pose, _pose_of(text.pose))[1]
    x, y, depth = camera.project(place[None], width, height)[0]
    if depth < 0.2 or not 0 <= x < width or not 0 <= y < height:
        return None
    # Font sizes in pixels assume a window of about this height.
    fixed = text.font_size * height / _WINDOW
    pixels = fixed if text.scale_invariant else text.font_size * height / (2 * np.tan(np.radians(camera.field) / 2) * depth)
    return text.text, (float(x), float(y)), float(pixels), _rgb(text.color)


def _against_world(frames: dict[str, tuple[str, Pose]], name: str) -> Pose:
    pose: Pose = (np.eye(3), np.zeros(3))
    while name != WORLD:
        if name not in frames:
            raise SceneError(f"no transform of the frame of reference {name!r}")
        name, above = frames[name][0], frames[name][1]
        pose = _chained(above, pose)
    return pose


def _chained(outer: Pose, inner: Pose) -> Pose:
    return outer[0] @ inner[0], outer[0] @ inner[1] + outer[1]


def _interpolated(moves: list[Any], time: int) -> Pose:
    """Pose of a frame of reference at a time, interpolated between its transforms."""
    times = [move.timestamp.ToNanoseconds() for move in moves]
    after = min(bisect.bisect_right(times, time), len(times) - 1)
    before = max(after - 1, 0)
    (turn, place), (next_turn, next_place) = (_pose(moves[i].translation, moves[i].rotation) for i in (before, after))
    share = min(max((time - times[before]) / max(times[after] - times[before], 1), 0.0), 1.0)
    way = Rotation.from_matrix(turn.T @ next_turn).as_rotvec()
    return turn @ exponential(share * way), (1 - share) * place + share * next_place


def _pose(place: Any, turn: Any) -> Pose:
    q = np.array([turn.x, turn.y, turn.z, turn.w])
    return matrix(q / np.linalg.norm(q)), np.array([place.x, place.y, place.z])


def _pose_of(pose: Any) -> Pose:
    return _pose(pose.position, pose.orientation)


def _rgb(colour: Any) -> tuple[float, float, float]:
    return colour.r, colour.g, colour.b


def _colour(colour: Any) -> F64:
    return linear(np.array([colour.r, colour.g, colour.b, colour.a]))


@functools.lru_cache(maxsize=256)
def _model(data: bytes) -> list[Mesh]:
    return read_glb(data)


def _box(cube: Any) -> Mesh:
    """Six faces in cells of a metre, so that only the cells behind the camera are dropped."""
    size = np.array([cube.size.x, cube.size.y, cube.size.z])
    vertices, normals, triangles, count = [], [], [], 0
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        nu, nv = (max(1, int(np.ceil(size[k] / _BOX_CELL))) for k in (u, v))
        for side in (-1, 1):
            grid = np.zeros((nu + 1, nv + 1, 3))
            grid[..., axis] = side * size[axis] / 2
            grid[..., u] = np.linspace(-size[u] / 2, size[u] / 2, nu + 1)[:, None]
            grid[..., v] = np.linspace(-size[v] / 2, size[v] / 2, nv + 1)[None]
            a = (np.arange(nu)[:, None] * (nv + 1) + np.arange(nv)).ravel() + count
            triangles += [np.stack([a, a + nv + 1, a + nv + 2], axis=1), np.stack([a, a + nv + 2, a + 1], axis=1)]
            normal = np.zeros(3)
            normal[axis] = side
            vertices.append(grid.reshape(-1, 3))
            normals.append(np.tile(normal, (grid.shape[0] * grid.shape[1], 1)))
            count += grid.shape[0] * grid.shape[1]
    return Mesh(
        vertices=np.concatenate(vertices), normals=np.concatenate(normals), triangles=np.concatenate(triangles), colour=(1, 1, 1)
    )


def _cylinder(cylinder: Any) -> Mesh:
    x, z = cylinder.size.x / 2, cylinder.size.z / 2
    profile = [(0.0, -z), (x * cylinder.bottom_scale, -z), (x * cylinder.top_scale, z), (0.0, z)]
    return lathe(profile, (1, 1, 1), 24)


def read_glb(content: bytes) -> list[Mesh]:
    """The meshes of a file from :func:`shuttle_marl.scene.mesh.glb`."""
    document = gltf.GLTF2().load_from_bytes(content)
    out = []
    for primitive in document.meshes[0].primitives:
        material = document.materials[primitive.material]
        red, green, blue, _ = material.pbrMetallicRoughness.baseColorFactor
        out.append(
            Mesh(
                vertices=_z_up(read_array(document, primitive.attributes.POSITION).astype(np.float64)),
                normals=_z_up(read_array(document, primitive.attributes.NORMAL).astype(np.float64)),
                triangles=read_array(document, primitive.indices).reshape(-1, 3).astype(np.int64),
                colour=(red, green, blue),
                two_sided=material.doubleSided,
            )
        )
    return out


def _z_up(v: F64) -> F64:
    return np.stack([v[:, 0], -v[:, 2], v[:, 1]], axis=1)
