"""Rotations as matrices and quaternions, for arrays of any leading shape. Quaternions are ``(x, y, z, w)``, as in glTF.

Conversions are :mod:`scipy`'s. Rotations about fixed axes and the angles of the body are not: on the small arrays of the
staging its Euler angles take several times as long.
"""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from shuttle_marl.base.arrays import F64, Floats
from shuttle_marl.base.compiling import compiled

_NEXT, _AFTER = [1, 2, 0], [2, 0, 1]


def unit(v: F64) -> F64:
    """Vectors of length one; zero stays zero."""
    return v / np.maximum(np.sqrt((v * v).sum(axis=-1, keepdims=True)), 1e-12)


def cross(a: F64, b: F64) -> F64:
    """Vector products ``[..., 3]``; several times faster than numpy's for small arrays."""
    out: F64 = a[..., _NEXT] * b[..., _AFTER] - a[..., _AFTER] * b[..., _NEXT]
    return out


def _terms(x: float, y: float, z: float) -> tuple[F64, F64, F64]:
    """Terms of Rodrigues' formula for a unit axis: constant, factor of sin(angle), and factor of -cos(angle)."""
    sine = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + sine @ sine, sine, sine @ sine


def _about(terms: tuple[F64, F64, F64], angle: F64 | float) -> F64:
    rest, sine, cosine = terms
    angle = np.asarray(angle, dtype=np.float64)[..., None, None]
    out: F64 = rest + np.sin(angle) * sine - np.cos(angle) * cosine
    return out


def turned(angle: F64 | float) -> F64:
    """``[..., 3, 3]`` rotation about the vertical, anticlockwise seen from above [rad]."""
    return _about(_TURN, angle)


def from_yaw_pitch_roll(yaw: F64, pitch: F64, roll: F64) -> F64:
    """``[..., 3, 3]`` turn left by ``yaw``, then bow forward by ``pitch``, then lean right by ``roll`` [rad].

    The axes are the body's own: x to the right, y forward, z up.
    """
    return _about(_TURN, yaw) @ _about(_BOW, pitch) @ _about(_LEAN, roll)


def apply(rotation: F64, v: F64) -> F64:
    """Rotate vectors ``[..., 3]`` by matrices ``[..., 3, 3]``."""
    out: F64 = np.matmul(rotation, v[..., None])[..., 0]
    return out


def frame(first: F64, second: F64) -> F64:
    """``[..., 3, 3]`` right-handed frame whose columns are ``first``, ``second`` made orthogonal to it, and their product."""
    a = unit(first)
    b = unit(second - (a * second).sum(axis=-1, keepdims=True) * a)
    return np.stack([a, b, cross(a, b)], axis=-1)


def quaternion(rotation: F64) -> F64:
    """``[..., 4]`` quaternions (x, y, z, w) of matrices, w not negative."""
    return _quaternions(np.ascontiguousarray(rotation, dtype=np.float64).reshape(-1, 3, 3)).reshape(*rotation.shape[:-2], 4)


@compiled
def _quaternions(rotation: F64) -> F64:
    """``[N, 4]`` quaternions (x, y, z, w) of ``[N, 3, 3]`` rotations, w not negative, by the largest one (Shepperd 1978)."""
    out, q = np.empty((len(rotation), 4)), np.empty(4)
    for n in range(len(rotation)):
        r = rotation[n]
        trace = r[0, 0] + r[1, 1] + r[2, 2]
        largest, most = 3, trace
        for i in range(3):
            if r[i, i] > most:
                largest, most = i, r[i, i]
        if largest == 3:
            q[3] = 1.0 + trace
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                q[i] = r[k, j] - r[j, k]
        else:
            i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
            q[i] = 1.0 - trace + 2.0 * r[i, i]
            q[j], q[k], q[3] = r[j, i] + r[i, j], r[k, i] + r[i, k], r[k, j] - r[j, k]
        length = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
        if q[3] < 0:
            length = -length
        for i in range(4):
            out[n, i] = q[i] / length
    return out


def matrix(q: Floats) -> F64:
    """``[..., 3, 3]`` matrices of quaternions (x, y, z, w) of any length but 0."""
    return Rotation.from_quat(q.reshape(-1, 4)).as_matrix().reshape(*q.shape[:-1], 3, 3)


_TURN, _BOW, _LEAN = _terms(0.0, 0.0, 1.0), _terms(-1.0, 0.0, 0.0), _terms(0.0, 1.0, 0.0)
