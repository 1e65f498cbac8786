"""The value of a state over the court: where to aim the reply to an incoming stroke."""

import dataclasses
import difflib
from pathlib import Path
from typing import Any, Final

import numpy as np

from shuttle_marl.analysis import pictures
from shuttle_marl.arrays import F64, Intp
from shuttle_marl.exact.fixed_point import ExactError
from shuttle_marl.exact.optimal import Solution
from shuttle_marl.game.court import AREAS, N_AREAS, area_centre
from shuttle_marl.game.shipped import real_strokes
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES, UnknownStrokeError
from shuttle_marl.game.tables import Game

_SPREAD: Final = 0.35
"""Probabilities of winning within this of one half are told apart by colour; what lies beyond has the last one."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Aim:
    """The best replies to an incoming stroke from one contact, by target area.

    Attributes:
        value: ``[9]`` value of the best reply aimed at each area, NaN where none is legal.
        stroke: ``[9]`` catalogue index of that reply, -1 where none is legal.
        strokes: ``[9]`` real strokes behind that reply (:func:`shuttle_marl.game.shipped.real_strokes`); NaN where there is none,
            and in a game of no model.
        state_value: value of the best reply of all.
    """

    value: F64
    stroke: Intp
    strokes: F64
    state_value: float


def aims(solution: Solution, incoming: int, own: int | None = None) -> tuple[Aim, Aim]:
    """The best replies to a stroke from below and from above the net, under perfect play afterwards.

    Args:
        solution: the solved game.
        incoming: catalogue index of the incoming stroke.
        own: the striker's own last stroke; None: the mean over all that can precede (the serve has none).

    Raises:
        ExactError: the two strokes never follow each other.
    """
    game = solution.games[0]
    edges = edges_of(game, incoming, own)
    # Rested players, and no duel: the states of the first block.
    below, above = (_aim(game, solution.value[1], 2 * edges + contact) for contact in (0, 1))
    return below, above


def edges_of(game: Game, incoming: int, own: int | None = None) -> Intp:
    """Edges on which a stroke comes in: after one's own last stroke, or after any (None).

    Raises:
        ExactError: the two strokes never follow each other.
    """
    edges = np.flatnonzero(game.edge_incoming == incoming)
    if own is not None:
        edges = edges[game.edge_own[edges] == own]
    if not len(edges):
        after = "" if own is None else f" after one's own {game.catalogue.names[own]}"
        raise ExactError(f"{game.catalogue.names[incoming]} never comes in{after}: it is no legal reply there")
    return edges


def _aim(game: Game, following: F64, states: Intp) -> Aim:
    # The replies to a stroke from a contact are the same whatever the striker's own last stroke was, in the same order.
    strokes = game.legal_strokes(int(states[0]))
    mean = np.mean([game.stroke_values(following, game.pairs_of(s)) for s in states.tolist()], axis=0)
    by_area = np.full(N_AREAS, np.nan)
    chosen, behind = np.full(N_AREAS, -1, dtype=np.intp), np.full(N_AREAS, np.nan)
    real = real_strokes(game)
    support = np.full(len(strokes), np.nan) if real is None else real[game.base_pair_edge[game.pairs_of(int(states[0]))]]
    for stroke, worth, count in zip(strokes, mean, support, strict=True):
        area = game.catalogue.area[stroke]
        if not worth <= by_area[area]:
            by_area[area], chosen[area], behind[area] = worth, stroke, count
    return Aim(value=by_area, stroke=chosen, strokes=behind, state_value=float(mean.max()))


def stroke_index(game: Game, name: str) -> int:
    """Catalogue index of a stroke given by name.

    Raises:
        ExactError: there is none of that name; says which ones are close.
    """
    try:
        return game.catalogue.index(name)
    except UnknownStrokeError as error:
        close = difflib.get_close_matches(name, game.catalogue.names, n=4, cutoff=0.4)
        hint = f"; did you mean {', '.join(close)}?" if close else ""
        raise ExactError(f"{error}{hint}") from error


def plot(solution: Solution, path: Path, incoming: int, own: int | None = None) -> None:
    """Draw :func:`aims` on the court, the striker's half below, into a PNG, SVG or PDF file.

    Raises:
        ExactError: the strokes never follow each other.
        AnalysisError: the file's suffix is of no known format.
        FileWriteError: the file cannot be written.
        ModuleNotFoundError: matplotlib is not installed.
    """
    drawn = pictures.figure(9.6, 8.2)
    game = solution.games[0]
    colours = pictures.colour_map("RdYlGn")
    for axes, contact, aim in zip(drawn.subplots(1, 2), HEIGHTS, aims(solution, incoming, own), strict=True):
        pictures.draw_court(axes)
        _draw_incoming(axes, int(game.catalogue.area[incoming]))
        for area in range(N_AREAS):
            _draw_area(axes, game, aim, area, colours)
        axes.set_title(f"shuttle {contact} the net: wins {_percent(aim.state_value)}", fontsize=11)
    names = game.catalogue.names
    if own is not None:
        before = f" after one's own {names[own]}"
    else:
        before = "" if game.catalogue.is_serve[incoming] else ", mean over one's own last strokes"
    drawn.suptitle(f"Reply to {names[incoming]}{before}", fontsize=12)
    pictures.save(drawn, path)


def _percent(value: float) -> str:
    return f"{100 * (1 + value) / 2:.1f} %"


def _draw_incoming(axes: Any, area: int) -> None:
    # The striker receives it: the opponent's half turned by half a turn.
    left, bottom, width, height = pictures.area_box(area)
    x, y, text = -left - width / 2, -bottom - height / 2, AREAS[area].replace("-", "\n")
    box = [(-left, -bottom), (-left - width, -bottom), (-left - width, -bottom - height), (-left, -bottom - height)]
    axes.fill(*zip(*box, strict=True), facecolor=pictures.LINE, alpha=0.9, zorder=3.5)
    axes.text(x, y, f"incoming\n{text}", ha="center", va="center", fontsize=7.5, color=pictures.INK, zorder=5)


def _draw_area(axes: Any, game: Game, aim: Aim, area: int, colours: Any) -> None:
    left, bottom, width, height = pictures.area_box(area)
    box = [(left, bottom), (left + width, bottom), (left + width, bottom + height), (left, bottom + height)]
    x, y = area_centre(np.array(area))
    if aim.stroke[area] < 0:
        axes.fill(*zip(*box, strict=True), facecolor="none", edgecolor=pictures.LINE, hatch="//", alpha=0.5, zorder=3.5)
        return
    value = float(aim.value[area])
    best = value >= aim.state_value
    axes.fill(
        *zip(*box, strict=True),
        facecolor=colours(np.clip(0.5 + value / 2 / _SPREAD / 2, 0, 1)),
        edgecolor=pictures.INK if best else pictures.LINE,
        linewidth=3 if best else 0.8,
        zorder=3.6 if best else 3.5,
    )
    stroke = aim.stroke[area]
    shot = SHOTS[game.catalogue.shot[stroke]].replace("cross-court-net-shot", "cross-court\nnet-shot")
    text = f"{_percent(value)}\n{shot}\n{TECHNIQUES[game.catalogue.technique[stroke]]}"
    if np.isfinite(aim.strokes[area]):
        text += f"\nn = {aim.strokes[area]:.0f}"
    axes.text(x, y, text, ha="center", va="center", fontsize=7.5, color=pictures.INK, weight="bold" if best else None, zorder=5)
