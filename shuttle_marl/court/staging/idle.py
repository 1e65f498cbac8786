"""Idle movements of players: breathing, shifts of weight, turning the racket in the hand; fatigue deepens the breath.

They are added to the pose between key poses, and vanish at the player's own contacts. They depend on the time and on the past
only, so that continued motions are smooth.
"""

import dataclasses
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.court.staging.arm import BEND, DEVIATION, ELBOW, PRONATION, RAISE, ROLL, SWING_1
from shuttle_marl.court.staging.curves import ease
from shuttle_marl.court.staging.library import FREE_ARM, N_POSE, RACKET_ARM
from shuttle_marl.court.staging.skeleton import HIPS_ROLL, HIPS_YAW, SPINE_PITCH, SPINE_ROLL
from shuttle_marl.court.staging.trajectory import Trajectory

_CLEAR: Final = 0.06
"""Half width of the window around an own contact without idle movement [s]."""
_COMING: Final = 0.20
"""Fade-out before that window [s]: no effect before the opponent's contact, the branch of a continued motion."""
_IN_PLAY: Final = 0.4
"""Amplitude during the rally, as a fraction."""
_CALM: Final = 0.5
"""Duration of the transition between rest and play [s]."""
_BREATH: Final = (3.4, 1.7)
"""Duration of a breath, rested and tired [s]."""
_MOST_EFFORT: Final = 6
"""Number of attacks in a rally until full fatigue."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Habits:
    """Idle movement over F frames, in the player's own frame, as a right-hander.

    Attributes:
        pose: ``[F, 27]`` to trunk and arms [rad].
        place: ``[F, 3]`` to the hips [m].
    """

    pose: F64
    place: F64


def habits(trajectory: Trajectory, seat: int, rhythm: int, frames: int, fps: int) -> Habits:
    """Idle movements of a player.

    Args:
        rhythm: random seed of the phases of both players, 0 or more.
    """
    time = np.arange(frames) / fps
    own = trajectory.time[trajectory.rally.striker == seat]
    late = time[:, None] - own
    free = np.where(late < 0, ease((-late - _CLEAR) / _COMING), ease((late - _CLEAR) / _CALM)).prod(axis=1)
    begun = float(trajectory.time[0]) if len(trajectory.time) else np.inf
    over = np.inf if trajectory.rally.open or not len(trajectory.time) else float(trajectory.end_time[-1])
    resting = np.maximum(1 - ease((time - begun + 0.9) / _CALM), ease((time - over) / _CALM))
    much = free * (_IN_PLAY + (1 - _IN_PLAY) * resting)
    # Attacks so far, from 0 to 1.
    attacks = trajectory.time[(trajectory.rally.striker == seat) & trajectory.rally.catalogue.is_attack[trajectory.rally.stroke]]
    tired = free * np.minimum(ease(time[:, None] - attacks).sum(axis=1) / _MOST_EFFORT, 1.0)
    phase = np.random.default_rng([rhythm & 0xFFFFFFFF, seat]).uniform(0, 2 * np.pi, 8)
    breath = np.sin(phase[0] + np.cumsum(2 * np.pi / (_BREATH[0] + (_BREATH[1] - _BREATH[0]) * tired)) / fps)

    def wave(k: int, seconds: float) -> F64:
        return np.sin(2 * np.pi * time / seconds + phase[k])

    pose = np.zeros((frames, N_POSE))
    pose[:, SPINE_PITCH] = much * (0.014 + 0.035 * tired) * breath + 0.10 * tired
    weight = wave(1, 2.7) + 0.5 * wave(2, 1.7)
    pose[:, HIPS_ROLL], pose[:, SPINE_ROLL] = 0.016 * much * weight, -0.020 * much * weight
    pose[:, HIPS_YAW] = 0.022 * much * wave(3, 3.1)
    for part in (RACKET_ARM, FREE_ARM):
        pose[:, part.start + RAISE] = much * (0.02 + 0.03 * tired) * breath
    arm = RACKET_ARM.start
    pose[:, arm + ELBOW] = 0.06 * much * wave(4, 1.9) - 0.10 * tired
    pose[:, arm + SWING_1] = 0.03 * much * wave(5, 2.3)
    pose[:, arm + BEND], pose[:, arm + DEVIATION] = 0.08 * much * wave(6, 1.3), 0.04 * much * wave(7, 1.1)
    # The racket turns in the fingers, periodically.
    since = (time + phase[3]) % 2.6
    turns = resting * free * np.where(since < 0.7, np.sin(np.pi * np.clip(since / 0.7, 0, 1)) ** 2, 0.0)
    pose[:, arm + ROLL], pose[:, arm + PRONATION] = 0.9 * turns, 0.35 * turns
    pose[:, FREE_ARM.start + ELBOW] = 0.04 * much * wave(5, 1.6)
    place = np.stack([0.016 * weight, 0.010 * wave(4, 2.2), 0.006 * wave(6, 0.95) - 0.004], axis=1)
    place *= (free * (0.12 + 0.88 * resting))[:, None]
    return Habits(pose=pose, place=place)
