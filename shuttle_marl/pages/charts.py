"""Charts as SVG elements of an HTML page, drawn by matplotlib: the same arguments give the same bytes.

The content security policy of a page forbids inline styles, so the styles of matplotlib become attributes, and its colours
variables of the page's style sheet, which has a light and a dark theme.
"""

import functools
import io
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, ParamSpec, TypeVar
from xml.etree import ElementTree

import numpy as np
from markupsafe import Markup

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.errors import printable

_COLOURS: Final = ("#0b8f66", "#d0553c", "#3f6fd8", "#b8860b", "#8a56c9", "#1d9aa8", "#c2478f", "#6b7d2c", "#8c6a55", "#5c6b7a")
INK, DIM, _LINE, _ACCENT, _SECOND = "#1c2127", "#69727d", "#e3e5e2", "#0b6e4e", "#c8553d"
PLAYERS: Final = ("#1f5fa8", "#b8500a")
"""Colours of two players, blue and orange, which all readers tell apart."""
_THEME: Final = {INK: "--ink", DIM: "--dim", _LINE: "--line", _ACCENT: "--accent", _SECOND: "--second"} | dict(
    zip(PLAYERS, ("--first", "--other"), strict=True)
)
"""Colours that follow the theme of the page, and their variables."""
_LOST_TO_WON: Final = ("#ba4830", "#f7f6f0", "#0b6e4f")
_WIDTH: Final = 1100.0
"""Width of a chart [px]; a point of matplotlib is drawn as one pixel."""
_LONGEST_NAME: Final = 26
_SMALLEST_LABELLED: Final = 30.0
"""Least size of a cell that shows its number [px]."""
_SVG, _XLINK = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"
_STYLE: Final = {
    "svg.fonttype": "none",
    "svg.hashsalt": "shuttle_marl",
    "text.parse_math": False,
    "font.size": 11,
    "text.color": INK,
    "axes.edgecolor": _LINE,
    "axes.labelcolor": DIM,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.xmargin": 0.02,
    "grid.color": _LINE,
    "xtick.color": _LINE,
    "ytick.color": _LINE,
    "xtick.labelcolor": DIM,
    "ytick.labelcolor": DIM,
    "legend.frameon": False,
    "legend.labelcolor": INK,
    "savefig.transparent": True,
}


P = ParamSpec("P")
T = TypeVar("T")


def styled(draw: Callable[P, T]) -> Callable[P, T]:
    """Draw in the style of the page, whatever the user's settings of matplotlib are."""

    @functools.wraps(draw)
    def styled(*args: P.args, **kwargs: P.kwargs) -> T:
        from matplotlib import style  # noqa: PLC0415  slow to import

        with style.context(["default", _STYLE]):
            return draw(*args, **kwargs)

    return styled


class Chart:
    """A figure of matplotlib with the tooltips of its elements.

    Args:
        width, height: size [px].
        projection: of its axes: None for Cartesian coordinates, or ``polar``.
    """

    def __init__(self, width: float, height: float, projection: str | None = None) -> None:
        from matplotlib.figure import Figure  # noqa: PLC0415  slow to import

        self._tooltips: dict[str, Sequence[str]] = {}
        self.figure: Any = Figure(figsize=(width / 72, height / 72), layout="constrained")
        self.axes: Any = self.figure.add_subplot(projection=projection)

    def tooltips(self, *texts: str) -> str:
        """Identifier (``gid``) for an artist whose elements have these tooltips, in the order in which they are drawn."""
        self._tooltips[gid := f"tooltips-{len(self._tooltips)}"] = texts
        return gid

    def svg(self, title: str) -> Markup:
        """The figure as an SVG element.

        Args:
            title: description for screen readers.
        """
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
    """The shapes in a group, without those that it only defines."""
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


@styled
def forest(rows: Sequence[tuple[str, float, float, float, float]], unit: str) -> Markup:
    """Estimates with intervals, one below the other.

    Args:
        rows: name, estimate, lower and upper end of its interval, exact value; NaN if unknown.
    """
    chart = Chart(_WIDTH, 22.0 * len(rows) + 34)
    axes = chart.axes
    for y, (name, value, low, high, exact) in enumerate(rows):
        if not math.isnan(value):
            about = f"{name}: {value:+.0f} {unit}, 95 % {low:+.0f} to {high:+.0f}"
            axes.plot([low, high], [y, y], color=_ACCENT, linewidth=2, gid=chart.tooltips(about))
            axes.plot(value, y, "o", color=_ACCENT, markersize=7, gid=chart.tooltips(about))
        if not math.isnan(exact):
            about = chart.tooltips(f"{name}: exactly {exact:+.0f} {unit}")
            axes.plot(exact, y, "D", color="none", markeredgecolor=_SECOND, markeredgewidth=1.8, markersize=8, gid=about)
    axes.set_yticks(range(len(rows)), [label(name) for name, *_ in rows], color=INK)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)
    axes.xaxis.set_major_formatter("{x:+g}")
    return chart.svg("Ratings with 95 % intervals")


@styled
def heat_map(names: Sequence[str], win: F64) -> Markup:
    """Payoffs of all pairs.

    Args:
        names: N rows and columns.
        win: ``[N, N]`` probability that the row wins against the column, NaN if unknown; the diagonal is not shown.
    """
    from matplotlib.collections import PatchCollection  # noqa: PLC0415  slow to import
    from matplotlib.colors import LinearSegmentedColormap, to_hex  # noqa: PLC0415
    from matplotlib.patches import Rectangle  # noqa: PLC0415

    n = len(names)
    size = 36.0 if n <= 24 else max(8.0, 800.0 / n)
    chart = Chart(size * n + 240, size * n + 130)
    axes, colours = chart.axes, LinearSegmentedColormap.from_list("wins", _LOST_TO_WON)
    cells = [(i, j, float(win[i, j])) for i, j in np.ndindex(n, n) if i != j and not math.isnan(win[i, j])]
    squares = PatchCollection([Rectangle((j - 0.48, i - 0.48), 0.96, 0.96) for i, j, _ in cells])
    squares.set_facecolor([to_hex(colours(p)) for *_, p in cells] or "none")
    squares.set_gid(chart.tooltips(*(f"{names[i]} beats {names[j]} in {100 * p:.1f} % of matches" for i, j, p in cells)))
    axes.add_collection(squares)
    for i, j, p in cells if size >= _SMALLEST_LABELLED else ():
        colour = "#ffffff" if abs(2 * p - 1) > 0.55 else "#16191c"
        axes.text(j, i, f"{100 * p:.0f}", color=colour, fontsize=10, ha="center", va="center_baseline")
    axes.set(xlim=(-0.5, n - 0.5), ylim=(n - 0.5, -0.5), aspect="equal")
    labels = [label(name) for name in names]
    axes.set_xticks(range(n), labels, color=INK, rotation=55, ha="left", rotation_mode="anchor")
    axes.set_yticks(range(n), labels, color=INK)
    axes.tick_params(length=0, labeltop=True, labelbottom=False)
    axes.spines[:].set_visible(False)
    axes.grid(visible=False)
    return chart.svg("Probability that the row wins against the column")


@styled
def scatter(points: Mapping[str, tuple[float, float]], across: str, up: str) -> Markup:
    """Named points, whose names do not overlap."""
    chart = Chart(_WIDTH, 460.0)
    axes = chart.axes
    axes.scatter(
        *np.array([*points.values()]).T,
        color=_ACCENT,
        s=60,
        gid=chart.tooltips(*(f"{name}: {x:.3f}, {y:.3f}" for name, (x, y) in points.items())),
    )
    axes.margins(x=0.1, y=0.08)
    axes.set(xlabel=across, ylabel=up)
    chart.figure.draw_without_rendering()
    # Left and right edge and centre of each name that is placed [px]; a name moves up or down until it covers no other.
    placed: list[tuple[float, float, float]] = []
    for name, point in sorted(points.items(), key=lambda item: item[1][1]):
        (x, y), width = 72 / chart.figure.dpi * axes.transData.transform(point), 6.7 * len(label(name))
        shift = next(
            shift
            for shift in sorted(range(-13 * len(points), 13 * len(points) + 1, 13), key=abs)
            if not any(x + 9 < right and x + 9 + width > left and abs(y + shift - other) < 13 for left, right, other in placed)
        )
        placed.append((x + 9, x + 9 + width, y + shift))
        line = {"arrowstyle": "-", "color": DIM, "linewidth": 0.8} if shift else None
        axes.annotate(label(name), point, (9, shift), textcoords="offset points", va="center", arrowprops=line)
    return chart.svg(f"{up} against {across}")


@styled
def curves(
    lines: Mapping[str, Sequence[tuple[float, float]]], across: str, up: str, *, logarithmic: bool = False
) -> Markup | None:
    """Curves by name, with a legend; None without any point.

    Args:
        lines: points of each, from left to right; an empty one is not drawn, and keeps its colour for other charts.
        logarithmic: whether the vertical axis is; points that are not above 0 are left out then.
    """
    from matplotlib.ticker import LogLocator, NullLocator  # noqa: PLC0415  slow to import

    shown = {name: [(x, y) for x, y in points if y > 0 or not logarithmic] for name, points in lines.items()}
    if not any(shown.values()):
        return None
    chart = Chart(_WIDTH, 440.0 + 6 * len(shown))
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


@styled
def radars(axes: Sequence[str], values: Mapping[str, Sequence[float]], reference: Sequence[float]) -> dict[str, Markup]:
    """Figures from 0 (the centre) to 1 (the rim) by name, and those of a reference as a dashed line."""
    chart = Chart(300.0, 230.0, projection="polar")
    angles = 2 * math.pi * np.arange(len(axes)) / len(axes)
    chart.axes.fill(angles, reference, facecolor="none", edgecolor=DIM, linestyle=(0, (3, 3)))
    shapes = [
        *chart.axes.fill(angles, reference, facecolor=_ACCENT, alpha=0.25),
        *chart.axes.fill(angles, reference, facecolor="none", edgecolor=_ACCENT, linewidth=1.6),
    ]
    chart.axes.set(theta_zero_location="N", theta_direction=-1, rlim=(0, 1))
    chart.axes.set_thetagrids(np.degrees(angles), [label(name) for name in axes])
    chart.axes.set_rgrids([0.5, 1.0], ["", ""])
    drawn = {}
    for name, figures in values.items():
        for shape in shapes:
            shape.set_xy(np.column_stack([angles, figures]))
        drawn[name] = chart.svg("Mix of strokes")
        chart.figure.set_layout_engine("none")  # that of the first one is kept, because all have the same text
    return drawn
