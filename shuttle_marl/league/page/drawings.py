"""Drawings of a report as SVG within the page: ratings, payoffs, scatter, radar, curves."""

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from shuttle_marl.arrays import F64
from shuttle_marl.league.page.document import Html, element

COLOURS: Final = ("#0b8f66", "#d0553c", "#3f6fd8", "#b8860b", "#8a56c9", "#1d9aa8", "#c2478f", "#6b7d2c", "#8c6a55", "#5c6b7a")
_LONGEST: Final = 26
_READABLE: Final = 30.0
"""Width of a cell that holds a number."""
_EVEN: Final = np.array([247, 246, 240])
_WON: Final = np.array([11, 110, 79])
_LOST: Final = np.array([186, 72, 48])


def _svg(width: float, height: float, *content: str, about: str) -> Html:
    size = {"viewBox": f"0 0 {width:g} {height:g}", "width": f"{width:g}", "height": f"{height:g}"}
    return element("svg", *content, xmlns="http://www.w3.org/2000/svg", role="img", aria_label=about, **size)


def _label(value: str) -> str:
    return value if len(value) <= _LONGEST else f"{value[: _LONGEST - 1]}…"


def ticks(low: float, high: float, most: int = 6) -> list[float]:
    """Round numbers within an interval, ``most`` or fewer."""
    span = max(high - low, 1e-12)
    step = 10.0 ** math.floor(math.log10(span / most))
    step *= next(factor for factor in (1, 2, 5, 10) if span / (step * factor) <= most + 1e-9)
    first = math.ceil(low / step - 1e-9)
    return [round(i * step, 10) + 0.0 for i in range(first, math.floor(high / step + 1e-9) + 1)]


def forest(rows: Sequence[tuple[str, float, float, float, float]], unit: str) -> Html:
    """Figures with intervals, one below the other.

    Args:
        rows: name, figure, lower and upper end of its interval, exact figure; NaN where there is none.
        unit: of the figures.
    """
    known = [value for _, *figures in rows for value in figures if not math.isnan(value)] or [0.0]
    low, high = min(known), max(known)
    pad = max(1.0, 0.04 * (high - low))
    low, high = low - pad, high + pad
    left, width, line = 190.0, 1100.0, 22.0
    height = line * len(rows) + 34

    def x(value: float) -> float:
        return left + (value - low) / (high - low) * (width - left - 14)

    parts = []
    for tick in ticks(low, high, 8):
        parts.append(element("line", x1=x(tick), x2=x(tick), y1=4, y2=height - 26, class_="grid"))
        parts.append(element("text", f"{tick:+g}", x=x(tick), y=height - 10, text_anchor="middle", class_="dim"))
    for i, (name, value, lower, upper, exact) in enumerate(rows):
        y = 4 + line * (i + 0.5)
        parts.append(element("text", _label(name), x=left - 10, y=y + 4, text_anchor="end"))
        if not math.isnan(value):
            about = element("title", f"{name}: {value:+.0f} {unit}, 95 % {lower:+.0f} to {upper:+.0f}")
            parts.append(element("line", about, x1=x(lower), x2=x(upper), y1=y, y2=y, class_="whisker"))
            parts.append(element("circle", about, cx=x(value), cy=y, r=4, class_="dot"))
        if not math.isnan(exact):
            d = f"M{x(exact):.1f} {y - 7:.1f}l5 7l-5 7l-5 -7z"
            parts.append(element("path", element("title", f"{name}: exactly {exact:+.0f} {unit}"), d=d, class_="exact"))
    return _svg(width, height, *parts, about="Ratings with 95 % intervals")


def heat_map(names: Sequence[str], win: F64) -> Html:
    """Payoffs of all pairs.

    Args:
        names: N rows and columns.
        win: ``[N, N]`` probability that the row wins against the column, NaN where it is not known.
    """
    n = len(names)
    size = 36.0 if n <= 24 else max(8.0, 800.0 / n)
    left, top = 190.0, 150.0
    parts = []
    for i, name in enumerate(names):
        middle = size * (i + 0.5)
        parts.append(element("text", _label(name), x=left - 8, y=top + middle + 4, text_anchor="end"))
        where = f"translate({left + middle + 4:.1f} {top - 8:.1f}) rotate(-55)"
        parts.append(element("text", _label(name), transform=where))
    for i, j in np.ndindex(n, n):
        p = float(win[i, j])
        if i == j or math.isnan(p):
            continue
        strength = abs(2 * p - 1)
        red, green, blue = np.rint(_EVEN + (strength**0.8) * ((_WON if p > 0.5 else _LOST) - _EVEN)).astype(int).tolist()
        x, y = left + size * j, top + size * i
        about = element("title", f"{names[i]} beats {names[j]} in {100 * p:.1f} % of matches")
        fill = f"#{red:02x}{green:02x}{blue:02x}"
        parts.append(element("rect", about, x=x, y=y, width=size - 1, height=size - 1, rx=2, fill=fill))
        if size >= _READABLE:
            shown = f"{100 * p:.0f}"
            dark = "light" if strength > 0.55 else "dark"
            spot = {"x": x + size / 2 - 0.5, "y": y + size / 2 + 3.5}
            parts.append(element("text", shown, text_anchor="middle", class_=dark, pointer_events="none", **spot))
    return _svg(left + size * n + 90, top + size * n + 4, *parts, about="Probability that the row wins against the column")


class _Frame:
    """Axes of a drawing: where a point lies, and the lines and numbers around."""

    width, height, left, bottom = 1100.0, 460.0, 62.0, 44.0

    def __init__(self, xs: Sequence[float], ys: Sequence[float], *, logarithmic: bool = False) -> None:
        self._logarithmic = logarithmic
        ys = [self._up(y) for y in ys]
        self._x, self._y = self._range(xs), self._range(ys)

    @staticmethod
    def _range(values: Sequence[float]) -> tuple[float, float]:
        low, high = min(values), max(values)
        pad = 0.05 * (high - low) or 0.5 * abs(high) or 1.0
        return low - pad, high + pad

    def _up(self, y: float) -> float:
        return math.log10(y) if self._logarithmic else y

    def place(self, x: float, y: float) -> tuple[float, float]:
        """Pixels of a point."""
        (x_low, x_high), (y_low, y_high) = self._x, self._y
        right = self.left + (x - x_low) / (x_high - x_low) * (self.width - self.left - 14)
        return right, 18 + (self.height - self.bottom - 18) * (1 - (self._up(y) - y_low) / (y_high - y_low))

    def axes(self, across: str, up: str) -> list[Html]:
        """Lines, numbers and names."""
        parts = []
        for tick in ticks(*self._x, 8):
            x, _ = self.place(tick, 1.0)
            parts.append(element("line", x1=x, x2=x, y1=18.0, y2=self.height - self.bottom, class_="grid"))
            parts.append(
                element(
                    "text",
                    f"{tick:,.0f}" if abs(tick) >= 1000 else f"{tick:g}",
                    x=x,
                    y=self.height - self.bottom + 16,
                    text_anchor="middle",
                    class_="dim",
                )
            )
        heights = [10.0**tick for tick in self._decades()] if self._logarithmic else ticks(*self._y)
        for tick in heights:
            _, y = self.place(self._x[0], tick)
            parts.append(element("line", x1=self.left, x2=self.width - 14, y1=y, y2=y, class_="grid"))
            parts.append(element("text", f"{tick:g}", x=self.left - 7, y=y + 4, text_anchor="end", class_="dim"))
        parts.append(element("text", f"{across} →", x=self.width - 14, y=self.height - 6, text_anchor="end", class_="dim"))
        return [*parts, element("text", f"↑ {up}", x=self.left - 30, y=11.0, class_="dim")]

    def _decades(self) -> list[float]:
        low, high = self._y
        steps = [math.log10(digit) + decade for decade in range(math.floor(low), math.ceil(high) + 1) for digit in (1, 2, 5)]
        return [step for step in steps if low <= step <= high]


def scatter(points: Mapping[str, tuple[float, float]], across: str, up: str) -> Html:
    """Named points; names keep out of each other's way."""
    frame = _Frame(*map(list, zip(*points.values(), strict=True)))
    parts = frame.axes(across, up)
    placed = {name: frame.place(*point) for name, point in points.items()}
    # Left, right, upper and lower edge of what no name may cover.
    taken = [(x - 5, x + 5, y - 5, y + 5) for x, y in placed.values()]
    for name, (x, y) in sorted(placed.items(), key=lambda item: item[1][1]):
        wide = 6.7 * len(_label(name))
        spots = [
            (begin, y + 4 + down)
            for down in sorted(range(-104, 105, 13), key=abs)
            for begin in (x + 9 + abs(down) / 4, x - 9 - wide - abs(down) / 4)
            if begin > frame.left and begin + wide < frame.width and 12 < y + 4 + down < frame.height - frame.bottom
        ]
        begin, line = next(
            (
                spot
                for spot in spots
                if not any(
                    spot[0] < right and spot[0] + wide > left and spot[1] - 11 < lower and spot[1] + 3 > upper
                    for left, right, upper, lower in taken
                )
            ),
            (x + 9, y + 4),
        )
        taken.append((begin, begin + wide, line - 11, line + 3))
        about = element("title", f"{name}: {points[name][0]:.3f}, {points[name][1]:.3f}")
        if abs(line - y - 4) > 1:
            parts.append(element("line", x1=x, y1=y, x2=begin - 2 if begin > x else begin + wide + 1, y2=line - 4, class_="axis"))
        parts.append(element("circle", about, cx=x, cy=y, r=4.5, class_="dot"))
        parts.append(element("text", _label(name), x=begin, y=line))
    return _svg(frame.width, frame.height, *parts, about=f"{up} against {across}")


def curves(lines: Mapping[str, Sequence[tuple[float, float]]], across: str, up: str, *, logarithmic: bool = False) -> Html:
    """Curves by name, with a legend.

    Args:
        lines: points of each, from left to right; one without any is left out, and keeps its colour for other figures.
        across, up: names of the axes.
        logarithmic: whether heights are; those that are not above 0 are left out.
    """
    kept = {name: [(x, y) for x, y in points if y > 0 or not logarithmic] for name, points in lines.items()}
    spots = [spot for points in kept.values() for spot in points]
    if not spots:
        return Html("")
    frame = _Frame([x for x, _ in spots], [y for _, y in spots], logarithmic=logarithmic)
    parts, legend = frame.axes(across, up), []
    for i, (name, points) in enumerate(kept.items()):
        if not points:
            continue
        colour = COLOURS[i % len(COLOURS)]
        line = " ".join(f"{x:.1f},{y:.1f}" for x, y in (frame.place(*point) for point in points))
        parts.append(element("polyline", element("title", name), points=line, class_="curve", stroke=colour))
        swatch = _svg(18, 10, element("line", x1=0, x2=18, y1=5, y2=5, stroke=colour, stroke_width=3), about="")
        legend.append(element("span", swatch, name))
    drawn = _svg(frame.width, frame.height, *parts, about=f"{up} against {across}")
    return Html(drawn + element("div", *legend, class_="swatches"))


def radar(axes: Sequence[str], values: Sequence[float], reference: Sequence[float]) -> Html:
    """Figures from 0 (the middle) to 1 (the rim), and those of a reference, dashed."""
    width, size, radius = 300.0, 210.0, 80.0
    angles = [2 * math.pi * i / len(axes) - math.pi / 2 for i in range(len(axes))]

    def ring(shares: Sequence[float]) -> str:
        spots = zip(shares, angles, strict=True)
        return " ".join(f"{width / 2 + radius * r * math.cos(a):.1f},{size / 2 + radius * r * math.sin(a):.1f}" for r, a in spots)

    parts = [element("polygon", points=ring([r] * len(axes)), fill="none", class_="grid") for r in (0.5, 1.0)]
    for axis, angle in zip(axes, angles, strict=True):
        across, down = math.cos(angle), math.sin(angle)
        anchor = "middle" if abs(across) < 0.3 else "start" if across > 0 else "end"
        spot = {"x": width / 2 + (radius + 8) * across, "y": size / 2 + (radius + 10) * down + 4}
        ends = {"x1": width / 2, "y1": size / 2, "x2": width / 2 + radius * across, "y2": size / 2 + radius * down}
        parts.append(element("line", class_="grid", **ends))
        parts.append(element("text", axis, text_anchor=anchor, class_="dim", **spot))
    parts.append(element("polygon", points=ring(reference), class_="reference"))
    parts.append(element("polygon", points=ring(values), class_="area"))
    return _svg(width, size, *parts, about="Mix of strokes")
