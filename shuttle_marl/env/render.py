"""``render()``: the state of an environment as text, and as a picture from above the court.

The environment has areas, so contact points follow a fixed rule. Plan: X along the court from player 0 (X < 0), Y to player 0's
right, which is down in the picture.
"""

import dataclasses
import functools
import importlib
import itertools
import os
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64, U8, Floats
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.extras import install_hint
from shuttle_marl.game.court import (
    AREA_WORDS,
    HALF_LENGTH,
    HALF_WIDTH,
    LONG_SERVICE,
    N_SIDES,
    SHORT_SERVICE,
    WIDTH,
    Hands,
    area_box,
    area_centre,
    seen_by,
)
from shuttle_marl.game.layout import Layout
from shuttle_marl.game.rally import Stroke
from shuttle_marl.game.recovery import POSITIONS
from shuttle_marl.game.rules import FAULT, HURRIED_BELOW, OUTCOMES, WINNER
from shuttle_marl.game.scoring import serves_from_right
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES, Catalogue


class RenderError(ShuttleError):
    """Pictures cannot be drawn."""


@functools.cache
def _pygame() -> Any:
    """The module, which is optional, and imported when the first picture is drawn.

    Raises:
        RenderError: it is not installed.
    """
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        return importlib.import_module("pygame")
    except ImportError as error:
        raise RenderError(
            "render_mode 'human' and 'rgb_array' need pygame, which is not installed ('ansi' works without); "
            + install_hint("render")
        ) from error


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Snapshot:
    """The rally so far, or the last rally until the next serve is struck.

    Attributes:
        reason: reason of the end: ``fault``, ``winner``, ``illegal stroke``, ``illegal position`` or ``too many
            strokes``; None before.
        positions: where the receiver of each stroke waited, None if that is not known; empty before the rally is over,
            because it is hidden from the opponent, and in games without recovery.
    """

    game: Layout
    names: tuple[str, str]
    title: str
    strokes: tuple[Stroke, ...]
    server: int
    striker: int | None  # player to hit next; None if the rally is over
    winner: int | None  # winner of the rally; None while it continues or if it was truncated
    reason: str | None
    by_game: tuple[tuple[int, int], ...] = ()  # points of players 0 and 1 in each game so far; empty without a match
    match_winner: int | None = None  # winner of the match; None while it continues
    hands: Hands = ("right", "right")  # ``right`` or ``left``, of players 0 and 1
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

# Rise of a flight above the straight line, by shot type [m].
_PEAK: Final = (0.7, 5.0, 4.6, 4.2, 0.9, 0.15, 0.2, 0.35, 0.8, 0.1, 0.6, 0.7, 0.7)
_SPREAD: Final = (0.45, 0.54)  # half the width and depth over which contact points vary inside an area [m]
_BASE: Final = (0.0, -3.4)  # base position of players between strokes, in their own frame [m]
_RETURNED: Final = 0.55  # fraction of the path to the base covered during a flight
_FAULT_REACH: Final = 0.62  # fraction of the path to its target at which a fault is drawn to end


class Flight(NamedTuple):
    """The shuttle from one contact to the next; points in metres."""

    stroke: Stroke
    start: Point
    end: Point  # next contact, landing point, or drawn end of a fault


class Plan(NamedTuple):
    """Positions of all drawn objects [m]."""

    flights: tuple[Flight, ...]
    shuttle: Point
    bodies: tuple[Point, Point]


def to_plan(player: int, x: float, y: float) -> Point:
    """A point in a player's frame (x to the right, y to the net and beyond) in the plan."""
    return (y, x) if player == 0 else (-y, -x)


def plan_of(snapshot: Snapshot) -> Plan:
    """Place the strokes of a rally on the court."""
    points = snapshot.by_game[-1] if snapshot.by_game else (0, 0)
    side = 1.0 if serves_from_right(points[snapshot.server]) else -1.0
    contact = to_plan(snapshot.server, 0.4 * side, -SHORT_SERVICE - 0.25)
    stands = [to_plan(p, 0.5 * side, -SHORT_SERVICE - (0.5 if p == snapshot.server else 1.0)) for p in (0, 1)]
    flights: list[Flight] = []
    catalogue = snapshot.game.catalogue
    for played in snapshot.strokes:
        player = played.player
        if flights:
            stands[player] = _stance(snapshot, player, contact, int(catalogue.technique[played.stroke]))
        end = _landing(player, snapshot.target(played), len(flights), played.stroke)
        if played.outcome == FAULT:
            end = _between(contact, end, _FAULT_REACH)
        flights.append(Flight(played, contact, end))
        # The striker returns to the base; the receiver has reached the shuttle, or only half of the path to a winner.
        stands[player] = _between(stands[player], to_plan(player, *_BASE), _RETURNED)
        if played.outcome != FAULT:
            reach = 0.5 if played.outcome == WINNER else 1.0
            stands[1 - player] = _between(stands[1 - player], _stance(snapshot, 1 - player, end, 0), reach)
        contact = end
    return Plan(tuple(flights), contact, (stands[0], stands[1]))


def _landing(player: int, area: int, number: int, stroke: int) -> Point:
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


Colour = tuple[int, ...]

INK, TEXT, MUTED, WHITE = (13, 17, 26), (229, 231, 235), (139, 151, 168), (240, 244, 248)
PLAYERS: Final = ((56, 189, 248), (251, 113, 133))
YELLOW, GREEN, RED = (251, 191, 36), (52, 211, 153), (248, 80, 80)
MAT, AROUND, TARGET = (18, 114, 87), (14, 93, 72), (70, 128, 76)

SIZE: Final = (900, 560)  # width and height of the picture [px]; it is painted twice as large
WIDE, HIGH = 2 * SIZE[0], 2 * SIZE[1]
PX: Final = 116.0  # painted pixels per metre
_RISE: Final = 34.0  # painted pixels that a flight is lifted for each metre of height


def px(point: Point | Floats) -> F64:
    """A point of the plan in the painting."""
    return np.array([WIDE / 2, HIGH / 2]) + PX * np.asarray(point)


def _rect(surface: Any, a: Point, b: Point, colour: Colour) -> None:
    (left, top), (right, bottom) = np.rint(np.sort([px(a), px(b)], axis=0)).tolist()
    _pygame().draw.rect(surface, colour, (left, top, right - left, bottom - top))


def _line(surface: Any, points: Sequence[Floats] | Floats, width: float, colour: Colour) -> None:
    for a, b in itertools.pairwise(points):
        side = width / 2 * np.array([a[1] - b[1], b[0] - a[0]]) / max(float(np.hypot(*(b - a))), 1e-9)
        _pygame().draw.polygon(surface, colour, [a + side, b + side, b - side, a - side])


def _write(surface: Any, text: str, at: tuple[float, float], size: int, colour: Colour, anchor: str = "midleft") -> float:
    """Write a line of text, of which the point ``anchor`` lies at ``at``; returns the x of its end."""
    _pygame().font.init()
    image = _pygame().font.Font(None, size).render(text, True, colour)
    place = image.get_rect(**{anchor: at})
    surface.blit(image, place)
    return float(place.right)


def _paint_court(surface: Any) -> None:
    length, half = HALF_LENGTH, WIDTH / 2
    _rect(surface, (-length - 0.9, -half - 0.5), (length + 0.9, half + 0.5), AROUND)
    _rect(surface, (-length, -half), (length, half), MAT)
    for side in (-1, 1):
        lines = [((side * x, -half), (side * x, half)) for x in (length, length - LONG_SERVICE, SHORT_SERVICE)]
        lines += [((-length, side * y), (length, side * y)) for y in (HALF_WIDTH, half)]
        for a, b in (*lines, ((side * SHORT_SERVICE, 0), (side * length, 0))):
            _line(surface, [px(a), px(b)], 0.05 * PX, WHITE)


def _paint_flight(surface: Any, snapshot: Snapshot, flight: Flight, strength: float) -> None:
    """A flight, lifted by its height; a shuttle slows down so much that it is highest well behind the middle."""
    t, peak = np.linspace(0, 1, 40)[:, None], _PEAK[snapshot.game.catalogue.shot[flight.stroke.stroke]]
    path = px(flight.start) + t * (px(flight.end) - px(flight.start)) - peak * 6.75 * t**2 * (1 - t) * [0, _RISE]
    colour = strength * np.array(PLAYERS[flight.stroke.player]) + (1 - strength) * np.array(MAT)
    _line(surface, path, 6, tuple(np.rint(colour).astype(int).tolist()))


def _paint_player(surface: Any, snapshot: Snapshot, plan: Plan, player: int) -> None:
    """A player from above: shoulders, head, and the racket towards the shuttle."""
    body = px(plan.bodies[player])
    if snapshot.striker == player:
        _pygame().draw.circle(surface, WHITE, body, 54, 5)
    ahead = px(plan.shuttle) - body
    ahead = ahead / max(float(np.hypot(*ahead)), 1e-9)
    right = np.array([-ahead[1], ahead[0]]) * (1 if snapshot.hands[player] == "right" else -1)
    hand = body + 26 * right
    _line(surface, [hand, hand + 50 * ahead], 6, WHITE)
    _pygame().draw.circle(surface, WHITE, hand + 68 * ahead, 20, 4)
    _line(surface, [body - 34 * right, body + 34 * right], 32, PLAYERS[player])
    _pygame().draw.circle(surface, INK, body, 18)


def _paint_shuttle(surface: Any, plan: Plan) -> None:
    """The shuttle, or a mark that says how the rally ended there."""
    at, outcome = px(plan.shuttle), plan.flights[-1].stroke.outcome if plan.flights else None
    if outcome == WINNER:
        for radius in (18, 32, 46):
            _pygame().draw.circle(surface, GREEN, at, radius, 5)
    elif outcome == FAULT:
        for arm in ([18, 18], [18, -18]):
            _line(surface, [at - arm, at + arm], 8, RED)
    else:
        _pygame().draw.circle(surface, YELLOW, at, 13)


def _paint_words(surface: Any, snapshot: Snapshot) -> None:
    serving = snapshot.winner if snapshot.winner is not None else snapshot.server
    for player, name in enumerate(snapshot.names):
        y = 40 + 52 * player
        _pygame().draw.rect(surface, PLAYERS[player], (40, y - 22, 8, 44))
        end = _write(surface, name, (104, y), 44, TEXT)
        if player == serving:
            _pygame().draw.circle(surface, YELLOW, (76, y), 10)
        if snapshot.game.levels > 1:
            end = _write(surface, f"effort {effort_in_words(snapshot, player)}", (end + 20, y), 34, MUTED)
        for column, points in enumerate(snapshot.by_game):
            colour = TEXT if column == len(snapshot.by_game) - 1 else MUTED
            _write(surface, str(points[player]), (max(600, end + 40) + 80 * column, y), 52, colour, "center")
    _write(surface, snapshot.title, (WIDE - 40, 40), 40, MUTED, "midright")
    _write(surface, standing(snapshot), (WIDE - 40, 92), 44, TEXT, "midright")
    if snapshot.strokes:
        last, number = snapshot.strokes[-1], len(snapshot.strokes)
        words = in_words(snapshot.game.catalogue, last.stroke)
        _write(surface, f"{number}  {snapshot.names[last.player]}: {words}", (40, HIGH - 88), 48, PLAYERS[last.player])
        odds = f"good {last.p_succ:.1%}, returned {last.p_ret:.1%}: {OUTCOMES[last.outcome]}"
        _write(surface, odds, (40, HIGH - 36), 40, MUTED)


class CourtRenderer:
    """Draws snapshots; opens a window when first asked to show one.

    Raises:
        RenderError: pygame is not installed.
    """

    def __init__(self, title: str, *, fps: float) -> None:
        self._title = title
        self._fps = fps
        self._court = _pygame().Surface((WIDE, HIGH))
        self._court.fill(INK)
        _paint_court(self._court)
        self._window: Any = None
        self._clock: Any = None
        self._dismissed = False

    def frame(self, snapshot: Snapshot) -> U8:
        """``[560, 900, 3]`` picture."""
        return np.ascontiguousarray(_pygame().surfarray.array3d(self._paint(snapshot)).swapaxes(0, 1))

    def show(self, snapshot: Snapshot) -> None:
        """Show the picture for one frame; does nothing once the user has closed the window."""
        if self._dismissed:
            return
        if self._window is None:
            _pygame().display.init()
            _pygame().display.set_caption(f"shuttle_marl {self._title}")
            self._window = _pygame().display.set_mode(SIZE)
            self._clock = _pygame().time.Clock()
        self._window.blit(self._paint(snapshot), (0, 0))
        _pygame().display.flip()
        if any(event.type == _pygame().QUIT for event in _pygame().event.get()):
            self.close()
            self._dismissed = True
            return
        self._clock.tick(self._fps)

    def close(self) -> None:
        """Close the window."""
        if self._window is not None:
            _pygame().display.quit()
            self._window = None

    def _paint(self, snapshot: Snapshot) -> Any:
        surface, plan = self._court.copy(), plan_of(snapshot)
        if snapshot.strokes:
            last = snapshot.strokes[-1]
            (left, right), (near, far) = area_box(snapshot.target(last))
            _rect(surface, to_plan(last.player, left, near), to_plan(last.player, right, far), TARGET)
        _line(surface, [px((0, -WIDTH / 2 - 0.1)), px((0, WIDTH / 2 + 0.1))], 10, WHITE)
        for player in (0, 1):
            _paint_player(surface, snapshot, plan, player)
        for flight, strength in zip(plan.flights[-3:], (0.35, 0.6, 1.0)[-len(plan.flights) :], strict=False):
            _paint_flight(surface, snapshot, flight, strength)
        _paint_shuttle(surface, plan)
        _paint_words(surface, snapshot)
        return _pygame().transform.smoothscale(surface, SIZE)
