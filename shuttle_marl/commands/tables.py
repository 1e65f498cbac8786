"""Tables of the exact figures for the console; their cells are plain text, never markup."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.table import Table
from rich.text import Text

from shuttle_marl.errors import printable
from shuttle_marl.policy.scorecard import Scorecard

Floats = npt.NDArray[np.float64]

_SHOWN_SHOTS = 5


def facts(rows: Mapping[str, str]) -> Table:
    """Names and values, one a line."""
    table = Table.grid(padding=(0, 3))
    for name, value in rows.items():
        table.add_row(Text(printable(name), "dim"), Text(printable(value)))
    return table


def shares(named: Mapping[str, float], count: int | None = None) -> str:
    """The largest shares of a mapping, in percent."""
    order = sorted(named, key=lambda name: -named[name])[:count]
    return ", ".join(f"{name} {percent(named[name])}" for name in order)


def scorecards(cards: Sequence[Scorecard]) -> Table:
    """The figures of policies, one a row."""
    table = Table(title="Against bc, its best response, and perfect play", title_justify="left", header_style="bold")
    table.add_column("policy", no_wrap=True)
    for heading in ("rallies won", "matches won", "normalised", "exploitability", "regret a rally", "strokes a rally"):
        table.add_column(heading, justify="right")
    for card in cards:
        rally, match = (_with_interval(*pair) for pair in _win_probabilities(card))
        figures = (card.normalised_score, card.exploitability, card.regret_per_rally)
        table.add_row(_name(card.policy), rally, match, *map(_number, figures), f"{card.rally_length_vs_bc:.2f}")
    return table


def play(cards: Sequence[Scorecard]) -> Table:
    """Endings and shots of the rallies against bc, one policy a row."""
    table = Table(title="Rallies against bc", title_justify="left", header_style="bold")
    for heading in ("policy", "how they end", f"its {_SHOWN_SHOTS} commonest shots"):
        table.add_column(heading)
    for card in cards:
        if card.endings_vs_bc is not None and card.shot_mix_vs_bc is not None:
            table.add_row(_name(card.policy), shares(card.endings_vs_bc), shares(card.shot_mix_vs_bc, _SHOWN_SHOTS))
    return table


def matrix(title: str, names: Sequence[str], probabilities: Floats) -> Table:
    """Probabilities of the row against the column, ``[N, N]``."""
    table = Table(title=title, title_justify="left", header_style="bold")
    table.add_column("", no_wrap=True)
    for name in names:
        table.add_column(_name(name), justify="right", no_wrap=True)
    for i, name in enumerate(names):
        table.add_row(_name(name), *("" if i == j else percent(probabilities[i, j]) for j in range(len(names))))
    return table


def percent(share: float) -> str:
    """A share in percent."""
    return f"{100 * share:.1f} %"


def _name(name: str) -> Text:
    return Text(printable(name))


def _win_probabilities(card: Scorecard) -> tuple[tuple[float, Any], tuple[float, Any]]:
    return (card.rally_win_vs_bc, card.rally_interval), (card.match_win_vs_bc, card.match_interval)


def _with_interval(share: float, interval: tuple[float, float] | None) -> str:
    return percent(share) if interval is None else f"{percent(share)} ({percent(interval[0])} to {percent(interval[1])})"


def _number(value: float | None) -> str:
    # Adding 0 turns a rounded -0.0 into 0.0.
    return "-" if value is None else f"{round(value, 4) + 0:.4f}"
