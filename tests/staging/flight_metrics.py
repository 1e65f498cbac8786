"""Measures of flights by shot type: height over the net, speed off the racket, and apex, from the frames of the shuttle."""

import dataclasses
from collections.abc import Hashable, Iterable, Sequence
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.court.staging.motion import Motion
from shuttle_marl.court.staging.trajectory import NET
from shuttle_marl.game.rules import RETURNED_BELOW
from shuttle_marl.game.stroke import SHOTS
from tests.staging.motion_metrics import clearance

_DIGITS: Final = 2


@dataclasses.dataclass(frozen=True, kw_only=True)
class Flight:
    """One stroke.

    Attributes:
        player: who struck it.
        below: whether it is returned from below the net.
        net_cm: height over the net where it crosses it [cm]; NaN for a shuttle into the net.
        kmh: speed off the racket [km/h].
        apex_m: greatest height above the floor [m].
    """

    shot: str
    player: Hashable
    below: bool
    net_cm: float
    kmh: float
    apex_m: float


def flights_of(motion: Motion, match: Hashable) -> Iterable[Flight]:
    """The flights of a rally; players are told apart by match and seat."""
    trajectory, rally, contacts = motion.trajectory, motion.trajectory.rally, motion.contact_frame
    ends = np.rint(trajectory.end_time * motion.fps).astype(np.int64)
    for i, outcome in enumerate(rally.outcome.tolist()):
        path = motion.shuttle[contacts[i] : ends[i] + 1].astype(np.float64)
        yield Flight(
            shot=SHOTS[rally.catalogue.shot[rally.stroke[i]]],
            player=(match, int(rally.striker[i])),
            below=outcome == RETURNED_BELOW,
            net_cm=np.nan if trajectory.end[i] == NET else 100 * clearance(motion, i),
            kmh=3.6 * float(np.linalg.norm(motion.shuttle_velocity[contacts[i]])),
            apex_m=float(path[:, 2].max()),
        )


def summary_of_flights(found: Sequence[Flight]) -> dict[str, Any]:
    """Figures over flights.

    Returns:
        ``flights``: by shot type the number of ``strokes`` that cross the net, ``median`` and ``p90`` of ``net_cm``, of the same
        for those ``below_cm`` that are returned from below, and of ``kmh``, and the median ``apex_m``;
        ``half_smash_slower``: share of all pairs of a half smash and a smash of one player in which the half smash is slower.
    """
    by_shot = {shot: [one for one in found if one.shot == shot and np.isfinite(one.net_cm)] for shot in SHOTS}
    figures: dict[str, Any] = {
        shot: {
            "strokes": len(own),
            "net_cm": _spread([one.net_cm for one in own]),
            "below_cm": _spread([one.net_cm for one in own if one.below]),
            "kmh": _spread([one.kmh for one in own]),
            "apex_m": round(float(np.median([one.apex_m for one in own])), _DIGITS),
        }
        for shot, own in by_shot.items()
        if own
    }
    pairs = [half.kmh < full.kmh for half in by_shot["half-smash"] for full in by_shot["smash"] if half.player == full.player]
    return {"flights": figures, "half_smash_slower": float(np.mean(pairs)) if pairs else None}


def _spread(values: Sequence[float] | F64) -> dict[str, float] | None:
    if not len(values):
        return None
    return {name: round(float(np.quantile(values, q)), _DIGITS) for name, q in (("median", 0.5), ("p90", 0.9))}
