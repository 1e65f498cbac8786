"""Rotations as matrices and quaternions, for arrays of any leading shape. Quaternions are ``(x, y, z, w)``, as in glTF."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


def unit(v: Floats) -> Floats:
    """Vectors of length one; zero stays zero."""
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12)


def about(axis: Floats, angle: Floats | float) -> Floats:
    """``[..., 3, 3]`` rotation by ``angle`` [rad] about unit axes ``[..., 3]``; the two broadcast."""
    angle = np.asarray(angle, dtype=np.float64)
    x, y, z = np.moveaxis(np.broadcast_to(axis, (*np.broadcast_shapes(np.shape(axis)[:-1], angle.shape), 3)), -1, 0)
    c, s = np.cos(angle), np.sin(angle)
    d = 1 - c
    out = np.empty((*x.shape, 3, 3))
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = c + x * x * d, x * y * d - z * s, x * z * d + y * s
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = y * x * d + z * s, c + y * y * d, y * z * d - x * s
    out[..., 2, 0], out[..., 2, 1], out[..., 2, 2] = z * x * d - y * s, z * y * d + x * s, c + z * z * d
    return out


def exponential(v: Floats) -> Floats:
    """``[..., 3, 3]`` rotation by the rotation vectors ``[..., 3]`` [rad]."""
    angle = np.linalg.norm(v, axis=-1)
    return about(v / np.maximum(angle, 1e-12)[..., None], angle)


def turned(angle: Floats | float) -> Floats:
    """``[..., 3, 3]`` rotation about the vertical, anticlockwise seen from above [rad]."""
    return about(np.array([0.0, 0.0, 1.0]), angle)


def yaw_pitch_roll(yaw: Floats, pitch: Floats, roll: Floats) -> Floats:
    """``[..., 3, 3]`` turn left by ``yaw``, then bow forward by ``pitch``, then lean right by ``roll`` [rad].

    The axes are the body's own: x to the right, y forward, z up.
    """
    return turned(yaw) @ about(np.array([-1.0, 0.0, 0.0]), pitch) @ about(np.array([0.0, 1.0, 0.0]), roll)


def apply(rotation: Floats, v: Floats) -> Floats:
    """Rotate vectors ``[..., 3]`` by matrices ``[..., 3, 3]``."""
    out: Floats = np.matmul(rotation, v[..., None])[..., 0]
    return out


def frame(first: Floats, second: Floats) -> Floats:
    """``[..., 3, 3]`` right-handed frame whose columns are ``first``, ``second`` made orthogonal to it, and their product."""
    a = unit(first)
    b = unit(second - (a * second).sum(axis=-1, keepdims=True) * a)
    return np.stack([a, b, np.cross(a, b)], axis=-1)


def quaternion(rotation: Floats) -> Floats:
    """``[..., 4]`` quaternions (x, y, z, w) of matrices, w not negative."""
    m = rotation
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    # The largest of the four squared components is at least 1/4, so dividing by it is safe (Shepperd 1978).
    squares = np.stack([1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz, 1 + xx + yy + zz], axis=-1)
    a, b, c = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    d, e, f = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    columns = np.stack(
        [
            np.stack([squares[..., 0], d, e, a], axis=-1),
            np.stack([d, squares[..., 1], f, b], axis=-1),
            np.stack([e, f, squares[..., 2], c], axis=-1),
            np.stack([a, b, c, squares[..., 3]], axis=-1),
        ],
        axis=-2,
    )
    best = np.argmax(squares, axis=-1)
    q = unit(np.take_along_axis(columns, best[..., None, None], axis=-2)[..., 0, :])
    return np.where(q[..., 3:] < 0, -q, q)


def matrix(q: Floats) -> Floats:
    """``[..., 3, 3]`` matrices of unit quaternions (x, y, z, w)."""
    x, y, z, w = np.moveaxis(np.asarray(q, dtype=np.float64), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
