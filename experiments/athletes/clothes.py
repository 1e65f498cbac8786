"""Adds shirt, shorts, socks, shoes and hair to a body, as separate parts so that renderers can colour the kit.

Garments are copies of the skin, offset outwards and smoothed; shoes are the convex hulls of slices of the foot. Skin
under clothes is removed.
"""

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import ConvexHull, cKDTree

from experiments.athletes.base_mesh import Body
from shuttle_marl.base.arrays import F64, I64, Bools

SOLE: Final = 0.014
"""Thickness of the soles [m]: the floor of a dressed athlete lies this far under the bare feet."""
_SLEEVE: Final = 0.50
"""Length of the sleeves as a fraction of the upper arm."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Part:
    """Triangles of one material.

    Attributes:
        material: its name.
        vertices: ``[V, 3]`` [m].
        normals: ``[V, 3]`` unit.
        weights: ``[V, J]`` skin weights.
        triangles: ``[T, 3]``.
    """

    material: str
    vertices: F64
    normals: F64
    weights: F64
    triangles: I64


def dress(body: Body) -> list[Part]:
    """All parts of a dressed athlete."""
    return _Tailor(body).parts()


class _Tailor:
    """The measures of one body."""

    def __init__(self, body: Body) -> None:
        self.body = body
        self.normals = vertex_normals(body.vertices, body.faces)
        self.centre = body.vertices[body.faces].mean(axis=1)
        self.weight = body.weights[body.faces].mean(axis=1)
        self.neck, self.hips = body.head("Neck")[1], body.head("Hips")[1]
        self.knee, self.ankle = body.head("LeftLeg")[1], body.head("LeftFoot")[1]
        self.hem, self.shorts_end = self.hips - 0.085, self.knee + 0.13
        hand = np.zeros(len(body.faces), dtype=bool)
        for side in ("Left", "Right"):
            hand |= self._share(*(b for b in body.bones if b.startswith(f"{side}Hand"))) > 0.5
        sleeves = []
        arm = hand
        for side in ("Left", "Right"):
            limb = self._share(f"{side}Arm", f"{side}ForeArm", f"{side}Hand") > 0.5
            along = _along(self.centre, body.head(f"{side}Arm"), body.head(f"{side}ForeArm"))
            sleeves.append(limb & (along < _SLEEVE + 0.02))
            arm = arm | limb
        self.arm, self.sleeve = arm, sleeves[0] | sleeves[1]
        self.deep_sleeve = self.sleeve & ~np.logical_or.reduce(
            [_along(self.centre, body.head(f"{s}Arm"), body.head(f"{s}ForeArm")) > _SLEEVE - 0.1 for s in ("Left", "Right")]
        )

    def _share(self, *bones: str) -> F64:
        """``[F]`` summed weight of some bones."""
        total: F64 = self.weight[:, [self.body.bone(b) for b in bones]].sum(axis=1)
        return total

    def parts(self) -> list[Part]:
        """Skin, clothes, shoes, hair, eyes."""
        y, z = self.centre[:, 1], self.centre[:, 2]
        head = self._share("Head") > 0.5
        collar = self.neck + 0.02 - (z - self.body.head("Neck")[2]) * 0.55
        shirt = (~self.arm & ~head & (y < collar) & (y > self.hem)) | self.sleeve
        shorts = ~self.arm & (y < self.hips + 0.06) & (y > self.shorts_end)
        shoe_top = self.ankle + 0.012
        sock = (y < self.ankle + 0.085) & (y >= shoe_top - 0.02) & ~self.arm
        shoe = (y < shoe_top) & ~self.arm
        hidden = shirt & ~self.sleeve & (y < collar - 0.02) & (y > self.hem + 0.02)
        hidden |= self.deep_sleeve | ((y < self.hips + 0.02) & (y > self.shorts_end + 0.05) & ~self.arm)
        hidden |= (y < shoe_top - 0.015) & ~self.arm
        body = self.body
        parts = [
            self._part("skin", body.vertices, body.faces[~hidden]),
            self._shirt(shirt),
            self._shorts(shorts),
            self._garment("sock", sock, 0.005, 2, snap=_level(lambda p: p[:, 1] > self.ankle + 0.06, self.ankle + 0.085)),
            *self._shoes(shoe),
            self._hair(head),
            *self._eyes(),
        ]
        for part in parts:
            part.vertices[:, 1] += SOLE
        return parts

    def _part(self, material: str, vertices: F64, quads: I64, weights: F64 | None = None) -> Part:
        used, inverse = np.unique(quads, return_inverse=True)
        quads_used = inverse.reshape(quads.shape)
        normals = vertex_normals(vertices, quads)
        triangles = np.concatenate([quads_used[:, [0, 1, 2]], quads_used[:, [0, 2, 3]]])
        a, b, c = triangles.T
        return Part(
            material=material,
            vertices=vertices[used].copy(),
            normals=normals[used],
            weights=(self.body.weights if weights is None else weights)[used],
            triangles=triangles[(a != b) & (b != c) & (a != c)],
        )

    def _garment(
        self,
        material: str,
        mask: Bools,
        offset: float,
        smoothing: int,
        *,
        grow: Callable[[F64], F64] | None = None,
        shape: Callable[[F64], F64] | None = None,
        snap: Callable[[F64, Bools], F64] | None = None,
    ) -> Part:
        """A copy of the skin under ``mask``, ``offset`` metres away (plus what ``grow`` adds), smoothed and hemmed."""
        body = self.body
        quads = body.faces[mask]
        away = np.full(len(body.vertices), offset) + (0 if grow is None else grow(body.vertices))
        vertices = body.vertices + self.normals * away[:, None]
        if shape is not None:
            vertices = shape(vertices)
        inner, border, on_border = _neighbours(quads, len(vertices))
        for _ in range(smoothing):
            vertices = _relaxed(vertices, inner)
        if snap is not None:
            vertices = snap(vertices, on_border)
            for _ in range(2):
                vertices = _relaxed(vertices, border)
        depth = ((vertices - body.vertices) * self.normals).sum(axis=1)
        vertices = vertices + self.normals * np.maximum(0, 0.55 * offset - depth)[:, None]
        return self._part(material, vertices, quads)

    def _shirt(self, mask: Bools) -> Part:
        body = self.body

        def snap(points: F64, border: Bools) -> F64:
            points = _level(lambda p: p[:, 1] < self.hem + 0.06, self.hem)(points, border)
            for side, sign in (("Left", 1), ("Right", -1)):
                start, end = body.head(f"{side}Arm"), body.head(f"{side}ForeArm")
                rows = border & (sign * points[:, 0] > 0.2)
                points[rows] += (_SLEEVE - _along(points[rows], start, end))[:, None] * (end - start)
            return points

        return self._garment(
            "shirt", mask, 0.011, 10, grow=lambda p: 0.02 * np.clip((self.neck - 0.18 - p[:, 1]) / 0.45, 0, 1), snap=snap
        )

    def _shorts(self, mask: Bools) -> Part:
        body = self.body

        def flare(points: F64) -> F64:
            top = self.hips - 0.05
            share = np.clip((top - points[:, 1]) / (top - self.shorts_end), 0, 1)[:, None]
            out = points.copy()
            for side, sign in (("Left", 1), ("Right", -1)):
                start, end = body.head(f"{side}UpLeg"), body.head(f"{side}Leg")
                axis = start + (end - start) * np.clip(_along(points, start, end), 0, 1)[:, None]
                out = np.where((sign * points[:, 0] > 0)[:, None], axis + (points - axis) * (1 + 0.2 * share), out)
            return out

        hem = _level(lambda p: p[:, 1] < self.shorts_end + 0.06, self.shorts_end)
        return self._garment("shorts", mask, 0.016, 8, shape=flare, snap=hem)

    def _hair(self, head: Bools) -> Part:
        body, (_, y, z) = self.body, self.centre.T
        base = body.head("Head")
        top = body.vertices[np.unique(body.faces[head]), 1].max() - base[1]
        line = np.where(z > base[2] + 0.045, 0.80, np.where(z > base[2] - 0.01, 0.60, 0.30))
        scalp = head & (y > base[1] + top * line)

        def crown(p: F64) -> F64:
            return 0.006 + 0.010 * np.clip((p[:, 1] - (base[1] + 0.7 * top)) / (0.3 * top), 0, 1)

        return self._garment("hair", scalp, 0.008, 5, grow=crown)

    def _eyes(self) -> list[Part]:
        body = self.body
        centres = body.vertices[body.eyes].mean(axis=1)
        middle, front = np.median(centres[:, 2]), centres[:, 2].max()
        iris = body.eyes[centres[:, 2] > middle + 0.85 * (front - middle)]
        return [
            self._part("eye", body.vertices, body.eyes),
            self._part("iris", body.vertices + np.array([0, 0, 0.0006]), iris),
        ]

    def _shoes(self, mask: Bools) -> list[Part]:
        body = self.body
        skin = np.unique(body.faces)
        tree = cKDTree(body.vertices[skin])
        uppers, soles = [], []
        for sign in (1, -1):
            foot = body.vertices[np.unique(body.faces[mask & (sign * self.centre[:, 0] > 0)])]
            vertices, quads = _shoe(foot)
            weights = body.weights[skin[tree.query(vertices)[1]]]
            upper = vertices[quads].mean(axis=1)[:, 1] > 0.012
            uppers.append(self._part("shoe", vertices, quads[upper], weights))
            soles.append(self._part("sole", vertices, quads[~upper], weights))
        return uppers + soles


def vertex_normals(vertices: F64, quads: I64) -> F64:
    """``[V, 3]`` unit normals, weighted by area; zero for vertices without a face."""
    a, b, c, d = (vertices[quads[:, k]] for k in range(4))
    face = np.cross(c - a, d - b)
    out = np.zeros_like(vertices)
    for k in range(4):
        np.add.at(out, quads[:, k], face)
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-12)


def _along(points: F64, start: F64, end: F64) -> F64:
    """Position of points along a segment: 0 at its start, 1 at its end."""
    axis = end - start
    share: F64 = (points - start) @ axis / (axis @ axis)
    return share


def _level(where: Callable[[F64], Bools], y: float) -> Callable[[F64, Bools], F64]:
    """A hem: border vertices that satisfy ``where`` move to height ``y``."""

    def snap(points: F64, border: Bools) -> F64:
        points = points.copy()
        points[border & where(points), 1] = y
        return points

    return snap


def _neighbours(quads: I64, n: int) -> tuple[csr_array, csr_array, Bools]:
    """Averaging matrices of a patch: over all edges (along the border only for border vertices), over border edges."""
    edges = np.concatenate([quads[:, [k, (k + 1) % 4]] for k in range(4)])
    edges = np.sort(edges[edges[:, 0] != edges[:, 1]], axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    rim = unique[count == 1]
    on_border = np.zeros(n, dtype=bool)
    on_border[rim] = True
    both = np.concatenate([unique, unique[:, ::-1]])
    rim_both = np.concatenate([rim, rim[:, ::-1]])
    inside = both[~on_border[both[:, 0]]]
    return _average(np.concatenate([inside, rim_both]), n), _average(rim_both, n), on_border


def _average(edges: I64, n: int) -> csr_array:
    degree = np.bincount(edges[:, 0], minlength=n)
    return csr_array((1.0 / degree[edges[:, 0]], (edges[:, 0], edges[:, 1])), shape=(n, n))


def _relaxed(vertices: F64, average: csr_array) -> F64:
    """Move each vertex half way to the mean of its neighbours; vertices without neighbours do not move."""
    has = np.diff(average.indptr) > 0
    mean = average @ vertices
    return np.where(has[:, None], 0.5 * (vertices + mean), vertices)


def _shoe(foot: F64, rings: int = 22, spokes: int = 28, margin: float = 0.007) -> tuple[F64, I64]:
    """A closed shoe around the vertices of a foot: rings across it, each the support function of the hull of a slice."""
    low, high = foot[:, 2].min(), foot[:, 2].max()
    stations = np.r_[
        low - 0.008,
        low - 0.004,
        low + 0.004,
        np.linspace(low + 0.016, high - 0.012, rings - 6),
        high + np.array([-0.004, 0.006, 0.01]),
    ]
    shrink = np.ones(rings)
    shrink[:3], shrink[-3:] = (0.35, 0.75, 0.95), (0.96, 0.72, 0.35)
    angle = np.linspace(0, 2 * np.pi, spokes, endpoint=False)
    ray = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    span = 4 * (high - low) / 14
    out = np.empty((rings, spokes, 3))
    for i, (z, scale) in enumerate(zip(stations, shrink, strict=True)):
        middle = np.clip(z, low + span / 2, high - span / 2)
        slab = foot[np.abs(foot[:, 2] - middle) <= span / 2 + 1e-6]
        outline = slab[ConvexHull(slab[:, :2]).vertices, :2]
        centre = (outline.min(axis=0) + outline.max(axis=0)) / 2
        radius = ((outline - centre) @ ray.T).max(axis=0) + margin
        out[i, :, :2] = centre + scale * radius[:, None] * ray
        out[i, :, 2] = z
    for _ in range(2):
        out[1:-1] = 0.25 * out[:-2] + 0.5 * out[1:-1] + 0.25 * out[2:]
    out[..., 1] = np.where(out[..., 1] < 0.004, -SOLE, out[..., 1])
    ring, spoke = np.meshgrid(np.arange(rings - 1), np.arange(spokes), indexing="ij")
    after = (spoke + 1) % spokes
    sides = np.stack(
        [ring * spokes + spoke, ring * spokes + after, (ring + 1) * spokes + after, (ring + 1) * spokes + spoke], axis=-1
    )
    vertices = np.concatenate([out.reshape(-1, 3), out[0].mean(axis=0)[None], out[-1].mean(axis=0)[None]])
    heel, toe = len(vertices) - 2, len(vertices) - 1
    k = np.arange(spokes)
    last = (rings - 1) * spokes
    caps = [
        np.stack([np.full(spokes, heel), (k + 1) % spokes, k, k], axis=1),
        np.stack([np.full(spokes, toe), last + k, last + (k + 1) % spokes, last + (k + 1) % spokes], axis=1),
    ]
    return vertices, np.concatenate([sides.reshape(-1, 4), *caps])
