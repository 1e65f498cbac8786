"""Measures of natural movement: impact of the strokes, jumps and landings, steps, stillness, poses.

The input is positions and rotations only. Speeds are central differences between frames.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.base.arrays import F64, I64, Bools
from shuttle_marl.court.staging.motion import Motion, against_parents
from shuttle_marl.court.staging.skeleton import BONE
from shuttle_marl.game.stroke import NET_SHOTS, SHOTS

_WINDOW: Final = 0.12  # window around a contact for the maximum racket speed [s]
_AROUND: Final = 0.5  # window around a contact for the maximum vertical acceleration [s]
_ABSORBED: Final = 0.4  # time after a landing in which the hips sink [s]
_TOUCHING: Final = 0.02  # height of the ball of a foot below which it is on the floor [m]
_TOGETHER: Final = 0.04  # maximum interval between the landings of both feet of a hop [s]
_STILL: Final = 0.02  # speed of the fastest bone below which a player is motionless [m/s]
_FAST_WRIST: Final = np.radians(2000.0)
_HIGH: Final = 1.2  # minimum contact height of a net shot taken early [m]
_NEAR_SHOULDER: Final = 0.05
_HANGING: Final = 0.10
_JUMPED: Final = ("smash", "half-smash")


Life = dict[str, npt.NDArray[Any]]  # measures of one motion by name, see `measure_life`


def measure_life(motion: Motion) -> Life:
    """Measure a motion of n strokes and T steps.

    Returns:
        shot: ``[n]`` shot type of each stroke.
        impact_ratio: ``[n]`` speed of the middle of the strings at the contact, relative to that of the shuttle after it.
        impact_peak: ``[n]`` from the contact to the instant at which the strings are fastest nearby [s].
        impact_cosine: ``[n]`` cosine between the directions in which strings and shuttle move at the contact.
        vertical_acceleration: ``[n]`` greatest vertical acceleration of the striker's hips around each contact [m/s²].
        airborne: ``[n]`` whether both feet of the striker are off the floor at the contact.
        landing_sink: ``[n]`` how far the hips sink after the landing of a jump [m]; NaN where the striker is not airborne.
        still: frames before the serve and after the rally in which a player is motionless, and ``waiting`` how many there are.
        waiting: see ``still``.
        step_length: ``[T]`` way of the hips from one landing to the next step, while the rally lasts; hops are no steps [m].
        fast_wrist: frames in which the hand that plays turns faster than 2,000°/s against the forearm.
        player_frames: frames of both players.
        high_net_shot: ``[n]`` whether it is a net shot that is met above 1.2 m.
        high_elbow: ``[n]`` whether the elbow is then less than 5 cm below the shoulder, or above it.
        hanging_racket: ``[n]`` whether the strings are then more than 10 cm below the grip.
    """
    trajectory, frames = motion.trajectory, motion.contact_frame
    rally, n = trajectory.rally, len(motion.contact_frame)
    shot = rally.catalogue.shot[rally.stroke].astype(np.int64)
    strings, strikers = motion.sweet_spot, rally.striker.tolist()
    floor = np.stack([_off_floor(motion, seat).min(axis=1) for seat in (0, 1)], axis=1)
    airborne = floor[frames, rally.striker] > _TOUCHING
    contacts = list(zip(frames.tolist(), strikers, strict=True))
    impact = np.array([_impact(motion, strings[:, seat], i, frame) for i, (frame, seat) in enumerate(contacts)]).reshape(n, 3)
    sink = [_sink(motion, seat, frame) if up else np.nan for (frame, seat), up in zip(contacts, airborne, strict=True)]
    elbow, hanging = _net_pose(motion, strings)
    still, waiting = _stillness(motion)
    found: dict[str, Any] = {
        "shot": shot,
        **dict(zip(("impact_ratio", "impact_peak", "impact_cosine"), impact.T, strict=True)),
        "vertical_acceleration": [_vertical(motion, seat, frame) for frame, seat in contacts],
        "airborne": airborne,
        "landing_sink": sink,
        "still": still,
        "waiting": waiting,
        "step_length": _steps(motion),
        "fast_wrist": _fast_wrists(motion),
        "player_frames": 2 * len(motion.time),
        "high_net_shot": np.isin(shot, [SHOTS.index(name) for name in NET_SHOTS]) & (trajectory.contact[:, 2] > _HIGH),
        "high_elbow": elbow,
        "hanging_racket": hanging,
    }
    return {name: np.atleast_1d(np.asarray(value)) for name, value in found.items()}


def summary_of_life(found: Sequence[Life]) -> dict[str, Any]:
    """Figures over several motions; see the keys of :func:`benchmarks.staging.summary`."""

    def every(name: str) -> npt.NDArray[Any]:
        return np.concatenate([life[name] for life in found])

    shot, net = every("shot"), every("high_net_shot")
    sink = every("landing_sink")[np.isin(shot, [SHOTS.index(name) for name in _JUMPED])]
    figures: dict[str, Any] = {
        "impact_ratio": _by_shot(shot, every("impact_ratio")),
        "impact_peak_ms": 1000 * float(np.median(every("impact_peak"))),
        "impact_cosine": float(np.median(every("impact_cosine"))),
        "impact_cosine_by_shot": _by_shot(shot, every("impact_cosine")),
        "vertical_acceleration": float(np.quantile(every("vertical_acceleration"), 0.99)),
        "airborne": {name: float(every("airborne")[shot == k].mean()) for k, name in enumerate(SHOTS) if (shot == k).any()},
        "still_share": float(every("still").sum() / max(every("waiting").sum(), 1)),
        "wrist_speed": float(every("fast_wrist").sum() / every("player_frames").sum()),
    }
    if (~np.isnan(sink)).any():
        figures["landing_sink"] = float(np.nanmedian(sink))
    if len(steps := every("step_length")):
        figures["step_length"] = float(np.median(steps))
    if net.any():
        figures["net_shot_high_elbow"] = float(every("high_elbow")[net].mean())
        figures["net_shot_hanging_racket"] = float(every("hanging_racket")[net].mean())
    return figures


def _by_shot(shot: I64, values: F64) -> dict[str, float]:
    """Median of each shot type that occurs."""
    return {name: float(np.median(values[shot == k])) for k, name in enumerate(SHOTS) if (shot == k).any()}


def _velocity(path: F64, frame: int, fps: int) -> F64:
    """``[3]`` velocity in a frame by central differences."""
    before, after = max(frame - 1, 0), min(frame + 1, len(path) - 1)
    return (path[after] - path[before]) * (fps / max(after - before, 1))


def _impact(motion: Motion, strings: F64, i: int, frame: int) -> tuple[float, float, float]:
    """Strings relative to the shuttle: speed, time from the contact to the maximum speed [s], cosine of the directions."""
    _, out = (v[0] for v in motion.trajectory.flight.at(i, np.array([0.0])))
    racket = _velocity(strings, frame, motion.fps)
    speed, leaving = float(np.linalg.norm(racket)), float(np.linalg.norm(out))
    near = round(_WINDOW * motion.fps)
    rows = np.arange(max(frame - near, 1), min(frame + near, len(strings) - 2) + 1)
    around = np.array([np.linalg.norm(_velocity(strings, int(row), motion.fps)) for row in rows])
    top = int(around.argmax())
    late = float(rows[top] - frame)
    if 0 < top < len(rows) - 1:
        # Vertex of the parabola through three frames.
        a, b, c = around[top - 1 : top + 2]
        late += float(0.5 * (a - c) / min(a - 2 * b + c, -1e-9))
    return speed / leaving, late / motion.fps, float(racket @ out) / max(speed * leaving, 1e-9)


def _off_floor(motion: Motion, seat: int) -> F64:
    """``[F, 2]`` height of the balls of both feet above where they are on the floor [m]."""
    toes = [BONE["LeftToeBase"], BONE["RightToeBase"]]
    return motion.position[:, seat, toes, 2].astype(np.float64) - motion.skeletons[seat].at("RightToeBase")[2]


def _vertical(motion: Motion, seat: int, frame: int) -> float:
    near = round(_AROUND * motion.fps)
    height = motion.position[max(frame - near, 0) : frame + near + 1, seat, 0, 2].astype(np.float64)
    return float(np.abs(np.diff(height, 2)).max()) * motion.fps**2


def _sink(motion: Motion, seat: int, frame: int) -> float:
    """Depth to which the hips sink after a jumped contact [m]; NaN without a landing."""
    down = np.flatnonzero((_off_floor(motion, seat)[frame:] < _TOUCHING).any(axis=1))
    after = round(_ABSORBED * motion.fps)
    if not len(down) or frame + down[0] + after >= len(motion.time):
        return float("nan")
    height = motion.position[frame + down[0] : frame + down[0] + after + 1, seat, 0, 2]
    return float(height[0] - height.min())


def _steps(motion: Motion) -> F64:
    """Distances of the hips between steps during the rally [m]; a hop with both feet is not a step."""
    if not len(motion.contact_frame):
        return np.zeros(0)
    over = round(float(motion.trajectory.end_time[-1]) * motion.fps)
    steps: list[F64] = []
    for seat in (0, 1):
        left, right = (_landings(motion, seat, foot) for foot in (0, 1))
        frames = np.unique(np.concatenate([left, right]))
        frames = frames[(frames > motion.contact_frame[0]) & (frames <= over)]
        near = round(_TOGETHER * motion.fps)
        hop = np.array([all((np.abs(side - f) <= near).any() for side in (left, right)) for f in frames], dtype=bool)
        hips = motion.position[frames, seat, 0, :2].astype(np.float64)
        steps.append(np.linalg.norm(np.diff(hips, axis=0), axis=1)[~hop[1:]])
    return np.concatenate(steps)


def _landings(motion: Motion, seat: int, foot: int) -> I64:
    """Frames in which a foot lands."""
    planted = motion.planted[:, seat, foot]
    return np.flatnonzero(planted[1:] & ~planted[:-1]).astype(np.int64) + 1


def _stillness(motion: Motion) -> tuple[int, int]:
    """Number of motionless frames before the serve and after the rally, and the total number of these frames."""
    frames = np.arange(1, len(motion.time))
    trajectory = motion.trajectory
    if len(motion.contact_frame):
        over = round(float(trajectory.end_time[-1]) * motion.fps)
        frames = frames[(frames <= motion.contact_frame[0]) | (frames > over)]
    moved = np.linalg.norm(motion.position[frames] - motion.position[frames - 1], axis=3).max(axis=2) * motion.fps
    return int((moved < _STILL).sum()), int(moved.size)


def _fast_wrists(motion: Motion) -> int:
    """Number of frames in which the racket hand rotates too fast relative to the forearm."""
    count = 0
    for seat in (0, 1):
        hand = BONE["RightHand" if motion.hands[seat] == "right" else "LeftHand"]
        wrist = against_parents(motion.rotation[:, seat], motion.parents(seat))[:, hand]
        cosine = np.abs((wrist[1:] * wrist[:-1]).sum(axis=1))
        count += int((2 * np.arccos(np.clip(cosine, -1, 1)) * motion.fps > _FAST_WRIST).sum())
    return count


def _net_pose(motion: Motion, strings: F64) -> tuple[Bools, Bools]:
    """Whether the elbow is high and whether the racket hangs at each contact."""
    rows, seat = motion.contact_frame, motion.trajectory.rally.striker
    side = ["Right" if motion.hands[k] == "right" else "Left" for k in (0, 1)]
    elbow, shoulder = (np.array([BONE[f"{side[k]}{bone}"] for k in seat], dtype=np.int64) for bone in ("ForeArm", "Arm"))
    height = motion.position[rows, seat, :, 2]
    row = np.arange(len(rows))
    high = height[row, elbow] > height[row, shoulder] - _NEAR_SHOULDER
    hanging = strings[rows, seat, 2] < height[:, BONE["Racket"]] - _HANGING
    return high, hanging
