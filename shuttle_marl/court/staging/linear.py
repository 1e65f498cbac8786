"""Vectors and 3 by 3 matrices as tuples, which compiled code keeps in registers; inputs may be arrays too."""

import math

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.compiling import compiled

Vec = tuple[float, float, float]
Mat = tuple[Vec, Vec, Vec]
"""Rows of a matrix."""


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
def from_yaw_pitch_roll(yaw: float, pitch: float, roll: float) -> Mat:
    """Rotation: turn left by ``yaw``, then bow forward by ``pitch``, then lean right by ``roll`` [rad]."""
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
    """Sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@compiled
def sub(a: F64 | Vec, b: F64 | Vec) -> Vec:
    """Difference of two vectors."""
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
    """Dot product."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@compiled
def cross(a: F64 | Vec, b: F64 | Vec) -> Vec:
    """Cross product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def unit(v: F64 | Vec) -> Vec:
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
def orthonormal_frame(first: F64 | Vec, second: F64 | Vec) -> Mat:
    """Right-handed frame whose columns are ``first``, ``second`` made orthogonal to it, and their product."""
    a = unit(first)
    b = unit(sub(second, scaled(dot(a, second), a)))
    return transposed((a, b, cross(a, b)))
