"""Pictures drawn with matplotlib: landings on the court, replies, shot mix, and the best replies of the solved game."""

import dataclasses
import difflib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from shuttle_marl.analysis.summary import LONGEST, AnalysisError, Summary
from shuttle_marl.analysis.worth import Worth
from shuttle_marl.base.arrays import F64, Intp
from shuttle_marl.base.files import replace_file
from shuttle_marl.exact.fixed_point import ExactError
from shuttle_marl.exact.optimal import Solution
from shuttle_marl.game.court import (
    AREA_WORDS,
    HALF_LENGTH,
    HALF_WIDTH,
    HANDS,
    N_AREAS,
    SHORT_SERVICE,
    WIDTH,
    area_box,
    area_centre,
    seen_by,
)
from shuttle_marl.game.shipped import real_strokes
from shuttle_marl.game.stroke import HEIGHTS, N_SERVES, SHOTS, TECHNIQUES, UnknownStrokeError
from shuttle_marl.game.tables import Game
from shuttle_marl.pages.languages import Texts

_FORMATS: Final = (".png", ".svg", ".pdf")
INK: Final = "#0b0f17"
LINE: Final = "#dcebe6"
COLOURS: Final = ("#127257", "#d95f02", "#5b6bb5", "#b5365b")
SHORT_NAMES: Final = {"cross-court-net-shot": "cross-court\nnet shot", "short-serve": "short serve", "long-serve": "long serve"}
_MAT: Final = "#127257"
_MOST_POINTS: Final = 4000
"""Approximate largest number of landing points drawn for a player."""
_LEAST_SHARE: Final = 3.0
"""Smallest share of a reply that is printed in a picture of transitions [%]."""
_SPREAD: Final = 0.35
"""Range of the colours: probabilities of winning from 0.15 to 0.85."""


def figure(width: float, height: float) -> Any:
    """An empty figure; width and height in inches."""
    import matplotlib as mpl  # noqa: PLC0415  slow to import
    from matplotlib.figure import Figure  # noqa: PLC0415

    mpl.use("Agg")
    return Figure(figsize=(width, height), layout="constrained")


def check_format(path: Path) -> None:
    """Check the suffix of a picture file.

    Raises:
        AnalysisError: it is not a supported format.
    """
    if path.suffix not in _FORMATS:
        raise AnalysisError(f"{path}: pictures are written as {', '.join(_FORMATS)}; use one of these suffixes")


def save(drawn: Any, path: Path) -> None:
    """Write a figure as PNG, SVG or PDF.

    Raises:
        AnalysisError: the suffix is not a supported format.
        FileWriteError: the file cannot be written.
    """
    check_format(path)
    with io.BytesIO() as buffer:
        drawn.savefig(buffer, format=path.suffix[1:], dpi=110)
        replace_file(path, buffer.getvalue())


def colour_map(name: str) -> Any:
    """A colour map of matplotlib: a function from [0, 1] to colours."""
    import matplotlib as mpl  # noqa: PLC0415  slow to import

    return mpl.colormaps[name]


def draw_court(axes: Any) -> None:
    """Draw the lines of a whole court [m] into axes, with the striker's half at the bottom."""
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


def corners(area: int, *, incoming: bool = False) -> tuple[list[float], list[float]]:
    """Corners of an area of the opponent's half [m], x and y; for an incoming stroke the area lies in the striker's half."""
    (x0, x1), (y0, y1) = area_box(area)
    sign = -1 if incoming else 1
    return [sign * x0, sign * x1, sign * x1, sign * x0], [sign * y0, sign * y0, sign * y1, sign * y1]


def of_hand(area: int, hand: str | None) -> int:
    """An area named as a right-handed player sees it, as a player of a hand does (None: unknown, as right-handed); -1 stays."""
    return area if area < 0 else seen_by(hand, area)


def _sides(hand: str) -> str:
    """Label of the forehand and the backhand side of a receiver of a hand; the striker is at the bottom."""
    return Texts("en")(f"sides.{hand}")


def landings(summaries: Mapping[str, Summary], reference: Summary, name: str) -> Any:
    """Share of good strokes that land in each area, coloured by the difference from a reference.

    Landing points are drawn for annotated matches; a log holds only areas. All receivers are drawn as right-handed.

    Args:
        reference: summary that they are compared with.
    """
    from matplotlib.cm import ScalarMappable  # noqa: PLC0415  slow to import
    from matplotlib.colors import Normalize  # noqa: PLC0415

    drawn = figure(3.4 * len(summaries) + 0.6, 6.4)
    axes_of = np.atleast_1d(drawn.subplots(1, len(summaries)))
    differences = {player: 100 * (summary.areas - reference.areas) for player, summary in summaries.items()}
    most = max(5.0, *(float(np.abs(difference).max()) for difference in differences.values()))
    for axes, (player, summary) in zip(axes_of, summaries.items(), strict=True):
        draw_court(axes)
        for area in range(N_AREAS):
            _draw_share(axes, area, 100 * summary.areas[area], differences[player][area], most)
        if summary.marked:
            points = summary.points[:: max(1, len(summary.points) // _MOST_POINTS)]
            axes.scatter(*points.T, s=1.5, color=INK, alpha=0.35, linewidths=0, zorder=4)
        axes.text(
            0, -HALF_LENGTH / 2, f"{player}\nstrikes from here", ha="center", va="center", color="white", fontsize=9, zorder=5
        )
        axes.set_title(f"{player}: {summary.strokes:,} strokes", fontsize=10)
    drawn.supxlabel(_sides(HANDS[0]), fontsize=9)
    drawn.colorbar(
        ScalarMappable(Normalize(-most, most), "RdBu_r"),
        ax=axes_of.tolist(),
        shrink=0.5,
        label=f"percentage points more than {name}",
    )
    return drawn


def _draw_share(axes: Any, area: int, share: float, more: float, most: float) -> None:
    """Draw an area, coloured by its difference from the reference in percentage points."""
    x, y = area_centre(np.array(area))
    axes.fill(*corners(area), facecolor=colour_map("RdBu_r")(0.5 + more / most / 2), edgecolor=INK, linewidth=0.5, zorder=3.5)
    outline = {"boxstyle": "round,pad=0.15", "facecolor": "white", "alpha": 0.75, "edgecolor": "none"}
    axes.text(x, y, f"{share:.0f} %\n{more:+.0f}", ha="center", va="center", color=INK, fontsize=9, bbox=outline, zorder=5)


def transitions(summary: Summary, title: str) -> Any:
    """Replies of a player: one row per incoming shot type, with the share of each reply."""
    drawn = figure(8.6, 7.0)
    axes = drawn.subplots()
    count = summary.transitions
    total = count.sum(axis=1)
    rows, replies = np.flatnonzero(total), np.flatnonzero(np.arange(len(SHOTS)) >= N_SERVES)
    share = 100 * count[np.ix_(rows, replies)] / total[rows, None]
    picture = axes.imshow(share, cmap="Greens", vmin=0, vmax=max(40.0, float(share.max(initial=0.0))), aspect="auto")
    for row, column in zip(*np.nonzero(share >= _LEAST_SHARE), strict=True):
        light = share[row, column] > 0.6 * picture.norm.vmax
        axes.text(column, row, f"{share[row, column]:.0f}", ha="center", va="center", fontsize=8, color="white" if light else INK)
    played = 100 * count[:, replies].sum(axis=0) / max(1, total.sum())
    names = [SHORT_NAMES.get(shot, shot.replace("-", " ")) for shot in SHOTS]
    axes.set_xticks(
        range(len(replies)),
        [f"{names[k]}\n{part:.0f} %" for k, part in zip(replies, played, strict=True)],
        rotation=40, ha="right", fontsize=8,
    )  # fmt: skip
    incoming = [f"{names[k].replace(chr(10), ' ')}  {100 * total[k] / max(1, total.sum()):.0f} %" for k in rows]
    axes.set_yticks(range(len(rows)), incoming, fontsize=8)
    axes.set(xlabel="reply, and its share of all replies", ylabel="incoming shot, and its share of all that come")
    axes.set_xticks(np.arange(len(replies) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(rows) + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=1)
    axes.tick_params(which="both", length=0)
    axes.spines[:].set_visible(False)
    drawn.colorbar(picture, ax=axes, shrink=0.6, label="share of the replies to a shot [%]")
    axes.set_title(title, fontsize=11)
    return drawn


def shot_mix(summaries: Mapping[str, Summary]) -> Any:
    """Shares of shot types side by side, and the distributions of rally lengths below."""
    drawn = figure(9.5, 6.6)
    above, below = drawn.subplots(2, 1)
    width = 0.8 / len(summaries)
    at = np.arange(len(SHOTS))
    for i, (name, summary) in enumerate(summaries.items()):
        colour = COLOURS[i % len(COLOURS)]
        above.bar(at + (i - (len(summaries) - 1) / 2) * width, 100 * summary.shots, width, label=name, color=colour)
        share = 100 * summary.lengths / max(1, summary.lengths.sum())
        # The first lines are the widest, so that they stay visible behind later ones.
        wide = 1.3 + 2.2 * (len(summaries) - 1 - i)
        label = f"{name}: mean {summary.length:.1f}"
        below.step(np.arange(LONGEST + 1), share, where="mid", color=colour, linewidth=wide, label=label)
    above.set_xticks(at, [SHORT_NAMES.get(shot, shot.replace("-", " ")) for shot in SHOTS], rotation=40, ha="right", fontsize=8)
    above.set_ylabel("share of strokes [%]")
    below.set(xlabel="strokes of a rally", ylabel="share of rallies [%]", xlim=(0, 40))
    for axes in (above, below):
        axes.legend(fontsize=8, frameon=False)
        axes.spines[["top", "right"]].set_visible(False)
    return drawn


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Aim:
    """The best replies to an incoming stroke from one contact, by target area.

    Attributes:
        win: ``[9]`` probability of winning with the best reply aimed at each area, named as in the game; NaN where no reply is
            legal.
        stroke: ``[9]`` catalogue index of that reply; -1 where no reply is legal.
        support: ``[9]`` real strokes behind that reply (:func:`shuttle_marl.game.shipped.real_strokes`); NaN where no reply is
            legal, and in games that belong to no model.
        best: the largest of them.
    """

    win: F64
    stroke: Intp
    support: F64
    best: float


def aims(solution: Solution, incoming: int, own: int | None = None) -> tuple[Aim, Aim]:
    """The best replies to a stroke from below and from above the net, under perfect play from then on.

    Args:
        incoming: catalogue index of the incoming stroke.
        own: the striker's own last stroke; None: mean over all possible ones (a serve has none).

    Raises:
        ExactError: the incoming stroke is not legal after the striker's own.
    """
    game = solution.games[0]
    edges = edges_of(game, incoming, own)
    # Rested players, none of them hurried: states of the first block.
    worth = Worth(game, solution.value, 0, solution.policy[1])
    below, above = (_aim(game, worth, 4 * edges + contact) for contact in (0, 1))
    return below, above


def edges_of(game: Game, incoming: int, own: int | None = None) -> Intp:
    """Edges of an incoming stroke: after the striker's own last stroke, or after any (None).

    Raises:
        ExactError: the incoming stroke is not legal after the striker's own.
    """
    edges = np.flatnonzero(game.edge_incoming == incoming)
    if own is not None:
        edges = edges[game.edge_own[edges] == own]
    if not len(edges):
        after = "" if own is None else f" after one's own {game.catalogue.names[own]}"
        raise ExactError(f"{game.catalogue.names[incoming]} never comes in{after}: it is no legal reply there")
    return edges


def _aim(game: Game, worth: Worth, states: Intp) -> Aim:
    # Legal replies and their order depend on the incoming stroke and the contact alone, so the first state has them all.
    strokes = game.legal_strokes(int(states[0]))
    mean = np.mean([worth.win(game.pairs_of(s)) for s in states.tolist()], axis=0)
    win, chosen, behind = np.full(N_AREAS, np.nan), np.full(N_AREAS, -1, dtype=np.intp), np.full(N_AREAS, np.nan)
    real = real_strokes(game)
    support = np.full(len(strokes), np.nan) if real is None else real[game.base_pair_edge[game.pairs_of(int(states[0]))]]
    for stroke, value, count in zip(strokes, mean, support, strict=True):
        area = game.catalogue.area[stroke]
        if not value <= win[area]:
            win[area], chosen[area], behind[area] = value, stroke, count
    return Aim(win=win, stroke=chosen, support=behind, best=float(mean.max()))


def stroke_index(game: Game, name: str) -> int:
    """Catalogue index of a stroke name.

    Raises:
        ExactError: unknown name; the message lists similar ones.
    """
    try:
        return game.catalogue.index(name)
    except UnknownStrokeError as error:
        close = difflib.get_close_matches(name, game.catalogue.names, n=4, cutoff=0.4)
        hint = f"; did you mean {', '.join(close)}?" if close else ""
        raise ExactError(f"{error}{hint}") from error


def best_replies(solution: Solution, incoming: int, own: int | None = None) -> Any:
    """Probability of winning with the best reply to each target area (:func:`aims`), with the striker's half at the bottom.

    The players of the game of a pair have their own hands.

    Raises:
        ExactError: the incoming stroke is not legal after the striker's own.
    """
    drawn = figure(9.6, 8.2)
    game = solution.games[0]
    people = None if game.whole is None else game.whole.people
    hands = (HANDS[0], HANDS[0]) if people is None else people.hands
    colours = colour_map("RdYlGn")
    for axes, contact, aim in zip(drawn.subplots(1, 2), HEIGHTS, aims(solution, incoming, own), strict=True):
        draw_court(axes)
        area = int(game.catalogue.area[incoming])
        xs, ys = corners(of_hand(area, hands[0]), incoming=True)
        axes.fill(xs, ys, facecolor=LINE, alpha=0.9, zorder=3.5)
        place = {"x": (xs[0] + xs[1]) / 2, "y": (ys[0] + ys[2]) / 2, "ha": "center", "va": "center"}
        met = AREA_WORDS[area].replace(" ", "\n")
        axes.text(**place, s=f"incoming\n{met}", fontsize=7.5, color=INK, zorder=5)
        for area in range(N_AREAS):
            _draw_area(axes, game, aim, area, of_hand(area, hands[1]), colours)
        axes.set_title(f"shuttle {contact} the net: wins {_percent(aim.best)}", fontsize=11)
    names = game.catalogue.names
    if own is not None:
        before = f" after one's own {names[own]}"
    else:
        before = "" if game.catalogue.is_serve[incoming] else ", mean over one's own last strokes"
    drawn.suptitle(f"Reply to {names[incoming]}{before}", fontsize=12)
    drawn.supxlabel(_sides(hands[1]), fontsize=9)
    return drawn


def _percent(win: float) -> str:
    return f"{100 * win:.1f} %"


def _draw_area(axes: Any, game: Game, aim: Aim, area: int, place: int, colours: Any) -> None:
    """Draw the best reply to an area, which lies at a place as the receiver sees it."""
    box = corners(place)
    x, y = area_centre(np.array(place))
    if aim.stroke[area] < 0:
        axes.fill(*box, facecolor="none", edgecolor=LINE, hatch="//", alpha=0.5, zorder=3.5)
        return
    win = float(aim.win[area])
    best = win >= aim.best
    axes.fill(
        *box,
        facecolor=colours(np.clip(0.5 + (win - 0.5) / _SPREAD / 2, 0, 1)),
        edgecolor=INK if best else LINE,
        linewidth=3 if best else 0.8,
        zorder=3.6 if best else 3.5,
    )
    stroke = aim.stroke[area]
    shot = SHOTS[game.catalogue.shot[stroke]].replace("cross-court-net-shot", "cross-court\nnet-shot")
    text = f"{_percent(win)}\n{shot}\n{TECHNIQUES[game.catalogue.technique[stroke]]}"
    if np.isfinite(aim.support[area]):
        text += f"\nn = {aim.support[area]:.0f}"
    axes.text(x, y, text, ha="center", va="center", fontsize=7.5, color=INK, weight="bold" if best else None, zorder=5)
