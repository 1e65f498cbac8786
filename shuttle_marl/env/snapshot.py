"""State of an environment for rendering: as text, and as positions on the court in metres.

The environment has areas, not positions, so contact points within an area follow a fixed rule: the same rally always gives
the same picture. Court frame: X along the court from player 0 (X < 0) to player 1, Y to player 0's right,
which is down in the picture; the origin is under the middle of the net.
"""

import dataclasses
from typing import Final

import numpy as np

from shuttle_marl.game.court import AREA_WORDS, N_SIDES, SHORT_SERVICE, Hands, area_box, area_centre, seen_by
from shuttle_marl.game.layout import Layout
from shuttle_marl.game.rally import Stroke
from shuttle_marl.game.recovery import POSITIONS
from shuttle_marl.game.rules import FAULT, HURRIED_BELOW, OUTCOMES, WINNER
from shuttle_marl.game.scoring import serves_from_right
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES, Catalogue


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Snapshot:
    """The rally so far, or the last rally until the next serve is struck.

    Attributes:
        striker: player to hit next; None if the rally is over.
        winner: winner of the rally; None while it continues or if it was truncated.
        reason: reason of the end: ``fault``, ``winner``, ``illegal stroke``, ``illegal position`` or ``too many strokes``; None
            before.
        by_game: points of players 0 and 1 in each game so far; empty without a match.
        match_winner: winner of the match; None while it continues.
        hands: ``right`` or ``left``, of players 0 and 1.
        positions: where the receiver of each stroke waited, None if that is not known; empty before the rally is over, because it
            is hidden from the opponent, and in games without recovery.
    """

    game: Layout
    names: tuple[str, str]
    title: str
    strokes: tuple[Stroke, ...]
    server: int
    striker: int | None
    winner: int | None
    reason: str | None
    by_game: tuple[tuple[int, int], ...] = ()
    match_winner: int | None = None
    hands: Hands = ("right", "right")
    positions: tuple[int | None, ...] = ()

    def target(self, played: Stroke) -> int:
        """Area at which a stroke aims, as the receiver sees it."""
        return seen_by(self.hands[1 - played.player], int(self.game.catalogue.area[played.stroke]))


def as_text(snapshot: Snapshot) -> str:
    """Score, strokes with probabilities and outcomes, and state of the rally, as text; after the rally where receivers waited."""
    names = snapshot.names
    lines = [f"{snapshot.title}, {names[snapshot.server]} serves"]
    width = max(map(len, names))
    for player, name in enumerate(names if snapshot.by_game else ()):
        lines.append(f"{name:{width}}" + "".join(f"{game[player]:4}" for game in snapshot.by_game))
    if snapshot.game.levels > 1:
        lines.append("effort: " + ", ".join(f"{name} {effort_in_words(snapshot, p)}" for p, name in enumerate(names)))
    for number, stroke in enumerate(snapshot.strokes, start=1):
        words = in_words(snapshot.game.catalogue, stroke.stroke)
        probabilities = f"good {stroke.p_succ:6.1%}, returned {stroke.p_ret:6.1%}"
        waited = snapshot.positions[number - 1] if snapshot.positions else None
        where = "" if waited is None else f", receiver waited {POSITIONS[waited]}"
        lines.append(f"{number:3}  {names[stroke.player]}  {words:62} {probabilities}  {OUTCOMES[stroke.outcome]}{where}")
    lines.append(standing(snapshot))
    return "\n".join(lines) + "\n"


def in_words(catalogue: Catalogue, stroke: int) -> str:
    """Stroke as text: ``cross-court net shot to the middle backhand side, forehand above the net``."""
    shot = SHOTS[catalogue.shot[stroke]].replace("-", " ").replace("cross court", "cross-court")
    technique, height = TECHNIQUES[catalogue.technique[stroke]].replace("-", " "), HEIGHTS[catalogue.height[stroke]]
    area = int(catalogue.area[stroke])
    target = AREA_WORDS[area] + ("" if area % N_SIDES == 1 else " side")
    return f"{shot} to the {target}, {technique} {height} the net"


def effort_in_words(snapshot: Snapshot, player: int) -> str:
    """A player's current effort and the maximum: ``1 of 2``."""
    attacks = sum(snapshot.game.catalogue.is_attack[stroke.stroke] for stroke in snapshot.strokes if stroke.player == player)
    highest = snapshot.game.levels - 1
    return f"{min(attacks, highest)} of {highest}"


def standing(snapshot: Snapshot) -> str:
    """State of the rally: who is to hit, or who won and why."""
    names = snapshot.names
    if snapshot.striker is not None and snapshot.reason is None:
        hurried = snapshot.strokes and snapshot.strokes[-1].outcome >= HURRIED_BELOW
        return f"{names[snapshot.striker]} is to {'hit' if snapshot.strokes else 'serve'}{', hurried' if hurried else ''}"
    if snapshot.reason is None:
        return "no rally has started"
    if snapshot.winner is None:
        return f"no result: {snapshot.reason}"
    text = f"{names[snapshot.winner]} wins the rally ({snapshot.reason})"
    return text if snapshot.match_winner is None else f"{text} and the match"


Point = tuple[float, float]

_PEAK: Final = (0.7, 5.0, 4.6, 4.2, 0.9, 0.15, 0.2, 0.35, 0.8, 0.1, 0.6, 0.7, 0.7)
"""Rise of a flight above the straight line, by shot type [m]."""
_SPREAD: Final = (0.45, 0.54)
"""Half the width and depth over which contact points vary inside an area [m]."""
_BASE: Final = (0.0, -3.4)
"""Base position of players between strokes, in their own frame [m]."""
_RETURNED: Final = 0.55
"""Fraction of the path to the base covered during a flight."""
_CELLS: Final = ((1.1, 0.0, -1.1), (2.5, 3.8, 5.1))
"""Middles of positions: distances towards the forehand side, and from the net [m]."""
_FAULT_REACH: Final = 0.62
"""Fraction of the path to its target at which a fault is drawn to end."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Flight:
    """The shuttle from one contact to the next.

    Attributes:
        start: contact point [m].
        end: next contact, landing point, or drawn end of a fault [m].
        peak: height above the straight line at its middle [m].
    """

    stroke: Stroke
    start: Point
    end: Point
    peak: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class Plan:
    """Positions of all drawn objects.

    Attributes:
        shuttle: position of the shuttle [m].
        bodies: positions of players 0 and 1 [m].
        came_from: positions at their last contact [m]; None for the player to hit.
        waited: where the receiver of the last stroke waited [m], the middle of a cell; None where that is hidden or no choice.
    """

    flights: tuple[Flight, ...]
    shuttle: Point
    bodies: tuple[Point, Point]
    came_from: tuple[Point | None, Point | None]
    waited: Point | None = None


def to_plan(player: int, x: float, y: float) -> Point:
    """A point in a player's frame (x to the right, y to the net and beyond) in the plan."""
    return (y, x) if player == 0 else (-y, -x)


def area_corners(player: int, area: int) -> tuple[Point, Point]:
    """Two opposite corners, in the plan, of an area that a player aims at."""
    (left, right), (near, far) = area_box(area)
    return to_plan(player, left, near), to_plan(player, right, far)


def plan_of(snapshot: Snapshot) -> Plan:
    """Place the strokes of a rally on the court."""
    points = snapshot.by_game[-1] if snapshot.by_game else (0, 0)
    side = 1.0 if serves_from_right(points[snapshot.server]) else -1.0
    contact = to_plan(snapshot.server, 0.4 * side, -SHORT_SERVICE - 0.25)
    stands = [to_plan(p, 0.5 * side, -SHORT_SERVICE - (0.5 if p == snapshot.server else 1.0)) for p in (0, 1)]
    came_from: list[Point | None] = [None, None]
    flights: list[Flight] = []
    catalogue = snapshot.game.catalogue
    for played in snapshot.strokes:
        player = played.player
        if flights:
            stands[player] = _stance(snapshot, player, contact, int(catalogue.technique[played.stroke]))
        end = _landing(player, snapshot.target(played), len(flights), played.stroke)
        if played.outcome == FAULT:
            end = _between(contact, end, _FAULT_REACH)
        flights.append(Flight(stroke=played, start=contact, end=end, peak=_PEAK[catalogue.shot[played.stroke]]))
        # The striker returns to the base; the receiver has reached the shuttle, or only half of the path to a winner.
        came_from[player], came_from[1 - player] = stands[player], stands[1 - player]
        stands[player] = _between(stands[player], to_plan(player, *_BASE), _RETURNED)
        if played.outcome != FAULT:
            reach = 0.5 if played.outcome == WINNER else 1.0
            stands[1 - player] = _between(stands[1 - player], _stance(snapshot, 1 - player, end, 0), reach)
        contact = end
    return Plan(
        flights=tuple(flights),
        shuttle=contact,
        bodies=(stands[0], stands[1]),
        came_from=(came_from[0], came_from[1]),
        waited=_waited(snapshot),
    )


def _waited(snapshot: Snapshot) -> Point | None:
    """Where the receiver of the last stroke waited."""
    where = snapshot.positions[-1] if snapshot.positions else None
    if where is None:
        return None
    receiver = 1 - snapshot.strokes[-1].player
    depth, side = divmod(where, N_SIDES)
    x = _CELLS[0][side] * (1 if snapshot.hands[receiver] == "right" else -1)
    return to_plan(receiver, x, -_CELLS[1][depth])


def _landing(player: int, area: int, number: int, stroke: int) -> Point:
    """Point in the area, varied by the number of the stroke, so that paths do not overlap."""
    x, y = area_centre(np.array(area))
    dx, dy = np.random.default_rng([number, stroke]).uniform(-1, 1, 2)
    return to_plan(player, float(x + dx * _SPREAD[0]), float(y + dy * _SPREAD[1]))


def _stance(snapshot: Snapshot, player: int, contact: Point, technique: int) -> Point:
    """Position of a player at a contact: behind the shuttle, which is at the side of the racket for all but a backhand."""
    sideways = 0.45 if (technique == 1) == (snapshot.hands[player] == "right") else -0.45
    back = to_plan(player, sideways, -0.35)
    return contact[0] + back[0], contact[1] + back[1]


def _between(a: Point, b: Point, share: float) -> Point:
    return a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])
