"""Timeline of a player, in their own frame and mirrored for a left-hander: key poses, contacts, jumps, stands of the feet."""

import dataclasses
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64, I64
from shuttle_marl.court.staging import poses
from shuttle_marl.court.staging.feet import Stand
from shuttle_marl.court.staging.flight import GRAVITY
from shuttle_marl.court.staging.geometry import ease, turned, unit
from shuttle_marl.court.staging.poses import CONTACT, TRUNK, Athlete, Stance
from shuttle_marl.court.staging.skeleton import HIPS_HEIGHT, HIPS_YAW, LEFT, RIGHT
from shuttle_marl.court.staging.trajectory import RETURN, Trajectory
from shuttle_marl.game.rules import WINNER
from shuttle_marl.game.stroke import SHOTS

_BEFORE: Final = ((0.54, 0.74), (0.27, 0.42), (0.09, 0.18))  # preparation, take-back, load: seconds before, limit by flight
_HURRIED: Final = 0.7  # times before the contact of a hurried player, as a fraction of those of others
_AFTER: Final = ((0.10, 0.22), (0.30, 0.48))
_REACTION: Final = 0.675  # strength of the reactions to the end of the rally, from 0 to 1
_SPLIT_HOP, _WAY_TO_SPLIT = 0.035, 0.25  # height of the hop, and way of the hips from which a step precedes it [m]
_HIGHEST_JUMP, _LEAST_JUMP = 0.48, 0.12  # height of a jump, the least one for an attack that could be played from the floor [m]
_TIME_TO_JUMP: Final = 0.6  # time since the opponent's contact above which an attack is jumped [s]
_STRETCH, _SINK = 0.08, 0.14  # gain on the toes overhead, and depth after a jump [m]
_LEANT: Final = 2.0  # backward lean of the racket in an overhead stroke per sine of the launch angle
_FULL_SWING: Final = 38.0  # launch speed of the shuttle above which the swing is full [m/s]
_PUSH, _ABSORB = 15.0, 17.0  # greatest upward acceleration of a take-off, and of a landing [m/s²]
_DIP, _RISE = 12.0, 7.0  # greatest acceleration while sinking into the crouch, and while rising again after a landing [m/s²]
LANDING: Final = np.array([(-0.16, -0.26, 22), (0.14, 0.26, -6)])  # after a jump: scissored legs
SPLIT: Final = np.array([(-0.29, 0.03, 14), (0.29, 0.00, -14)])  # in the split step
WAIT: Final = np.array([(-0.10, 0.24, 0), (0.12, -0.22, -28)])  # the receiver before the serve, the free foot in front


@dataclasses.dataclass(frozen=True, eq=False)
class Hit:
    """One contact of this player."""

    frame: int
    stroke: int
    stance: Stance
    point: F64  # [3] position of the shuttle [m]
    normal: F64  # [3] direction that the strings face
    shaft: F64  # [3] preferred direction of the shaft
    elbow: F64  # [3] preferred direction from shoulder to elbow
    swing: F64  # [3] target velocity of the strings [m/s]
    soft: float  # fraction of the way from take-back to contact completed at the load; 0 for full swings


@dataclasses.dataclass(frozen=True, eq=False)
class Keys:
    """K solved key poses of a player."""

    frame: I64  # [K] of each pose, ascending
    pose: F64  # [K, 27]
    slope: F64  # [K, 27] per frame


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Timeline:
    """Movements of a player over F frames."""

    frame: I64  # [K] of each key pose, ascending
    pose: F64  # [K, 27] the key poses; racket arm and spine at contacts are still to be solved
    known: Keys  # the first of them, already solved
    hits: tuple[Hit, ...]
    lift: F64  # [F] height of the hips in jumps, relative to standing [m]
    air: F64  # [F] height of the feet over the floor in jumps [m]
    stands: list[Stand]


@dataclasses.dataclass(frozen=True, eq=False)
class Past:
    """Unchanged part of the plan of a player."""

    frame: int  # the last unchanged one
    strokes: int  # struck by then
    keys: Keys  # key poses up to that frame, the last one in it
    stand: Stand
    planned: Timeline  # the timeline, whose jumps may last


def half_time(height: float) -> float:
    """Time from take-off to the top of a jump of a height [s]."""
    return float(np.sqrt(2 * height / GRAVITY))


def leap(since: F64, height: float, sink: float) -> tuple[F64, F64]:
    """``[F]`` heights of the hips, relative to standing, and of the feet in a jump [m]; ``since``: ``[F]`` time since the top
    [s]; ``height``: of the jump [m]; ``sink``: least depth to which the hips sink after the landing [m]."""
    half = half_time(height)
    speed = GRAVITY * half
    air = np.maximum(height - GRAVITY / 2 * since**2, 0.0)
    hips = np.where(np.abs(since) <= half, air, 0.0)
    down = max(speed**2 / (2 * _PUSH), 1e-3)
    hips += _bow(-half - since, speed, down, float(np.sqrt(6 * down / _DIP)))
    sink = max(sink, speed**2 / (2 * _ABSORB))
    hips += _bow(since - half, speed, sink, float(np.sqrt(6 * sink / _RISE)))
    return hips, air


def _bow(after: F64, speed: float, depth: float, seconds: float) -> F64:
    """Decelerate evenly from a downward speed to a depth, then return within ``seconds``; 0 before and after."""
    stop = 2 * depth / speed
    slowed = -speed * after + 0.5 * speed / stop * after**2
    back = -depth * (1 - ease((after - stop) / seconds))
    return np.where(after <= 0, 0.0, np.where(after <= stop, slowed, back))


def feet_at(motion: int, root: F64, heading: float, reach: float, high: float = 0.0) -> tuple[F64, F64, int]:
    """Places ``[2, 2]`` and headings ``[2]`` of the feet at a contact, and the foot that lands last.

    Args:
        root: ``[2]`` the hips over the floor [m].
        heading: rotation of the stroke frame to the left [rad].
        reach: lateral stretch, 0 to 1.
        high: height of the contact above the natural one, which shortens a lunge [m].
    """
    left, right, last = poses.STROKES[motion].feet
    spots = np.array([left, right])
    if motion in (poses.DEFENCE, poses.SIDE):
        spots[RIGHT, 0] += 0.16 * reach
    elif motion == poses.DEFENCE_BACKHAND:
        spots[LEFT, 0] -= 0.16 * reach
    elif motion in poses.LUNGES:
        spots[RIGHT, 1] += 0.05 * reach
        spots[:, 1] *= 1 - 0.9 * float(np.clip(high, 0.0, 0.5))
    place, yaw = placed(spots, root, heading)
    return place, yaw, last


def placed(spots: F64, root: F64, heading: float) -> tuple[F64, F64]:
    """Places ``[2, 2]`` and headings ``[2]`` of feet given in a frame at ``root`` that is turned left by ``heading``."""
    c, s = np.cos(heading), np.sin(heading)
    x, y = spots[:, 0], spots[:, 1]
    return root + np.stack([c * x - s * y, s * x + c * y], axis=1), np.radians(spots[:, 2]) + heading


class TimelineBuilder:
    """Builder of the timeline of one player; ``hips``: ``[F, 2]`` path of the hips over the floor, mirrored for a left-hander
    [m]; ``higher``: ``[n]`` additional height of the hips at each stroke [m]; ``mood``: index of the reaction to the end of the
    rally."""

    def __init__(
        self, trajectory: Trajectory, athlete: Athlete, hips: F64, higher: F64, fps: int, mood: int, past: Past | None = None
    ) -> None:
        self.trajectory, self.hips, self.higher, self.fps = trajectory, hips, higher, fps
        self.seat, self.right_handed, self.library = athlete.seat, athlete.right_handed, athlete.library
        self.sign = athlete.signs
        self.frames = len(hips)
        self.keys: dict[int, F64] = {}
        self.fixed: set[int] = set()
        self.stands: list[Stand] = []
        self.lift, self.air = np.zeros(self.frames), np.zeros(self.frames)
        self.clock = np.rint(trajectory.time * fps).astype(np.int64)
        self.mood, self.past, self.done = mood, past, -1
        if past:
            self.done = past.frame
            self.keys = dict(zip(past.keys.frame.tolist(), past.keys.pose, strict=True))
            self.fixed = set(self.keys)
            self.stands = [past.stand]
            for name in ("lift", "air"):
                getattr(self, name)[: past.frame + 1] = getattr(past.planned, name)[: past.frame + 1]

    def timeline(self) -> Timeline:
        """Build the timeline."""
        trajectory, hits = self.trajectory, []
        rally = trajectory.rally
        over = round(trajectory.end_time[-1] * self.fps) if len(rally) else self.frames - 1
        self._begin()
        # The jump of the last stroke may still last, so it is written again.
        for i in range(max(self.past.strokes - 3, 0) if self.past else 0, len(rally)):
            frame = int(self.clock[i])
            following = self.clock[i + 1] if i + 1 < len(self.clock) else over
            if rally.striker[i] == self.seat:
                before = self.clock[i - 1] if i else 0
                hit = self._strike(i, frame, int(before), int(following))
                if frame > self.done:
                    hits.append(hit)
            else:
                self._split(i, frame, int(following))
        if rally.open:
            # The next striker is on the way, the other player recovers.
            if len(self.clock):
                self._key(over, self._ready(over), fixed=True)
                self._stand(over - 1, over, placed(SPLIT, self.hips[-1], self._facing(over)))
        else:
            self._finish(over)
        order = sorted(self.keys)
        pose = np.array([self.keys[f] for f in order])
        return Timeline(
            frame=np.array(order),
            pose=pose,
            known=self.past.keys if self.past else Keys(np.zeros(0, dtype=np.int64), pose[:0], pose[:0]),
            hits=tuple(hits),
            lift=self.lift,
            air=self.air,
            stands=self.stands,
        )

    def _key(self, frame: int, pose: F64, *, fixed: bool = False) -> None:
        """Add a key pose, unless a fixed one is within two frames."""
        if frame <= self.done:
            return
        frame = min(max(frame, 0), self.frames - 1)
        near = [f for f in range(frame - 2, frame + 3) if f in self.keys]
        if not fixed and near:
            return
        for f in near:
            if f not in self.fixed:
                del self.keys[f]
        self.keys[frame] = pose
        if fixed:
            self.fixed.add(frame)

    def _stand(self, begin: int, end: int, feet: tuple[F64, F64], last: int = 1, hop: bool = False) -> None:
        if begin <= self.done:
            return
        if self.stands:
            begin = max(begin, self.stands[-1].end + 2)
        end = min(max(end, begin), self.frames - 1)
        if begin < self.frames - 1:
            self.stands.append(Stand(begin, end, *feet, last=last, hop=hop))

    def _jump(self, peak: float, height: float, sink: float = 0.0) -> tuple[int, int]:
        """Add a jump; returns the frames of take-off and landing."""
        rows = np.arange(self.done + 1, self.frames)
        hips, air = leap((rows - peak) / self.fps, height, sink)
        self.lift[rows] += hips
        self.air[rows] = np.maximum(self.air[rows], air)
        half = half_time(height) * self.fps
        return int(np.floor(peak - half)), int(np.ceil(peak + half))

    def _facing(self, frame: int) -> float:
        """Heading towards the next contact, positive to the left [rad]."""
        i = int(np.clip(np.searchsorted(self.clock, frame), 0, len(self.clock) - 1))
        way = (self.trajectory.contact[i] * self.sign)[:2] - self.hips[min(max(frame, 0), self.frames - 1)]
        return float(0.7 * np.arctan2(-way[0], max(way[1], 1.5)))

    def _ready(self, frame: int, low: float = 0.0) -> F64:
        pose = self.library.ready.copy()
        pose[HIPS_YAW] += self._facing(frame)
        pose[HIPS_HEIGHT] -= low
        return pose

    def _begin(self) -> None:
        """Waiting for the serve: the server in the first pose, the receiver with a foot in front."""
        trajectory = self.trajectory
        first = int(self.clock[0]) if len(self.clock) else self.frames
        if self.past and not self.past.strokes and len(self.clock):
            # Both walk from their waiting positions to the serve.
            self._serve_stand(first - round(0.45 * self.fps), first)
        if trajectory.rally.server == self.seat:
            self._serve_stand(0, first)
            if not len(self.clock):
                stance = self._mirrored(trajectory.reply)
                pose = self.library.stroke[stance.motion, 0].copy()
                pose[HIPS_YAW] += stance.heading
                self._key(0, pose, fixed=True)
            return
        pose = self.library.wait.copy()
        self._key(0, pose, fixed=True)
        self._key(first - round(0.25 * self.fps), pose)
        self._serve_stand(0, first)

    def _serve_stand(self, begin: int, first: int) -> None:
        hips = self.hips[begin]
        if self.trajectory.rally.server != self.seat:
            self._stand(begin, first - round(0.08 * self.fps), placed(WAIT, hips, 0.0))
            return
        stance = self._mirrored(self.trajectory.stance[0] if len(self.clock) else self.trajectory.reply)
        place, yaw, _ = feet_at(stance.motion, hips, stance.heading, 0.0)
        self._stand(begin, first + round(0.12 * self.fps), (place, yaw))

    def _split(self, i: int, frame: int, following: int) -> None:
        fps = self.fps
        self._key(frame - round(0.12 * fps), self._ready(frame, 0.01))
        self._key(frame + round(0.08 * fps), self._ready(frame, 0.05))
        room = frame - self.stands[-1].end
        heading = self._facing(frame)
        if room > 0.16 * fps:
            up, down = self._jump(frame - 0.01 * fps, _SPLIT_HOP)
            if i and room > 0.34 * fps and self._away(up) > _WAY_TO_SPLIT:
                self._stand(up - 1, up, placed(SPLIT, self.hips[up], heading), last=i % 2)
            elif self.stands[-1].end < up:
                # No time for a step: the hop begins at the current stand.
                self.stands[-1] = dataclasses.replace(self.stands[-1], end=max(self.stands[-1].end, up))
            self._stand(down, down + 2, placed(SPLIT, self.hips[min(down + 1, self.frames - 1)], heading), hop=True)
        elif following - frame > 0.5 * fps:
            self._stand(frame + 2, frame + 4, placed(SPLIT, self.hips[min(frame + 3, self.frames - 1)], heading))

    def _away(self, frame: int) -> float:
        """Distance from the middle between the feet to the hips in a frame [m]."""
        return float(np.hypot(*(self.stands[-1].place.mean(axis=0) - self.hips[frame])))

    def _mirrored(self, stance: Stance | None) -> Stance:
        assert stance is not None
        if self.right_handed:
            return stance
        return dataclasses.replace(stance, heading=-stance.heading, root=stance.root * np.array([-1.0, 1.0]))

    def _strike(self, i: int, frame: int, before: int, following: int) -> Hit:
        stance, fps = self._mirrored(self.trajectory.stance[i]), self.fps
        motion, heading = stance.motion, stance.heading
        launch = self.trajectory.flight.velocity(i, 0)
        # The strings face between the incoming and the outgoing flight.
        normal = unit(launch)
        if i:
            normal = normal - 0.4 * unit(self.trajectory.flight.velocity(i - 1, -1))
        point, normal = self.trajectory.contact[i] * self.sign, unit(normal) * self.sign
        high = float(point[2] - self.library.contact[motion, 0, 2])
        ahead, behind = (frame - before) / fps, max(following - frame, 0.3 * fps) / fps
        hurried = bool(self.trajectory.rally.hurried[i])
        keys = self.library.stroke[motion].copy()
        keys[:, HIPS_YAW] += heading
        power = float(np.clip(self.trajectory.flight.launch_speed[i] / _FULL_SWING, 0.35, 1.0))
        keys[1:CONTACT] = keys[0] + power * (keys[1:CONTACT] - keys[0]) if motion not in poses.OVERHEADS else keys[1:CONTACT]
        keys[CONTACT + 1 :] = keys[CONTACT] + max(power, 0.5) * (keys[CONTACT + 1 :] - keys[CONTACT])
        air = self._rise(i, keys, stance, frame, ahead, high)
        self._key(frame, keys[CONTACT], fixed=True)
        for k, (seconds, share) in enumerate(_BEFORE):
            lead = 0.9 if i == 0 and k == 0 else min(seconds, share * ahead) * (_HURRIED if hurried else 1.0)
            self._key(frame - max(2, round(lead * fps)), keys[k], fixed=k != 1)
        for k, (seconds, share) in enumerate(_AFTER):
            self._key(frame + max(3, round(min(seconds, share * behind) * fps)), keys[CONTACT + 1 + k], fixed=k == 0)
        if i == 0:
            self._key(0, keys[0], fixed=True)
        if behind > 0.8:
            self._key(frame + round(0.75 * behind * fps), self._ready(frame + round(0.75 * behind * fps)))
        self._feet(i, stance, frame, air, high)
        facing = turned(keys[CONTACT, HIPS_YAW])
        shaft, elbow = (facing @ direction[0] for direction in poses.pointed(motion, np.array([high])))
        if motion in poses.OVERHEADS:
            # The strings move across the line from the shoulder: this line leans back to strike upwards.
            up = max(float(unit(launch)[2]), 0.0)
            shaft = unit(shaft - np.array([0.0, _LEANT * up, 0.0]))
        manner = poses.MANNERS[SHOTS[self.trajectory.rally.catalogue.shot[self.trajectory.rally.stroke[i]]]]
        return Hit(frame, i, stance, point, normal, shaft, elbow, manner.ratio * launch * self.sign, manner.soft)

    def _rise(self, i: int, keys: F64, stance: Stance, frame: int, ahead: float, need: float) -> tuple[int, int] | None:
        """Lower or raise the hips for a contact so high above the natural one; returns take-off and landing of a jump."""
        motion, higher = stance.motion, float(self.higher[i])
        air, raised = None, higher
        if motion in poses.OVERHEADS:
            rally = self.trajectory.rally
            attack = bool(rally.catalogue.is_attack[rally.stroke[i]]) and ahead > _TIME_TO_JUMP
            jump = max(need + 0.03 + higher, _LEAST_JUMP if attack else 0.0)
            if attack or need + higher > _STRETCH:
                jump = min(jump, _HIGHEST_JUMP)
                air = self._jump(frame - 0.02 * self.fps, jump, _SINK)
                need, raised = min(need - jump, 0.0), 0.0
            else:
                raised += max(need, 0.0)
        change = poses.bent(keys[CONTACT, TRUNK], motion, np.array([need]))[0] - keys[CONTACT, TRUNK]
        change[HIPS_HEIGHT] += raised
        if motion in (poses.DEFENCE, poses.DEFENCE_BACKHAND):
            change[HIPS_HEIGHT] -= 0.04 * stance.reach
        for k, share in ((CONTACT - 1, 0.6), (CONTACT, 1.0), (CONTACT + 1, 0.8)):
            keys[k, TRUNK] += share * change
        return air

    def _feet(self, i: int, stance: Stance, frame: int, air: tuple[int, int] | None, high: float) -> None:
        if i == 0:
            return
        fps, root = self.fps, self.hips[frame]
        place, yaw, last = feet_at(stance.motion, root, stance.heading, stance.reach, high)
        if air is None:
            hold = 0.16 if stance.motion in poses.LUNGES | {poses.KILL} else 0.10
            # A hurried player is still in the step when the racket meets the shuttle.
            begin = frame + 1 if self.trajectory.rally.hurried[i] else frame - round(0.05 * fps)
            self._stand(begin, frame + round(hold * fps), (place, yaw), last=last)
            return
        up, down = air
        before = self.hips[max(up - 1, 0)]
        self._stand(up - round(0.08 * fps), up, (place - root + before, yaw), last=last)
        after = self.hips[min(down + 1, self.frames - 1)]
        self._stand(down, down + round(0.08 * fps), placed(LANDING, after, 0.5 * stance.heading), hop=True)

    def _finish(self, over: int) -> None:
        fps, rally = self.fps, self.trajectory.rally
        last = max(over, int(self.clock[-1]) + round(0.4 * fps))
        turn = self._facing(last)
        if rally.striker[-1] != self.seat and self.trajectory.end[-1] != RETURN:
            self._key(over - round(0.05 * fps), self._ready(over, 0.02))
        won = (rally.ending == WINNER) == (rally.striker[-1] == self.seat)
        shown = (self.library.wins if won else self.library.loses)[self.mood]
        rest = self.library.rest.copy()
        felt = rest + _REACTION * (shown - rest)
        for pose in (rest, felt):
            pose[HIPS_YAW] += turn
        # Joy is immediate and passes; disappointment comes slowly and stays.
        for seconds in (0.5, 1.0) if won else (0.9, 1.7):
            self._key(last + round(seconds * fps), felt)
        self._key(self.frames - 1, rest if won else felt, fixed=True)
        self._stand(last + round(0.9 * fps), self.frames - 1, placed(SPLIT, self.hips[-1], self._facing(self.frames - 1)))
