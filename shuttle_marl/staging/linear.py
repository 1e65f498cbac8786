"""Operations on vectors and 3 by 3 matrices in plain loops; ``out`` is written and must not overlap the inputs."""

import math

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.compiling import compiled


@compiled
def rotation_about(axis: F64, angle: float, out: F64) -> None:
    """``[3, 3]`` rotation about a unit axis by an angle [rad] (Rodrigues)."""
    x, y, z = axis[0], axis[1], axis[2]
    s, c = math.sin(angle), math.cos(angle)
    d = 1.0 - c
    out[0, 0], out[0, 1], out[0, 2] = c + d * x * x, d * x * y - s * z, d * x * z + s * y
    out[1, 0], out[1, 1], out[1, 2] = d * x * y + s * z, c + d * y * y, d * y * z - s * x
    out[2, 0], out[2, 1], out[2, 2] = d * x * z - s * y, d * y * z + s * x, c + d * z * z


@compiled
def copy_vec(a: F64, out: F64) -> None:
    """Copy a vector; slice assignment takes long to compile."""
    for i in range(len(a)):
        out[i] = a[i]


@compiled
def copy_mat(a: F64, out: F64) -> None:
    """Copy a matrix."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, j]


@compiled
def add_vec(a: F64, b: F64, out: F64) -> None:
    """Sum of two vectors."""
    for i in range(3):
        out[i] = a[i] + b[i]


@compiled
def mat_mul(a: F64, b: F64, out: F64) -> None:
    """``a @ b``."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@compiled
def mat_vec(a: F64, v: F64, out: F64) -> None:
    """``a @ v``."""
    for i in range(3):
        out[i] = a[i, 0] * v[0] + a[i, 1] * v[1] + a[i, 2] * v[2]


@compiled
def cross(a: F64, b: F64, out: F64) -> None:
    """Cross product."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@compiled
def transposed_mat_mul(a: F64, b: F64, out: F64) -> None:
    """``a.T @ b``."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[0, i] * b[0, j] + a[1, i] * b[1, j] + a[2, i] * b[2, j]


@compiled
def mat_mul_transposed(a: F64, b: F64, out: F64) -> None:
    """``a @ b.T``."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[j, 0] + a[i, 1] * b[j, 1] + a[i, 2] * b[j, 2]


@compiled
def dot(a: F64, b: F64) -> float:
    """Dot product."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@compiled
def normalise(v: F64) -> None:
    """Scale a vector to unit length, in place; zero stays zero."""
    length = max(math.sqrt(dot(v, v)), 1e-12)
    for i in range(3):
        v[i] /= length


@compiled
def orthonormal_frame(first: F64, second: F64, out: F64) -> None:
    """Right-handed frame whose columns are ``first``, ``second`` made orthogonal to it, and their product."""
    length = max(math.sqrt(dot(first, first)), 1e-12)
    for i in range(3):
        out[i, 0] = first[i] / length
    along = out[0, 0] * second[0] + out[1, 0] * second[1] + out[2, 0] * second[2]
    square = 0.0
    for i in range(3):
        out[i, 1] = second[i] - along * out[i, 0]
        square += out[i, 1] * out[i, 1]
    length = max(math.sqrt(square), 1e-12)
    for i in range(3):
        out[i, 1] /= length
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i, 2] = out[j, 0] * out[k, 1] - out[k, 0] * out[j, 1]


@compiled
def from_yaw_pitch_roll(yaw: float, pitch: float, roll: float, out: F64) -> None:
    """``[3, 3]`` rotation: turn left by ``yaw``, then bow forward by ``pitch``, then lean right by ``roll`` [rad]."""
    cy, sy, cp, sp, cr, sr = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch), math.cos(roll), math.sin(roll)
    out[0, 0], out[0, 1], out[0, 2] = cy * cr + sy * sp * sr, -sy * cp, cy * sr - sy * sp * cr
    out[1, 0], out[1, 1], out[1, 2] = sy * cr - cy * sp * sr, cy * cp, sy * sr + cy * sp * cr
    out[2, 0], out[2, 1], out[2, 2] = -cp * sr, -sp, cp * cr
