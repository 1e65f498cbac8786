"""Software rasteriser of triangles and lines, with depth buffer, smooth shading and transparency."""

import dataclasses
import math
from typing import Any

import numba
import numpy as np

from shuttle_marl.base.arrays import F64, I64, U8
from shuttle_marl.staging.rotation import unit

_NEAR = 0.2
_LIGHT = unit(np.array([0.35, -0.45, 0.85]))
_SKY, _SUN = 0.52, 0.62


@dataclasses.dataclass(frozen=True, kw_only=True)
class Camera:
    """Viewpoint of a picture.

    Attributes:
        place: position in the frame of the court [m].
        target: point in the middle of the picture [m].
        field: vertical field of view [degrees].
    """

    place: tuple[float, float, float] = (10.3, -6.7, 5.9)
    target: tuple[float, float, float] = (-0.4, 0.1, 1.0)
    field: float = 39.0

    def project(self, points: F64, width: int, height: int) -> F64:
        """``[N, 3]`` horizontal and vertical pixel, and depth along the viewing direction [m]."""
        place, target = np.array(self.place), np.array(self.target)
        ahead = unit(target - place)
        right = unit(np.cross(ahead, [0.0, 0.0, 1.0]))
        up = np.cross(right, ahead)
        seen = (points - place) @ np.stack([right, up, ahead], axis=1)
        depth = np.maximum(seen[:, 2], 1e-6)
        scale = height / 2 / math.tan(math.radians(self.field) / 2)
        out: F64 = np.stack([width / 2 + scale * seen[:, 0] / depth, height / 2 - scale * seen[:, 1] / depth, seen[:, 2]], axis=1)
        return out


class Canvas:
    """A picture, drawn at twice its resolution.

    Args:
        width: width of the picture [pixels].
        height: height of the picture [pixels].
        camera: viewpoint.
        background: linear red, green, blue.
    """

    def __init__(self, width: int, height: int, camera: Camera, background: tuple[float, float, float]) -> None:
        self._size = (2 * width, 2 * height)
        self._camera = camera
        self._pixels = np.tile(np.array(background), (2 * height, 2 * width, 1)).astype(np.float64)
        self._nearness = np.zeros((2 * height, 2 * width))

    def triangles(self, vertices: F64, normals: F64, faces: I64, colour: F64) -> None:
        """Draw lit triangles.

        Args:
            vertices: ``[V, 3]`` [m].
            normals: ``[V, 3]`` unit.
            faces: ``[T, 3]``.
            colour: linear red, green, blue, and alpha; below 1 the triangles are blended and do not change the depth.
        """
        towards = unit(np.array(self._camera.place) - vertices)
        facing = np.where((normals * towards).sum(axis=1, keepdims=True) < 0, -normals, normals)
        lit = _SKY + _SUN * np.clip(facing @ _LIGHT, 0, 1) + 0.10 * facing[:, 2]
        shade = np.clip(lit[:, None] * colour[:3], 0, 1)
        seen = self._camera.project(vertices, *self._size)
        faces = faces[(seen[:, 2][faces] > _NEAR).all(axis=1)]
        _fill(self._pixels, self._nearness, seen, shade, faces, float(colour[3]))

    def line(self, points: F64, colours: F64, width: float) -> None:
        """Draw a line ``[P, 3]`` [m] in colours ``[P, 4]`` (linear, alpha), ``width`` pixels wide."""
        seen = self._camera.project(points, *self._size)
        for a in range(len(points) - 1):
            if min(seen[a, 2], seen[a + 1, 2]) > _NEAR:
                _stroke(self._pixels, self._nearness, seen[a], seen[a + 1], colours[a], colours[a + 1], width)

    def image(self) -> U8:
        """``[height, width, 3]`` picture in sRGB."""
        height, width, _ = self._pixels.shape
        mean = self._pixels.reshape(height // 2, 2, width // 2, 2, 3).mean(axis=(1, 3))
        seen = np.where(mean <= 0.0031308, 12.92 * mean, 1.055 * np.maximum(mean, 1e-9) ** (1 / 2.4) - 0.055)
        return np.rint(255 * np.clip(seen, 0, 1)).astype(np.uint8)


def linear(colour: F64) -> F64:
    """Linear colours of sRGB colours, with alpha last."""
    out = np.array(colour, dtype=np.float64)
    rgb = out[..., :3]
    out[..., :3] = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return out


def _compiled(function: Any) -> Any:
    return numba.njit(cache=True)(function)


@_compiled
def _fill(pixels: Any, nearness: Any, seen: Any, shade: Any, faces: Any, alpha: float) -> None:
    height, width = nearness.shape
    for t in range(len(faces)):
        i, j, k = faces[t]
        x0, y0, x1, y1, x2, y2 = seen[i, 0], seen[i, 1], seen[j, 0], seen[j, 1], seen[k, 0], seen[k, 1]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if abs(area) < 1e-9:
            continue
        first, last = max(0, math.floor(min(x0, x1, x2))), min(width - 1, math.ceil(max(x0, x1, x2)))
        top, bottom = max(0, math.floor(min(y0, y1, y2))), min(height - 1, math.ceil(max(y0, y1, y2)))
        z0, z1, z2 = 1 / seen[i, 2], 1 / seen[j, 2], 1 / seen[k, 2]
        for y in range(top, bottom + 1):
            for x in range(first, last + 1):
                px, py = x + 0.5, y + 0.5
                b = ((px - x0) * (y2 - y0) - (x2 - x0) * (py - y0)) / area
                c = ((x1 - x0) * (py - y0) - (px - x0) * (y1 - y0)) / area
                a = 1 - b - c
                if a < 0 or b < 0 or c < 0:
                    continue
                near = a * z0 + b * z1 + c * z2
                if near <= nearness[y, x]:
                    continue
                if alpha >= 1:
                    nearness[y, x] = near
                for channel in range(3):
                    value = (a * z0 * shade[i, channel] + b * z1 * shade[j, channel] + c * z2 * shade[k, channel]) / near
                    pixels[y, x, channel] += alpha * (value - pixels[y, x, channel])


@_compiled
def _stroke(pixels: Any, nearness: Any, start: Any, end: Any, first: Any, last: Any, width: float) -> None:
    height, across = nearness.shape
    dx, dy = end[0] - start[0], end[1] - start[1]
    length = math.sqrt(dx * dx + dy * dy)
    if length < 1e-9:
        return
    half = max(width, 1.0) / 2
    x_from, x_to = max(0, int(min(start[0], end[0]) - half)), min(across - 1, int(max(start[0], end[0]) + half) + 1)
    y_from, y_to = max(0, int(min(start[1], end[1]) - half)), min(height - 1, int(max(start[1], end[1]) + half) + 1)
    for y in range(y_from, y_to + 1):
        for x in range(x_from, x_to + 1):
            px, py = x + 0.5 - start[0], y + 0.5 - start[1]
            u = (px * dx + py * dy) / (length * length)
            # Half open, so that consecutive segments share no pixel.
            if u < 0 or u >= 1 or abs(px * dy - py * dx) / length > half:
                continue
            near = (1 - u) / start[2] + u / end[2]
            # Lines on a surface are visible.
            if near * 1.002 < nearness[y, x]:
                continue
            alpha = (1 - u) * first[3] + u * last[3]
            for channel in range(3):
                value = (1 - u) * first[channel] + u * last[channel]
                pixels[y, x, channel] += alpha * (value - pixels[y, x, channel])
