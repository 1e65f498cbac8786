"""Packed form of a motion, about 5 KB per second; ``docs/motion_format.md`` describes the format.

Rotations relative to the parent bone (three components of each quaternion), positions of the hips, and positions of the shuttle
outside flights are quantised and stored as second differences, byte by byte, then deflated. A JSON header holds the data of the
rally and of each stroke. Positions of bones follow from hips and rotations, positions of a flying shuttle from its launch.
"""

import dataclasses
import json
import zlib
from typing import Any, Final

import numpy as np

from shuttle_marl.arrays import F64, I64, Bools, Floats, Ints
from shuttle_marl.staging.rotation import apply, matrix, quaternion
from shuttle_marl.staging.skeleton import N_BONES, StagingError

MAGIC: Final = b"SMOT"
VERSION: Final = 1
BITS: Final = 15
"""Bits of each component of a quaternion."""
HIPS_STEP: Final = 2.5e-4
"""Step of the places of the hips [m]."""
SHUTTLE_STEP: Final = 5e-4
"""Step of the places of the shuttle outside flights [m]."""
_OTHERS: Final = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
_LARGEST: Final = 1 << 26
"""Maximum size of an inflated motion in bytes: about an hour."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Frames:
    """Numbers packed for every frame: F frames, two players.

    Attributes:
        hips: ``[F, 2, 3]`` positions of the hips [m].
        local: ``[F, 2, 23, 4]`` quaternions (x, y, z, w) of the bones against their parents.
        planted: ``[F, 2, 2]`` whether the left and the right foot of each player stand.
        loose: ``[L, 3]`` positions of the shuttle in frames outside its flights [m].
    """

    hips: F64
    local: F64
    planted: Bools
    loose: F64


def write(head: dict[str, Any], frames: Frames) -> bytes:
    """Pack a motion.

    Args:
        head: JSON header.
        frames: data of every frame.
    """
    about = json.dumps(head, ensure_ascii=True, separators=(",", ":"), allow_nan=False).encode()
    parts = [len(about).to_bytes(4, "little"), about]
    scale = ((1 << (BITS - 1)) - 1) * np.sqrt(2)
    for seat in (0, 1):
        parts.append(_deltas(np.rint(frames.hips[:, seat] / HIPS_STEP)))
        largest, rest = _three(frames.local[:, seat])
        parts.append(np.diff(largest, axis=0, prepend=0).astype(np.uint8).T.tobytes())
        parts += [_deltas(np.rint(rest[:, bone] * scale)) for bone in range(N_BONES)]
    parts.append((frames.planted.reshape(-1, 4) @ np.array([1, 2, 4, 8])).astype(np.uint8).tobytes())
    parts.append(_deltas(np.rint(frames.loose / SHUTTLE_STEP)))
    return MAGIC + bytes([VERSION]) + zlib.compress(b"".join(parts), 9)


def read_head(content: bytes) -> tuple[dict[str, Any], memoryview]:
    """Header of a packed motion, and the remaining bytes.

    Raises:
        StagingError: not a packed motion, of another version, cut off or damaged.
    """
    if content[:4] != MAGIC:
        raise StagingError("no packed motion: its first bytes are not SMOT; expected what Motion.pack() returned")
    if content[4:5] != bytes([VERSION]):
        raise StagingError(f"a packed motion of version {content[4:5].hex() or 'none'}: expected {VERSION}; pack it again")
    inflate = zlib.decompressobj()
    try:
        data = inflate.decompress(content[5:], _LARGEST)
    except zlib.error as error:
        raise StagingError(f"a packed motion is damaged: {error}; take another copy") from error
    if not inflate.eof:
        raise StagingError("a packed motion is cut off, or too long to be one; take another copy")
    size = int.from_bytes(data[:4], "little")
    try:
        head = json.loads(data[4 : 4 + size])
    except (UnicodeDecodeError, ValueError, RecursionError) as error:
        raise StagingError("a packed motion is damaged: its head is no JSON; take another copy") from error
    if not isinstance(head, dict):
        raise StagingError("a packed motion is damaged: its head is no object; take another copy")
    return head, memoryview(data)[4 + size :]


def read_frames(data: memoryview, count: int, loose: int) -> Frames:
    """The frames of a packed motion.

    Args:
        data: bytes after the header.
        count: number of frames.
        loose: number of frames without a flight.

    Raises:
        StagingError: the wrong number of bytes.
    """
    expected = count * (2 * (6 + 7 * N_BONES) + 1) + 6 * loose
    if len(data) != expected:
        raise StagingError(f"a packed motion is damaged: {len(data)} bytes of frames, expected {expected}; take another copy")
    at = 0

    def block(size: int) -> memoryview:
        nonlocal at
        at += size
        return data[at - size : at]

    hips, local = np.empty((count, 2, 3)), np.empty((count, 2, N_BONES, 4))
    scale = ((1 << (BITS - 1)) - 1) * np.sqrt(2)
    for seat in (0, 1):
        hips[:, seat] = HIPS_STEP * _summed(block(6 * count), count)
        changes = np.frombuffer(block(N_BONES * count), dtype=np.uint8).reshape(N_BONES, count)
        largest = np.cumsum(changes, axis=1, dtype=np.uint8).T & 3
        rest = np.stack([_summed(block(6 * count), count) for _ in range(N_BONES)], axis=1) / scale
        local[:, seat] = _four(largest, rest)
    planted = np.frombuffer(block(count), dtype=np.uint8)[:, None] >> np.arange(4) & 1
    return Frames(
        hips=hips,
        local=local,
        planted=planted.astype(bool).reshape(count, 2, 2),
        loose=SHUTTLE_STEP * _summed(block(6 * loose), loose),
    )


def against_parents(rotation: Floats, parents: I64) -> F64:
    """``[F, 23, 4]`` rotations relative to the parent bones, from rotations relative to the rest pose."""
    turn = matrix(rotation)
    carried = turn.copy()
    for bone, parent in enumerate(parents):
        if parent >= 0:
            carried[:, bone] = np.swapaxes(turn[:, parent], -1, -2) @ turn[:, bone]
    return quaternion(carried)


def from_parents(hips: F64, local: F64, parents: I64, rest: F64) -> tuple[F64, F64]:
    """Forward kinematics.

    Args:
        hips: ``[F, 3]`` positions of the hips [m].
        local: ``[F, 23, 4]`` quaternions against the parent bones.
        parents: ``[23]`` parent of every bone, -1 for the hips, parents before children but for the racket.
        rest: ``[23, 3]`` start of every bone at rest [m].

    Returns:
        ``[F, 23, 4]`` rotations relative to the rest pose, and ``[F, 23, 3]`` positions [m].
    """
    own = matrix(local)
    turn, place = np.empty_like(own), np.empty((len(own), N_BONES, 3))
    for bone, parent in enumerate(parents):
        if parent < 0:
            turn[:, bone], place[:, bone] = own[:, bone], hips
        else:
            turn[:, bone] = turn[:, parent] @ own[:, bone]
            place[:, bone] = place[:, parent] + apply(turn[:, parent], rest[bone] - rest[parent])
    return quaternion(turn), place


def _three(q: F64) -> tuple[I64, F64]:
    """``[F, 23]`` index of the largest component, and ``[F, 23, 3]`` the others, signed so that it is positive."""
    largest = np.abs(q).argmax(axis=-1)
    sign = np.where(np.take_along_axis(q, largest[..., None], axis=-1) < 0, -1.0, 1.0)
    return largest, np.take_along_axis(sign * q, _OTHERS[largest], axis=-1)


def _four(largest: Ints, rest: F64) -> F64:
    q = np.empty((*rest.shape[:-1], 4))
    np.put_along_axis(q, _OTHERS[largest], rest, axis=-1)
    missing = np.sqrt(np.maximum(1 - (rest**2).sum(axis=-1, keepdims=True), 0.0))
    np.put_along_axis(q, largest[..., None].astype(np.int64), missing, axis=-1)
    return q


def _deltas(values: F64) -> bytes:
    """Columns of ``[N, k]`` whole numbers: second differences modulo 2^16, zigzag, low bytes then high bytes."""
    whole = values.astype(np.int64).astype(np.int16)
    change = np.diff(whole, 2, axis=0, prepend=np.zeros((2, whole.shape[1]), dtype=np.int16))
    zigzag = ((change << 1) ^ (change >> 15)).astype("<u2")
    return np.ascontiguousarray(zigzag.T).view(np.uint8).reshape(whole.shape[1], -1, 2).transpose(0, 2, 1).tobytes()


def _summed(data: memoryview, n: int) -> F64:
    """``[n, 3]`` inverse of :func:`_deltas`."""
    planes = np.frombuffer(data, dtype=np.uint8).reshape(3, 2, n).astype(np.uint16)
    zigzag = planes[:, 0] | (planes[:, 1] << np.uint16(8))
    change = (zigzag >> np.uint16(1)).astype(np.int16) ^ -(zigzag & np.uint16(1)).astype(np.int16)
    whole = np.cumsum(np.cumsum(change, axis=1, dtype=np.int16), axis=1, dtype=np.int16)
    return whole.T.astype(np.float64)
