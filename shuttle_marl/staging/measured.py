"""Timing and places measured in the training matches; written by ``experiments/fit_staging.py``."""

import dataclasses
import functools
import json
from pathlib import Path
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.stroke import HEIGHTS, N_SERVES, SHOTS

FILE: Final = Path(__file__).parent / "measured.json"
"""Shipped table; its ``provenance`` names the matches."""
DISTANCES: Final = tuple(float(d) for d in range(14))
"""Edges of the classes of length of a stroke [m]."""
QUARTILES: Final = (0.25, 0.5, 0.75)
QUANTILES: Final = (0.05, 0.25, 0.5, 0.75, 0.95)
"""Quantiles of places."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Measured:
    """Times and places in the matches.

    Attributes:
        flight_time: ``[13, 3]`` quartiles of the time until the receiver strikes [s], by shot type.
        flight_time_by_length: ``[13, 2, 13, 3]`` the same by shot type, height at which the shuttle is met (0 below, 1
            above the net), and length in metres (class k: from k to k + 1).
        places: ``[13, 9, 2, 5]`` quantiles of x and y of the point where the receiver meets the shuttle, in the striker's
            frame [m], by shot type and area.
        base: ``[13, 9, 2]`` where a player stands, in their own frame [m], when the opponent answers; by their own stroke.
        net_share: ``[13]`` share of the faults of a shot type that do not cross the net.
        out_by: ``[2, 5]`` quantiles of the distance by which shuttles land beyond the side and the back line [m].
        serve: ``[2, 2, 2, 5]`` quantiles by serve, (server, receiver), (distance from the centre line, from the net) [m].
    """

    flight_time: F64
    flight_time_by_length: F64
    places: F64
    base: F64
    net_share: F64
    out_by: F64
    serve: F64

    def seconds(self, shot: int, met: int, length: float, u: float) -> float:
        """Flight time [s] at a share ``u`` of the interquartile range, by shot type, height met (0/1) and length."""
        low, middle, high = self.flight_time_by_length[shot, met, min(int(length), len(DISTANCES) - 2)]
        drawn = low + 2 * u * (middle - low) if u < 0.5 else middle + (2 * u - 1) * (high - middle)
        return float(np.clip(drawn, self.flight_time[shot, 0], self.flight_time[shot, 2]))


def quantile(knots: F64, u: float) -> float:
    """Value at a share ``u`` from quantiles ``[5]`` at :data:`QUANTILES`, linear in between, held outside."""
    return float(np.interp(u, QUANTILES, knots))


@functools.cache
def load_measured(path: Path = FILE) -> Measured:
    """The shipped table, or one that ``experiments/fit_staging.py`` wrote."""
    raw = json.loads(path.read_text(encoding="utf-8"))
    serves = SHOTS[:N_SERVES]
    by_length = raw["flight_time_by_length"]
    return Measured(
        flight_time=np.array([raw["flight_time"][s] for s in SHOTS]),
        flight_time_by_length=np.array([[by_length[s][h] for h in HEIGHTS] for s in SHOTS]),
        places=np.array([[raw["places"][s][a] for a in AREAS] for s in SHOTS]),
        base=np.array([[raw["base"][s][a] for a in AREAS] for s in SHOTS]),
        net_share=np.array([raw["faults"][s] for s in SHOTS]),
        out_by=np.array([raw["out_by"][side] for side in ("side", "back")]),
        serve=np.array([[raw["serve"][s][who] for who in ("striker", "receiver")] for s in serves]),
    )
