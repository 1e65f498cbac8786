"""Charts of the pages as SVG elements, and pictures as files, drawn by Matplotlib: the same arguments give the same bytes.

The content security policy of a page forbids inline styles, so the styles of Matplotlib become attributes, and its colours
variables of the page's style sheet, which has a light and a dark theme.
"""

import contextlib
import io
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any, Final
from xml.etree import ElementTree

import numpy as np
from markupsafe import Markup

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.errors import OptionError, printable
from shuttle_marl.base.files import replace_file
from shuttle_marl.game.court import HALF_LENGTH, HALF_WIDTH, N_AREAS, SHORT_SERVICE, WIDTH, area_box, area_centre, seen_by
from shuttle_marl.game.recovery import position_box

if TYPE_CHECKING:
    from shuttle_marl.reports.waits import Stand, Wait
    from shuttle_marl.reports.words import Words

_COLOURS: Final = ("#0b8f66", "#d0553c", "#3f6fd8", "#b8860b", "#8a56c9", "#1d9aa8", "#c2478f", "#6b7d2c", "#8c6a55", "#5c6b7a")
_INK, _DIM, _LINE, _ACCENT, _SECOND = "#1c2127", "#69727d", "#e3e5e2", "#0b6e4e", "#c8553d"
_PLAYERS: Final = ("#1f5fa8", "#b8500a")  # of two players: blue and orange, which all readers tell apart
_THEME: Final = {_INK: "--ink", _DIM: "--dim", _LINE: "--line", _ACCENT: "--accent", _SECOND: "--second"} | dict(
    zip(_PLAYERS, ("--first", "--other"), strict=True)
)
_MORE, _LESS, _ALIKE = "#e8a15c", "#7fb0e0", "#f4f4f0"  # of larger and smaller shares, which all readers tell apart
INK: Final = "#0b0f17"
_MAT, _MARKING, _DARK = "#127257", "#dcebe6", "#16191c"
_WIDE, _NARROW = 1100.0, 460.0  # widths of charts [px = points of Matplotlib]; the second fits a telephone
_LONGEST_NAME: Final = 26
_LETTERS: Final = 30
_FORMATS: Final = (".png", ".svg", ".pdf")
_SVG, _XLINK = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"
_STYLE: Final[dict[str, Any]] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "shuttle_marl",
    "font.size": 11,
    "axes.xmargin": 0.02,
    **dict.fromkeys(("text.color", "legend.labelcolor"), _INK),
    **dict.fromkeys(("axes.edgecolor", "grid.color", "xtick.color", "ytick.color"), _LINE),
    **dict.fromkeys(("axes.labelcolor", "xtick.labelcolor", "ytick.labelcolor"), _DIM),
    **dict.fromkeys(("axes.grid", "axes.axisbelow", "savefig.transparent"), True),
    **dict.fromkeys(("text.parse_math", "axes.spines.top", "axes.spines.right", "legend.frameon"), False),
}


@contextlib.contextmanager
def _styled() -> Iterator[None]:
    """Draw in the style of the page, whatever the user's settings of Matplotlib are."""
    from matplotlib import style  # noqa: PLC0415  slow to import

    with style.context(["default", _STYLE]):
        yield


def figure(width: float, height: float) -> Any:
    """An empty figure of Matplotlib; width and height in inches."""
    from matplotlib.figure import Figure  # noqa: PLC0415  slow to import

    return Figure(figsize=(width, height), layout="constrained")


class Chart:
    """A figure of matplotlib with the tooltips of its elements; ``width``, ``height``: size [px]."""

    def __init__(self, width: float, height: float) -> None:
        self._tooltips: dict[str, Sequence[str]] = {}
        self.figure = figure(width / 72, height / 72)
        self.axes: Any = self.figure.add_subplot()

    def tooltips(self, *texts: str) -> str:
        """Identifier (``gid``) for an artist whose elements have these tooltips, in the order in which they are drawn."""
        self._tooltips[gid := f"tooltips-{len(self._tooltips)}"] = texts
        return gid

    def svg(self, title: str) -> Markup:
        """The figure as an SVG element; ``title``: description for screen readers."""
        buffer = io.BytesIO()
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Glyph")  # a browser has fonts for names in any script
            self.figure.savefig(buffer, format="svg", metadata={"Date": None})
        root = ElementTree.fromstring(buffer.getvalue())
        for parent in [*root.iter()]:
            for child in [child for child in parent if _tag(child) in ("metadata", "style")]:
                parent.remove(child)
            for part, text in zip(_drawn(parent), self._tooltips.get(parent.get("id", ""), ()), strict=False):
                ElementTree.SubElement(part, f"{{{_SVG}}}title").text = printable(text)
            _without_style(parent)
        width, height = (str(root.get(side)).removesuffix("pt") for side in ("width", "height"))
        root.attrib.update(
            {"width": width, "height": height, "role": "img", "aria-label": printable(title), "stroke-linejoin": "round"}
        )
        for prefix, namespace in (("", _SVG), ("xlink", _XLINK)):
            ElementTree.register_namespace(prefix, namespace)
        return Markup(ElementTree.tostring(root, encoding="unicode"))


def _tag(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2]


def _drawn(group: ElementTree.Element) -> list[ElementTree.Element]:
    shapes = []
    for child in group:
        if _tag(child) == "g":
            shapes += _drawn(child)
        elif _tag(child) in ("path", "use"):
            shapes.append(child)
    return shapes


def _without_style(element: ElementTree.Element) -> None:
    """Turn the style of an element into attributes, its colours into variables, and drop fonts and needless identifiers."""
    if _tag(element) == "g":
        element.attrib.pop("id", None)
    if "d" in element.attrib:
        element.set("d", " ".join(element.attrib["d"].split()))
    for declaration in filter(None, element.attrib.pop("style", "").split(";")):
        name, value = (part.strip() for part in declaration.split(":", 1))
        if name != "font-family":
            element.set(name, f"var({_THEME[value]})" if value in _THEME else value)


def label(name: str, longest: int = _LONGEST_NAME) -> str:
    """A printable name, shortened."""
    name = printable(name)
    return name if len(name) <= longest else f"{name[: longest - 1]}…"


def _shades(*colours: str) -> Callable[[float], str]:
    from matplotlib.colors import LinearSegmentedColormap, to_hex  # noqa: PLC0415  slow to import

    mixed = LinearSegmentedColormap.from_list("shades", colours)
    return lambda share: to_hex(mixed(share))


def _write(axes: Any, x: float, y: float, text: str, size: float, colour: str = _DARK, **style: Any) -> None:
    axes.text(x, y, text, **{"ha": "center", "va": "center", "color": colour, "fontsize": size} | style)


def draw_court(axes: Any) -> None:
    """Draw the lines of a whole court [m] into axes, with the striker's half at the bottom."""
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set(xlim=(-WIDTH / 2 - 0.3, WIDTH / 2 + 0.3), ylim=(-HALF_LENGTH - 0.3, HALF_LENGTH + 0.3))
    axes.fill([-WIDTH / 2, WIDTH / 2, WIDTH / 2, -WIDTH / 2], np.repeat([-HALF_LENGTH, HALF_LENGTH], 2), color=_MAT, zorder=0)
    line = {"color": _MARKING, "linewidth": 1.2, "zorder": 3}
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


@_styled()
def curves(
    lines: Mapping[str, Sequence[tuple[float, float]]], across: str, up: str, *, logarithmic: bool = False
) -> Markup | None:
    """Curves by name, with a legend; None without any point; ``lines``: points of each, from left to right; an empty one is not
    drawn, and keeps its colour for other charts; ``logarithmic``: whether the vertical axis is; points that are not above 0 are
    left out then."""
    from matplotlib.ticker import LogLocator, NullLocator  # noqa: PLC0415  slow to import

    shown = {name: [(x, y) for x, y in points if y > 0 or not logarithmic] for name, points in lines.items()}
    if not any(shown.values()):
        return None
    chart = Chart(_WIDE, 440.0 + 6 * len(shown))
    for i, (name, points) in enumerate(shown.items()):
        if points:
            colour = _COLOURS[i % len(_COLOURS)]
            # A name that begins with an underscore has no legend in matplotlib, unless its label is set afterwards.
            (line,) = chart.axes.plot(*zip(*points, strict=True), color=colour, linewidth=1.8, gid=chart.tooltips(name))
            line.set_marker("o" if len(points) == 1 else "")  # a line of one point is invisible
            line.set_label(f"\N{ZERO WIDTH SPACE}{label(name)}")
    chart.axes.set(xlabel=across, ylabel=up, yscale="log" if logarithmic else "linear")
    chart.axes.xaxis.set_major_formatter("{x:,.10g}")
    if logarithmic:
        chart.axes.yaxis.set(major_locator=LogLocator(subs=(1, 2, 5)), minor_locator=NullLocator())
        chart.axes.yaxis.set_major_formatter("{x:g}")
    chart.figure.legend(loc="outside lower center", ncols=4)
    return chart.svg(f"{up} against {across}")


def _words() -> "Words":
    from shuttle_marl.reports.words import words  # noqa: PLC0415  slow to import

    return words()


@_styled()
def court(shares: F64, reference: F64, title: str, hand: str | None, clear: Sequence[int] = ()) -> Markup:
    """Draw where strokes land.

    Args:
        shares, reference: ``[9]`` shares of the target areas, as a right-handed receiver sees them, and those to compare with.
        hand: of the receiver; None: unknown.
        clear: areas with a frame.
    """
    chart, say = Chart(330.0, 330.0), _words()
    axes, colours, difference = chart.axes, _shades(_LESS, _ALIKE, _MORE), 100 * (shares - reference)
    draw_court(axes)
    axes.grid(visible=False)
    most = max(4.0, float(np.abs(difference).max()))
    for area in range(N_AREAS):
        place, marked = of_hand(area, hand), area in clear
        width, level, weight = (3.0, 3.6, "bold") if marked else (0.6, 3.5, "normal")
        shade = colours(0.5 + difference[area] / most / 2)
        axes.fill(*corners(place), facecolor=shade, edgecolor=_DARK, linewidth=width, zorder=level)
        x, y = area_centre(np.array(place))
        text = f"{100 * shares[area]:.0f}\n({round(float(difference[area])):+d})"
        _write(axes, x, y, text, 12, zorder=5, weight=weight)
    axes.set_ylim(-1.2, HALF_LENGTH + 0.3)
    described = say.listed(f"{say.area(area, 'receiver')} {100 * shares[area]:.0f}" for area in range(N_AREAS))
    return chart.svg(f"{title}: {described}")


@_styled()
def waits(rows: Sequence["Wait | Stand"], title: str, hand: str | None) -> Markup:
    """Half courts with the shares of the nine positions, the net at the top, as the player who waits there sees them; ``rows``: a
    court for each; ``hand``: of the player (None: unknown)."""
    chart, colours, step = Chart(_NARROW, 235.0), _shades(_ALIKE, _MORE), 2 * HALF_WIDTH + 0.7
    axes = chart.axes
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set(xlim=(-HALF_WIDTH - 0.2, HALF_WIDTH + 0.2 + step * (len(rows) - 1)), ylim=(-HALF_LENGTH - 0.2, 1.5))
    for number, wait in enumerate(rows):
        middle, name = number * step, _words().shots(wait.shot)
        _write(axes, middle, 0.3, fill(label(name, 2 * _LETTERS), _LETTERS // 2), 13, _INK, va="bottom")
        axes.plot([middle - HALF_WIDTH, middle + HALF_WIDTH], [0, 0], color=_INK, linewidth=3, zorder=4)
        for position, share in enumerate(wait.positions):
            (x0, x1), (y0, y1) = position_box(position)
            x0, x1 = (-x1, -x0) if hand == "left" else (x0, x1)
            shade, xs = colours(min(1.0, 2 * share)), [middle + x for x in (x0, x1, x1, x0)]
            axes.fill(xs, [y1, y1, y0, y0], facecolor=shade, edgecolor=_DARK, linewidth=0.6)
            _write(axes, middle + (x0 + x1) / 2, (y0 + y1) / 2, f"{100 * share:.0f}", 14)
    return chart.svg(title)


@_styled()
def drill(met: int, target: int, hands: tuple[str | None, str | None], title: str) -> Markup:
    """A whole court with the area where the player meets the shuttle, at the bottom, and the target of the answer; ``met``: area
    of the player's half, as a right-handed player sees it (-1: the player serves); ``target``: area of the other half, as a
    right-handed receiver sees it; ``hands``: of the player and of the receiver (None: unknown)."""
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


@_styled()
def course(chance: Sequence[float], games: Sequence[int], moments: Sequence[int], names: tuple[str, str], title: str) -> Markup:
    """Probability of winning a match over its rallies.

    Args:
        chance: before each of R rallies and after the last one.
        games: rallies after which a game ended.
        moments: rallies with a dot.
        names: of the players, at the upper and at the lower end.
    """
    chart = Chart(_NARROW, 220.0)
    axes, at = chart.axes, np.arange(len(chance))
    values = 100 * np.array(chance)
    axes.axhline(50, color=_DIM, linewidth=1)
    for end in games:
        axes.axvline(end, color=_DIM, linewidth=1, linestyle=(0, (4, 3)))
    axes.fill_between(at, values, 50, where=values >= 50, color=_PLAYERS[0], alpha=0.25, linewidth=0, interpolate=True)
    axes.fill_between(at, values, 50, where=values <= 50, color=_PLAYERS[1], alpha=0.25, linewidth=0, interpolate=True)
    axes.plot(at, values, color=_INK, linewidth=1.6)
    axes.plot([m + 1 for m in moments], [values[m + 1] for m in moments], "o", color=_INK, markersize=6)
    axes.set(ylim=(0, 100), xlim=(0, max(1, len(chance) - 1)))
    axes.set_yticks([0, 50, 100], [label(names[1], 20), "50", label(names[0], 20)], color=_INK)
    return chart.svg(title)


def check_format(path: Path) -> None:
    """Check the suffix of a picture file. Raises OptionError: it is not a supported format."""
    if path.suffix not in _FORMATS:
        raise OptionError(f"{path}: pictures are written as {', '.join(_FORMATS)}; use one of these suffixes")


def save(drawn: Any, path: Path) -> None:
    """Write a figure as PNG, SVG or PDF. Raises OptionError: the suffix is not a supported format. Raises FileWriteError: the
    file cannot be written."""
    check_format(path)
    with io.BytesIO() as buffer:
        drawn.savefig(buffer, format=path.suffix[1:], dpi=110)
        replace_file(path, buffer.getvalue())


@_styled()
def tradeoff(frontier: Sequence[tuple[float, float, float]], methods: Mapping[str, Sequence[tuple[int, float, float]]]) -> Any:
    """Score against exploitability: an exact frontier, and every method at each budget.

    Points far below the frontier are drawn at the lower edge, with their score in the legend.

    Args:
        frontier: restriction, exploitability and score of its points.
        methods: by name, budget (0: none), exploitability and score of its points.
    """
    drawn = figure(10.5, 6.5)
    axes = drawn.add_subplot()
    restriction, risk, score = zip(*frontier, strict=True)
    axes.plot(risk, score, color=_INK, linewidth=2, label="exact frontier, by restriction")
    for p, x, y in zip(restriction, risk, score, strict=True):
        axes.annotate(f"{p:g}", (x, y), (-4, 6), textcoords="offset points", ha="right", fontsize=9)
    least = min(score) - (max(score) - min(score))
    budgets = sorted({budget for points in methods.values() for budget, _, _ in points if budget})
    for i, (name, points) in enumerate(methods.items()):
        style = {"color": _COLOURS[i % len(_COLOURS)], "marker": "osD^vPX*"[i % 8]}
        low = [f"{y:.1f}" for _, _, y in points if y < least]
        places = [(x, max(y, least)) for _, x, y in points]
        axes.plot(*zip(*places, strict=True), linewidth=0.8, label=label(name) + (f" ({', '.join(low)})" if low else ""), **style)
        for place, (budget, _, _) in zip(places, points, strict=True):
            axes.plot(*place, markersize=6 + (4 * budgets.index(budget) if budget else 0), clip_on=False, **style)
    axes.set(xlabel="exploitability [points]", ylabel="score: rallies won above perfect play [points]", ylim=(least, None))
    sizes = "\n".join(["strokes, by size:", *(f"{budget:,}" for budget in budgets)]) if len(budgets) > 1 else None
    drawn.legend(loc="outside right upper", fontsize=9, title=sizes, title_fontsize=9, alignment="left")
    return drawn
