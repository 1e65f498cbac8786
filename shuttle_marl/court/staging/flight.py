"""Flight of a shuttle with quadratic drag, the launch that reaches a point at a given time, and the bounds of each shot type.

    dv/dt = -g - |v| v / L,    L = U² / g,    U = 6.8 m/s (Cohen et al., New Journal of Physics 17, 2015)

Lengths are scaled by L and times by U/g. Time steps grow so that drag alone would cover equal distances: 16 of them are exact
to millimetres. Heights and times that are drawn independently can contradict the shot type; bounds keep a flight what players
call it.
"""

import dataclasses
import math
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64, Intp
from shuttle_marl.base.compiling import compiled
from shuttle_marl.game.court import NET_HEIGHT, NET_HEIGHT_CENTRE, WIDTH
from shuttle_marl.game.stroke import SHOTS

GRAVITY: Final = 9.81  # acceleration of gravity [m/s²]
TERMINAL: Final = 6.8  # terminal speed of a shuttle [m/s]
LENGTH: Final = TERMINAL**2 / GRAVITY  # length over which drag slows a fast shuttle by a factor e [m]
_TIME: Final = TERMINAL / GRAVITY
STEPS: Final = 16
_TOLERANCE: Final = 5e-4 / LENGTH
CLEARANCE: Final = 0.035  # least height of the shuttle above the net [m]
_ANY: Final = (0.0, np.inf)
_TOUCHES, _KMH = 100.0, 0.01  # weight of the height that is missing over the net, and of the speed beyond a bound [m per km/h]


class Flights(NamedTuple):
    """N flights, each known at K instants from its launch."""

    start: F64  # [N, 3] start of each flight [m]
    heading: F64  # [N, 2] unit direction on the floor
    time: F64  # [N, K] instants since the launch [s]
    along: F64  # [N, K] distance along the floor [m]
    rise: F64  # [N, K] height gained [m]
    speed_along: F64  # [N, K] [m/s]
    speed_up: F64  # [N, K] [m/s]

    def at(self, flight: int, time: F64) -> tuple[F64, F64]:
        """Position and velocity, each ``[..., 3]``, of one flight at times since its launch (held at both ends)."""
        t = self.time[flight]
        k = np.clip(np.searchsorted(t, time, side="right") - 1, 0, len(t) - 2)
        h = t[k + 1] - t[k]
        u = np.clip((time - t[k]) / h, 0, 1)
        along, v_along = _hermite(self.along[flight], self.speed_along[flight], k, h, u)
        rise, v_up = _hermite(self.rise[flight], self.speed_up[flight], k, h, u)
        heading = self.heading[flight]
        position = self.start[flight] + np.stack([heading[0] * along, heading[1] * along, rise], axis=-1)
        return position, np.stack([heading[0] * v_along, heading[1] * v_along, v_up], axis=-1)

    def velocity(self, flight: int, instant: int) -> F64:
        """``[3]`` velocity of one flight at one of its instants, 0: launch, -1: end [m/s]."""
        along, up = self.speed_along[flight, instant], self.speed_up[flight, instant]
        return np.array([*(self.heading[flight] * along), up])

    @property
    def launch_speed(self) -> F64:
        """``[N]`` speed off the racket [m/s]."""
        return np.hypot(self.speed_along[:, 0], self.speed_up[:, 0])

    @property
    def apex(self) -> F64:
        """``[N]`` greatest height, at one of the known instants [m]."""
        return self.start[:, 2] + self.rise.max(axis=1)

    def height_over(self, y: float) -> F64:
        """``[N]`` height at which each flight crosses the plane of constant ``y`` [m]; infinite if it does not."""
        share = self.heading[:, 1]
        distance = np.where(share != 0, (y - self.start[:, 1]) / np.where(share != 0, share, 1.0), np.inf)[:, None]
        k = np.clip((self.along < distance).sum(axis=1) - 1, 0, self.along.shape[1] - 2)[:, None]
        along, rise, up, ahead = (
            np.take_along_axis(part, k + np.arange(2), axis=1)
            for part in (self.along, self.rise, self.speed_up, self.speed_along)
        )
        # Height as a cubic of the distance between two instants; its slope is the ratio of the speeds.
        h = np.maximum(along[:, 1] - along[:, 0], 1e-9)
        slope = h[:, None] * up / np.maximum(ahead, 1e-6)
        u = np.clip((distance[:, 0] - along[:, 0]) / h, 0, 1)
        z = self.start[:, 2] + _cubic(rise[:, 0], rise[:, 1], slope[:, 0], slope[:, 1], u)
        return np.where((distance[:, 0] >= 0) & (distance[:, 0] <= self.along[:, -1]), z, np.inf)


def shoot(start: F64, end: F64, time: F64) -> Flights:
    """Flights from ``start`` ``[N, 3]`` [m] that are at ``end`` after ``time`` ``[N]`` seconds, but for less than a millimetre.
    Newton's method on the logarithm of the launch speed and its angle, from the exact solution without gravity aimed above the
    target by the drop that drag allows."""
    offset = end - start
    distance = np.hypot(offset[:, 0], offset[:, 1])
    heading = offset[:, :2] / np.maximum(distance, 1e-9)[:, None]
    x, y, t = np.maximum(distance, 1e-3) / LENGTH, offset[:, 2] / LENGTH, time / _TIME
    lift = y + np.log(np.cosh(t))
    reach = np.hypot(x, lift)
    log_speed, angle = np.log(np.expm1(reach) / t), np.arctan2(lift, x)
    todo = np.arange(len(t))
    for _ in range(12):
        u, a = log_speed[todo], angle[todo]
        # Finite differences: the flight itself and two perturbed launches, integrated together.
        e = 1e-5
        speed, aim = np.exp(np.concatenate([u, u + e, u])), np.concatenate([a, a, a + e])
        _, px, py, _, _ = _integrate(speed * np.cos(aim), speed * np.sin(aim), np.tile(t[todo], 3), STEPS)
        end_x, end_y = px[:, -1].reshape(3, -1), py[:, -1].reshape(3, -1)
        mx, my = end_x[0] - x[todo], end_y[0] - y[todo]
        (xs, xa), (ys, ya) = (end_x[1:] - end_x[0]) / e, (end_y[1:] - end_y[0]) / e
        far = np.hypot(mx, my) > _TOLERANCE
        if not far.any():
            break
        det = xs * ya - xa * ys
        det = np.where(np.abs(det) < 1e-9, 1e-9, det)
        log_speed[todo] = u + np.where(far, np.clip((xa * my - ya * mx) / det, -1, 1), 0)
        angle[todo] = a + np.where(far, np.clip((ys * mx - xs * my) / det, -0.5, 0.5), 0)
        todo = todo[far]
    speed = np.exp(log_speed)
    return _flown(start, heading, speed * np.cos(angle), speed * np.sin(angle), t, STEPS)


def fall(start: F64, velocity: F64, time: F64, steps: int = STEPS) -> Flights:
    """Flights with a given launch, for ``time`` seconds."""
    along = np.hypot(velocity[:, 0], velocity[:, 1])
    heading = velocity[:, :2] / np.maximum(along, 1e-9)[:, None]
    return _flown(start, heading, along / TERMINAL, velocity[:, 2] / TERMINAL, time / _TIME, steps)


def net_height(x: F64 | float) -> F64:
    """Height of the top of the net [m]: 1.524 m in the middle, 1.55 m over the doubles side lines."""
    return NET_HEIGHT_CENTRE + (NET_HEIGHT - NET_HEIGHT_CENTRE) * (2 * np.asarray(x, dtype=np.float64) / WIDTH) ** 2


@dataclasses.dataclass(frozen=True, kw_only=True)
class Bounds:
    """Least and greatest values of the flights of one shot type."""

    over: tuple[float, float] = (CLEARANCE, np.inf)  # height above the net of shuttles met below it, or that land [m]
    over_high: tuple[float, float] = (CLEARANCE, np.inf)  # of shuttles met above the net: loose ones [m]
    varied: float = 0.0  # share of the range of over by which its upper end is lowered at most, as drawn for each stroke
    kmh: tuple[float, float] = _ANY  # launch speed [km/h]
    apex: tuple[float, float] = _ANY  # greatest height above the floor [m]

    def excess(self, flights: Flights, met: int, u: float, *, crosses: bool) -> F64:
        """``[N]`` distance from the bounds, 0 inside them [m]; ``met``: 0: below the net or on the floor; 1: above the net;
        ``u``: how much the range of ``over`` is lowered, 0 to 1; ``crosses``: whether the flights pass the net; otherwise only
        their speed is bounded."""
        out = _KMH * _outside(3.6 * flights.launch_speed, self.kmh)
        if crosses:
            # Infinite if a flight begins beyond the net or does not reach it.
            x = flights.start[:, 0] - flights.start[:, 1] / np.maximum(flights.heading[:, 1], 1e-6) * flights.heading[:, 0]
            over, (low, high) = flights.height_over(0.0) - net_height(x), self.over
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
BOUNDS: Final = tuple(_OF[shot] for shot in SHOTS)  # bounds of each shot type. Half smashes are slower than every smash


def _outside(value: F64, limits: tuple[float, float]) -> F64:
    finite = np.where(np.isfinite(value), value, limits[0])
    return np.maximum(finite - limits[1], 0.0) + np.maximum(limits[0] - finite, 0.0)


def _flown(start: F64, heading: F64, vx: F64, vy: F64, t: F64, steps: int) -> Flights:
    nodes, px, py, ux, uy = _integrate(vx, vy, t, steps)
    return Flights(start, heading, nodes * _TIME, px * LENGTH, py * LENGTH, ux * TERMINAL, uy * TERMINAL)


def _integrate(vx: F64, vy: F64, t: F64, steps: int) -> tuple[F64, F64, F64, F64, F64]:
    """Classical Runge-Kutta in scaled units: instants, positions and velocities, each ``[N, steps + 1]``."""
    # From rest, steps are equal.
    stretch = np.log1p(np.maximum(np.hypot(vx, vy) * t, 1e-3))[:, None] * np.linspace(0, 1, steps + 1)
    nodes = t[:, None] * np.expm1(stretch) / np.maximum(np.expm1(stretch[:, -1:]), 1e-12)
    return nodes, *_states(vx, vy, nodes)


@compiled
def _states(vx: F64, vy: F64, nodes: F64) -> F64:
    """Classical Runge-Kutta of flights in scaled units: ``[4, N, K + 1]`` places and velocities at instants ``[N, K + 1]``."""
    out, k = np.empty((4, *nodes.shape)), np.empty((4, 4))
    for n in range(len(vx)):
        out[0, n, 0], out[1, n, 0], out[2, n, 0], out[3, n, 0] = 0.0, 0.0, vx[n], vy[n]
        for i in range(nodes.shape[1] - 1):
            h = nodes[n, i + 1] - nodes[n, i]
            for stage in range(4):
                share = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
                u, w = out[2, n, i], out[3, n, i]
                if stage:
                    u += share * k[stage - 1, 2]
                    w += share * k[stage - 1, 3]
                drag = -math.sqrt(u * u + w * w)
                k[stage, 0], k[stage, 1], k[stage, 2], k[stage, 3] = u, w, drag * u, drag * w - 1.0
            for c in range(4):
                out[c, n, i + 1] = out[c, n, i] + h / 6 * (k[0, c] + 2 * k[1, c] + 2 * k[2, c] + k[3, c])
    return out


def _cubic(p0: F64, p1: F64, m0: F64, m1: F64, u: F64) -> F64:
    return (2 * u**3 - 3 * u**2 + 1) * p0 + (u**3 - 2 * u**2 + u) * m0 + (3 * u**2 - 2 * u**3) * p1 + (u**3 - u**2) * m1


def _hermite(p: F64, v: F64, k: Intp, h: F64, u: F64) -> tuple[F64, F64]:
    position = _cubic(p[k], p[k + 1], v[k] * h, v[k + 1] * h, u)
    velocity = 6 * u * (1 - u) * (p[k + 1] - p[k]) / h + (1 - 4 * u + 3 * u**2) * v[k] + (3 * u**2 - 2 * u) * v[k + 1]
    return position, velocity
