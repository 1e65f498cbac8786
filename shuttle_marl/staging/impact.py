"""Impact: the speed with which the strings arrive, in the direction in which the shuttle leaves.

At a contact the joints of the arm turn so fast that the middle of the strings moves at a share of the shuttle's launch
velocity, less what hips and trunk give it already. A stroke is a swing about that instant: from the load to the contact
the joints speed up evenly, after it they slow down, so that the racket is fastest when it strikes.
"""

from typing import Final

import numpy as np

from shuttle_marl.arrays import F64
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.staging.arm import LIMITS, Arm, sweet_spot_jacobian

RATIO: Final[dict[str, float]] = {
    "short-serve": 0.60,
    "long-serve": 0.62,
    "clear": 0.72,
    "lift": 0.68,
    "drop": 0.45,
    "smash": 0.72,
    "half-smash": 0.70,
    "drive": 0.68,
    "push": 0.60,
    "net-kill": 0.80,
    "net-shot": 0.32,
    "block": 0.30,
    "cross-court-net-shot": 0.36,
}
"""Speed of the strings that is aimed at, relative to the shuttle's launch: what strings and shuttle give back (about 0.5 to 0.7
for full strokes; the incoming shuttle gives the rest in soft ones)."""
RATIOS: Final[F64] = np.array([RATIO[shot] for shot in SHOTS])

SOFT: Final[dict[str, float]] = {
    "short-serve": 0.3,
    "drop": 0.25,
    "push": 0.35,
    "net-shot": 0.75,
    "block": 0.75,
    "cross-court-net-shot": 0.7,
}
"""Strokes for which the racket is held out early and then hardly moves: share of its way that it has made at the take-back."""

_COST: Final = np.array([0.5, 0.5, 0.13, 0.13, 0.12, 0.12, 0.14, 0.30, 0.34, 50.0])
"""Unwillingness of each joint to turn: collar bone little, shoulder, elbow and forearm most, the grip not at all."""
_FASTEST: Final = np.array([7.0, 7.0, 24.0, 24.0, 36.0, 32.0, 36.0, 24.0, 14.0, 0.0])
"""Greatest speed of each joint [rad/s]; internal rotation of the shoulder and pronation are the fastest in smashes."""
_ROOM: Final = 2.2


def swing(arm: Arm, angles: F64, wanted: F64, before: F64, after: F64) -> F64:
    """``[N, 10]`` speeds of the joints at contacts [rad/s].

    Args:
        arm: the model.
        angles: ``[N, 10]`` at the contact.
        wanted: ``[N, 3]`` velocity of the strings against the chest, in its frame [m/s].
        before: ``[N]`` seconds from the load to the contact.
        after: ``[N]`` seconds from the contact to the follow-through.
    """
    jacobian = sweet_spot_jacobian(arm, angles)
    back, ahead = angles - LIMITS[:, 0], LIMITS[:, 1] - angles
    most = np.minimum(_FASTEST, _ROOM * np.minimum(back / before[:, None], ahead / after[:, None]))
    least = -np.minimum(_FASTEST, _ROOM * np.minimum(ahead / before[:, None], back / after[:, None]))
    speed, held = np.zeros_like(angles), np.zeros(angles.shape, dtype=bool)
    for _ in range(5):
        free = np.where(held[:, None], 0.0, jacobian)
        rest = wanted - np.einsum("nij,nj->ni", jacobian, np.where(held, speed, 0.0))
        square = np.einsum("nij,j,nkj->nik", free, _COST**-2, free) + 0.02 * np.eye(3)
        push = np.linalg.solve(square, rest[..., None])[..., 0]
        found = np.einsum("nij,ni->nj", free, push) * _COST**-2
        speed = np.where(held, speed, np.clip(found, least, most))
        beyond = ~held & ((found < least) | (found > most))
        if not beyond.any():
            break
        held |= beyond
    return speed
