"""Hips and spine: from angles to the chest, and from a place on the court to the frame of the chest."""

import itertools

import numpy as np
import numpy.typing as npt

from shuttle_marl.staging.rotation import apply, yaw_pitch_roll
from shuttle_marl.staging.skeleton import Skeleton

Floats = npt.NDArray[np.float64]

HIPS_HEIGHT, HIPS_YAW, HIPS_PITCH, HIPS_ROLL, SPINE_YAW, SPINE_PITCH, SPINE_ROLL = range(7)
N_TRUNK = 7
"""Numbers that describe the trunk: height of the hips [m] and six angles [rad], in this order."""
SPINE_LIMITS: Floats = np.radians([(-45, 45), (-30, 60), (-35, 35)])
"""``[3, 2]`` how far the chest turns left, bows, and leans right against the hips [rad] (thoracic and lumbar spine)."""


def trunk(skeleton: Skeleton, hips: Floats, angles: Floats) -> tuple[Floats, Floats]:
    """Bones of the trunk.

    Args:
        skeleton: the athlete.
        hips: ``[N, 3]`` where the hips are.
        angles: ``[N, 7]``; the height is not used.

    Returns:
        ``[4, N, 3, 3]`` rotations and ``[4, N, 3]`` positions of Hips, Spine, Spine1, Spine2.
    """
    root = yaw_pitch_roll(angles[:, HIPS_YAW], angles[:, HIPS_PITCH], angles[:, HIPS_ROLL])
    third = yaw_pitch_roll(*(angles[:, k] / 3 for k in (SPINE_YAW, SPINE_PITCH, SPINE_ROLL)))
    rotation, position = [root], [hips]
    names = ("Hips", "Spine", "Spine1", "Spine2")
    for below, above in itertools.pairwise(names):
        position.append(position[-1] + apply(rotation[-1], skeleton.at(above) - skeleton.at(below)))
        rotation.append(rotation[-1] @ third)
    return np.stack(rotation), np.stack(position)


def collar_of(skeleton: Skeleton, rotation: Floats, position: Floats, side: str = "Right") -> Floats:
    """``[N, 3]`` where the collar bone of a side begins, from rotation and position of Spine2."""
    return position + apply(rotation, skeleton.at(f"{side}Shoulder") - skeleton.at("Spine2"))
