"""Key poses of strokes, of waiting and of reactions.

Every key pose gives hips and spine as angles, and both hands as places and directions in the *facing frame* (origin on the floor
under the hips, y where the hips face, x to their right), for a right-hander of 1.79 m as in :mod:`shuttle_marl.staging.motions`.
:mod:`shuttle_marl.staging.library` turns them into joint angles within the limits.
"""

import dataclasses
from typing import Final

from shuttle_marl.staging import motions
from shuttle_marl.staging.motions import LEFT, RIGHT

Triple = tuple[float, float, float]

CONTACT: Final = 3
"""Number of the contact among the key poses of a stroke: prepare, take back, load, contact, follow through, finish. It has no
position of the grip, which follows from the shuttle."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Key:
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
    grip: Triple
    shaft: Triple
    elbow: Triple
    free: Triple
    free_elbow: Triple = (-0.6, -0.3, -0.75)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Stroke:
    """A kind of motion.

    Attributes:
        aim: approximate contact in the stroke frame [m]; the solver moves it within the comfort of the arm.
        feet: left and right foot at the contact (x, y, heading in degrees), and the foot that lands last.
        keys: key poses, see :data:`CONTACT`.
    """

    aim: Triple
    feet: tuple[Triple, Triple, int]
    keys: tuple[Key, Key, Key, Key, Key, Key]


READY: Final = Key(
    hips=(0.885, 0, 14, 0),
    spine=(0, 20, 0),
    grip=(0.14, 0.48, 1.06),
    shaft=(-0.38, 0.55, 0.74),
    elbow=(0.55, -0.05, -0.83),
    free=(-0.30, 0.40, 1.08),
    free_elbow=(-0.6, -0.1, -0.8),
)
"""Between strokes: knees bent, racket up in front."""

WAIT: Final = Key(
    hips=(0.955, -12, 4, 0),
    spine=(0, 8, 0),
    grip=(0.22, 0.36, 1.12),
    shaft=(-0.30, 0.45, 0.84),
    elbow=(0.45, -0.15, -0.88),
    free=(-0.30, 0.30, 1.22),
    free_elbow=(-0.55, -0.1, -0.83),
)
"""The receiver before the serve: upright, the free hand raised for balance."""

REST: Final = Key(
    hips=(0.985, 0, 2, 0),
    spine=(0, 6, 0),
    grip=(0.30, 0.10, 0.84),
    shaft=(-0.10, 0.75, -0.55),
    elbow=(0.35, -0.1, -0.93),
    free=(-0.30, 0.04, 0.82),
    free_elbow=(-0.35, -0.15, -0.92),
)
"""After the rally."""

WINS: Final = (
    Key(hips=(0.975, 0, 0, 0), spine=(8, -6, 0), grip=(0.34, 0.10, 0.92), shaft=(0.05, 0.90, -0.30),
        elbow=(0.45, -0.20, -0.87), free=(-0.20, 0.36, 1.44), free_elbow=(-0.60, 0.40, -0.69)),
    Key(hips=(0.985, 0, -2, 0), spine=(-6, -10, 0), grip=(0.36, 0.12, 1.80), shaft=(0.05, 0.05, 1.00),
        elbow=(0.78, 0.25, 0.57), free=(-0.44, 0.10, 1.02), free_elbow=(-0.75, -0.2, -0.6)),
)  # fmt: skip
"""After a won point: a fist in front of the face; the racket raised."""
LOSES: Final = (
    Key(hips=(0.90, 0, 24, 0), spine=(0, 38, 0), grip=(0.24, 0.46, 0.66), shaft=(-0.35, 0.75, -0.45),
        elbow=(0.62, -0.15, -0.77), free=(-0.24, 0.44, 0.64), free_elbow=(-0.62, -0.15, -0.77)),
    Key(hips=(0.97, 6, 4, 2), spine=(6, 16, 0), grip=(0.10, 0.40, 1.16), shaft=(-0.62, 0.28, 0.73),
        elbow=(0.60, 0.05, -0.80), free=(-0.20, 0.46, 1.36), free_elbow=(-0.62, 0.2, -0.75)),
)  # fmt: skip
"""After a lost point: bent over, the hands at the knees; a look at the strings."""

STROKES: Final[dict[int, Stroke]] = {
    motions.OVERHEAD: Stroke(aim=(0.26, 0.30, 2.50), feet=((-0.14, 0.10, 10), (0.18, -0.18, -48), RIGHT), keys=(
        Key(hips=(0.90, -62, 2, 0), spine=(-14, -4, 6), grip=(0.36, 0.14, 1.42), shaft=(-0.30, 0.12, 0.95),
            elbow=(0.85, -0.25, -0.45), free=(-0.40, 0.34, 1.62), free_elbow=(-0.85, 0.45, 0.1)),
        Key(hips=(0.90, -60, -4, 0), spine=(-18, -10, 8), grip=(0.40, 0.02, 1.56), shaft=(-0.35, -0.25, 0.90),
            elbow=(0.92, -0.35, -0.05), free=(-0.44, 0.30, 1.80), free_elbow=(-0.80, 0.45, 0.4)),
        Key(hips=(0.955, -24, -4, -3), spine=(-10, -10, -6), grip=(0.30, -0.10, 1.70), shaft=(0.10, -0.55, -0.83),
            elbow=(0.80, 0.40, 0.45), free=(-0.34, 0.40, 1.42), free_elbow=(-0.80, 0.3, -0.5)),
        Key(hips=(0.985, 4, 4, -4), spine=(10, 4, -14), grip=(0, 0, 0), shaft=(0.02, 0.22, 0.97),
            elbow=(0.62, 0.30, 0.72), free=(-0.28, 0.26, 1.16), free_elbow=(-0.75, -0.2, -0.6)),
        Key(hips=(0.95, 16, 14, -2), spine=(16, 20, -8), grip=(0.00, 0.66, 1.34), shaft=(-0.15, 0.80, -0.58),
            elbow=(0.55, 0.82, 0.05), free=(-0.34, 0.06, 1.10), free_elbow=(-0.7, -0.5, -0.5)),
        Key(hips=(0.90, 16, 16, 0), spine=(14, 20, 0), grip=(-0.20, 0.42, 0.98), shaft=(-0.55, 0.30, -0.78),
            elbow=(0.35, 0.60, -0.70), free=(-0.36, 0.02, 1.12), free_elbow=(-0.7, -0.5, -0.5)),
    )),
    motions.AROUND: Stroke(aim=(-0.12, 0.25, 2.42), feet=((-0.26, -0.06, 20), (0.12, 0.04, -24), LEFT), keys=(
        Key(hips=(0.90, -52, 2, 0), spine=(-14, -4, 0), grip=(0.34, 0.12, 1.44), shaft=(-0.30, 0.12, 0.95),
            elbow=(0.85, -0.25, -0.45), free=(-0.42, 0.34, 1.58), free_elbow=(-0.85, 0.45, 0.1)),
        Key(hips=(0.90, -50, -4, -2), spine=(-16, -10, -6), grip=(0.36, 0.00, 1.60), shaft=(-0.40, -0.25, 0.88),
            elbow=(0.88, -0.25, 0.25), free=(-0.48, 0.26, 1.70), free_elbow=(-0.85, 0.40, 0.2)),
        Key(hips=(0.95, -16, -4, -8), spine=(-4, -10, -18), grip=(0.14, -0.06, 1.74), shaft=(0.20, -0.55, -0.80),
            elbow=(0.62, 0.35, 0.70), free=(-0.48, 0.26, 1.30), free_elbow=(-0.85, 0.1, -0.5)),
        Key(hips=(0.97, 10, 2, -10), spine=(14, 2, -24), grip=(0, 0, 0), shaft=(-0.30, 0.20, 0.93),
            elbow=(0.35, 0.40, 0.85), free=(-0.50, 0.10, 1.06), free_elbow=(-0.85, -0.2, -0.5)),
        Key(hips=(0.94, 14, 12, -6), spine=(18, 18, -12), grip=(-0.02, 0.64, 1.30), shaft=(0.05, 0.82, -0.57),
            elbow=(0.55, 0.80, 0.0), free=(-0.46, -0.04, 1.06), free_elbow=(-0.8, -0.4, -0.4)),
        Key(hips=(0.90, 10, 16, 0), spine=(10, 20, 0), grip=(0.06, 0.46, 0.98), shaft=(-0.35, 0.50, -0.79),
            elbow=(0.45, 0.45, -0.77), free=(-0.40, 0.02, 1.10), free_elbow=(-0.7, -0.5, -0.5)),
    )),
    motions.OVERHEAD_BACKHAND: Stroke(aim=(-0.33, 0.14, 2.34), feet=((0.24, 0.02, 84), (-0.30, -0.06, 108), RIGHT), keys=(
        Key(hips=(0.90, 78, 4, 0), spine=(14, 4, 0), grip=(0.02, 0.36, 1.26), shaft=(-0.45, 0.30, 0.84),
            elbow=(0.62, 0.70, -0.35), free=(-0.34, 0.22, 1.18)),
        Key(hips=(0.90, 112, 4, 0), spine=(20, 2, 0), grip=(-0.04, 0.36, 1.36), shaft=(-0.55, 0.10, 0.60),
            elbow=(0.60, 0.78, -0.10), free=(-0.36, 0.14, 1.14)),
        Key(hips=(0.95, 116, 0, 2), spine=(18, -4, -2), grip=(0.10, 0.40, 1.50), shaft=(-0.60, 0.30, -0.60),
            elbow=(0.62, 0.62, 0.48), free=(-0.38, 0.04, 1.08)),
        Key(hips=(0.975, 112, -2, 2), spine=(6, -8, -4), grip=(0, 0, 0), shaft=(0.10, 0.10, 0.98),
            elbow=(0.66, 0.36, 0.66), free=(-0.40, -0.10, 1.06)),
        Key(hips=(0.95, 104, 0, 4), spine=(-6, -6, 4), grip=(0.52, 0.18, 1.66), shaft=(0.80, -0.20, 0.55),
            elbow=(0.90, 0.10, 0.42), free=(-0.38, -0.06, 1.06)),
        Key(hips=(0.91, 60, 8, 0), spine=(-4, 6, 0), grip=(0.40, 0.30, 1.16), shaft=(0.35, 0.65, 0.65),
            elbow=(0.80, -0.10, -0.58), free=(-0.34, 0.12, 1.08)),
    )),
    motions.KILL: Stroke(aim=(0.28, 0.92, 1.84), feet=((-0.12, -0.34, 24), (0.14, 0.38, 0), RIGHT), keys=(
        Key(hips=(0.90, -8, 10, 0), spine=(-8, 12, 0), grip=(0.26, 0.42, 1.34), shaft=(-0.12, 0.25, 0.95),
            elbow=(0.70, 0.25, -0.65), free=(-0.40, 0.26, 1.20)),
        Key(hips=(0.92, -8, 10, 0), spine=(-8, 8, 2), grip=(0.28, 0.46, 1.52), shaft=(-0.05, 0.10, 0.98),
            elbow=(0.72, 0.45, -0.50), free=(-0.46, 0.14, 1.24)),
        Key(hips=(0.94, -6, 10, 0), spine=(-8, 6, 2), grip=(0.29, 0.50, 1.56), shaft=(0.00, -0.18, 0.98),
            elbow=(0.72, 0.55, -0.40), free=(-0.50, 0.00, 1.22)),
        Key(hips=(0.94, 6, 14, 0), spine=(4, 12, 0), grip=(0, 0, 0), shaft=(0.00, 0.55, 0.83),
            elbow=(0.52, 0.80, -0.20), free=(-0.52, -0.12, 1.20)),
        Key(hips=(0.92, 8, 16, 0), spine=(6, 16, 0), grip=(0.20, 0.66, 1.42), shaft=(-0.10, 0.98, -0.15),
            elbow=(0.50, 0.75, -0.42), free=(-0.50, -0.10, 1.16)),
        Key(hips=(0.90, 4, 14, 0), spine=(2, 16, 0), grip=(0.18, 0.56, 1.24), shaft=(-0.25, 0.80, 0.50),
            elbow=(0.55, 0.35, -0.75), free=(-0.42, 0.12, 1.12)),
    )),
    motions.KILL_BACKHAND: Stroke(aim=(-0.08, 0.94, 1.84), feet=((-0.12, -0.34, 24), (0.12, 0.38, 6), RIGHT), keys=(
        Key(hips=(0.90, 8, 10, 0), spine=(8, 12, 0), grip=(0.04, 0.46, 1.30), shaft=(-0.40, 0.25, 0.88),
            elbow=(0.68, 0.55, -0.48), free=(-0.38, 0.24, 1.18)),
        Key(hips=(0.92, 10, 10, 0), spine=(12, 10, 0), grip=(-0.02, 0.46, 1.44), shaft=(-0.62, 0.10, 0.78),
            elbow=(0.62, 0.75, -0.20), free=(-0.44, 0.10, 1.20)),
        Key(hips=(0.94, 10, 10, 0), spine=(12, 10, 0), grip=(-0.03, 0.48, 1.48), shaft=(-0.75, -0.10, 0.65),
            elbow=(0.58, 0.80, -0.10), free=(-0.48, -0.02, 1.18)),
        Key(hips=(0.94, 8, 14, 0), spine=(10, 12, 0), grip=(0, 0, 0), shaft=(-0.15, 0.55, 0.82),
            elbow=(0.42, 0.90, -0.10), free=(-0.50, -0.14, 1.16)),
        Key(hips=(0.92, 6, 16, 0), spine=(6, 16, 0), grip=(0.06, 0.68, 1.44), shaft=(0.20, 0.97, -0.10),
            elbow=(0.45, 0.85, -0.25), free=(-0.48, -0.12, 1.14)),
        Key(hips=(0.90, 4, 14, 0), spine=(4, 16, 0), grip=(0.12, 0.56, 1.22), shaft=(-0.20, 0.80, 0.55),
            elbow=(0.55, 0.40, -0.73), free=(-0.40, 0.12, 1.10)),
    )),
    motions.LUNGE: Stroke(aim=(0.26, 1.24, 0.95), feet=((-0.14, -0.58, 42), (0.10, 0.62, -4), RIGHT), keys=(
        Key(hips=(0.88, -6, 14, 0), spine=(-4, 16, 0), grip=(0.28, 0.50, 1.10), shaft=(0.05, 0.75, 0.66),
            elbow=(0.62, 0.20, -0.75), free=(-0.42, 0.24, 1.10)),
        Key(hips=(0.80, -4, 14, 0), spine=(-8, 14, 0), grip=(0.34, 0.56, 1.02), shaft=(0.25, 0.86, 0.44),
            elbow=(0.66, 0.40, -0.62), free=(-0.54, -0.04, 1.14)),
        Key(hips=(0.72, 4, 14, 0), spine=(-10, 14, 0), grip=(0.34, 0.60, 0.94), shaft=(0.30, 0.92, 0.10),
            elbow=(0.62, 0.60, -0.50), free=(-0.58, -0.24, 1.10), free_elbow=(-0.8, -0.5, -0.3)),
        Key(hips=(0.665, 12, 16, 0), spine=(-14, 16, 0), grip=(0, 0, 0), shaft=(0.05, 0.98, -0.08),
            elbow=(0.45, 0.76, -0.46), free=(-0.58, -0.36, 1.04), free_elbow=(-0.75, -0.6, -0.2)),
        Key(hips=(0.67, 12, 15, 0), spine=(-10, 14, 0), grip=(0.24, 0.68, 1.02), shaft=(-0.10, 0.90, 0.42),
            elbow=(0.48, 0.70, -0.50), free=(-0.58, -0.32, 1.06), free_elbow=(-0.75, -0.6, -0.2)),
        Key(hips=(0.77, 6, 12, 0), spine=(-6, 14, 0), grip=(0.22, 0.56, 1.10), shaft=(-0.20, 0.75, 0.62),
            elbow=(0.55, 0.35, -0.75), free=(-0.50, -0.10, 1.08)),
    )),
    motions.LUNGE_BACKHAND: Stroke(aim=(-0.04, 1.26, 0.95), feet=((-0.12, -0.58, 46), (0.08, 0.62, 8), RIGHT), keys=(
        Key(hips=(0.88, 6, 14, 0), spine=(4, 16, 0), grip=(0.06, 0.52, 1.12), shaft=(-0.40, 0.70, 0.58),
            elbow=(0.62, 0.45, -0.64), free=(-0.40, 0.22, 1.10)),
        Key(hips=(0.80, 12, 14, 0), spine=(10, 14, 0), grip=(-0.02, 0.54, 1.06), shaft=(-0.60, 0.72, 0.34),
            elbow=(0.52, 0.72, -0.46), free=(-0.48, -0.06, 1.14)),
        Key(hips=(0.72, 18, 14, 0), spine=(12, 14, 0), grip=(-0.04, 0.56, 0.98), shaft=(-0.66, 0.72, 0.05),
            elbow=(0.45, 0.80, -0.40), free=(-0.52, -0.26, 1.10), free_elbow=(-0.8, -0.5, -0.3)),
        Key(hips=(0.665, 22, 16, 0), spine=(10, 16, 0), grip=(0, 0, 0), shaft=(-0.15, 0.97, -0.12),
            elbow=(0.32, 0.86, -0.40), free=(-0.52, -0.38, 1.04), free_elbow=(-0.75, -0.6, -0.2)),
        Key(hips=(0.67, 20, 15, 0), spine=(6, 14, 0), grip=(0.10, 0.72, 1.04), shaft=(0.05, 0.92, 0.38),
            elbow=(0.40, 0.80, -0.45), free=(-0.52, -0.34, 1.06), free_elbow=(-0.75, -0.6, -0.2)),
        Key(hips=(0.77, 12, 12, 0), spine=(2, 14, 0), grip=(0.14, 0.56, 1.10), shaft=(-0.20, 0.75, 0.62),
            elbow=(0.55, 0.40, -0.73), free=(-0.46, -0.12, 1.08)),
    )),
    motions.SIDE: Stroke(aim=(1.08, 0.52, 1.45), feet=((-0.36, -0.02, 10), (0.50, 0.10, -44), RIGHT), keys=(
        Key(hips=(0.87, -20, 10, 0), spine=(-14, 12, 2), grip=(0.44, 0.34, 1.22), shaft=(0.10, 0.35, 0.93),
            elbow=(0.86, -0.05, -0.50), free=(-0.40, 0.30, 1.16)),
        Key(hips=(0.85, -30, 8, 2), spine=(-22, 8, 4), grip=(0.48, 0.20, 1.28), shaft=(0.20, -0.35, 0.91),
            elbow=(0.92, -0.15, -0.36), free=(-0.44, 0.24, 1.18)),
        Key(hips=(0.84, -26, 8, 4), spine=(-18, 8, 6), grip=(0.52, 0.22, 1.24), shaft=(0.35, -0.70, 0.62),
            elbow=(0.92, 0.10, -0.36), free=(-0.46, 0.18, 1.16)),
        Key(hips=(0.83, -12, 10, 4), spine=(-8, 10, 8), grip=(0, 0, 0), shaft=(0.86, 0.46, 0.20),
            elbow=(0.86, 0.44, -0.25), free=(-0.48, 0.06, 1.12)),
        Key(hips=(0.84, 2, 12, 2), spine=(6, 12, 2), grip=(0.30, 0.66, 1.26), shaft=(-0.35, 0.90, 0.22),
            elbow=(0.62, 0.72, -0.30), free=(-0.48, 0.02, 1.10)),
        Key(hips=(0.87, 4, 12, 0), spine=(6, 14, 0), grip=(0.12, 0.54, 1.16), shaft=(-0.62, 0.62, 0.48),
            elbow=(0.60, 0.40, -0.70), free=(-0.42, 0.14, 1.10)),
    )),
    motions.SIDE_BACKHAND: Stroke(aim=(-0.76, 0.66, 1.42), feet=((0.10, -0.30, 34), (-0.26, 0.40, 40), RIGHT), keys=(
        Key(hips=(0.87, 20, 10, 0), spine=(12, 12, -2), grip=(0.02, 0.42, 1.18), shaft=(-0.50, 0.25, 0.83),
            elbow=(0.66, 0.62, -0.42), free=(-0.36, 0.24, 1.10)),
        Key(hips=(0.85, 30, 8, -2), spine=(22, 10, -4), grip=(-0.08, 0.38, 1.22), shaft=(-0.72, -0.25, 0.62),
            elbow=(0.52, 0.82, -0.25), free=(-0.40, 0.14, 1.08)),
        Key(hips=(0.84, 28, 8, -4), spine=(22, 10, -4), grip=(-0.10, 0.40, 1.20), shaft=(-0.80, -0.45, 0.35),
            elbow=(0.46, 0.86, -0.20), free=(-0.42, 0.08, 1.08)),
        Key(hips=(0.83, 22, 10, -4), spine=(16, 10, -6), grip=(0, 0, 0), shaft=(-0.82, 0.52, 0.20),
            elbow=(0.30, 0.92, -0.20), free=(-0.46, -0.02, 1.08)),
        Key(hips=(0.84, 12, 12, -2), spine=(4, 12, 0), grip=(0.16, 0.68, 1.28), shaft=(0.45, 0.86, 0.22),
            elbow=(0.52, 0.82, -0.22), free=(-0.46, -0.04, 1.06)),
        Key(hips=(0.87, 6, 12, 0), spine=(2, 14, 0), grip=(0.22, 0.56, 1.18), shaft=(0.15, 0.72, 0.66),
            elbow=(0.66, 0.35, -0.66), free=(-0.40, 0.10, 1.08)),
    )),
    motions.DEFENCE: Stroke(aim=(0.96, 0.66, 0.80), feet=((-0.36, 0.00, 14), (0.42, 0.06, -28), RIGHT), keys=(
        Key(hips=(0.83, -8, 16, 0), spine=(-6, 20, 0), grip=(0.32, 0.46, 0.98), shaft=(0.20, 0.70, 0.45),
            elbow=(0.70, 0.20, -0.68), free=(-0.42, 0.30, 1.02)),
        Key(hips=(0.79, -14, 16, 3), spine=(-10, 20, 4), grip=(0.44, 0.40, 0.90), shaft=(0.55, 0.40, 0.25),
            elbow=(0.80, 0.20, -0.56), free=(-0.48, 0.22, 1.02)),
        Key(hips=(0.78, -14, 16, 4), spine=(-12, 20, 6), grip=(0.48, 0.40, 0.86), shaft=(0.70, 0.20, 0.00),
            elbow=(0.82, 0.30, -0.48), free=(-0.50, 0.14, 1.02)),
        Key(hips=(0.77, -10, 16, 4), spine=(-8, 20, 8), grip=(0, 0, 0), shaft=(0.66, 0.62, -0.42),
            elbow=(0.74, 0.52, -0.42), free=(-0.52, 0.06, 1.00)),
        Key(hips=(0.79, -2, 15, 2), spine=(0, 18, 2), grip=(0.30, 0.64, 1.02), shaft=(0.10, 0.86, 0.50),
            elbow=(0.66, 0.62, -0.42), free=(-0.50, 0.06, 1.02)),
        Key(hips=(0.85, 0, 14, 0), spine=(0, 18, 0), grip=(0.20, 0.52, 1.08), shaft=(-0.20, 0.70, 0.68),
            elbow=(0.58, 0.25, -0.77), free=(-0.42, 0.22, 1.06)),
    )),
    motions.DEFENCE_BACKHAND: Stroke(aim=(-0.56, 0.86, 0.80), feet=((-0.44, 0.06, 30), (0.34, 0.00, -12), LEFT), keys=(
        Key(hips=(0.83, 8, 16, 0), spine=(8, 20, 0), grip=(0.08, 0.48, 1.00), shaft=(-0.45, 0.62, 0.42),
            elbow=(0.66, 0.50, -0.56), free=(-0.42, 0.22, 1.02)),
        Key(hips=(0.79, 14, 16, -3), spine=(14, 20, -2), grip=(-0.02, 0.46, 0.96), shaft=(-0.72, 0.35, 0.25),
            elbow=(0.56, 0.72, -0.40), free=(-0.46, 0.10, 1.02)),
        Key(hips=(0.78, 16, 16, -4), spine=(16, 20, -4), grip=(-0.06, 0.46, 0.92), shaft=(-0.82, 0.20, 0.05),
            elbow=(0.48, 0.80, -0.36), free=(-0.48, 0.02, 1.02)),
        Key(hips=(0.77, 14, 16, -4), spine=(12, 20, -4), grip=(0, 0, 0), shaft=(-0.62, 0.62, -0.46),
            elbow=(0.38, 0.84, -0.36), free=(-0.50, -0.06, 1.00)),
        Key(hips=(0.79, 8, 15, -2), spine=(4, 18, 0), grip=(0.14, 0.66, 1.06), shaft=(0.15, 0.86, 0.46),
            elbow=(0.56, 0.74, -0.36), free=(-0.50, -0.02, 1.02)),
        Key(hips=(0.85, 4, 14, 0), spine=(0, 18, 0), grip=(0.18, 0.54, 1.10), shaft=(-0.15, 0.72, 0.66),
            elbow=(0.58, 0.30, -0.75), free=(-0.42, 0.16, 1.06)),
    )),
    motions.SERVE_BACKHAND: Stroke(aim=(0.05, 0.70, 1.04), feet=((-0.12, -0.24, 24), (0.10, 0.22, -8), RIGHT), keys=(
        Key(hips=(0.955, 6, 4, 0), spine=(4, 10, 0), grip=(0.20, 0.34, 1.20), shaft=(-0.45, 0.18, -0.80),
            elbow=(0.86, 0.32, -0.35), free=(0.02, 0.56, 1.06), free_elbow=(-0.62, 0.35, -0.70)),
        Key(hips=(0.955, 6, 4, 0), spine=(4, 10, 0), grip=(0.20, 0.33, 1.20), shaft=(-0.48, 0.06, -0.86),
            elbow=(0.86, 0.32, -0.35), free=(0.02, 0.56, 1.06), free_elbow=(-0.62, 0.35, -0.70)),
        Key(hips=(0.955, 6, 4, 0), spine=(5, 10, 0), grip=(0.20, 0.33, 1.21), shaft=(-0.50, -0.04, -0.86),
            elbow=(0.86, 0.34, -0.33), free=(0.02, 0.56, 1.06), free_elbow=(-0.62, 0.35, -0.70)),
        Key(hips=(0.955, 6, 5, 0), spine=(4, 11, 0), grip=(0, 0, 0), shaft=(-0.30, 0.48, -0.78),
            elbow=(0.82, 0.46, -0.32), free=(-0.06, 0.54, 1.04), free_elbow=(-0.62, 0.35, -0.70)),
        Key(hips=(0.95, 4, 6, 0), spine=(2, 12, 0), grip=(0.20, 0.46, 1.22), shaft=(-0.14, 0.84, -0.40),
            elbow=(0.80, 0.48, -0.36), free=(-0.16, 0.46, 1.02), free_elbow=(-0.62, 0.2, -0.75)),
        Key(hips=(0.90, 0, 12, 0), spine=(0, 18, 0), grip=(0.18, 0.48, 1.14), shaft=(-0.30, 0.66, 0.55),
            elbow=(0.62, 0.10, -0.77), free=(-0.30, 0.38, 1.06)),
    )),
    motions.SERVE_FOREHAND: Stroke(aim=(0.40, 0.70, 0.82), feet=((-0.14, 0.26, 0), (0.14, -0.24, -58), RIGHT), keys=(
        Key(hips=(0.965, -34, 0, 0), spine=(-8, 6, 2), grip=(0.42, 0.06, 1.16), shaft=(0.45, 0.10, 0.85),
            elbow=(0.80, -0.25, -0.54), free=(-0.16, 0.50, 1.26), free_elbow=(-0.6, 0.4, -0.68)),
        Key(hips=(0.965, -40, 0, 0), spine=(-14, 4, 4), grip=(0.46, -0.06, 1.12), shaft=(0.50, -0.35, 0.70),
            elbow=(0.80, -0.42, -0.42), free=(-0.14, 0.52, 1.28), free_elbow=(-0.6, 0.4, -0.68)),
        Key(hips=(0.955, -24, 2, 0), spine=(-10, 8, 4), grip=(0.42, 0.02, 0.92), shaft=(0.30, -0.70, -0.45),
            elbow=(0.62, -0.40, -0.67), free=(-0.22, 0.46, 1.22), free_elbow=(-0.6, 0.3, -0.7)),
        Key(hips=(0.95, -6, 6, 0), spine=(-2, 12, 2), grip=(0, 0, 0), shaft=(0.14, 0.58, -0.78),
            elbow=(0.46, 0.22, -0.86), free=(-0.32, 0.30, 1.16), free_elbow=(-0.7, 0.0, -0.7)),
        Key(hips=(0.95, 10, 8, 0), spine=(8, 10, 0), grip=(0.16, 0.64, 1.34), shaft=(-0.30, 0.72, 0.62),
            elbow=(0.55, 0.82, -0.15), free=(-0.36, 0.14, 1.12), free_elbow=(-0.7, -0.2, -0.65)),
        Key(hips=(0.93, 12, 8, 0), spine=(10, 10, 0), grip=(-0.16, 0.46, 1.44), shaft=(-0.75, 0.10, 0.62),
            elbow=(0.42, 0.90, 0.05), free=(-0.36, 0.10, 1.10), free_elbow=(-0.7, -0.3, -0.6)),
    )),
}  # fmt: skip
"""Strokes by kind of motion."""
