"""Random trajectory of a rally: place and time of every contact, and the flights in between.

A stroke depends on the seed and the strokes up to it alone. Of several drawn points and times the first one is used that the
bounds of the shot type and the receiver's reach allow, else the closest; a hurried receiver gets the one that leaves the least
time.
"""

import dataclasses
import functools
import json
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.court.staging import poses
from shuttle_marl.court.staging.flight import BOUNDS, Flights, fall, net_height, shoot
from shuttle_marl.court.staging.poses import Athlete, Stance
from shuttle_marl.court.staging.trajectory import NET, OPEN, OUT, RESTING, RETURN, WIN, Trajectory, behind
from shuttle_marl.game import draws
from shuttle_marl.game.court import AREAS, HALF_LENGTH, HALF_WIDTH, N_SIDES, NET_HEIGHT, SHORT_SERVICE, third_of
from shuttle_marl.game.rally import Rally
from shuttle_marl.game.rules import FAULT, HURRIED_BELOW, RETURNED_BELOW, WINNER
from shuttle_marl.game.shipped import waiting_places
from shuttle_marl.game.stroke import HEIGHTS, N_SERVES, SHOTS, TECHNIQUES

if TYPE_CHECKING:
    from shuttle_marl.court.staging.motion import Branch

_QUANTILES: Final = (0.05, 0.25, 0.5, 0.75, 0.95)
_TRIES, _AS_DRAWN = 10, 5  # tries, and how many of them are as drawn; later ones are nearer to the receiver
_ACCELERATION, _REACTION = 10.0, 0.06
_CLEAR, _KILL = SHOTS.index("clear"), SHOTS.index("net-kill")
_FURTHER_BACK: Final = 0.3  # contact of a clear: distance behind the contact of a smash [m]
_SHORT_SERVE, _BACKHAND = SHOTS.index("short-serve"), TECHNIQUES.index("backhand")
# Expected shot types of the next striker, by height (below, above) and depth of the area.
_EXPECTED: Final = (("net-shot", "block", "lift"), ("net-kill", "drive", "clear"))
_QUICK: Final = 0.5  # of hurried players, and places of net kills: share of the range from its lower end
_LOW_FROM: Final = 1.2  # distance from the net above which hurried players strike lower [m]
_SHORT, _STRETCH = 0.08, 0.35  # how far the hips of a hurried player are short [m], and their additional reach (1: widest)
_STEEP: Final = 1.3
_STEEPEST: Final = {"push": 0.7, "drive": 0.35}  # greatest slope from a contact below the net to its top
_FLAT: Final = frozenset(map(SHOTS.index, ("smash", "half-smash", "drive")))
_BODY: Final = 0.3  # distance from the middle of a defender within which a fast shuttle is met with the backhand [m]
_TIMES: Final = (np.ones(1), np.linspace(0.55, 1.6, 36), np.linspace(1.6, 4.0, 25))  # relative to the drawn time
_UNTIMELY, _STRICT = 0.2, 4.0  # cost of a time outside the quartiles [m/s], and weight of a distance from the bounds
_FITS, _GOOD = 1e-6, 0.02  # costs below which all fits, and below which no other point is tried
_POOR: Final = 1.0  # cost above which even a much longer flight is tried
_SLOT: Final = 8  # number of draws reserved for each try of a stroke


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Measured:
    """Times and places in the matches."""

    flight_time: F64  # [13, 3] quartiles of the time until the receiver strikes [s], by shot type
    flight_time_by_length: F64  # [13, 2, 13, 3] by shot type, height met (0 below, 1 above the net), length (k: k to k + 1 m)
    places: F64  # [13, 9, 2, 5] quantiles of x and y where the receiver meets it, in the striker's frame [m], by shot type, area
    base: F64  # [13, 9, 2] where a player stands when the opponent answers, by their own stroke [m]
    net_share: F64  # [13] share of the faults of a shot type that do not cross the net
    out_by: F64  # [2, 5] quantiles of the distance by which shuttles land beyond the side and the back line [m]
    serve: F64  # [2, 2, 2, 5] quantiles by serve, (server, receiver), (distance from the centre line, from the net) [m]

    def seconds(self, shot: int, met: int, length: float, u: float) -> float:
        """Flight time [s] at a share ``u`` of the interquartile range, by shot type, height met (0/1) and length."""
        low, middle, high = self.flight_time_by_length[shot, met, min(int(length), self.flight_time_by_length.shape[2] - 1)]
        drawn = low + 2 * u * (middle - low) if u < 0.5 else middle + (2 * u - 1) * (high - middle)
        return float(np.clip(drawn, self.flight_time[shot, 0], self.flight_time[shot, 2]))


def _quantile(knots: F64, u: float) -> float:
    """Value at a share ``u`` from quantiles ``[5]`` at 5, 25, 50, 75 and 95 %, linear in between, held outside."""
    return float(np.interp(u, _QUANTILES, knots))


@functools.cache
def load_measured() -> Measured:
    """The tables measured in the training matches, see ``docs/truth_record.md``; ``provenance`` of the file names them."""
    raw = json.loads(Path(__file__).with_name("measured.json").read_text(encoding="utf-8"))
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


@dataclasses.dataclass(frozen=True, eq=False)
class _Choice:
    point: F64
    seconds: float
    flight: Flights
    stance: Stance | None
    cost: float


@dataclasses.dataclass(frozen=True, eq=False)
class _Try:
    point: F64
    ticks: int  # drawn time of flight [frames]
    least: int  # shortest time of flight in the matches [frames]
    most: int  # longest one
    met: int  # 0: below the net or on the floor, 1: above the net
    stance: Stance | None
    aside: float  # how far a fast shuttle passes a defender on the other side than that of their racket [m]
    late: float  # distance by which the receiver misses the shuttle at the drawn time [m]


class TrajectoryBuilder:
    """Draws points and times of a rally; contacts fall on multiples of 1/fps seconds."""

    def __init__(self, rally: Rally, players: tuple[Athlete, Athlete], seed: int, fps: int) -> None:
        self.rally, self.measured, self.players = rally, load_measured(), players
        self.key, self.fps = draws.stream(seed), fps
        self.drawn: dict[int, list[float]] = {}
        c, s = rally.catalogue, rally.stroke
        self.shot, self.area = c.shot[s].astype(np.int64), rally.aim[rally.striker, s]
        self.height, self.technique = c.height[s].astype(np.int64), c.technique[s].astype(np.int64)
        self.hurried = rally.hurried
        if rally.open:
            # Expectation of the stroke that is not chosen yet.
            hurried, above = divmod(rally.ending - RETURNED_BELOW, HURRIED_BELOW - RETURNED_BELOW)
            shot = _EXPECTED[above][third_of(int(self.area[-1]))] if len(rally) else SHOTS[_SHORT_SERVE]
            self.shot, self.area = np.r_[self.shot, SHOTS.index(shot)], np.r_[self.area, 1]
            self.height, self.hurried = np.r_[self.height, above], np.r_[self.hurried, hurried > 0]
            self.technique = np.r_[self.technique, 0 if len(rally) else _BACKHAND]

    def uniform(self, stroke: int, number: int) -> float:
        """Uniform draw from [0, 1) of a stroke by number."""
        if stroke not in self.drawn:
            bits = draws.draw(draws.extend(self.key, stroke), np.arange(_SLOT * (_TRIES + 1)))
            self.drawn[stroke] = ((bits >> np.uint64(11)) * 2.0**-53).tolist()
        return float(self.drawn[stroke][number])

    def build(self, lead_in: float, branch: "Branch | None") -> Trajectory:
        """Draw the trajectory; of a branch, the strokes stay, and the flight of the last one is drawn again."""
        rally, n = self.rally, len(self.rally)
        struck = branch.strokes if branch else 0
        before, first = np.zeros((2, 2)), max(struck - 1, 0)
        if branch and struck:
            old = branch.motion.trajectory
            before = old.before
            contacts = [old.contact[i] * poses.own_frame(rally.facing(self._striker(i))) for i in range(struck)]
            stances, times, base = list(old.stance[:struck]), old.time[:struck].tolist(), [*old.base[:struck]]
        else:
            contact, stance = self._serve(before)
            begun = lead_in
            if branch:
                # Both players walk to their positions for the serve.
                way = np.linalg.norm(branch.motion.trajectory.before - before, axis=1).max()
                begun = branch.frame / self.fps + 0.6 * float(way) + lead_in
            contacts, stances, times, base = [contact], [stance], [round(begun * self.fps) / self.fps], [before]
        drawn: list[_Choice] = []
        for i in range(first, n):
            if i >= len(base):
                base.append(self._bases(i))
            choice = self._choose(i, contacts[i], base[i][1 - self._striker(i)])
            drawn.append(choice)
            if choice.stance is not None:
                contacts.append(choice.point * np.array([-1, -1, 1]))
                stances.append(choice.stance)
                times.append(times[i] + choice.seconds)
        # From the frames of the strikers to that of the court.
        turn = np.array([poses.own_frame(rally.facing(int(seat))) for seat in rally.striker[first:]]).reshape(-1, 3)
        points = np.array([choice.point for choice in drawn]).reshape(-1, 3) * turn
        time = np.array(times[first:n])
        new = Trajectory(
            rally=rally,
            time=time,
            contact=np.array(contacts[first:n]).reshape(-1, 3) * turn,
            end=np.array([self._end(i) for i in range(first, n)], dtype=np.int64),
            end_time=time + np.array([choice.seconds for choice in drawn]),
            chosen_point=points,
            end_point=points.copy(),
            flight=_joined([choice.flight for choice in drawn], turn),
            stance=tuple(stances[first:n]),
            base=np.array(base[first:n]).reshape(-1, 2, 2),
            before=before,
            reply=stances[n] if rally.open else None,
        )
        return behind(branch.motion.trajectory, new, first) if branch and first else new

    def _striker(self, i: int) -> int:
        return (self.rally.server + i) % 2

    def _serve(self, before: F64) -> tuple[F64, Stance]:
        """Contact and stance of the server; writes the positions of both players to ``before``."""
        shot, server = self.shot[0], self.rally.server
        # The receiver stands in the service court diagonally opposite, their own right one if it is that of the server.
        sign = 1.0 if self.rally.from_right else -1.0
        x, y, rx, ry = (
            _quantile(self.measured.serve[shot, who, axis], self.uniform(0, 1 + 2 * who + axis))
            for who in (0, 1)
            for axis in (0, 1)
        )
        z = self._height(0, self.uniform(0, 5))
        motion = poses.motion_of(shot, self.technique[0], z, y)
        hips = np.array([sign * max(x, 0.12), -max(y, SHORT_SERVICE + 0.4)])
        player = self.players[server]
        probe = poses.stance_of(
            motion, np.array([0.0, -3.0, z]), np.array([0.0, -3.0]), player.right_handed, player.library.natural(motion, z)
        )
        contact = np.array([*(hips - probe.root + np.array([0.0, -3.0])), z])
        before[server], before[1 - server] = hips, (sign * rx, -ry)
        return contact, dataclasses.replace(probe, root=hips)

    def _bases(self, i: int) -> F64:
        """``[2, 2]`` base positions of both players at stroke i, by the last stroke of each; of a receiver where they wait."""
        out = np.zeros((2, 2))
        for seat in (0, 1):
            last = i - 1 if self._striker(i - 1) == seat else i - 2
            if last < 0:
                out[seat] = self.measured.base[self.shot[i], 4]
            else:
                out[seat] = self.measured.base[self.shot[last], self.area[last]]
        if self.rally.waited[i] >= 0:
            receiver = 1 - self._striker(i)
            forehand = 1.0 if self.players[receiver].right_handed else -1.0
            out[receiver] = waiting_places()[self.rally.waited[i]] * (forehand, -1.0)
        return out

    def _end(self, i: int) -> int:
        if i + 1 < len(self.rally):
            return RETURN
        if self.rally.open:
            return OPEN
        if self.rally.ending == WINNER:
            return WIN
        assert self.rally.ending == FAULT
        # A shuttle aimed at the middle of the court does not land out.
        into_net = self.shot[i] >= N_SERVES and self.area[i] in (1, 4)
        return NET if into_net or self.uniform(i, 6) < self.measured.net_share[self.shot[i]] else OUT

    def _choose(self, i: int, contact: F64, base: F64) -> _Choice:
        """First try within all bounds that can be reached; otherwise the cheapest one."""
        end = self._end(i)
        hurries = self._hurries(i, end)
        tries = [self._try(i, end, contact, base, k) for k in range(_TRIES)]
        best: _Choice | None = None
        for tried in sorted(tries, key=lambda t: (max(t.late, 0.0), -t.late * hurries)):
            if best and best.cost <= max(tried.late, _GOOD):
                break
            choice = self._flown(i, contact, base, tried, end)
            if best is None or choice.cost < best.cost:
                best = choice
        assert best is not None
        return best

    def _try(self, i: int, end: int, contact: F64, base: F64, k: int) -> _Try:
        point, met = self._point(i, end, k)
        stance = None
        if end in (RETURN, OPEN):
            if k >= _AS_DRAWN:
                point = self._nearer(i, point, base, (k + 1 - _AS_DRAWN) / (_TRIES - _AS_DRAWN))
            stance = self._stance(i + 1, point, base)
        length = np.hypot(*(point[:2] - contact[:2]))
        u = self.uniform(i, _SLOT * (k + 1)) * (_QUICK if self._hurries(i, end) else 1.0)
        seconds, least, most = self.measured.seconds(self.shot[i], met, length, u), 1, 9 * self.fps
        if end == NET:
            share = float(np.clip(-contact[1] / max(point[1] - contact[1], 0.1), 0.05, 1))
            point = self._net_point(i, contact, point, share, k)
            seconds = max(seconds * share, 0.08)
        elif end in (RETURN, OPEN):
            low, _, high = self.measured.flight_time[self.shot[i]] * self.fps
            least, most = int(np.ceil(low - 1e-6)), int(np.floor(high + 1e-6))
        else:
            # The tables end at the receiver's racket; the floor is a little further away.
            seconds = 1.12 * seconds + 0.10
        ticks = min(max(round(seconds * self.fps), least), max(least, most))
        aside = self._aside(i, stance, point, base)
        late = float(self._late(stance, base, np.array(ticks / self.fps)))
        return _Try(point, ticks, least, most, met, stance, aside, late)

    def _nearer(self, i: int, point: F64, base: F64, share: float) -> F64:
        """Point of a stroke moved by a share of the receiver's way towards them, among the places of the matches."""
        way = share * (self._stance(i + 1, point, base).root - base)
        low, high = self.measured.places[self.shot[i], self._met_in(i)][:, [0, -1]].T
        return np.array([*np.clip(point[:2] + way, np.minimum(low, point[:2]), np.maximum(high, point[:2])), point[2]])

    def _flown(self, i: int, contact: F64, base: F64, tried: _Try, end: int) -> _Choice:
        """Flight of a try, at the time nearest to the drawn one that fits; its cost is 0 if all fits."""
        best: _Choice | None = None
        for scale in _TIMES:
            ticks = np.unique(np.maximum(np.rint(tried.ticks * scale), 2))
            seconds = ticks / self.fps
            flights = shoot(np.tile(contact, (len(ticks), 1)), np.tile(tried.point, (len(ticks), 1)), seconds)
            cost = _STRICT * BOUNDS[self.shot[i]].excess(flights, tried.met, self.uniform(i, 7), crosses=end != NET) + tried.aside
            cost += np.maximum(self._late(tried.stance, base, seconds), 0.0)
            cost += _UNTIMELY * (np.maximum(ticks - tried.most, 0) + np.maximum(tried.least - ticks, 0)) / self.fps
            k = int(np.argmin(cost + _FITS * np.abs(ticks - tried.ticks)))
            if best is None or cost[k] < best.cost:
                flight = Flights(*(part[k : k + 1] for part in flights))
                best = _Choice(tried.point, float(seconds[k]), flight, tried.stance, float(cost[k]))
            if best.cost - tried.aside <= (_FITS if len(ticks) == 1 else _POOR):
                break
        assert best is not None
        return best

    def _point(self, i: int, end: int, k: int) -> tuple[F64, int]:
        first = _SLOT * (k + 1)
        u = [self.uniform(i, first + 1 + j) for j in range(4)]
        area = self.area[i] if end not in (RETURN, OPEN) else self._met_in(i)
        if area != self.area[i]:
            u[1] *= _QUICK
        places = self.measured.places[self.shot[i], area]
        x, y = (_quantile(places[axis], u[axis]) for axis in (0, 1))
        if self.shot[i] < N_SERVES:
            # The service court diagonally opposite to the server.
            x, y = (-1.0 if self.rally.from_right else 1.0) * max(abs(x), 0.04), max(y, SHORT_SERVICE + 0.04)
        if end in (RETURN, OPEN):
            low = self.hurried[i + 1] and y > _LOW_FROM
            z = self._height(i + 1, u[2] * (_QUICK if low else 1.0), flat=self.shot[i] in _FLAT)
            # Close to the net there is no way over it from further down.
            y = max(y, 0.25, (NET_HEIGHT - z) / _STEEPEST.get(SHOTS[self.shot[i + 1]], _STEEP))
            return np.array([x, y, z]), int(self.height[i + 1])
        if end == OUT:
            x, y = self._outside(i, x, y, u[2], u[3])
        return np.array([x, max(y, 0.12), RESTING]), 0

    def _met_in(self, i: int) -> int:
        """Area where the receiver meets a stroke: one who kills it steps in before it has dropped where it was meant for."""
        area = int(self.area[i])
        return area % N_SIDES if self.shot[i + 1] == _KILL else area

    def _outside(self, i: int, x: float, y: float, which: float, u: float) -> tuple[float, float]:
        by_side, by_back = (_quantile(self.measured.out_by[k], u) for k in (0, 1))
        depth, side = divmod(int(self.area[i]), 3)
        if self.shot[i] == _SHORT_SERVE and (which < 0.5 or (side == 1 and depth < 2)):
            return x, SHORT_SERVICE - max(by_side, 0.05)
        if side == 1 or (depth == 2 and which < 0.5):
            return x, HALF_LENGTH + max(by_back, 0.05)
        return float(np.copysign(HALF_WIDTH + max(by_side, 0.05), -1.0 if side == 0 else 1.0)), y

    def _net_point(self, i: int, contact: F64, point: F64, share: float, k: int) -> F64:
        x = contact[0] + share * (point[0] - contact[0])
        # Most balls into the net are just too low.
        z = float(net_height(x)) - 0.03 - min(0.9, contact[2]) * 0.6 * self.uniform(i, _SLOT * (k + 1) + 5) ** 2
        return np.array([x, -0.02, z])

    def _stance(self, i: int, point: F64, base: F64) -> Stance:
        own = point * np.array([-1, -1, 1])
        player = self.players[self._striker(i)]
        z = own[2] / player.skeleton.scale if own[2] > poses.OVERHEAD_FROM * player.skeleton.scale else own[2]
        motion = poses.motion_of(int(self.shot[i]), int(self.technique[i]), float(z), float(-own[1]))
        natural = player.library.natural(motion, float(own[2]))
        if self.shot[i] == _CLEAR and motion in poses.OVERHEADS:
            natural = natural - np.array([0.0, _FURTHER_BACK, 0.0])
        stance = poses.stance_of(motion, own, base, player.right_handed, natural)
        if not self.hurried[i]:
            return stance
        back = base - stance.root
        root = stance.root + back * min(1.0, _SHORT / max(float(np.hypot(*back)), 1e-6))
        return dataclasses.replace(stance, root=root, reach=min(stance.reach + _STRETCH, 1.0))

    def _height(self, i: int, u: float, *, flat: bool = False) -> float:
        """Contact height of stroke i [m], in reply to a flat one or not; overhead contacts scale with the player."""
        low, high = poses.height_range(self.shot[i], self.height[i], self.technique[i], flat=flat)
        z = low + (high - low) * u
        return z * self.players[self._striker(i)].skeleton.scale if z > poses.OVERHEAD_FROM else z

    def _late(self, stance: Stance | None, base: F64, seconds: F64) -> F64:
        """Distance by which a player who starts from rest at ``base`` misses a stance, negative if they have time [m]."""
        if stance is None:
            return np.zeros_like(seconds)
        run = 0.45 * _ACCELERATION * np.maximum(seconds - _REACTION, 0.0) ** 2
        return float(np.hypot(*(stance.root - base))) - run - 0.15

    def _aside(self, i: int, stance: Stance | None, point: F64, base: F64) -> float:
        """How far a fast shuttle that a defender meets is on the other side than that of the racket [m]."""
        if stance is None or self.shot[i] not in _FLAT or stance.motion not in (poses.DEFENCE, poses.DEFENCE_BACKHAND):
            return 0.0
        forehand = (-point[0] - base[0]) * (1.0 if self.players[1 - self._striker(i)].right_handed else -1.0)
        return float(max(0.0, forehand - _BODY if stance.motion in poses.BACKHANDS else _BODY - forehand))

    def _hurries(self, i: int, end: int) -> bool:
        return end in (RETURN, OPEN) and bool(self.hurried[i + 1])


def _joined(flights: list[Flights], turn: F64) -> Flights:
    none = fall(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    start, heading, *others = map(np.concatenate, zip(none, *flights, strict=True))
    return Flights(start * turn, heading * turn[:, :2], *others)
