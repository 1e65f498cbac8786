"""Pictures of an analysis, drawn with matplotlib: landings on the court, transitions, rankings, rallies."""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from shuttle_marl.analysis.summary import LONGEST, AnalysisError, Summary
from shuttle_marl.analysis.values import PlayerValue
from shuttle_marl.files import replace_file
from shuttle_marl.game.court import (
    AREAS,
    BACK_CUT,
    HALF_LENGTH,
    HALF_WIDTH,
    MIDDLE_CUT,
    N_AREAS,
    SHORT_SERVICE,
    SIDE_CUT,
    WIDTH,
    area_centre,
)
from shuttle_marl.game.stroke import N_SERVES, SHOTS

_FORMATS: Final = (".png", ".svg", ".pdf")
INK: Final = "#0b0f17"
LINE: Final = "#dcebe6"
_MAT: Final = "#127257"
_COLOURS: Final = ("#127257", "#d95f02", "#5b6bb5", "#b5365b")
_MOST_POINTS: Final = 4000
"""About so many landing points of a player are drawn at most."""
_LEAST_SHARE: Final = 3.0
"""Replies rarer than this have no number in a picture of transitions [%]."""
_SHORT: Final = {"cross-court-net-shot": "cross-court\nnet shot", "short-serve": "short serve", "long-serve": "long serve"}


def figure(width: float, height: float) -> Any:
    """An empty figure, in inches.

    Raises:
        ModuleNotFoundError: matplotlib is not installed.
    """
    import matplotlib as mpl  # noqa: PLC0415  an extra
    from matplotlib.figure import Figure  # noqa: PLC0415

    mpl.use("Agg")
    return Figure(figsize=(width, height), layout="constrained")


def check_format(path: Path) -> None:
    """Refuse a file whose suffix is of no known format.

    Raises:
        AnalysisError: it is not.
    """
    if path.suffix not in _FORMATS:
        raise AnalysisError(f"{path}: pictures are written as {', '.join(_FORMATS)}; name the file accordingly")


def save(drawn: Any, path: Path) -> None:
    """Write a figure as PNG, SVG or PDF.

    Raises:
        AnalysisError: the suffix is of no known format.
        FileWriteError: the file cannot be written.
    """
    check_format(path)
    with io.BytesIO() as buffer:
        drawn.savefig(buffer, format=path.suffix[1:], dpi=110)
        replace_file(path, buffer.getvalue())


def colour_map(name: str) -> Any:
    """A colour map of matplotlib, from numbers between 0 and 1 to colours."""
    import matplotlib as mpl  # noqa: PLC0415  an extra

    return mpl.colormaps[name]


def draw_court(axes: Any) -> None:
    """Draw the lines of a whole court in metres, the striker's half below, into matplotlib's axes."""
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set(xlim=(-WIDTH / 2 - 0.3, WIDTH / 2 + 0.3), ylim=(-HALF_LENGTH - 0.3, HALF_LENGTH + 0.3))
    axes.fill([-WIDTH / 2, WIDTH / 2, WIDTH / 2, -WIDTH / 2], np.repeat([-HALF_LENGTH, HALF_LENGTH], 2), color=_MAT, zorder=0)
    line = {"color": LINE, "linewidth": 1.2, "zorder": 3}
    for x in (-WIDTH / 2, -HALF_WIDTH, HALF_WIDTH, WIDTH / 2):
        axes.plot([x, x], [-HALF_LENGTH, HALF_LENGTH], **line)
    for y in (-HALF_LENGTH, -SHORT_SERVICE, SHORT_SERVICE, HALF_LENGTH):
        axes.plot([-WIDTH / 2, WIDTH / 2], [y, y], **line)
    for side in (-1, 1):
        axes.plot([0, 0], [side * SHORT_SERVICE, side * HALF_LENGTH], **line)
    axes.plot([-WIDTH / 2 - 0.1, WIDTH / 2 + 0.1], [0, 0], color=INK, linewidth=3, zorder=4)


def area_box(area: int) -> tuple[float, float, float, float]:
    """Left, bottom, width and height of an area of the opponent's half [m]; its right is the opponent's."""
    xs = (-HALF_WIDTH, -SIDE_CUT, SIDE_CUT, HALF_WIDTH)
    ys = (0.0, MIDDLE_CUT, BACK_CUT, HALF_LENGTH)
    depth, side = divmod(area, 3)
    return xs[side], ys[depth], xs[side + 1] - xs[side], ys[depth + 1] - ys[depth]


def landings(summaries: Mapping[str, Summary], reference: Summary, name: str) -> Any:
    """Areas in which the good strokes of each come down: their share, coloured by the difference from a reference.

    Points are shown where they were marked in matches; within an area a log does not know any.

    Args:
        summaries: whose strokes, by name.
        reference: what they are compared with.
        name: of the reference.
    """
    drawn = figure(3.4 * len(summaries) + 0.6, 6.4)
    axes_of = np.atleast_1d(drawn.subplots(1, len(summaries)))
    differences = {of: 100 * (summary.areas - reference.areas) for of, summary in summaries.items()}
    most = max(5.0, *(float(np.abs(difference).max()) for difference in differences.values()))
    for axes, (of, summary) in zip(axes_of, summaries.items(), strict=True):
        draw_court(axes)
        for area in range(N_AREAS):
            _draw_share(axes, area, 100 * summary.areas[area], differences[of][area], most)
        if summary.marked:
            shown = summary.points[:: max(1, len(summary.points) // _MOST_POINTS)]
            axes.scatter(*shown.T, s=1.5, color=INK, alpha=0.35, linewidths=0, zorder=4)
        axes.text(0, -HALF_LENGTH / 2, f"{of}\nstrikes from here", ha="center", va="center", color="white", fontsize=9, zorder=5)
        axes.set_title(f"{of}: {summary.strokes:,} strokes", fontsize=10)
    scale = _colours_between(-most, most)
    drawn.colorbar(scale, ax=axes_of.tolist(), shrink=0.5, label=f"percentage points more than {name}")
    return drawn


def _draw_share(axes: Any, area: int, share: float, more: float, most: float) -> None:
    """An area, coloured by how many percentage points its share is above the reference."""
    left, bottom, width, height = area_box(area)
    x, y = area_centre(np.array(area))
    xs, ys = (left, left + width, left + width, left), (bottom, bottom, bottom + height, bottom + height)
    axes.fill(xs, ys, facecolor=colour_map("RdBu_r")(0.5 + more / most / 2), edgecolor=INK, linewidth=0.5, zorder=3.5)
    outline = {"boxstyle": "round,pad=0.15", "facecolor": "white", "alpha": 0.75, "edgecolor": "none"}
    axes.text(x, y, f"{share:.0f} %\n{more:+.0f}", ha="center", va="center", color=INK, fontsize=9, bbox=outline, zorder=5)


def _colours_between(low: float, high: float) -> Any:
    """The colours of differences, for a colour bar."""
    from matplotlib.cm import ScalarMappable  # noqa: PLC0415  an extra
    from matplotlib.colors import Normalize  # noqa: PLC0415

    return ScalarMappable(Normalize(low, high), "RdBu_r")


def transitions(summary: Summary, title: str) -> Any:
    """With which shot types a player answers which: a row for each incoming shot, the shares of the replies in it."""
    drawn = figure(8.6, 7.0)
    axes = drawn.subplots()
    count = summary.transitions
    total = count.sum(axis=1)
    come, replies = np.flatnonzero(total), np.flatnonzero(np.arange(len(SHOTS)) >= N_SERVES)
    share = 100 * count[np.ix_(come, replies)] / total[come, None]
    picture = axes.imshow(share, cmap="Greens", vmin=0, vmax=max(40.0, float(share.max(initial=0.0))), aspect="auto")
    for row, column in zip(*np.nonzero(share >= _LEAST_SHARE), strict=True):
        light = share[row, column] > 0.6 * picture.norm.vmax
        axes.text(column, row, f"{share[row, column]:.0f}", ha="center", va="center", fontsize=8, color="white" if light else INK)
    played = 100 * count[:, replies].sum(axis=0) / max(1, total.sum())
    names = [_SHORT.get(shot, shot.replace("-", " ")) for shot in SHOTS]
    axes.set_xticks(
        range(len(replies)),
        [f"{names[k]}\n{part:.0f} %" for k, part in zip(replies, played, strict=True)],
        rotation=40, ha="right", fontsize=8,
    )  # fmt: skip
    met = [f"{names[k].replace(chr(10), ' ')}  {100 * total[k] / max(1, total.sum()):.0f} %" for k in come]
    axes.set_yticks(range(len(come)), met, fontsize=8)
    axes.set(xlabel="reply, and its share of all replies", ylabel="incoming shot, and its share of all that come")
    axes.set_xticks(np.arange(len(replies) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(come) + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=1)
    axes.tick_params(which="both", length=0)
    axes.spines[:].set_visible(False)
    drawn.colorbar(picture, ax=axes, shrink=0.6, label="share of the replies to a shot [%]")
    axes.set_title(title, fontsize=11)
    return drawn


def shot_mix(summaries: Mapping[str, Summary]) -> Any:
    """Share of every shot type, of each side by side; lengths of rallies below."""
    drawn = figure(9.5, 6.6)
    above, below = drawn.subplots(2, 1)
    width = 0.8 / len(summaries)
    at = np.arange(len(SHOTS))
    for i, (name, summary) in enumerate(summaries.items()):
        colour = _COLOURS[i % len(_COLOURS)]
        above.bar(at + (i - (len(summaries) - 1) / 2) * width, 100 * summary.shots, width, label=name, color=colour)
        share = 100 * summary.lengths / max(1, summary.lengths.sum())
        # The first lines are the widest, so that they show behind those drawn over them.
        wide = 1.3 + 2.2 * (len(summaries) - 1 - i)
        label = f"{name}: mean {summary.length:.1f}"
        below.step(np.arange(LONGEST + 1), share, where="mid", color=colour, linewidth=wide, label=label)
    above.set_xticks(at, [_SHORT.get(shot, shot.replace("-", " ")) for shot in SHOTS], rotation=40, ha="right", fontsize=8)
    above.set_ylabel("share of strokes [%]")
    below.set(xlabel="strokes of a rally", ylabel="share of rallies [%]", xlim=(0, 40))
    for axes in (above, below):
        axes.legend(fontsize=8, frameon=False)
        axes.spines[["top", "right"]].set_visible(False)
    return drawn


def ranking(groups: Mapping[str, Sequence[PlayerValue]], title: str) -> Any:
    """Value added of each player with its interval, and the part of it that is decisions; a panel a group."""
    sizes = [len(players) for players in groups.values()]
    drawn = figure(8.8, 1.4 + 0.29 * sum(sizes))
    panels = np.atleast_1d(drawn.subplots(len(groups), 1, sharex=True, height_ratios=sizes))
    extreme = 100 * max(max(abs(p.value), abs(p.decision)) for players in groups.values() for p in players)
    for axes, (group, players) in zip(panels, groups.items(), strict=True):
        y = -np.arange(len(players), dtype=np.float64)
        for offset, colour, label, columns in (
            (0.12, _COLOURS[0], "value added", ("value", "low", "high")),
            (-0.14, _COLOURS[1], "of it, by decisions", ("decision", "decision_low", "decision_high")),
        ):
            mean, low, high = (100 * np.array([getattr(p, name) for p in players]) for name in columns)
            axes.hlines(y + offset, low, high, color=colour, alpha=0.5, linewidth=2)
            axes.plot(mean, y + offset, "o", color=colour, markersize=4, label=label)
        axes.axvline(0, color=INK, linewidth=0.8)
        axes.set(xlim=(-3 * extreme, 3 * extreme), ylim=(y[-1] - 0.7, 0.7))
        axes.set_yticks(y, [f"{p.player}  ({p.matches} matches)" for p in players], fontsize=8)
        axes.set_ylabel(group)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].legend(fontsize=8, frameon=False, loc="lower right")
    panels[-1].set_xlabel("points won by 100 strokes, with 95 % intervals", fontsize=9)
    drawn.suptitle(title, fontsize=11)
    return drawn


def rally(valued: pa.Table, first: int, length: int) -> Any:
    """The server's probability of winning the rally, stroke by stroke, with the strokes named.

    Args:
        valued: what :func:`shuttle_marl.analysis.values.add_values` made.
        first: row of the first stroke.
        length: number of strokes.

    Raises:
        AnalysisError: the values of the rally are not all known.
    """
    rows = valued.slice(first, length).to_pylist()
    wins = [rows[0]["win_before"]]
    wins += [row["win_after"] if row["player"] == rows[0]["player"] else _flipped(row["win_after"]) for row in rows]
    if any(win is None for win in wins):
        raise AnalysisError(f"the rally from row {first} on has strokes whose value is not known; choose another one")
    drawn = figure(10.5, 4.6)
    axes = drawn.subplots()
    axes.axhline(50, color=INK, linewidth=0.6, linestyle=":")
    axes.plot(range(len(wins)), 100 * np.array(wins), color=INK, linewidth=1, zorder=2)
    for i, row in enumerate(rows, start=1):
        seat = int(row["player"] != rows[0]["player"])
        axes.plot(i, 100 * wins[i], "o", color=_COLOURS[seat], zorder=3)
        area = "" if row["area"] is None else f"\n{AREAS[row['area']]}"
        gain = f"{round(100 * row['value_added']):+d}"
        text = f"{_SHORT.get(SHOTS[row['shot']], SHOTS[row['shot']])}{area}\n{gain}"
        offset, across, side = (0.0, 8.0), "center", "bottom"
        if i == len(rows):  # beside its point, because the line comes from above or below
            offset, across, side = (9.0, 0.0), "left", "center"
        elif wins[i] < wins[i - 1]:
            offset, side = (0.0, -8.0), "top"
        axes.annotate(
            text,
            (i, 100 * wins[i]),
            offset,
            textcoords="offset points",
            ha=across,
            va=side,
            fontsize=7,
            color=_COLOURS[seat],
        )
    axes.set(
        ylim=(-12, 112),
        xlim=(-0.5, len(rows) + 1.2),
        xlabel="stroke",
        ylabel=f"probability that {rows[0]['player']} wins the rally [%]",
    )
    axes.set_xticks(range(1, len(rows) + 1))
    ends = "wins" if rows[-1]["value_added"] > 0 else "loses"
    axes.set_title(
        f"{rows[0]['player']} serves against {rows[0]['opponent']}; {rows[-1]['player']} strikes last and {ends}", fontsize=10
    )
    axes.spines[["top", "right"]].set_visible(False)
    return drawn


def _flipped(probability: float | None) -> float | None:
    return None if probability is None else 1 - probability
