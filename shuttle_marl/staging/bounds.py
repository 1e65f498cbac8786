"""Bounds of flights by shot type: height over the net, launch speed, and apex.

Matches tell when and roughly where a shuttle is met, but not how high. Heights and times that are drawn independently can
contradict the shot type. Within these bounds a flight looks like what players call it.
"""

import dataclasses
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.staging.flight import Flights
from shuttle_marl.staging.trajectory import net_height

CLEARANCE: Final = 0.035
"""Least height of the shuttle above the net [m]."""
_ANY: Final = (0.0, np.inf)
_TOUCHES: Final = 100.0
"""Weight of the height that is missing over the net."""
_KMH: Final = 0.01
"""Weight of the speed beyond a bound [m per km/h]."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Bounds:
    """Least and greatest values of the flights of one shot type.

    Attributes:
        over: height above the net of shuttles met below it, or that land [m].
        over_high: the same of shuttles met above the net: loose ones, for shots that are meant to be met below it [m].
        varied: share of the range of ``over`` by which its upper end is lowered at most, as drawn for each stroke.
        kmh: launch speed [km/h].
        apex: greatest height above the floor [m].
    """

    over: tuple[float, float] = (CLEARANCE, np.inf)
    over_high: tuple[float, float] = (CLEARANCE, np.inf)
    varied: float = 0.0
    kmh: tuple[float, float] = _ANY
    apex: tuple[float, float] = _ANY

    def excess(self, flights: Flights, met: int, u: float, *, crosses: bool) -> F64:
        """``[N]`` distance from the bounds, 0 inside them [m].

        Args:
            met: 0: below the net or on the floor; 1: above the net.
            u: how much the range of ``over`` is lowered, 0 to 1.
            crosses: whether the flights pass the net; otherwise only their speed is bounded.
        """
        out = _KMH * _outside(3.6 * flights.launch_speed, self.kmh)
        if crosses:
            over, (low, high) = height_over_net(flights), self.over
            lowered = low, high - u * self.varied * (high - low) if self.varied else high
            out += _outside(over, self.over_high if met else lowered) + _outside(flights.apex, self.apex)
            out += _TOUCHES * np.maximum(CLEARANCE - over, 0.0)
        return out


_OF: Final[dict[str, Bounds]] = {
    "short-serve": Bounds(over=(CLEARANCE, 0.24), over_high=(CLEARANCE, 0.50), varied=0.6, kmh=(0, 75)),
    "long-serve": Bounds(apex=(0, 7)),
    "clear": Bounds(kmh=(0, 230), apex=(4, 7)),
    "lift": Bounds(kmh=(0, 150), apex=(4, 7)),
    "drop": Bounds(over=(CLEARANCE, 0.85), over_high=(CLEARANCE, 1.0), kmh=(0, 114)),
    "smash": Bounds(over=(CLEARANCE, 0.45), over_high=(CLEARANCE, 0.60), kmh=(208, 330)),
    "half-smash": Bounds(over=(CLEARANCE, 0.45), over_high=(CLEARANCE, 0.60), kmh=(130, 200)),
    "drive": Bounds(over=(CLEARANCE, 0.40), over_high=(CLEARANCE, 0.38), kmh=(80, 220)),
    "push": Bounds(kmh=(0, 110), apex=(0, 3.6)),
    "net-kill": Bounds(over=(CLEARANCE, 0.35), over_high=(CLEARANCE, 0.45), kmh=(60, 200)),
    "net-shot": Bounds(over=(CLEARANCE, 0.23), over_high=(0.40, 0.90), varied=0.7, kmh=(0, 70)),
    "block": Bounds(over=(CLEARANCE, 0.35), over_high=(0.40, 0.90), varied=0.5, kmh=(0, 85)),
    "cross-court-net-shot": Bounds(over=(CLEARANCE, 0.23), over_high=(0.40, 0.90), varied=0.7, kmh=(0, 75)),
}
BOUNDS: Final = tuple(_OF[shot] for shot in SHOTS)
"""Bounds of each shot type. Half smashes are slower than every smash."""


def height_over_net(flights: Flights) -> F64:
    """``[N]`` height over the top of the net [m]; infinite if a flight begins beyond it or does not reach it."""
    ahead = np.maximum(flights.heading[:, 1], 1e-6)
    x = flights.start[:, 0] - flights.start[:, 1] / ahead * flights.heading[:, 0]
    return flights.height_over(0.0) - net_height(x)


def _outside(value: F64, limits: tuple[float, float]) -> F64:
    finite = np.where(np.isfinite(value), value, limits[0])
    return np.maximum(finite - limits[1], 0.0) + np.maximum(limits[0] - finite, 0.0)
