"""``python -m experiments.truth.shares --data DATA [--json]``: the minimum share of a legal shot type.

The models are fitted without each part of the training matches, and their game is compiled with each share. Compared are the
log-loss of V on the part that was left out, over the strokes that all games know, and the transfer of the best response and of
perfect play between games of two halves of the matches. No figure of the play itself is looked at.
"""

import json as json_format
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich.console import Console

from experiments.truth.decisions import promises, value_log_losses
from experiments.truth.legality import judged_strokes
from experiments.truth.matches import Strokes, folds_of, of_splits, ratio_by_match, strokes_of
from experiments.truth.transfer import transferred
from experiments.truth.worlds import Fitter, World
from shuttle_marl.base.runs import describe, write_json
from shuttle_marl.commands.cli import run
from shuttle_marl.data import load_strokes


def shares(
    *,
    data: Path,
    compared: tuple[float, ...] = (0.01, 0.015, 0.02, 0.03, 0.05),
    parts: int = 4,
    halvings: int = 2,
    seed: int = 0,
    out: Path | None = None,
    json_output: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> None:
    """Compare minimum shares of a legal shot type.

    Args:
        data: folder of the download, or a Parquet file of `data convert`.
        compared: shares to compare.
        parts: parts of the training matches; the models are fitted without each.
        halvings: halvings of the training matches for the transfer.
        seed: random seed of parts, halvings and fits.
        out: JSON file for the result, with its provenance.
        json_output: print JSON.
    """
    console = Console(stderr=True, highlight=False)
    strokes = of_splits(strokes_of(load_strokes(data)), "train")
    fitter = Fitter(strokes, Path(), seed=seed, report=lambda line: console.print(line, markup=False))
    fold = folds_of(strokes, parts, seed)
    losses: list[list[Any]] = [[] for _ in compared]
    illegal = np.zeros((len(compared), 2))
    judged = []
    for k in range(parts):
        part = strokes.take(fold == k)
        names = strokes.take(fold != k).matches
        for i, world in enumerate(fitter.of_layouts(names, fitter.layouts(names, compared))):
            here = part.marked(world.hurry)
            losses[i].append(value_log_losses(here, promises(world.bc, here)))
            known, forbidden = judged_strokes(world.game, here)
            illegal[i] += forbidden.sum(), known.sum()
        judged.append(part)
    moves: list[list[tuple[World, World]]] = [[] for _ in compared]
    layouts = fitter.layouts(strokes.matches, compared)
    for number in range(halvings):
        half = folds_of(strokes, 2, seed + number)
        sides = [fitter.of_layouts(strokes.take(half == side).matches, layouts) for side in (0, 1)]
        for i, (one, other) in enumerate(zip(*sides, strict=True)):
            moves[i] += [(one, other), (other, one)]
    joined = np.stack([np.concatenate(of) for of in losses])
    match = Strokes.joined(judged).rows.match
    used = np.isfinite(joined).all(axis=0)
    found = {
        f"{share:g}": {
            "illegal": illegal[i, 0] / illegal[i, 1],
            "value_log_loss": float(joined[i, used].mean()),
            "against_first": ratio_by_match((joined[i] - joined[0])[used], np.ones(int(used.sum())), match[used], seed),
            "transfer": transferred(moves[i]),
        }
        for i, share in enumerate(compared)
    }
    if out is not None:
        write_json(out, {**describe(("numpy", "torch")), "shares": found})
    (sys.stdout.write if json_output else console.print)(json_format.dumps(found, indent=None if json_output else 1) + "\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    return run(shares, prog="experiments.truth.shares", description=__doc__ or "", argv=argv)


if __name__ == "__main__":
    sys.exit(main())
