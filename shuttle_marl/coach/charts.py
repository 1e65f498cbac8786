"""Charts of the reports: court maps, intervals, and the course of a match."""

from collections.abc import Sequence
from textwrap import fill
from typing import Final, NamedTuple
from unicodedata import east_asian_width

import numpy as np
from markupsafe import Markup

from shuttle_marl.analysis.pictures import corners, draw_court, of_hand
from shuttle_marl.analysis.waits import Wait
from shuttle_marl.base.arrays import F64
from shuttle_marl.coach.words import words
from shuttle_marl.game.court import HALF_LENGTH, HALF_WIDTH, N_AREAS, SHORT_SERVICE, area_centre
from shuttle_marl.game.recovery import position_box
from shuttle_marl.pages.charts import DIM, INK, PLAYERS, Chart, label, styled

_WIDTH: Final = 460.0
"""Width of a chart [px], which fits a telephone."""
_LINE: Final = 30
"""Letters in a line of a label."""
_MORE, _LESS, _ALIKE = "#e8a15c", "#7fb0e0", "#f4f4f0"
"""Colours of larger and smaller shares; orange and blue are told apart by all readers."""
_DARK: Final = "#16191c"
_MISSING: Final = 4.5
"""Width that a letter takes beyond what a missing one does [px]."""


class Bar(NamedTuple):
    """An estimate: its name, value and interval, a reference (NaN: none), whether it is clear, and the player (0 or 1)."""

    name: str
    value: float
    low: float
    high: float
    reference: float = float("nan")
    clear: bool = True
    player: int = 0


def _wide(text: str) -> int:
    """Number of letters that are as wide as two."""
    return sum(east_asian_width(letter) == "W" for letter in text)


@styled
def bars(rows: Sequence[Bar], title: str) -> Markup:
    """Estimates with intervals, one below the other."""
    say = words()
    whole = [label(row.name, 3 * _LINE) for row in rows]
    labels = [fill(text, _LINE // 2 if 2 * _wide(text) > len(text) else _LINE) for text in whole]  # wide letters: half as many
    lines = max(text.count("\n") for text in labels) + 1
    chart = Chart(_WIDTH, (14.0 * lines + 6) * len(rows) + 40)
    # The font of matplotlib has no wide letters, and leaves less space for them than that of the reader takes.
    room = _MISSING * max(_wide(line) for text in labels for line in text.split("\n")) / _WIDTH
    chart.figure.get_layout_engine().set(rect=(room, 0, 1 - room, 1))
    axes = chart.axes
    for y, row in enumerate(rows):
        colour = PLAYERS[row.player]
        value, low, high = (say.number(x, ".1f") for x in row[1:4])
        estimate = say("report.interval", value=value, low=low, high=high)
        about = chart.tooltips(f"{row.name}: {estimate}")
        axes.plot([row.low, row.high], [y, y], color=colour, linewidth=3, alpha=0.55, gid=about)
        axes.plot(row.value, y, "os"[row.player], markersize=8, markeredgewidth=1.6, markeredgecolor=colour,
                  color=colour if row.clear else "none")  # fmt: skip
        if np.isfinite(row.reference):
            axes.plot(row.reference, y, "D", color="none", markeredgecolor=INK, markeredgewidth=1.4, markersize=7)
    if min(row.low for row in rows) < 0 < max(row.high for row in rows):
        axes.axvline(0, color=DIM, linewidth=1)
    axes.set_yticks(range(len(rows)), labels, color=INK)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)
    return chart.svg(title)


@styled
def court(shares: F64, reference: F64, title: str, hand: str | None, clear: Sequence[int] = ()) -> Markup:
    """Shares of the target areas, coloured by their difference from a reference, with the striker at the bottom.

    Args:
        shares, reference: ``[9]`` shares; areas as a right-handed receiver sees them.
        hand: of the receiver; None: unknown.
        clear: areas with a frame.
    """
    from matplotlib.colors import LinearSegmentedColormap, to_hex  # noqa: PLC0415  slow to import

    colours = LinearSegmentedColormap.from_list("differences", (_LESS, _ALIKE, _MORE))
    chart = Chart(330.0, 330.0)
    axes = chart.axes
    draw_court(axes)
    axes.set_ylim(-1.2, HALF_LENGTH + 0.3)
    axes.grid(visible=False)
    difference = 100 * (shares - reference)
    most = max(4.0, float(np.abs(difference).max()))
    for area in range(N_AREAS):
        place = of_hand(area, hand)
        x, y = area_centre(np.array(place))
        colour = to_hex(colours(0.5 + difference[area] / most / 2))
        marked = area in clear
        axes.fill(
            *corners(place), facecolor=colour, edgecolor=_DARK, linewidth=3.0 if marked else 0.6, zorder=3.7 if marked else 3.5
        )
        text = f"{100 * shares[area]:.0f}\n({round(float(difference[area])):+d})"
        axes.text(x, y, text, ha="center", va="center", color=_DARK, fontsize=12, zorder=5,
                  weight="bold" if marked else "normal")  # fmt: skip
    say = words()
    described = say.listed(f"{say.area(area, 'receiver')} {100 * shares[area]:.0f}" for area in range(N_AREAS))
    return chart.svg(f"{title}: {described}")


@styled
def waits(rows: Sequence[Wait], title: str, hand: str | None) -> Markup:
    """Half courts with the shares of the nine positions, the net at the top, as the player who waits there sees them.

    Args:
        rows: a court for each.
        hand: of the player; None: unknown.
    """
    from matplotlib.colors import LinearSegmentedColormap, to_hex  # noqa: PLC0415  slow to import

    colours = LinearSegmentedColormap.from_list("shares", (_ALIKE, _MORE))
    chart, step = Chart(_WIDTH, 235.0), 2 * HALF_WIDTH + 0.7
    axes = chart.axes
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set(xlim=(-HALF_WIDTH - 0.2, HALF_WIDTH + 0.2 + step * (len(rows) - 1)), ylim=(-HALF_LENGTH - 0.2, 1.5))
    for number, wait in enumerate(rows):
        middle, name = number * step, words().shots(wait.shot)
        axes.text(middle, 0.3, fill(label(name, 2 * _LINE), _LINE // 2), ha="center", va="bottom", color=INK, fontsize=13)
        axes.plot([middle - HALF_WIDTH, middle + HALF_WIDTH], [0, 0], color=INK, linewidth=3, zorder=4)
        for position, share in enumerate(wait.positions):
            (x0, x1), (y0, y1) = position_box(position)
            x0, x1 = (-x1, -x0) if hand == "left" else (x0, x1)
            colour = to_hex(colours(min(1.0, 2 * share)))
            axes.fill([middle + x for x in (x0, x1, x1, x0)], [y1, y1, y0, y0], facecolor=colour, edgecolor=_DARK, linewidth=0.6)
            at = middle + (x0 + x1) / 2, (y0 + y1) / 2
            axes.text(*at, f"{100 * share:.0f}", ha="center", va="center", color=_DARK, fontsize=14)
    return chart.svg(title)


@styled
def drill(met: int, target: int, hands: tuple[str | None, str | None], title: str) -> Markup:
    """A whole court with the area where the player meets the shuttle, at the bottom, and the target of the answer.

    Args:
        met: area of the player's half, as a right-handed player sees it; -1: the player serves.
        target: area of the other half, as a right-handed receiver sees it.
        hands: of the player and of the receiver; None: unknown.
    """
    met, target = of_hand(met, hands[0]), of_hand(target, hands[1])
    chart = Chart(220.0, 420.0)
    axes = chart.axes
    draw_court(axes)
    axes.grid(visible=False)
    x1, y1 = area_centre(np.array(target))
    axes.fill(*corners(target), facecolor=_MORE, edgecolor=_DARK, zorder=3.5)
    if met < 0:
        x0, y0 = (0.4 if x1 < 0 else -0.4), -SHORT_SERVICE - 0.5
    else:
        x0, y0 = (-float(part) for part in area_centre(np.array(met)))
        axes.fill(*corners(met, incoming=True), facecolor=_LESS, edgecolor=_DARK, zorder=3.5)
        axes.annotate("", (x0, y0), (0.0, 3.5), arrowprops={"arrowstyle": "->", "color": _DARK, "linestyle": "--"}, zorder=6)
    axes.annotate("", (x1, y1), (x0, y0), arrowprops={"arrowstyle": "->", "color": _DARK, "linewidth": 2.5}, zorder=6)
    return chart.svg(title)


@styled
def course(chance: Sequence[float], games: Sequence[int], moments: Sequence[int], names: tuple[str, str], title: str) -> Markup:
    """Probability of winning a match over its rallies.

    Args:
        chance: before each of R rallies and after the last one.
        games: rallies after which a game ended.
        moments: rallies with a dot.
        names: of the players, at the upper and at the lower end.
    """
    chart = Chart(_WIDTH, 220.0)
    axes, at = chart.axes, np.arange(len(chance))
    values = 100 * np.array(chance)
    axes.axhline(50, color=DIM, linewidth=1)
    for end in games:
        axes.axvline(end, color=DIM, linewidth=1, linestyle=(0, (4, 3)))
    axes.fill_between(at, values, 50, where=values >= 50, color=PLAYERS[0], alpha=0.25, linewidth=0, interpolate=True)
    axes.fill_between(at, values, 50, where=values <= 50, color=PLAYERS[1], alpha=0.25, linewidth=0, interpolate=True)
    axes.plot(at, values, color=INK, linewidth=1.6)
    axes.plot([m + 1 for m in moments], [values[m + 1] for m in moments], "o", color=INK, markersize=6)
    axes.set(ylim=(0, 100), xlim=(0, max(1, len(chance) - 1)))
    axes.set_yticks([0, 50, 100], [label(names[1], 20), "50", label(names[0], 20)], color=INK)
    return chart.svg(title)
