"""Skeletons of the athletes: bones, rest pose, limits of the joints and the trunk; dimensions of racket and shuttle.

Axes of a body: x to its right, y forward, z up [m], soles at z = 0; every bone is aligned with them at rest. Bones are those of
the ``.glb`` files (Mixamo's names) without the fingers, and the racket.
"""

import dataclasses
import functools
import json
from pathlib import Path
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64, I64
from shuttle_marl.base.compiling import compiled
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.court.staging.geometry import add, apply, mat_mul, mat_vec, put_mat, put_vec, turned_by, unit


class StagingError(ShuttleError):
    """A rally that cannot be staged, or an invalid option."""


BONES: Final = (  # parents before children; ``Racket`` begins in the middle of the grip
    *("Hips", "Spine", "Spine1", "Spine2", "Neck", "Head"),
    *(f"{side}{bone}" for side in ("Left", "Right") for bone in ("Shoulder", "Arm", "ForeArm", "Hand")),
    *(f"{side}{bone}" for side in ("Left", "Right") for bone in ("UpLeg", "Leg", "Foot", "ToeBase")),
    "Racket",
)
N_BONES: Final = len(BONES)
BONE: Final = {name: i for i, name in enumerate(BONES)}
FLIP: Final = np.array([-1.0, 1.0, 1.0])  # signs of a mirror between left and right
# ``[23]`` index of the bone on the other side.
MIRROR: Final = np.array([BONE[b.replace("Left", "*").replace("Right", "Left").replace("*", "Right")] for b in BONES])
LEFT, RIGHT = 0, 1

ATHLETES: Final = ("male", "female")
_FOLDER: Final = Path(__file__).parent / "athletes"
_FINGERS: Final = {  # bend of the joints, closed and open [degrees]
    "Index": ((44, 62, 40), (16, 20, 14)),
    "Middle": ((58, 72, 48), (20, 24, 16)),
    "Ring": ((62, 74, 50), (24, 26, 18)),
    "Pinky": ((62, 72, 48), (26, 28, 18)),
    "Thumb": ((-26, -20, -10), (-6, -8, -6)),
}
_REFERENCE: Final = 1.787

RACKET_LENGTH: Final = 0.675  # length of a racket (BWF Law 4: at most 0.680 m) [m]
RACKET_BUTT: Final = -0.10  # position of the lower end along the shaft, from the middle of the grip [m]
SWEET_SPOT: Final = 0.45  # distance from the middle of the grip to the middle of the strings, where the shuttle is struck [m]
RACKET_HEAD: Final = (RACKET_LENGTH + RACKET_BUTT - SWEET_SPOT, 0.105)  # half length and half width (at most 0.14 and 0.11 m) [m]
SHUTTLE_SCALE: Final = 1.9  # scale at which a shuttle is drawn: at its true size it cannot be seen across the court
CORK: Final = 0.0131  # radius of the cork (Law 2: 25 to 28 mm across) [m]
FEATHERS: Final = 16
FEATHER: Final = ((0.012, 0.0015, 0.013), (0.032, 0.0075, 0.076))
"""Both ends of a feather (62 to 70 mm long, 58 to 68 mm across their tips): distance from the axis, half the width of the vane,
distance behind the middle of the cork [m]."""

HIPS_HEIGHT, HIPS_YAW, HIPS_PITCH, HIPS_ROLL, SPINE_YAW, SPINE_PITCH, SPINE_ROLL = range(7)
N_TRUNK = 7  # size of a trunk pose: height of the hips [m] and six angles [rad], in this order
SPINE_LIMITS: F64 = np.radians([(-45, 45), (-30, 60), (-35, 35)])  # yaw, pitch, roll of the chest [rad]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Skeleton:
    """One athlete.

    Attributes:
        grip_axis, grip_normal: ``[3]`` of the racket at rest in the right hand: shaft, and side of the strings of a
            forehand.
    """

    name: str
    height: float  # from the floor to the top of the head [m]
    parent: I64  # [23] index of the parent, -1 for the hips. The racket hangs on the right hand; see `parents`
    rest: F64  # [23, 3] start of each bone at rest [m]
    grip_axis: F64
    grip_normal: F64
    fingers: F64  # [2, 3] along the fingers of the right hand, and the axis about which they bend

    @property
    def scale(self) -> float:
        """Size relative to the reference athlete of the motions."""
        return self.height / _REFERENCE

    def at(self, bone: str) -> F64:
        """``[3]`` start of a bone at rest [m]."""
        return self.rest[BONE[bone]]

    def parents(self, *, right_handed: bool) -> I64:
        """``[23]`` parents, with the racket in the playing hand."""
        out = self.parent.copy()
        out[BONE["Racket"]] = BONE["RightHand" if right_handed else "LeftHand"]
        return out

    def rest_pose(self, *, right_handed: bool) -> F64:
        """``[23, 3]`` start of each bone at rest, with the racket in the playing hand [m]."""
        return self.rest if right_handed else self.rest[MIRROR] * FLIP

    def racket(self, *, right_handed: bool) -> tuple[F64, F64]:
        """Direction of the shaft, and of the side of the strings that a forehand strikes with, at rest: ``[3]`` each."""
        side = np.array([1.0 if right_handed else -1.0, 1.0, 1.0])
        return self.grip_axis * side, self.grip_normal * side

    @functools.cached_property
    def spine(self) -> F64:
        """``[3, 3]`` from each bone of the trunk to the next at rest [m]."""
        return np.diff(self.rest[:4], axis=0)

    @functools.cached_property
    def leg(self) -> tuple[float, float]:
        """Lengths of thigh and shank [m]."""
        hip, knee, ankle = self.at("RightUpLeg"), self.at("RightLeg"), self.at("RightFoot")
        return float(np.linalg.norm(knee - hip)), float(np.linalg.norm(ankle - knee))


@functools.cache
def load_skeleton(name: str) -> Skeleton:
    """The skeleton of a shipped athlete. Raises StagingError: there is no athlete of this name."""
    if name not in ATHLETES:
        raise StagingError(f"athlete {name!r}: expected one of {', '.join(ATHLETES)}")
    raw = json.loads((_FOLDER / "skeletons.json").read_text(encoding="utf-8"))[name]
    bones = raw["bones"]
    head = {bone: np.array(entry["head"]) for bone, entry in bones.items()}
    hand, middle = head["RightHand"], head["RightHandMiddle1"]
    along, across = unit(middle - hand), unit(head["RightHandIndex1"] - head["RightHandPinky1"])
    palm = unit(np.cross(across, along))
    # The handle lies across the fingers, the shaft leaves between thumb and index finger, well forward as in play.
    axis = unit(0.62 * across + 0.78 * along)
    head["Racket"] = hand + 0.72 * (middle - hand) + 0.028 * palm
    parent = [-1 if b == "Hips" else BONE["RightHand"] if b == "Racket" else BONE[bones[b]["parent"]] for b in BONES]
    return Skeleton(
        name=name,
        height=raw["height"],
        parent=np.array(parent),
        rest=np.array([head[b] for b in BONES]),
        grip_axis=axis,
        grip_normal=unit(palm - (palm @ axis) * axis),
        fingers=np.array([along, unit(np.cross(along, palm))]),
    )


def model_file(name: str) -> Path:
    """The skinned model of a shipped athlete: binary glTF 2.0, y up, facing +z, 52 bones. Raises StagingError: there is no
    athlete of this name."""
    return _FOLDER / f"{load_skeleton(name).name}.glb"


def finger_pose(name: str, *, right_handed: bool) -> dict[str, F64]:
    """Quaternions (x, y, z, w) of the bent fingers of an athlete's model by bone of the ``.glb`` file, against the parent bone.
    The hand that holds the racket is closed; axes are those of the staging."""
    skeleton = load_skeleton(name)
    along, curl = skeleton.fingers
    out: dict[str, F64] = {}
    for side, sign in (("Right", np.ones(3)), ("Left", np.array([1.0, -1.0, -1.0]))):
        closed = (side == "Right") == right_handed
        for finger, bends in _FINGERS.items():
            for k, bend in enumerate(bends[0] if closed else bends[1]):
                axis = (skeleton.grip_axis if closed and k == 0 else along) if finger == "Thumb" else curl
                half = np.radians(bend) / 2
                out[f"{side}Hand{finger}{k + 1}"] = np.array([*(np.sin(half) * axis * sign), np.cos(half)])
    return out


def trunk(skeleton: Skeleton, hips: F64, angles: F64) -> tuple[F64, F64]:
    """Rotations ``[4, N, 3, 3]`` and positions of Hips, Spine, Spine1, Spine2 from hips ``[N, 3]`` [m] and poses ``[N, 7]``."""
    return _bent(np.ascontiguousarray(hips), np.ascontiguousarray(angles), skeleton.spine)


@compiled
def _bent(hips: F64, angles: F64, above: F64) -> tuple[F64, F64]:
    rotation, position = np.empty((4, len(angles), 3, 3)), np.empty((4, len(angles), 3))
    for n in range(len(angles)):
        a = angles[n]
        turn, third = turned_by(a[1], a[2], a[3]), turned_by(a[4] / 3, a[5] / 3, a[6] / 3)
        place = add(hips[n], (0.0, 0.0, 0.0))
        for k in range(4):
            put_mat(turn, rotation[k, n])
            put_vec(place, position[k, n])
            if k < 3:
                place = add(place, mat_vec(turn, above[k]))
                turn = mat_mul(turn, third)
    return rotation, position


def collar_of(skeleton: Skeleton, rotation: F64, position: F64, side: str = "Right") -> F64:
    """``[N, 3]`` start of the collar bone of a side, from rotation and position of Spine2 [m]."""
    return position + apply(rotation, skeleton.at(f"{side}Shoulder") - skeleton.at("Spine2"))


def chest_of(skeleton: Skeleton, hips: F64, pose: F64, *, free: bool = False) -> tuple[F64, F64]:
    """Rotation ``[N, 3, 3]`` of the chest and start ``[N, 3]`` of the collar bone of the racket arm [m]. ``free``: of the free
    arm instead, in a mirror: it is solved as a right arm."""
    rotation, position = trunk(skeleton, hips, pose[:, :N_TRUNK])
    chest, collar = rotation[-1], collar_of(skeleton, rotation[-1], position[-1], "Left" if free else "Right")
    return (np.diag(FLIP) @ chest @ np.diag(FLIP), collar * FLIP) if free else (chest, collar)
