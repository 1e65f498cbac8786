"""Footwork: place and time of every step; planted feet never slide.

A foot is the point under its ball, its heading, and the pitch of the heel. Places come from stances and split steps; steps in
between alternate under the hips as they travel.
"""

import dataclasses
from typing import NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64, Bools
from shuttle_marl.court.staging.geometry import ease
from shuttle_marl.court.staging.skeleton import LEFT, RIGHT

_STEP_TIME, _SWING = 0.17, 0.28  # shortest duration of a step, and longest swing of a foot in it [s]
_CROSSED, _WIDTH = 0.30, 0.15  # reach of a foot across the middle of the body, and half the width of steps [m]
_STRIDE, _STAYS = 1.25, 0.14  # longest step of a pair of steps, and distance below which a foot does not step [m]
_SOON, _SETTLED = 5, 12  # frames until a foot lands after a branch, and further ones for moving means


@dataclasses.dataclass(frozen=True, eq=False)
class Stand:
    """Both feet on the floor."""

    begin: int  # frame from which both are planted
    end: int  # last frame at which both are
    place: F64  # [2, 2] left and right, the ball of each foot [m]
    yaw: F64  # [2] headings [rad]
    last: int = RIGHT  # the foot that lands last
    hop: bool = False  # the feet come here together, through the air


@dataclasses.dataclass(eq=False)
class Plant:
    """One foot on the floor, from frame ``begin`` to frame ``end``."""

    begin: int
    end: int
    place: F64
    yaw: float


Plants = tuple[list[Plant], list[Plant]]  # of the left and of the right foot, in order of time


class Feet(NamedTuple):
    """Both feet over F frames; axis 0 is left, right: ``ball`` ``[2, F, 3]`` [m], heading, pitch of the heel, and who stands."""

    ball: F64
    yaw: F64
    pitch: F64
    planted: Bools

    def part(self, rows: slice) -> "Feet":
        """Copy of a range of frames."""
        return Feet(self.ball[:, rows].copy(), self.yaw[:, rows].copy(), self.pitch[:, rows].copy(), self.planted[:, rows].copy())

    def concatenated(self, after: "Feet") -> "Feet":
        """Two ranges of frames."""
        return Feet(*(np.concatenate(parts, axis=1) for parts in zip(self, after, strict=True)))

    def joined(self, after: "Feet") -> "Feet":
        """Blend ``after``, whose first frame is the last one of these, into these frames: feet in the air change their paths."""
        out = after.part(slice(1, None))
        for foot in (LEFT, RIGHT):
            flying = np.flatnonzero(np.r_[out.planted[foot], True])[0]
            if self.planted[foot, -1] or not flying:
                continue
            share = 1 - ease(np.arange(1, flying + 1) / (flying + 1))
            out.ball[foot, :flying] += share[:, None] * (self.ball[foot, -1] - after.ball[foot, 0])
            out.yaw[foot, :flying] += share * ((self.yaw[foot, -1] - after.yaw[foot, 0] + np.pi) % (2 * np.pi) - np.pi)
            out.pitch[foot, :flying] += share * (self.pitch[foot, -1] - after.pitch[foot, 0])
        return out


def standing(plants: Plants, ball: F64, frame: int) -> tuple[Stand, Plants]:
    """Plants up to a frame, with the next landings of feet ``[2, 3]`` in the air, and the stand that follows. A foot that would
    land much later lands within a few frames, on its path."""
    kept: Plants = ([], [])
    for foot in (LEFT, RIGHT):
        own = plants[foot]
        n = max(sum(plant.begin <= frame for plant in own), 1)
        kept[foot].extend(dataclasses.replace(plant) for plant in own[:n])
        here = kept[foot][-1]
        if here.end < frame and n < len(own):
            soon = min(own[n].begin, frame + _SOON)
            share = (soon - frame) / (own[n].begin - frame)
            place = ball[foot, :2] + share * (own[n].place - ball[foot, :2])
            kept[foot].append(Plant(soon, soon, place if soon < own[n].begin else own[n].place, own[n].yaw))
        else:
            here.end = max(frame, here.begin)
    last = [kept[foot][-1] for foot in (LEFT, RIGHT)]
    now = max(frame, *(plant.begin for plant in last))
    return Stand(now, now, np.array([plant.place for plant in last]), np.array([plant.yaw for plant in last])), kept


def steps(stands: list[Stand], hips: F64, yaw: F64, reach: F64, fps: int, known: Plants | None = None) -> Plants:
    """Plan when and where each foot is planted; ``hips``, ``yaw``: ``[F, 2]`` the hips over the floor [m], and ``[F]`` their
    heading [rad]; ``reach``: ``[F]`` largest distance of a foot from the hips [m]; ``known``: unchanged plants; the first stand
    is their end."""
    feet: Plants = ([], []) if known is None else (known[LEFT][-1:], known[RIGHT][-1:])
    landing = [0, 0] if known is None else [-1, -1]
    sure = (-1, -1) if known is None else (known[LEFT][-1].end, known[RIGHT][-1].end)
    for k, stand in enumerate(stands):
        for foot in (LEFT, RIGHT):
            own = feet[foot]
            if own and landing[foot] < 0:
                # The foot has not moved.
                own[-1].end = max(own[-1].end, stand.end)
            else:
                begin = stand.begin if k == 0 or stand.hop else landing[foot]
                own.append(Plant(begin, max(stand.end, begin), stand.place[foot], float(stand.yaw[foot])))
        if k + 1 < len(stands):
            landing = _between(stand, stands[k + 1], feet, hips, yaw, fps)
    found = []
    for foot, side in ((LEFT, -1.0), (RIGHT, 1.0)):
        new = _reachable(sorted(feet[foot], key=lambda p: p.begin), hips, yaw, reach, side, sure[foot])
        found.append([*known[foot][:-1], *new] if known else new)
    return found[LEFT], found[RIGHT]


def _between(here: Stand, there: Stand, feet: Plants, hips: F64, yaw: F64, fps: int) -> list[int]:
    """Add the steps from one stand to the next; returns the landing frame of each foot, -1 if it has not moved."""
    landing = [there.begin, there.begin]
    if there.hop:
        return landing
    gap = there.begin - here.end
    way = np.array([np.hypot(*(there.place[foot] - feet[foot][-1].place)) for foot in (LEFT, RIGHT)])
    if way.max() < _STAYS:
        return [-1, -1]
    most = max(2, int(gap / (_STEP_TIME * fps)))
    if way.min() < _STAYS and way.max() < 1.5 * _STRIDE:
        moving = int(way.argmax())
        landing[1 - moving] = -1
        order = [moving]
    else:
        n = int(np.clip(np.ceil(way.max() / _STRIDE) + 1, 2, most))
        order = [(there.last + n - 1 - k) % 2 for k in range(n)]
    n = len(order)
    swing = _swings(here.end, there.begin, n, hips, fps)
    for k, foot in enumerate(order):
        up, down = swing[k]
        plants = feet[foot]
        plants[-1].end = max(plants[-1].begin, up)
        later = [j for j in range(k + 1, n) if order[j] == foot]
        if later:
            middle = round((down + swing[later[0]][0]) / 2)
            side = _WIDTH if foot == RIGHT else -_WIDTH
            place = hips[middle] + side * np.array([np.cos(yaw[middle]), np.sin(yaw[middle])])
            plants.append(Plant(down, swing[later[0]][0], place, float(yaw[middle]) + (-0.2 if foot == RIGHT else 0.2)))
        else:
            landing[foot] = down
    return landing


def _swings(begin: int, end: int, n: int, hips: F64, fps: int) -> list[tuple[int, int]]:
    gap = end - begin
    path = np.r_[0, np.cumsum(np.hypot(*np.diff(hips[begin : end + 1], axis=0).T))]
    progress = 0.8 * path / max(path[-1], 1e-6) + 0.2 * np.linspace(0, 1, gap + 1)
    middle = begin + np.interp((np.arange(n) + 0.5) / n, progress / progress[-1], np.arange(gap + 1))
    apart = np.diff(middle)
    out = []
    for k in range(n):
        room = min([_SWING * fps, 2 * (middle[k] - begin), 2 * (end - middle[k])])
        near = [apart[j] for j in (k - 1, k) if 0 <= j < len(apart)]
        half = max(2.0, min([room, *(1.25 * a for a in near)])) / 2
        out.append((int(np.clip(round(middle[k] - half), begin, end - 2)), int(np.clip(round(middle[k] + half), begin + 2, end))))
    return out


def _reachable(plants: list[Plant], hips: F64, yaw: F64, reach: F64, side: float, sure: int) -> list[Plant]:
    """Shorten plants to the frames in which the leg reaches them; frames up to ``sure`` are reachable."""
    out: list[Plant] = []
    for plant in plants:
        frames = np.arange(plant.begin, plant.end + 1)
        way = plant.place - hips[frames]
        across = side * (np.cos(yaw[frames]) * way[:, 0] + np.sin(yaw[frames]) * way[:, 1])
        ok = (np.hypot(*way.T) <= reach[frames]) & (across > -_CROSSED) | (frames <= sure)
        if not ok.any():
            continue
        # The longest run of frames within reach, or the current one.
        edges = np.flatnonzero(np.diff(np.r_[0, ok.astype(np.int8), 0]))
        runs = edges.reshape(-1, 2)
        first, last = runs[0 if plant.begin <= sure else np.argmax(runs[:, 1] - runs[:, 0])]
        plant.begin, plant.end = int(frames[first]), int(frames[last - 1])
        if out and plant.begin <= out[-1].end:
            plant.begin = out[-1].end + 1
        if plant.begin <= plant.end:
            out.append(plant)
    return out


def lifted(plants: Plants, slips: Bools, done: int) -> bool:
    """Lift feet before they slip and plant them later; returns whether any plant changed. ``slips``: ``[2, F - done]`` whether a
    foot slips, in frames from ``done`` on."""
    shortened = False
    for foot in (LEFT, RIGHT):
        slipping = done + np.flatnonzero(slips[foot])
        for plant in plants[foot]:
            own = slipping[(slipping >= plant.begin) & (slipping <= plant.end)]
            early = own[2 * own < plant.begin + plant.end] if plant.begin > done else own[:0]
            late = own[len(early) :]
            if len(early):
                plant.begin, shortened = int(early[-1]) + 1, True
            if len(late) and late[0] > max(plant.begin, done):
                plant.end, shortened = int(late[0]) - 1, True
    return shortened


def move(plants: Plants, air: F64, frames: int, fps: int, done: int = 0) -> Feet:
    """Both feet in every frame; ``air``: ``[F]`` their height in jumps [m]. Swings before frame ``done`` are omitted."""
    ball, yaw = np.zeros((2, frames, 3)), np.zeros((2, frames))
    pitch, planted = np.zeros((2, frames)), np.zeros((2, frames), dtype=bool)
    for foot in (LEFT, RIGHT):
        own = plants[foot]
        for k, plant in enumerate(own):
            begin = 0 if k == 0 else plant.begin
            end = frames - 1 if k == len(own) - 1 else plant.end
            rows = slice(begin, end + 1)
            ball[foot, rows, :2], yaw[foot, rows], planted[foot, rows] = plant.place, plant.yaw, True
            if k + 1 < len(own) and own[k + 1].begin > done - _SETTLED:
                _swing(plant, own[k + 1], ball[foot], yaw[foot], pitch[foot], air, fps)
    return Feet(ball=ball, yaw=yaw, pitch=pitch, planted=planted)


def _swing(here: Plant, there: Plant, ball: F64, yaw: F64, pitch: F64, air: F64, fps: int) -> None:
    rows = np.arange(here.end + 1, there.begin)
    if not len(rows):
        return
    u = (rows - here.end) / (there.begin - here.end)
    share = ease(u)
    way = there.place - here.place
    ball[rows, :2] = here.place + share[:, None] * way
    far = float(np.hypot(*way))
    clear = min(0.03 + 0.10 * far, 0.14) * min(1.0, len(rows) / (0.12 * fps))
    ball[rows, 2] = clear * np.sin(np.pi * u) ** 1.2 + air[rows]
    turn = (there.yaw - here.yaw + np.pi) % (2 * np.pi) - np.pi
    yaw[rows] = here.yaw + share * turn
    there.yaw = here.yaw + turn
    # The heel lifts off first; a long stride lands on the heel, with the toes up.
    up, down = np.sin(np.pi * np.clip(u / 0.7, 0, 1)), np.sin(np.pi * np.clip((u - 0.55) / 0.45, 0, 1))
    pitch[rows] = min(1.0, far / 0.6) * (0.60 * up - 0.22 * down) + np.where(air[rows] > 0.02, 0.45, 0.0)
