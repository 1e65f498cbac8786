"""Vectors, rotations and curves; quaternions are ``(x, y, z, w)``.

Compiled functions of single vectors take arrays too and give tuples, which stay in registers; the others take any leading
shape.
"""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from shuttle_marl.base.arrays import F64, I64, Floats
from shuttle_marl.base.compiling import compiled

Vec = tuple[float, float, float]
Mat = tuple[Vec, Vec, Vec]  # rows of a matrix


@compiled
def rotation_about(axis: F64 | Vec, angle: float) -> Mat:
    """Rotation about a unit axis by an angle [rad] (Rodrigues)."""
    x, y, z = axis[0], axis[1], axis[2]
    s, c = math.sin(angle), math.cos(angle)
    d = 1.0 - c
    return (
        (c + d * x * x, d * x * y - s * z, d * x * z + s * y),
        (d * x * y + s * z, c + d * y * y, d * y * z - s * x),
        (d * x * z - s * y, d * y * z + s * x, c + d * z * z),
    )


@compiled
def turned_by(yaw: float, pitch: float, roll: float) -> Mat:
    """:func:`from_yaw_pitch_roll` of three angles."""
    cy, sy, cp, sp, cr, sr = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch), math.cos(roll), math.sin(roll)
    return (
        (cy * cr + sy * sp * sr, -sy * cp, cy * sr - sy * sp * cr),
        (sy * cr - cy * sp * sr, cy * cp, sy * sr + cy * sp * cr),
        (-cp * sr, -sp, cp * cr),
    )


@compiled
def put_vec(v: F64 | Vec, out: F64) -> None:
    """Write a vector."""
    for i in range(3):
        out[i] = v[i]


@compiled
def put_mat(m: F64 | Mat, out: F64) -> None:
    """Write a matrix."""
    for i in range(3):
        put_vec(m[i], out[i])


@compiled
def add(a: F64 | Vec, b: F64 | Vec) -> Vec:
    """``a + b``."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@compiled
def sub(a: F64 | Vec, b: F64 | Vec) -> Vec:
    """``a - b``."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@compiled
def scaled(s: float, v: F64 | Vec) -> Vec:
    """``s * v``."""
    return s * v[0], s * v[1], s * v[2]


@compiled
def over(v: F64 | Vec, s: float) -> Vec:
    """``v / s``."""
    return v[0] / s, v[1] / s, v[2] / s


@compiled
def dot(a: F64 | Vec, b: F64 | Vec) -> float:
    """``a @ b``."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@compiled
def cross_of(a: F64 | Vec, b: F64 | Vec) -> Vec:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def unit_of(v: F64 | Vec) -> Vec:
    """The vector scaled to unit length; zero stays zero."""
    return over(v, max(math.sqrt(dot(v, v)), 1e-12))


@compiled
def transposed(m: F64 | Mat) -> Mat:
    """``m.T``."""
    return (m[0][0], m[1][0], m[2][0]), (m[0][1], m[1][1], m[2][1]), (m[0][2], m[1][2], m[2][2])


@compiled
def mat_vec(m: F64 | Mat, v: F64 | Vec) -> Vec:
    """``m @ v``."""
    return dot(m[0], v), dot(m[1], v), dot(m[2], v)


@compiled
def mat_mul(a: F64 | Mat, b: F64 | Mat) -> Mat:
    """``a @ b``."""
    columns = transposed(b)
    return mat_vec(columns, a[0]), mat_vec(columns, a[1]), mat_vec(columns, a[2])


@compiled
def frame_of(first: F64 | Vec, second: F64 | Vec) -> Mat:
    """:func:`frame` of two vectors."""
    a = unit_of(first)
    b = unit_of(sub(second, scaled(dot(a, second), a)))
    return transposed((a, b, cross_of(a, b)))


def unit(v: F64) -> F64:
    """Vectors of length one; zero stays zero."""
    return v / np.maximum(np.sqrt((v * v).sum(axis=-1, keepdims=True)), 1e-12)


def cross(a: F64, b: F64) -> F64:
    """Vector products ``[..., 3]``; several times faster than numpy's for small arrays."""
    out: F64 = a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]
    return out


def _terms(x: float, y: float, z: float) -> tuple[F64, F64, F64]:
    """Terms of Rodrigues' formula for a unit axis: constant, factor of sin(angle), and factor of -cos(angle)."""
    sine = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + sine @ sine, sine, sine @ sine


_TURN, _BOW, _LEAN = _terms(0.0, 0.0, 1.0), _terms(-1.0, 0.0, 0.0), _terms(0.0, 1.0, 0.0)


def _about(terms: tuple[F64, F64, F64], angle: F64 | float) -> F64:
    rest, sine, cosine = terms
    angle = np.asarray(angle, dtype=np.float64)[..., None, None]
    out: F64 = rest + np.sin(angle) * sine - np.cos(angle) * cosine
    return out


def turned(angle: F64 | float) -> F64:
    """``[..., 3, 3]`` rotation about the vertical, anticlockwise seen from above [rad]."""
    return _about(_TURN, angle)


def from_yaw_pitch_roll(yaw: F64, pitch: F64, roll: F64) -> F64:
    """``[..., 3, 3]`` turn left by ``yaw``, then bow forward by ``pitch``, then lean right by ``roll`` [rad]. The axes are the
    body's own: x to the right, y forward, z up."""
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
    """``[N, 4]`` quaternions of ``[N, 3, 3]`` rotations, from the largest component (Shepperd 1978)."""
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


@compiled
def _at_end(near: float, far: float, chord: float, next_chord: float) -> float:
    """Slope at an end of a curve, from the lengths and the chords of the two intervals next to it."""
    slope = ((2 * near + far) * chord - near * next_chord) / (near + far)
    if slope * chord <= 0:
        return 0.0
    if chord * next_chord <= 0 and abs(slope) > 3 * abs(chord):
        return 3 * chord
    return slope


@compiled
def slopes_through(frame: I64, pose: F64) -> F64:
    """``[K, C]`` slopes per frame of monotone cubics through poses ``[K, C]`` in ascending frames (Fritsch & Butland 1984)."""
    out = np.zeros_like(pose)
    k, c = pose.shape
    for j in range(c if k > 1 else 0):
        for i in range(k):
            left = float(frame[i] - frame[i - 1]) if i else 0.0
            right = float(frame[i + 1] - frame[i]) if i + 1 < k else 0.0
            before = (pose[i, j] - pose[i - 1, j]) / left if i else 0.0
            after = (pose[i + 1, j] - pose[i, j]) / right if i + 1 < k else 0.0
            if k == 2:
                out[i, j] = after if i == 0 else before
            elif i == 0:
                further = float(frame[2] - frame[1])
                out[i, j] = _at_end(right, further, after, (pose[2, j] - pose[1, j]) / further)
            elif i == k - 1:
                further = float(frame[i - 1] - frame[i - 2])
                out[i, j] = _at_end(left, further, before, (pose[i - 1, j] - pose[i - 2, j]) / further)
            elif before * after > 0:
                first, second = 2 * right + left, right + 2 * left
                out[i, j] = (first + second) / (first / before + second / after)
    return out


@compiled
def curve(frame: I64, pose: F64, slope: F64, frames: int) -> F64:
    """``[F, C]`` cubic Hermite interpolation of poses with slopes per frame, constant before the first and after the last."""
    out = np.empty((frames, pose.shape[1]))
    last, c = len(frame) - 1, pose.shape[1]
    k = 0
    for f in range(len(out)):
        if f <= frame[0] or f >= frame[last]:
            row = 0 if f <= frame[0] else last
            for j in range(c):
                out[f, j] = pose[row, j]
            continue
        while frame[k + 1] <= f:
            k += 1
        h = float(frame[k + 1] - frame[k])
        u = (f - frame[k]) / h
        for j in range(c):
            chord = pose[k + 1, j] - pose[k, j]
            a, b = h * slope[k, j] - chord, chord - h * slope[k + 1, j]
            out[f, j] = pose[k, j] + u * chord + u * (1 - u) * ((1 - u) * a + u * b)
    return out


def curve_at(frame: I64, pose: F64, slope: F64, now: int) -> tuple[F64, F64]:
    """Value ``[C]`` and slope ``[C]`` of :func:`curve` in one frame between the first and the last key pose."""
    k = int(np.searchsorted(frame, now, side="right")) - 1
    h = float(frame[k + 1] - frame[k])
    u, chord = (now - frame[k]) / h, pose[k + 1] - pose[k]
    a, b = h * slope[k] - chord, chord - h * slope[k + 1]
    bend = (1 - u) * a + u * b
    return pose[k] + u * chord + u * (1 - u) * bend, (chord + (1 - 2 * u) * bend + u * (1 - u) * (b - a)) / h


def _held_ends(x: F64, by: int) -> F64:
    return np.concatenate([np.full(by, x[0]), x, np.full(by, x[-1])])


def widen(x: F64, by: int) -> F64:
    """``[F]`` moving maximum of ``[F]`` values within ``by`` frames."""
    return np.lib.stride_tricks.sliding_window_view(_held_ends(x, by), 2 * by + 1).max(axis=1)


def smooth(x: F64, by: int) -> F64:
    """``[F]`` moving mean of ``[F]`` values within ``by`` frames, with a Hann window."""
    kernel = np.hanning(2 * by + 3)[1:-1]
    return np.convolve(_held_ends(x, by), kernel / kernel.sum(), mode="valid")


def ease(u: F64) -> F64:
    """Smooth step from 0 at ``u`` = 0 to 1 at ``u`` = 1."""
    u = np.clip(u, 0, 1)
    return u * u * (3 - 2 * u)
