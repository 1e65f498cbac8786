"""Key poses of strokes, of waiting and of reactions, which are in ``poses.json``.

Every key pose gives hips and spine as angles, and both hands as places and directions in the *facing frame* (origin on the floor
under the hips, y where the hips face, x to their right), for a right-hander of 1.79 m as in :mod:`shuttle_marl.staging.motions`.
:mod:`shuttle_marl.staging.library` turns them into joint angles within the limits.
"""

from pathlib import Path
from typing import Final

import msgspec

from shuttle_marl.staging.motions import MOTIONS

Triple = tuple[float, float, float]

CONTACT: Final = 3
"""Number of the contact among the key poses of a stroke: prepare, take back, load, contact, follow through, finish. It has no
position of the grip, which follows from the shuttle."""


class Key(msgspec.Struct, frozen=True, kw_only=True):
    """One key pose.

    Attributes:
        hips: height of the hips [m], and how far they turn left, bow forward, lean right [degrees].
        spine: how far the chest turns left, bows forward, leans right against the hips [degrees].
        grip: middle of the grip [m].
        elbow: direction from the shoulder to the elbow of the racket arm.
        free: the free hand [m].
        free_elbow: direction from the shoulder to the elbow of the free arm.
    """

    hips: tuple[float, float, float, float]
    spine: Triple
    grip: Triple = (0.0, 0.0, 0.0)
    shaft: Triple
    elbow: Triple
    free: Triple
    free_elbow: Triple = (-0.6, -0.3, -0.75)


class Stroke(msgspec.Struct, frozen=True, kw_only=True):
    """A kind of motion.

    Attributes:
        aim: approximate contact in the stroke frame [m]; the solver moves it within the comfort of the arm.
        feet: left and right foot at the contact (x, y, heading in degrees), and the foot that lands last.
        keys: key poses, see :data:`CONTACT`.
    """

    aim: Triple
    feet: tuple[Triple, Triple, int]
    keys: tuple[Key, Key, Key, Key, Key, Key]


class _Poses(msgspec.Struct, frozen=True):
    """Content of the file.

    Attributes:
        ready: between strokes: knees bent, racket up in front.
        wait: the receiver before the serve: upright, the free hand raised for balance.
        rest: after the rally.
        wins: after a won point: a fist in front of the face; the racket raised.
        loses: after a lost point: bent over, the hands at the knees; a look at the strings.
        strokes: by kind of motion.
    """

    ready: Key
    wait: Key
    rest: Key
    wins: tuple[Key, Key]
    loses: tuple[Key, Key]
    strokes: dict[str, Stroke]


POSES: Final = msgspec.json.decode(Path(__file__).with_name("poses.json").read_bytes(), type=_Poses)
STROKES: Final = tuple(POSES.strokes[name] for name in MOTIONS)
"""Strokes by the number of their motion."""
