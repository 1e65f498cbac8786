"""Packed motions, read as ``docs/motion_format.md`` says."""

import dataclasses
import json
import zlib
from typing import Any

import numpy as np

from shuttle_marl.base.arrays import F64, I64, Bools
from shuttle_marl.court.staging.flight import fall
from shuttle_marl.court.staging.geometry import apply, matrix, quaternion
from shuttle_marl.court.staging.skeleton import N_BONES, SWEET_SPOT, load_skeleton

OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


@dataclasses.dataclass(frozen=True, eq=False)
class Read:
    """What a packed motion holds; arrays as in ``Motion``, of the frames that are packed."""

    head: dict[str, Any]
    shuttle: F64
    rotation: F64
    position: F64
    sweet_spot: F64
    planted: Bools


def from_parents(hips: F64, local: F64, parents: I64, rest: F64) -> tuple[F64, F64]:
    """``[F, 23, 4]`` rotations and ``[F, 23, 3]`` places of bones, from those against the parents."""
    own = matrix(local)
    turn, place = np.empty_like(own), np.empty((len(own), N_BONES, 3))
    for bone, parent in enumerate(parents):
        turn[:, bone] = own[:, bone] if parent < 0 else turn[:, parent] @ own[:, bone]
        place[:, bone] = hips if parent < 0 else place[:, parent] + apply(turn[:, parent], rest[bone] - rest[parent])
    return quaternion(turn), place


def read(content: bytes) -> Read:
    assert content[:5] == b"SMOT\x02"
    data = zlib.decompress(content[5:])
    size = 4 + int.from_bytes(data[:4], "little")
    head, at = json.loads(data[4:size]), size
    fps, first, count = head["fps"], head["first"], head["frames"]

    def bytes_of(n: int) -> np.ndarray:
        nonlocal at
        at += n
        return np.frombuffer(data, np.uint8, n, at - n)

    def column(n: int) -> np.ndarray:
        low, high = bytes_of(2 * n).reshape(2, n).astype(np.int64)
        folded = low + 256 * high
        change = np.where(folded % 2, -(folded + 1) // 2, folded // 2)
        return np.cumsum(np.cumsum(change)).astype(np.int16).astype(float)

    hips, local = np.empty((count, 2, 3)), np.empty((count, 2, N_BONES, 4))
    for seat in (0, 1):
        hips[:, seat] = 2.5e-4 * np.stack([column(count) for _ in range(3)], axis=1)
        largest = np.cumsum(bytes_of(N_BONES * count).reshape(N_BONES, count), axis=1) % 256
        for bone in range(N_BONES):
            three = np.stack([column(count) for _ in range(3)], axis=1) / ((2**14 - 1) * np.sqrt(2))
            q, k = local[:, seat, bone], largest[bone][:, None]
            np.put_along_axis(q, OTHERS[k[:, 0]], three, axis=1)
            np.put_along_axis(q, k, np.sqrt(np.maximum(1 - (three**2).sum(axis=1, keepdims=True), 0)), axis=1)
    planted = (bytes_of(count)[:, None] >> np.arange(4) & 1).astype(bool).reshape(count, 2, 2)
    shuttle, flies = np.empty((first + count, 3)), np.zeros(first + count, dtype=bool)
    for stroke in head["strokes"]:
        rows = np.arange(stroke["frame"], min(stroke["end_frame"] + 1, first + count))
        seconds = np.array([stroke["end_frame"] - stroke["frame"]]) / fps
        flight = fall(np.array([stroke["start"]]), np.array([stroke["velocity"]]), seconds)
        shuttle[rows], flies[rows] = flight.at(0, (rows - stroke["frame"]) / fps)[0], True
    shuttle, flies = shuttle[first:], flies[first:]
    shuttle[~flies] = 5e-4 * np.stack([column(int(np.count_nonzero(~flies))) for _ in range(3)], axis=1)
    assert at == len(data)
    seats = []
    for seat, player in enumerate(head["players"]):
        right, skeleton = player["hand"] == "right", load_skeleton(player["athlete"])
        parents, rest = skeleton.parents(right_handed=right), skeleton.rest_pose(right_handed=right)
        turn, place = from_parents(hips[:, seat], local[:, seat], parents, rest)
        strings = place[:, -1] + SWEET_SPOT * apply(matrix(turn[:, -1]), skeleton.racket(right_handed=right)[0][None])
        seats.append((turn, place, strings))
    rotation, position, sweet_spot = (np.stack(part, axis=1) for part in zip(*seats, strict=True))
    return Read(head, shuttle, rotation, position, sweet_spot, planted)
