"""Measures of how believable a staged rally is: of its positions, its rotations, and the path of its shuttle."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from shuttle_marl.game.court import HALF_LENGTH, HALF_WIDTH, SHORT_SERVICE, area_of
from shuttle_marl.staging.joints import joints
from shuttle_marl.staging.measured import load_measured
from shuttle_marl.staging.motion import Motion
from shuttle_marl.staging.skeleton import BONE
from shuttle_marl.staging.trajectory import NET, OUT, RETURN, WIN, facing, net_height

Floats = npt.NDArray[np.float64]

_FINE: float = 2000.0
"""Instants a second at which flights are looked at where they cross the net."""


_ROUNDING: float = 2e-6
"""Error of angles from rotations kept in 32 bits [rad]."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Metrics:
    """Measures of one motion; n strokes.

    Attributes:
        contact: ``[n]`` middle of the strings to the shuttle when each stroke is struck [m].
        slide: ``[P]`` how far the ball of a planted foot strays from where it was put down, for each of P plants [m].
        sunk: how far the ball of a foot is below the height it has on the floor at most [m].
        speed: ``[2]`` greatest speed of the hips of each player over the floor [m/s].
        acceleration: ``[2]`` greatest acceleration of the hips over the floor [m/s²].
        joint_excess: greatest angle by which a joint passes its limits [degrees]; 0 if none does.
        joint: name of the joint that comes closest to or furthest beyond its limits.
        clearance: height of the shuttle over the net where strokes that cross it do [m].
        landing: ``[n]`` end of each flight to the point that was drawn for it [m].
        timely: for each returned stroke, whether its flight time lies in the data's interquartile range of its shot type.
        true_end: ``[n]`` whether each stroke ends as it must: in the area it was meant for, out of court, or in the net.
        seconds: length [s].
    """

    contact: Floats
    slide: Floats
    sunk: float
    speed: Floats
    acceleration: Floats
    joint_excess: float
    joint: str
    clearance: Floats
    landing: Floats
    timely: npt.NDArray[np.bool_]
    true_end: npt.NDArray[np.bool_]
    seconds: float


def measure(motion: Motion) -> Metrics:
    """Measure a motion."""
    trajectory, frames = motion.trajectory, motion.contact_frame
    striker = trajectory.rally.striker
    hips = motion.position[:, :, 0, :2].astype(np.float64)
    velocity = np.diff(hips, axis=0) * motion.fps
    ends = np.rint(trajectory.end_time * motion.fps).astype(np.int64)
    worst = max((joint for seat in (0, 1) for joint in joints(motion, seat)), key=lambda joint: joint.excess)
    shot = trajectory.rally.catalogue.shot[trajectory.rally.stroke]
    low, _, high = load_measured().flight_time[shot].T
    duration = trajectory.end_time - trajectory.time
    returned = trajectory.end == RETURN
    slide, sunk = _feet(motion)
    return Metrics(
        contact=np.linalg.norm(motion.sweet_spot[frames, striker] - motion.shuttle[frames], axis=1),
        slide=slide,
        sunk=sunk,
        speed=np.linalg.norm(velocity, axis=2).max(axis=0),
        acceleration=np.linalg.norm(np.diff(velocity, axis=0), axis=2).max(axis=0) * motion.fps,
        joint_excess=float(np.degrees(worst.excess)) if worst.excess > _ROUNDING else 0.0,
        joint=worst.name,
        clearance=np.array([_clearance(motion, int(i)) for i in np.flatnonzero(trajectory.end != NET)]),
        landing=np.linalg.norm(motion.shuttle[ends] - trajectory.chosen_point, axis=1),
        timely=((duration >= low - 1e-6) & (duration <= high + 1e-6))[returned],
        true_end=np.array([_ends_truly(motion, i, int(ends[i])) for i in range(len(frames))]),
        seconds=float(motion.time[-1]),
    )


def summary(found: Sequence[Metrics]) -> dict[str, float]:
    """Figures over several motions.

    Args:
        found: the measures of each, at least one.

    Returns:
        ``rallies``, ``strokes``, ``plants`` (of a foot) and ``seconds`` that were measured; ``contact_max``, ``slide_max``,
        ``sunk_max``, ``net_clearance_min``, ``landing_error_max`` [m]; ``speed_max`` [m/s], ``acceleration_max`` [m/s²],
        ``joint_excess_deg``; shares ``contact_within_1cm``, ``ends_as_it_must`` and ``flight_times_in_quartiles``. Figures
        without data (no stroke crosses the net, none is returned) are left out.
    """

    def every(name: str) -> npt.NDArray[Any]:
        return np.concatenate([np.atleast_1d(getattr(metrics, name)) for metrics in found])

    figures: dict[str, float] = {
        "rallies": len(found),
        "strokes": len(every("contact")),
        "seconds": float(every("seconds").sum()),
        "contact_max": float(every("contact").max()),
        "contact_within_1cm": float((every("contact") <= 0.01).mean()),
        "slide_max": float(every("slide").max()),
        "plants": len(every("slide")),
        "sunk_max": float(every("sunk").max()),
        "speed_max": float(every("speed").max()),
        "acceleration_max": float(every("acceleration").max()),
        "joint_excess_deg": float(every("joint_excess").max()),
        "landing_error_max": float(every("landing").max()),
        "ends_as_it_must": float(every("true_end").mean()),
    }
    if len(clearance := every("clearance")):
        figures["net_clearance_min"] = float(clearance.min())
    if len(timely := every("timely")):
        figures["flight_times_in_quartiles"] = float(timely.mean())
    return figures


def _feet(motion: Motion) -> tuple[Floats, float]:
    """Slide of planted feet, and depth to which feet sink into the floor."""
    slides, sunk = [], 0.0
    for seat in (0, 1):
        for foot, side in enumerate(("Left", "Right")):
            ball = motion.position[:, seat, BONE[f"{side}ToeBase"]].astype(np.float64)
            sunk = max(sunk, float(motion.skeletons[seat].at("RightToeBase")[2] - ball[:, 2].min()))
            edges = np.flatnonzero(np.diff(np.r_[0, motion.planted[:, seat, foot].astype(np.int8), 0])).reshape(-1, 2)
            slides += [float(np.linalg.norm(ball[a:b, :2] - ball[a, :2], axis=1).max()) for a, b in edges]
    return np.array(slides), sunk


def _clearance(motion: Motion, i: int) -> float:
    """Height over the net of a stroke that crosses it [m]."""
    trajectory = motion.trajectory
    since = np.arange(0, trajectory.end_time[i] - trajectory.time[i], 1 / _FINE)
    path, _ = trajectory.flight.at(i, since)
    over = np.flatnonzero(np.diff(np.sign(path[:, 1])) != 0)
    return float((path[over, 2] - net_height(path[over, 0])).min()) if len(over) else -np.inf


def _ends_truly(motion: Motion, i: int, frame: int) -> bool:
    """Whether a stroke ends as it must."""
    trajectory, stroke = motion.trajectory, motion.trajectory.rally.stroke[i]
    x, y, z = motion.shuttle[frame].astype(np.float64) * np.array([facing(int(trajectory.rally.striker[i]))] * 2 + [1.0])
    meant = int(area_of(np.array(x), np.array(y))) == trajectory.rally.catalogue.area[stroke]
    serve = bool(trajectory.rally.catalogue.is_serve[stroke])
    in_box = abs(x) <= HALF_WIDTH and (SHORT_SERVICE if serve else 0.0) <= y <= HALF_LENGTH
    if trajectory.end[i] == RETURN:
        # Serves are struck on from where the server may not stand, so their place is moved into the service court.
        return meant or serve
    if trajectory.end[i] == WIN:
        return bool((meant or serve) and in_box and z < 0.05)
    if trajectory.end[i] == OUT:
        return bool(not in_box and z < 0.05)
    after = motion.shuttle[frame:].astype(np.float64)
    touched = abs(y) < 0.05 and z < float(net_height(x))
    stays = (after[:, 1] * facing(int(trajectory.rally.striker[i])) < 0.05).all()
    return bool(touched and stays and after[-1, 2] < 0.05)
