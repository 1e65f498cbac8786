"""The walk between two rallies: the shuttle is picked up, and both players go to their places for the next serve.

The player on whose side the shuttle lies walks to it and flicks it up with the racket: into their own hand if they serve next,
otherwise over the net to the server. The walk ends in the first frame of the next rally.
"""

import dataclasses
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.court.staging.assemble import onto_court, players_of
from shuttle_marl.court.staging.body import Habits, PlayerMotion, Prepared, bones, course, free_palm, prepare
from shuttle_marl.court.staging.feet import Plant, Stand
from shuttle_marl.court.staging.flight import net_height, shoot
from shuttle_marl.court.staging.geometry import smooth, turned
from shuttle_marl.court.staging.motion import Motion
from shuttle_marl.court.staging.poses import CONTACT, FREE_ARM, LUNGE, N_POSE, TRUNK, Stance, bent, pointed
from shuttle_marl.court.staging.skeleton import HIPS_HEIGHT, HIPS_PITCH, HIPS_YAW, LEFT, RIGHT, SPINE_PITCH, StagingError
from shuttle_marl.court.staging.timeline import Hit, Keys, Timeline, feet_at
from shuttle_marl.game.court import NET_DEPTH, NET_HEIGHT

_SPEED, _STRIDE = 1.6, 0.78
"""Mean speed of a walk [m/s], and its longest step [m]."""
_STILL, _LEAST = 0.35, 0.8
"""Time before and after a walk and around the pick-up in which the hips stay, and shortest duration of a walk [s]."""
_SHORT: Final = 1.3
"""Distance below which a player does not turn to walk [m]."""
_TURN, _TURN_BACK = 0.28, 0.8
"""Time of a turn, for each radian, and before the end of a walk at which the player turns to the net [s]."""
_STRINGS: Final = 0.10
"""Height of the middle of the strings when the frame of the racket touches a shuttle on the floor [m]."""
_EXACT, _SHORTER = 0.03, 0.35
"""Distance from the places of the feet in the next rally below which a foot stays, and shortening of the lunge that picks up the
shuttle, as for a contact that is so much higher [m]."""
_BOW: Final = np.radians(10)
"""Additional bow of hips and spine in the pick-up [rad]: with deeper hips instead, the hip joint lets no foot stand in front."""
_OWN_FLICK, _FLICK = 0.60, 1.15
"""Duration of the flight into the own hand, and least duration to the other player [s]."""
_HOLD, _CLEARANCE = 0.5, 0.15
"""Time between the catch and the next rally [s], and least distance of the shuttle from the net [m]."""
_PHASES: Final = (-0.50, -0.28, -0.12, 0.0, 0.16, 0.42)
"""Times of the key poses of the pick-up, relative to the contact [s]."""
_ATTEMPTS: Final = 4
_TOLERANCE: Final = 5e-3


def with_walk(rally: Motion, following: Motion) -> Motion:
    """Stage the walk from the end of a rally to the start of the next one.

    Args:
        rally: a finished rally that :func:`~shuttle_marl.court.staging.stage` returned.

    Returns:
        The motion of the rally, followed by 3 to 12 seconds of walking.

    Raises:
        StagingError: a walk already, an unfinished rally, or other ends, players or frame rates.
    """
    if rally.players is None or following.players is None:
        raise StagingError("a rally that follows a walk already: pass those that stage() returned")
    if rally.trajectory.rally.open:
        raise StagingError("the rally continues: a walk leads from the end of a rally to the next one")
    if rally.trajectory.rally.ends_changed != following.trajectory.rally.ends_changed:
        raise StagingError("the players change ends: a walk leads between rallies that they play at the same ends")
    for name in ("fps", "skeletons", "hands"):
        if getattr(rally, name) != getattr(following, name):
            raise StagingError(f"the rallies have different {name}: expected two rallies of a match")
    return _WalkBuilder(rally, following).build()


class _WalkBuilder:
    """Builds the walk.

    Attributes:
        picker: seat on whose side the shuttle lies.
        pick, catch: frames in which the shuttle is flicked up and caught.
        arrival: ``[2]`` frame in which each player is at the place for the serve.
    """

    def __init__(self, rally: Motion, following: Motion) -> None:
        assert rally.players is not None
        assert following.players is not None
        self.rally, self.following, self.fps = rally, following, rally.fps
        self.athletes = players_of(rally.trajectory.rally, rally.skeletons)
        self.starts, self.ends = rally.players, following.players
        self.lying = rally.shuttle[-1].astype(np.float64)
        self.server = following.trajectory.rally.server
        self.picker = int(self.lying[1] * rally.trajectory.rally.facing(0) > 0)
        self.stance = self._pick_up()
        self._plan()

    def build(self) -> Motion:
        rally = self.rally
        prepared = [self._prepared(seat) for seat in (0, 1)]
        shuttle = self._shuttle(prepared[self.server])
        seats = []
        for athlete, player in zip(self.athletes, prepared, strict=True):
            found = course(athlete.skeleton, player, shuttle * athlete.signs)
            seats.append(onto_court(*bones(athlete.skeleton, found), found.feet, athlete.signs))
        whole: dict[str, Any] = {"shuttle": shuttle, "shuttle_velocity": np.gradient(shuttle, 1 / self.fps, axis=0)}
        for name, both in zip(("rotation", "position", "planted"), zip(*seats, strict=True), strict=True):
            whole[name] = np.stack(both, axis=1)
        for name, new in whole.items():
            old = getattr(rally, name)
            whole[name] = np.concatenate([old, new[1:].astype(old.dtype)])
        return dataclasses.replace(rally, time=np.arange(len(whole["shuttle"])) / self.fps, players=None, **whole)

    def _place(self, seat: int, *, end: bool) -> F64:
        """``[2]`` hips of a player at the start or the end, in the player's own frame [m]."""
        return (self.ends[seat].course.hips[0] if end else self.starts[seat].course.hips[-1])[:2]

    def _pick_up(self) -> Stance:
        athlete = self.athletes[self.picker]
        point = (self.lying * athlete.signs)[:2]
        way = point - self._place(self.picker, end=False)
        heading = float(np.arctan2(-way[0], way[1]))
        natural = athlete.library.natural(LUNGE, _STRINGS)
        root = point - (turned(np.array(heading)) @ natural)[:2]
        root[1] = min(root[1], -0.45)  # behind the net
        return Stance(motion=LUNGE, heading=heading, root=root, reach=0.0)

    def _plan(self) -> None:
        fps, server, picker = self.fps, self.server, self.picker

        def needed(way: F64) -> float:
            far = float(np.hypot(*way))
            return 2 * _STILL + max(_LEAST, far / _SPEED) + (2 * _TURN if far > _SHORT else 0.0)

        root = self.stance.root
        direct = [needed(self._place(seat, end=True) - self._place(seat, end=False)) for seat in (0, 1)]
        pick = needed(root - self._place(picker, end=False))
        flight = _OWN_FLICK
        if server != picker:
            pick = max(pick, direct[server] - _FLICK)  # the server is there to catch it
            flight = self._flight_time()
        arrival = list(direct)
        arrival[picker] = pick + needed(self._place(picker, end=True) - root)
        self.frames = round(max(*arrival, pick + flight + _HOLD) * fps) + 1
        self.pick = round(pick * fps)
        self.catch = self.pick + round(flight * fps)
        self.arrival = [round(seconds * fps) for seconds in arrival]

    def _flight_time(self) -> float:
        """Duration of a flight to the server over the net, or under it from a shuttle close to it [s]."""
        end = np.array([*(self._place(self.server, end=True) * self.athletes[self.server].signs[:2]), 1.1])
        share = self.lying[1] / (self.lying[1] - end[1])
        over = float(net_height(self.lying[0] + share * (end[0] - self.lying[0]))) + _CLEARANCE
        seconds = _FLICK
        while seconds < 2 * _FLICK:
            flight = shoot(self.lying[None], end[None], np.array([seconds]))
            path = flight.at(0, np.linspace(0, seconds, 50))[0]
            height = np.interp(0.0, path[:, 1] * np.sign(end[1]), path[:, 2])
            if height >= over or height <= NET_HEIGHT - NET_DEPTH - _CLEARANCE:
                break
            seconds += 0.05
        return seconds

    def _prepared(self, seat: int) -> Prepared:
        """Hips, poses and feet of a player; the racket of the picker meets the shuttle."""
        athlete = self.athletes[seat]
        ease = np.cos(np.pi / 2 * np.clip(np.arange(self.frames) / (_STILL * self.fps), 0, 1)) ** 2
        shift, added = np.zeros(3), Habits(np.zeros((self.frames, N_POSE)), np.zeros((self.frames, 3)))
        for _ in range(_ATTEMPTS):
            hips = self._path(seat, shift)
            timeline = self._timeline(seat, shift)
            here = timeline.stands[0]
            left, right = ([Plant(here.begin, here.end, here.place[foot], float(here.yaw[foot]))] for foot in (LEFT, RIGHT))
            prepared = prepare(athlete.skeleton, timeline, hips, self.fps, added, (left, right))
            if added.place.any() and np.linalg.norm(prepared.miss) < _TOLERANCE:
                break
            shift = shift + 1.15 * prepared.miss[0] if len(prepared.miss) else shift
            # Both ends are where the rallies have the hips, which shift their weight.
            off = self.starts[seat].course.hips[-1] - prepared.hips[0], self.ends[seat].course.hips[0] - prepared.hips[-1]
            added.place[:] += ease[:, None] * off[0] + ease[::-1, None] * off[1]
        return prepared

    def _path(self, seat: int, shift: F64) -> F64:
        """``[F, 2]`` hips over the floor [m]."""
        still = round(_STILL * self.fps)
        there = self._place(seat, end=True)
        stops = [(0, self._place(seat, end=False)), (self.arrival[seat], there), (self.frames + still, there)]
        if seat == self.picker:
            stops.insert(1, (self.pick, self.stance.root + shift[:2]))
        frame = np.maximum.accumulate([frame + side for frame, _ in stops for side in (-still, still)])
        place = np.repeat([place for _, place in stops], 2, axis=0)
        return np.column_stack([smooth(np.interp(np.arange(self.frames), frame, place[:, k]), still - 1) for k in (0, 1)])

    def _timeline(self, seat: int, shift: F64) -> Timeline:
        """Poses and stands of a player: the way, the pick-up, the catch."""
        athlete, fps = self.athletes[seat], self.fps
        last, rest = self.ends[seat].course.pose[0].copy(), athlete.library.rest.copy()
        here, there = self._place(seat, end=False), self._place(seat, end=True)
        keys = {0: self.starts[seat].course.pose[-1]}
        stands = [_standing(self.starts[seat], -1, 0, round(_STILL * fps))]
        hits: tuple[Hit, ...] = ()
        if seat == self.picker:
            root, frames = self.stance.root + shift[:2], [self.pick + round(seconds * fps) for seconds in _PHASES]
            self._go(keys, rest, root - here, frames[0])
            heading = _nearest(self.stance.heading, keys)
            poses = athlete.library.stroke[LUNGE].copy()
            poses[:, HIPS_YAW] += heading
            need = np.array([_STRINGS - athlete.library.contact[LUNGE, 0, 2]])
            low = bent(poses[CONTACT, TRUNK], LUNGE, need)[0] - poses[CONTACT, TRUNK]
            low[HIPS_HEIGHT] += shift[2]
            low[[HIPS_PITCH, SPINE_PITCH]] += _BOW
            for k, share in ((CONTACT - 1, 0.7), (CONTACT, 1.0), (CONTACT + 1, 0.7)):
                poses[k, TRUNK] += share * low
            keys |= dict(zip(frames, poses, strict=True))
            place, yaw, landing = feet_at(LUNGE, root, heading, 0.0, _SHORTER)
            begin, end = self.pick - round(0.06 * fps), frames[CONTACT + 1]
            stands.append(Stand(begin, end, place, yaw, last=landing, stride=_STRIDE))
            point, facing, up = self.lying * athlete.signs, turned(np.array(heading)), np.array([0.0, 0.0, 1.0])
            point[2] = _STRINGS
            shaft, elbow = (facing @ direction[0] for direction in pointed(LUNGE, need))
            normal = facing @ np.array([0.0, 0.5, 0.87])
            hits = (Hit(self.pick, 0, self.stance, point, normal, shaft - 0.5 * up, elbow, swing=2.5 * up, soft=0.6),)
            here = root
        if seat == self.server:
            rest[FREE_ARM] = last[FREE_ARM]
            if seat != self.picker:
                self._go(keys, athlete.library.rest, there - here, self.arrival[seat])
                rest[HIPS_YAW] = last[HIPS_YAW] = _nearest(last[HIPS_YAW], keys)
            else:
                rest[HIPS_YAW] = _nearest(self.stance.heading, keys)
            keys[self.catch], here = rest.copy(), here if seat == self.picker else there
        self._go(keys, rest, there - here, self.arrival[seat])
        last[HIPS_YAW] = _nearest(last[HIPS_YAW], keys)
        keys[self.frames - 3] = keys[self.frames - 1] = last  # at rest
        final = _standing(self.ends[seat], 0, self.arrival[seat] - 1, self.frames - 1)
        stands.append(dataclasses.replace(final, stays=_EXACT))  # the next rally begins with these feet
        pose, zero = np.array(list(keys.values())), np.zeros(self.frames)
        return Timeline(
            frame=np.array(list(keys)),
            pose=pose,
            known=Keys(np.zeros(1, dtype=np.int64), pose[:1], np.zeros_like(pose[:1])),  # at rest
            hits=hits,
            lift=zero,
            air=zero,
            stands=stands,
        )

    def _go(self, keys: dict[int, F64], pose: F64, way: F64, until: int) -> None:
        """Add the poses of a walk along ``way``. For a short distance the player does not turn."""
        if np.hypot(*way) < _SHORT:
            return
        begin, pose = max(keys), pose.copy()
        before = float(keys[begin][HIPS_YAW])
        pose[HIPS_YAW] = _nearest(float(np.arctan2(-way[0], way[1])), keys)
        turn = round((_STILL + _TURN * abs(float(pose[HIPS_YAW]) - before)) * self.fps)
        middle = begin + min(turn, (until - begin) // 2)
        keys[middle] = pose
        keys[max(until - round(_TURN_BACK * self.fps), middle + 1)] = pose

    def _shuttle(self, server: Prepared) -> F64:
        """``[F, 3]`` path of the shuttle: on the floor, in the air, in the hand of the server [m]."""
        athlete = self.athletes[self.server]
        # The place of the palm does not depend on where the head looks.
        still = course(athlete.skeleton, server, np.tile(self.lying * athlete.signs, (self.frames, 1)))
        path = free_palm(athlete.skeleton, *bones(athlete.skeleton, still)) * athlete.signs
        path[: self.pick] = self.lying
        seconds = np.arange(self.catch - self.pick) / self.fps
        flight = shoot(self.lying[None], path[self.catch][None], np.array([len(seconds) / self.fps]))
        path[self.pick : self.catch] = flight.at(0, seconds)[0]
        return path


def _nearest(yaw: float, keys: dict[int, F64]) -> float:
    """The heading, plus the whole turns that bring it nearest to that of the last pose [rad]."""
    now = float(keys[max(keys)][HIPS_YAW])
    return now + (yaw - now + np.pi) % (2 * np.pi) - np.pi


def _standing(player: PlayerMotion, which: int, begin: int, end: int) -> Stand:
    """Stand on the first (0) or last (-1) places of the feet of a player."""
    plants = [player.prepared.plants[foot][which] for foot in (LEFT, RIGHT)]
    place, yaw = (np.array([getattr(plant, name) for plant in plants]) for name in ("place", "yaw"))
    return Stand(begin, end, place, yaw, stride=_STRIDE)
