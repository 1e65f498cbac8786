"""Compare behaviour cloning in self-play with the validation matches.

    python -m experiments.realism --data DATA [--split validation] [--json]

Simulated figures are exact (expected visits of every state) and have no noise; the intervals are bootstrap intervals over
matches.
"""

import json as json_format
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.table import Table

from shuttle_marl.base.arrays import F64
from shuttle_marl.commands.cli import run
from shuttle_marl.data import load_strokes
from shuttle_marl.data.schema import Outcome
from shuttle_marl.data.upstream import Split
from shuttle_marl.dynamics.evaluate import play_statistics
from shuttle_marl.dynamics.features import Rows, rows_from_strokes
from shuttle_marl.dynamics.make import rows_of
from shuttle_marl.game import load_game
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.policy import baselines

RESAMPLES: Final = 2000


def observed(rows: Rows, seed: int = 0) -> dict[str, dict[str, float]]:
    """Figures of real matches, each with its value and 95 % interval.

    The length of a rally is the number of its last stroke; rallies without a recorded end do not count. Shares of strokes refer
    to recorded strokes of known outcome. Few serves were missed by the cameras, but not at random: their share refers to
    rallies, not to strokes.
    """
    ended = (rows.outcome == Outcome.FAULT) | (rows.outcome == Outcome.WINNER)
    known = rows.outcome != Outcome.UNKNOWN
    n = len(rows.matches)
    # Dropped strokes (nearly always serves) before a recorded one count towards the length.
    total = np.bincount(rows.match[ended], rows.stroke[ended], n).astype(np.float64)
    per_match: dict[str, tuple[F64, F64]] = {
        "mean rally": (total, np.bincount(rows.match[ended], minlength=n).astype(np.float64)),
        "fault share": (np.bincount(rows.match[rows.outcome == Outcome.FAULT], minlength=n).astype(np.float64), total),
        "winner share": (np.bincount(rows.match[rows.outcome == Outcome.WINNER], minlength=n).astype(np.float64), total),
    }
    strokes = np.bincount(rows.match[known], minlength=n).astype(np.float64)
    for i, shot in enumerate(SHOTS):
        per_match[shot] = (np.bincount(rows.match[known & (rows.codes["shot"] == i)], minlength=n).astype(np.float64), strokes)
    used = np.flatnonzero(per_match["mean rally"][1])
    draws = used[np.random.default_rng(seed).integers(0, len(used), (RESAMPLES, len(used)))]
    out = {}
    for name, (top, bottom) in per_match.items():
        low, high = np.quantile(top[draws].sum(axis=1) / bottom[draws].sum(axis=1), [0.025, 0.975])
        out[name] = {"value": float(top.sum() / bottom.sum()), "low": float(low), "high": float(high)}
    return out


def simulated(model: str) -> dict[str, float]:
    """The same figures of behaviour cloning in self-play, computed exactly."""
    figures = play_statistics(baselines.load(None, load_game(model)))
    shares = {"mean rally": figures["mean_rally"], "fault share": figures["fault_share"], "winner share": figures["winner_share"]}
    return {**shares, **figures["shot_mix"]}


def realism(data: Path, split: Split = "validation", model: str = "default", json: bool = False) -> None:
    """Print the table.

    Args:
        data: folder of the download, or a Parquet file of `data convert`.
        split: matches to compare with.
        model: a shipped model or a model folder.
        json: print JSON instead.
    """
    real = observed(rows_of(rows_from_strokes(load_strokes(data)), split))
    ours = simulated(model)
    result: dict[str, Any] = {name: {**real[name], "simulated": ours[name]} for name in real}
    if json:
        sys.stdout.write(json_format.dumps({"split": split, "figures": result}) + "\n")
        return
    table = Table(title=f"Behaviour cloning against itself and the {split} matches")
    for column in ("", "simulated", "matches", "95 % interval"):
        table.add_column(column, justify="left" if not column else "right")
    for name, row in result.items():
        scale, unit = (1.0, "") if name == "mean rally" else (100.0, " %")
        value, low, high = (scale * row[key] for key in ("value", "low", "high"))
        table.add_row(name, f"{scale * row['simulated']:.2f}{unit}", f"{value:.2f}{unit}", f"{low:.2f} to {high:.2f}")
    Console(highlight=False).print(table)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line."""
    return run(realism, prog="experiments.realism", description=__doc__ or "", argv=argv)


if __name__ == "__main__":
    sys.exit(main())
