"""Trajectory of a rally: times and places of all strokes, flights, the path of the shuttle, and the travel of the players.

The hips travel on the smoothest path that is at the root of each stance and near the base when the opponent strikes:

    minimise   Σ w_a |p̈|² + Σ w_b |base - p|² + Σ w_v |ṗ|² + Σ W |root - p|²    subject to |ṗ| ≤ V, |p̈| ≤ A

Solved by the alternating direction method of multipliers (Boyd et al. 2011): one pentadiagonal system, and projections onto
discs.
"""

import dataclasses
import math
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import F64, I64
from shuttle_marl.base.compiling import compiled
from shuttle_marl.court.staging.flight import GRAVITY, Flights, fall, shoot
from shuttle_marl.court.staging.poses import HELD, Stance
from shuttle_marl.game.rally import Rally

LEAD_IN: Final = 1.2  # time before the serve [s]
RETURN, WIN, OUT, NET, OPEN = range(5)
ENDS: Final = ("returned", "winner", "out", "net", "open")  # open: the reply is not chosen yet

RESTING: Final = 0.014  # height of a shuttle that lies on the floor [m]
_BY_STROKE: Final = ("time", "contact", "end", "end_time", "chosen_point", "end_point", "base")
_BENDING: Final = 2e-3  # weight of the acceleration
_TOP_SPEED, _TOP_ACCELERATION = 6.5, 12.0  # limits of the hips over the floor, which are never passed [m/s] and [m/s²]
_MARGIN: Final = 0.90  # fraction of the limits that the solver aims at
_SPEED_PENALTY, _ACCELERATION_PENALTY = 2e-2, 3e-3  # penalties of what is above the limits
_ROUNDS, _MOST_ROUNDS = 240, 4000  # iterations after which the margin is given up, and their maximum number
_STIFFER: Final = (400, 1200)  # iterations at which the penalties grow twelvefold
_SLACK, _LATE_SLACK = 1.02, 0.995 / _MARGIN  # factors of the aim below which a path is accepted
_PINNED: Final = 1e11
_CONTACT, _BASE, _STILL, _BRAKE = 4e3, 6.0, 1.2, 0.6
_LATE: Final = 0.12  # time after the contact at which a hurried player brakes [s]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Trajectory:
    """Times, places and flights of a rally of n strokes, in the frame of the court."""

    rally: Rally
    time: F64  # [n] time of each contact, on the grid of frames [s]
    contact: F64  # [n, 3] position of the shuttle at each contact [m]
    end: I64  # [n] index into ENDS
    end_time: F64  # [n] end of the flight at the receiver's racket, on the floor, or in the net [s]
    chosen_point: F64  # [n, 3] drawn end point of each flight [m]
    end_point: F64  # [n, 3] end point [m]: the chosen point, unless the receiver's racket does not reach it
    flight: Flights
    stance: tuple[Stance, ...]  # n stances, each in its striker's own frame
    base: F64  # [n, 2, 2] base positions of seats 0 and 1 at each stroke, each in their own frame [m]
    before: F64  # [2, 2] positions of seats 0 and 1 before the serve, each in their own frame [m]
    reply: Stance | None = None  # expected stance of the next striker in an open rally


def with_contacts_moved(trajectory: Trajectory, by: dict[int, F64]) -> Trajectory:
    """Move some contacts, by number of the stroke, at the same times, and the flights to and from them [m]."""
    contact, end_point = trajectory.contact.copy(), trajectory.end_point.copy()
    for k, change in by.items():
        contact[k] += change
        if k:
            end_point[k - 1] += change
    rows = sorted({row for k in by for row in (k - 1, k) if row >= 0})
    flight = Flights(*(part.copy() for part in trajectory.flight))
    again = shoot(contact[rows], end_point[rows], (trajectory.end_time - trajectory.time)[rows])
    for part, new in zip(flight, again, strict=True):
        part[rows] = new
    return dataclasses.replace(trajectory, contact=contact, end_point=end_point, flight=flight)


def behind(old: Trajectory, new: Trajectory, first: int) -> Trajectory:
    """The first strokes of one trajectory and another one."""

    def whole(a: F64, b: F64) -> F64:
        return np.concatenate([a[:first], b])

    rows: dict[str, Any] = {name: whole(getattr(old, name), getattr(new, name)) for name in _BY_STROKE}
    flight = Flights(*map(whole, old.flight, new.flight))
    return dataclasses.replace(new, **rows, flight=flight, stance=old.stance[:first] + new.stance)


def shuttle_path(trajectory: Trajectory, frames: int, fps: int, first: int = 0) -> tuple[F64, F64]:
    """``[F, 3]`` position and velocity of the shuttle from the flight of stroke ``first`` on; before the serve it waits."""
    time = np.arange(frames) / fps
    position, velocity = np.zeros((frames, 3)), np.zeros((frames, 3))
    if not len(trajectory.time):
        # In front of the server.
        rally = trajectory.rally
        position[:] = (*(trajectory.before[rally.server] * rally.facing(rally.server)), 1.0)
        return position, velocity
    position[:] = trajectory.contact[0]
    for i in range(first, len(trajectory.time)):
        flown = slice(round(trajectory.time[i] * fps), round(trajectory.end_time[i] * fps) + 1)
        position[flown], velocity[flown] = trajectory.flight.at(i, time[flown] - trajectory.time[i])
    rows = np.flatnonzero(time > trajectory.end_time[-1] + 1e-6)
    hit = trajectory.flight.velocity(-1, -1)
    since = time[rows] - trajectory.end_time[-1]
    if trajectory.end[-1] == NET:
        start = trajectory.end_point[-1]
        back = np.array([-0.04 * hit[0], -0.05 * hit[1], min(0.0, 0.3 * hit[2])])
        drop = fall(start[None], back[None], np.array([2.5]), steps=32)
        position[rows], velocity[rows] = drop.at(0, since)
        landed = np.flatnonzero(position[rows, 2] <= RESTING)
        if len(landed):
            first = rows[landed[0]]
            _roll(position, velocity, first, position[first], velocity[first], time)
    elif len(rows):
        _roll(position, velocity, int(rows[0]), trajectory.end_point[-1], hit, time)
    return position, velocity


def held(position: F64, palm: F64, contacts: I64, trajectory: Trajectory, fps: int) -> None:
    """Place the shuttle in the server's hand: at the palm ``[F, 3]`` until the release, then it drops to the racket."""
    if not len(contacts):
        position[:] = palm
        return
    contact = int(contacts[0])
    release = contact - round(HELD[trajectory.stance[0].motion][1] * fps)
    position[: release + 1] = palm[: release + 1]
    whole = (contact - release) / fps
    since = np.arange(1, contact - release)[:, None] / fps
    pull = np.array([0.0, 0.0, -GRAVITY])
    start = (position[contact] - palm[release] - pull / 2 * whole**2) / whole
    position[release + 1 : contact] = palm[release] + start * since + pull / 2 * since**2


def _roll(position: F64, velocity: F64, first: int, start: F64, into: F64, time: F64) -> None:
    """One small bounce from frame ``first``, then a short slide to rest."""
    rows = slice(first, None)
    since = time[rows] - time[first] + 0.5 * (time[1] - time[0])
    up = min(0.18 * abs(float(into[2])), 1.0)
    stop = 0.25
    slide = 0.12 * into[:2] * stop * (1 - np.exp(-since / stop))[:, None]
    position[rows, :2] = start[:2] + slide
    position[rows, 2] = np.maximum(RESTING, RESTING + up * since - GRAVITY / 2 * since**2)
    velocity[rows] = np.gradient(position[rows], time[1] - time[0], axis=0) if len(since) > 1 else 0.0


def travel(trajectory: Trajectory, seat: int, shift: F64, frames: int, fps: int, walked: F64 | None = None) -> F64:
    """``[frames, 2]`` the hips of one player over the floor, in the player's own frame [m]; ``shift``: ``[n, 2]`` added to the
    root of each stance [m]; ``walked``: ``[B, 2]`` the first frames, where the hips have been already, two at least."""
    weight, target, still = _wishes(trajectory, seat, shift, frames, fps)
    if walked is None:
        return _smoothest(weight, target, still, fps)
    # The last two known frames pin place and speed, and only the following frames are solved.
    first = len(walked) - 2
    weight[first : first + 2], target[first : first + 2] = _PINNED, _PINNED * walked[first:]
    return np.concatenate([walked, _smoothest(weight[first:], target[first:], still[first:], fps)[2:]])


def _wishes(trajectory: Trajectory, seat: int, shift: F64, frames: int, fps: int) -> tuple[F64, F64, F64]:
    """``[F]`` weight of a place, ``[F, 2]`` weight times place, and ``[F - 1]`` weight of the speed."""
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
        return weight, target, still
    elif striker[-1] != seat and trajectory.end[-1] == WIN:
        # The receiver goes for a winner, but does not get there.
        landing = rally.facing(seat) * trajectory.end_point[-1, :2]
        begun = trajectory.base[-1, seat]
        place = begun + 0.55 * (landing - begun)
        place[1] = min(place[1], -0.8)
        wish(min(round(trajectory.end_time[-1] * fps), frames - 1), place, 60.0)
    still[-round(0.3 * fps) :] += 5.0
    return weight, target, still


@compiled
def _factor(weight: F64, still: F64, more: float, along: float, across: float, bands: F64) -> None:
    """Cholesky factor of diag(weight) + along · D1' diag(still + more) D1 + across · D2' D2; D1, D2: first, second differences.
    ``bands`` ``[3, F]`` are written: the factor in the row of each frame, two columns before it, one before it, in it."""
    n = len(weight)
    second, first, diagonal = bands[0], bands[1], bands[2]
    for i in range(n):
        second[i], first[i], diagonal[i] = 0.0, 0.0, weight[i]
    for i in range(n - 1):
        w = (still[i] + more) * along
        diagonal[i] += w
        diagonal[i + 1] += w
        first[i + 1] -= w
    for i in range(n - 2):
        diagonal[i] += across
        diagonal[i + 1] += 4 * across
        diagonal[i + 2] += across
        first[i + 1] -= 2 * across
        first[i + 2] -= 2 * across
        second[i + 2] += across
    for i in range(n):
        if i > 1:
            second[i] /= diagonal[i - 2]
            first[i] -= second[i] * first[i - 1]
            diagonal[i] -= second[i] * second[i]
        if i > 0:
            first[i] /= diagonal[i - 1]
            diagonal[i] -= first[i] * first[i]
        diagonal[i] = math.sqrt(diagonal[i])


@compiled
def _solve(bands: F64, x: F64) -> None:
    """Solve with a factor of :func:`_factor`: ``x`` ``[F, 2]`` is the right side, then the solution."""
    n = len(x)
    for i in range(n):
        for c in range(2):
            if i > 0:
                x[i, c] -= bands[1, i] * x[i - 1, c]
            if i > 1:
                x[i, c] -= bands[0, i] * x[i - 2, c]
            x[i, c] /= bands[2, i]
    for i in range(n - 1, -1, -1):
        for c in range(2):
            if i + 1 < n:
                x[i, c] -= bands[1, i + 1] * x[i + 1, c]
            if i + 2 < n:
                x[i, c] -= bands[0, i + 2] * x[i + 2, c]
            x[i, c] /= bands[2, i]


@compiled
def _project(now: F64, limit: float, projected: F64, scaled: F64, relax: float) -> float:
    """Update the multipliers of ``[N, 2]`` vectors limited to length ``limit``; returns the greatest current length."""
    longest = 0.0
    for i in range(len(now)):
        x, y = now[i, 0], now[i, 1]
        longest = max(longest, x * x + y * y)
        x, y = relax * x + (1 - relax) * projected[i, 0] + scaled[i, 0], relax * y + (1 - relax) * projected[i, 1] + scaled[i, 1]
        share = min(1.0, limit / max(math.sqrt(x * x + y * y), 1e-9))
        projected[i, 0], projected[i, 1] = share * x, share * y
        scaled[i, 0], scaled[i, 1] = x - projected[i, 0], y - projected[i, 1]
    return math.sqrt(longest)


@compiled
def _smoothest(weight: F64, target: F64, still: F64, fps: int) -> F64:
    """``[F, 2]`` path of the hips by the alternating direction method of multipliers, for what :func:`_wishes` returns."""
    rho_v, rho_a = _SPEED_PENALTY, _ACCELERATION_PENALTY
    top_speed, top_acceleration = _MARGIN * _TOP_SPEED, _MARGIN * _TOP_ACCELERATION
    n, p = len(weight), np.empty_like(target)
    speed, bend = float(fps), float(fps) * fps
    bands, now = np.empty((3, n)), np.empty_like(target)
    zv, za = np.zeros((n - 1, 2)), np.zeros((n - 2, 2))
    uv, ua = np.zeros((n - 1, 2)), np.zeros((n - 2, 2))
    # Plain loops: numba compiles expressions of arrays in seconds.
    for step in range(-1, _MOST_ROUNDS):
        if step < 0 or step in _STIFFER:
            # Where the start is given, the wishes may violate the limits by much: the penalties grow.
            if step > 0:
                rho_v, rho_a = 12 * rho_v, 12 * rho_a
                for i in range(n - 1):
                    for c in range(2):
                        uv[i, c] *= 1 / 12
                        if i < n - 2:
                            ua[i, c] *= 1 / 12
            _factor(weight, still, rho_v, speed**2, (_BENDING + rho_a) * bend**2, bands)
        for i in range(n):
            for c in range(2):
                p[i, c] = target[i, c]
        if step >= 0:
            for i in range(n - 1):
                for c in range(2):
                    push = rho_v * speed * (zv[i, c] - uv[i, c])
                    p[i + 1, c] += push
                    p[i, c] -= push
            for i in range(n - 2):
                for c in range(2):
                    push = rho_a * bend * (za[i, c] - ua[i, c])
                    p[i + 2, c] += push
                    p[i + 1, c] -= 2 * push
                    p[i, c] += push
        _solve(bands, p)
        relax = 1.6 if step >= 0 else 1.0
        for i in range(n - 1):
            for c in range(2):
                now[i, c] = (p[i + 1, c] - p[i, c]) * speed
        fastest = _project(now[: n - 1], top_speed, zv, uv, relax)
        for i in range(n - 2):
            for c in range(2):
                now[i, c] = (p[i + 2, c] - 2 * p[i + 1, c] + p[i, c]) * bend
        hardest = _project(now[: n - 2], top_acceleration, za, ua, relax)
        allowed = _SLACK if step < _ROUNDS else _LATE_SLACK
        if step > 0 and step % 10 == 9 and fastest < allowed * top_speed and hardest < allowed * top_acceleration:
            break
    return p
