"""``render()``: the state of an environment as text, and as a picture from above the court.

The environment has areas, so contact points follow a fixed rule. Plan: X along the court from player 0 (X < 0), Y to player 0's
right, which is down in the picture.
"""

import dataclasses
import functools
import importlib
import os
from typing import Any, Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64, U8
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.extras import install_hint
from shuttle_marl.game import court
from shuttle_marl.game.layout import Layout
from shuttle_marl.game.rally import Stroke
from shuttle_marl.game.recovery import POSITIONS
from shuttle_marl.game.rules import FAULT, HURRIED_BELOW, OUTCOMES, RETURNED_BELOW, WINNER
from shuttle_marl.game.scoring import serves_from_right
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES, Catalogue


class RenderError(ShuttleError):
    """Pictures cannot be drawn."""


@functools.cache
def _pygame() -> Any:
    """The module, which is optional, and imported when the first picture is drawn. Raises RenderError: it is not installed."""
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
    hands: court.Hands = ("right", "right")  # ``right`` or ``left``, of players 0 and 1
    positions: tuple[int | None, ...] = ()

    def target(self, played: Stroke) -> int:
        """Area at which a stroke aims, as the receiver sees it."""
        return court.seen_by(self.hands[1 - played.player], int(self.game.catalogue.area[played.stroke]))


def as_text(snapshot: Snapshot) -> str:
    """Score, strokes with probabilities and outcomes, and state of the rally, as text; after the rally where receivers waited."""
    names = snapshot.names
    lines = [f"{snapshot.title}, {names[snapshot.server]} serves"]
    width = max(map(len, names))
    for player, name in enumerate(names if snapshot.by_game else ()):
        lines.append(f"{name:{width}}" + "".join(f"{game[player]:4}" for game in snapshot.by_game))
    if snapshot.game.levels > 1:
        is_attack, highest = snapshot.game.catalogue.is_attack, snapshot.game.levels - 1
        attacks = [sum(is_attack[each.stroke] for each in snapshot.strokes if each.player == player) for player in (0, 1)]
        efforts = (f"{name} {min(n, highest)} of {highest}" for name, n in zip(names, attacks, strict=True))
        lines.append(f"effort: {', '.join(efforts)}")
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
    target = court.AREA_WORDS[area] + ("" if area % court.N_SIDES == 1 else " side")
    return f"{shot} to the {target}, {technique} {height} the net"


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

_SPREAD: Final = (0.45, 0.54)  # half the width and depth over which contact points vary inside an area [m]
_BASE: Final = (0.0, -3.4)  # base position of players between strokes, in their own frame [m]
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
    """Place the strokes of a rally on the court: the receiver at the shuttle, and the striker halfway to the base."""
    points = snapshot.by_game[-1] if snapshot.by_game else (0, 0)
    side = 1.0 if serves_from_right(points[snapshot.server]) else -1.0
    contact = to_plan(snapshot.server, 0.4 * side, -court.SHORT_SERVICE - 0.25)
    bodies = [to_plan(p, 0.5 * side, -court.SHORT_SERVICE - (0.5 if p == snapshot.server else 1.0)) for p in (0, 1)]
    flights: list[Flight] = []
    for played in snapshot.strokes:
        player, receiver = played.player, 1 - played.player
        end = _landing(player, snapshot.target(played), len(flights), played.stroke)
        if played.outcome == FAULT:
            end = _between(contact, end, _FAULT_REACH)
        flights.append(Flight(played, contact, end))
        bodies[player] = _between(contact, to_plan(player, *_BASE), 0.5)
        if played.outcome >= RETURNED_BELOW:
            back = to_plan(receiver, 0.0, -0.5)
            bodies[receiver] = end[0] + back[0], end[1] + back[1]
        contact = end
    return Plan(tuple(flights), contact, (bodies[0], bodies[1]))


def _landing(player: int, area: int, number: int, stroke: int) -> Point:
    x, y = court.area_centre(np.array(area))
    dx, dy = np.random.default_rng([number, stroke]).uniform(-1, 1, 2)
    return to_plan(player, float(x + dx * _SPREAD[0]), float(y + dy * _SPREAD[1]))


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


def px(point: Point) -> F64:
    """A point of the plan in the painting."""
    return np.array([WIDE / 2, HIGH / 2]) + PX * np.array(point)


class CourtRenderer:
    """Draws snapshots; opens a window when first asked to show one. Raises RenderError: pygame is not installed."""

    def __init__(self, title: str, *, fps: float) -> None:
        self._pygame, self._title, self._fps = _pygame(), title, fps
        self._window: Any = None
        self._clock = self._pygame.time.Clock()
        self._dismissed = False
        self._court = self._pygame.Surface((WIDE, HIGH))
        self._court.fill(INK)
        self._paint_court()

    def frame(self, snapshot: Snapshot) -> U8:
        """``[560, 900, 3]`` picture."""
        return np.ascontiguousarray(self._pygame.surfarray.array3d(self._paint(snapshot)).swapaxes(0, 1))

    def show(self, snapshot: Snapshot) -> None:
        """Show the picture for one frame; does nothing once the user has closed the window."""
        if self._dismissed:
            return
        if self._window is None:
            self._pygame.display.init()
            self._pygame.display.set_caption(f"shuttle_marl {self._title}")
            self._window = self._pygame.display.set_mode(SIZE)
        self._window.blit(self._paint(snapshot), (0, 0))
        self._pygame.display.flip()
        if any(event.type == self._pygame.QUIT for event in self._pygame.event.get()):
            self.close()
            self._dismissed = True
            return
        self._clock.tick(self._fps)

    def close(self) -> None:
        """Close the window."""
        if self._window is not None:
            self._pygame.display.quit()
            self._window = None

    def _paint_court(self) -> None:
        length, half = court.HALF_LENGTH, court.WIDTH / 2
        self._rect(self._court, (-length - 0.9, -half - 0.5), (length + 0.9, half + 0.5), AROUND)
        self._rect(self._court, (-length, -half), (length, half), MAT)
        for side in (-1, 1):
            lines = [((side * x, -half), (side * x, half)) for x in (length, length - court.LONG_SERVICE, court.SHORT_SERVICE)]
            lines += [((-length, side * y), (length, side * y)) for y in (court.HALF_WIDTH, half)]
            for a, b in (*lines, ((side * court.SHORT_SERVICE, 0), (side * length, 0))):
                self._line(self._court, a, b, WHITE)

    def _paint(self, snapshot: Snapshot) -> Any:
        surface, plan, circle = self._court.copy(), plan_of(snapshot), self._pygame.draw.circle
        if snapshot.strokes:
            last = snapshot.strokes[-1]
            (left, right), (near, far) = court.area_box(snapshot.target(last))
            self._rect(surface, to_plan(last.player, left, near), to_plan(last.player, right, far), TARGET)
        self._line(surface, (0, -court.WIDTH / 2 - 0.1), (0, court.WIDTH / 2 + 0.1), WHITE, 10)
        for player, body in enumerate(plan.bodies):
            circle(surface, PLAYERS[player], px(body), 32)
            if snapshot.striker == player:
                circle(surface, WHITE, px(body), 54, 5)
        for flight, strength in zip(plan.flights[-3:], (0.35, 0.6, 1.0)[-len(plan.flights) :], strict=False):
            colour = strength * np.array(PLAYERS[flight.stroke.player]) + (1 - strength) * np.array(MAT)
            self._line(surface, flight.start, flight.end, tuple(colour.astype(int).tolist()))
        outcome = snapshot.strokes[-1].outcome if snapshot.strokes else RETURNED_BELOW
        circle(surface, {WINNER: GREEN, FAULT: RED}.get(outcome, YELLOW), px(plan.shuttle), 16)
        self._write_words(surface, snapshot)
        return self._pygame.transform.smoothscale(surface, SIZE)

    def _write_words(self, surface: Any, snapshot: Snapshot) -> None:
        for player, name in enumerate(snapshot.names):
            self._write(surface, name, (40, 40 + 52 * player), 44, PLAYERS[player])
            for column, points in enumerate(snapshot.by_game):
                self._write(surface, str(points[player]), (640 + 80 * column, 40 + 52 * player), 52, TEXT, "center")
        self._write(surface, snapshot.title, (WIDE - 40, 40), 40, MUTED, "midright")
        self._write(surface, standing(snapshot), (WIDE - 40, 92), 44, TEXT, "midright")
        if snapshot.strokes:
            last, number = snapshot.strokes[-1], len(snapshot.strokes)
            words = in_words(snapshot.game.catalogue, last.stroke)
            self._write(surface, f"{number}  {snapshot.names[last.player]}: {words}", (40, HIGH - 88), 48, PLAYERS[last.player])
            odds = f"good {last.p_succ:.1%}, returned {last.p_ret:.1%}: {OUTCOMES[last.outcome]}"
            self._write(surface, odds, (40, HIGH - 36), 40, MUTED)

    def _rect(self, surface: Any, a: Point, b: Point, colour: Colour) -> None:
        (left, top), (right, bottom) = np.rint(np.sort([px(a), px(b)], axis=0)).tolist()
        self._pygame.draw.rect(surface, colour, (left, top, right - left, bottom - top))

    def _line(self, surface: Any, a: Point, b: Point, colour: Colour, width: int = 6) -> None:
        self._pygame.draw.line(surface, colour, px(a), px(b), width)

    def _write(
        self, surface: Any, text: str, at: tuple[float, float], size: int, colour: Colour, anchor: str = "midleft"
    ) -> None:
        """Write a line of text, of which the point ``anchor`` lies at ``at``."""
        self._pygame.font.init()
        image = self._pygame.font.Font(None, size).render(text, True, colour)
        surface.blit(image, image.get_rect(**{anchor: at}))
