"""Picture of a league: exploitability of the main agent over time."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from shuttle_marl.analysis.pictures import figure, save

_TARGET = 0.02


def draw(curve: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draw exact exploitability after every round, and the least so far.

    Args:
        curve: lines of ``metrics.jsonl``.
        path: of the picture.

    Raises:
        ModuleNotFoundError: matplotlib is not installed.
        FileWriteError: the file cannot be written.
    """
    seconds = [float(line["seconds"]) for line in curve]
    now = [max(float(line["exploitability"]), 1e-6) for line in curve]
    least = [min(now[: i + 1]) for i in range(len(now))]
    drawn = figure(7.0, 4.0)
    axes = drawn.subplots()
    axes.plot(seconds, now, "o-", color="#127257", markersize=3, linewidth=1, label="after each round")
    axes.step(seconds, least, where="post", color="#d95f02", linewidth=1.5, label="least so far")
    axes.axhline(_TARGET, color="0.6", linewidth=0.8, linestyle="--")
    axes.set(xlabel="seconds", ylabel="exploitability (exact)", yscale="log")
    axes.legend(frameon=False)
    axes.grid(visible=True, which="both", linewidth=0.3)
    save(drawn, path)
