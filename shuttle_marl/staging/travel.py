"""Travel of the hips of a player over the court: the smoothest path that is where it must be and breaks no limit.

    minimise   Σ w_a |p̈|² + Σ w_b |base - p|² + Σ w_v |ṗ|² + Σ W |root - p|²    subject to |ṗ| ≤ V, |p̈| ≤ A

over the positions of all frames: at each own stroke the hips are at the root of its stance, when the opponent strikes
they wait near their base, slow enough for a split step. Solved by the alternating direction method of multipliers (Boyd,
Parikh, Chu, Peleato & Eckstein 2011): one pentadiagonal system, factored once, and projections onto discs.
"""

from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.staging.path_solver import TravelOptions, TravelWishes, smooth_path
from shuttle_marl.staging.trajectory import WIN, Trajectory

TOP_SPEED: Final = 6.5
"""Speed of the hips over the floor that is never passed [m/s]."""
TOP_ACCELERATION: Final = 12.0
"""Acceleration of the hips over the floor that is never passed [m/s²]."""
_MARGIN: Final = 0.90
"""Fraction of the limits that the solver aims at."""
_PINNED: Final = 1e11
_CONTACT, _BASE, _STILL, _BRAKE = 4e3, 6.0, 1.2, 0.6
_LATE: Final = 0.12
"""Time after the contact at which a hurried player brakes [s]."""


_OPTIONS: Final = TravelOptions(
    bending=2e-3,
    speed_penalty=2e-2,
    acceleration_penalty=3e-3,
    top_speed=_MARGIN * TOP_SPEED,
    top_acceleration=_MARGIN * TOP_ACCELERATION,
    rounds=240,
    most_rounds=4000,
    stiffer=(400, 1200),
    slack=1.02,
    # Paths that want to break the limits converge slowly: after ``rounds`` the margin is given up, the limits never.
    late_slack=0.995 / _MARGIN,
)


def travel(trajectory: Trajectory, seat: int, shift: F64, frames: int, fps: int, walked: F64 | None = None) -> F64:
    """``[frames, 2]`` the hips of one player over the floor, in the player's own frame [m].

    Args:
        trajectory: the rally.
        seat: 0 or 1.
        shift: ``[n, 2]`` added to the root of each stance [m].
        frames: length of the staging.
        fps: frames a second.
        walked: ``[B, 2]`` the first frames, where the hips have been already, two at least.
    """
    wishes = _wishes(trajectory, seat, shift, frames, fps)
    if walked is None:
        return _solve(wishes, fps)
    # The last two known frames pin place and speed, and only the following frames are solved.
    first = len(walked) - 2
    wishes = TravelWishes(wishes.weight[first:].copy(), wishes.target[first:].copy(), wishes.still[first:])
    wishes.weight[:2], wishes.target[:2] = _PINNED, _PINNED * walked[first:]
    return np.concatenate([walked, _solve(wishes, fps)[2:]])


def _wishes(trajectory: Trajectory, seat: int, shift: F64, frames: int, fps: int) -> TravelWishes:
    """Weights of all frames."""
    weight, target, still = np.full(frames, 1e-3), np.zeros((frames, 2)), np.full(frames - 1, 4e-3)

    def wish(frame: int, place: F64, w: float, half: int = 0) -> None:
        rows = slice(max(frame - half, 0), min(frame + half + 1, frames))
        weight[rows] += w
        target[rows] += w * place

    def slow(frame: int, w: float, half: int) -> None:
        still[max(frame - half, 0) : min(frame + half + 1, frames - 1)] += w

    rally, striker = trajectory.rally, trajectory.rally.striker
    hits = np.rint(trajectory.time * fps).astype(np.int64)
    target += 1e-3 * trajectory.before[seat]
    wish(0, trajectory.before[seat] + (shift[0] if len(rally) and rally.server == seat else 0.0), 50.0)
    still[: hits[0] if len(rally) else frames] += 3.0
    for i, frame in enumerate(hits):
        if striker[i] == seat:
            wish(frame, trajectory.stance[i].root + shift[i], _CONTACT)
            slow(frame + round(_LATE * fps) * int(rally.hurried[i]), _BRAKE, 4)
        else:
            wish(frame, trajectory.base[i, seat], _BASE, 3)
            slow(frame, _STILL, 5)
    if not len(rally):
        wish(frames - 1, trajectory.before[seat], 50.0)
    elif trajectory.reply is not None:
        if striker[-1] != seat:
            wish(frames - 1, trajectory.reply.root, 60.0)
        return TravelWishes(weight, target, still)
    elif striker[-1] != seat and trajectory.end[-1] == WIN:
        # The receiver goes for a winner, but does not get there.
        landing = rally.facing(seat) * trajectory.end_point[-1, :2]
        begun = trajectory.base[-1, seat]
        place = begun + 0.55 * (landing - begun)
        place[1] = min(place[1], -0.8)
        wish(min(round(trajectory.end_time[-1] * fps), frames - 1), place, 60.0)
    still[-round(0.3 * fps) :] += 5.0
    return TravelWishes(weight, target, still)


def _solve(wishes: TravelWishes, fps: int) -> F64:
    path = np.empty_like(wishes.target)
    smooth_path(wishes, fps, _OPTIONS, path)
    return path
