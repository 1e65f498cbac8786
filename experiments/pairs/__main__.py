"""``python -m experiments.pairs --data DATA (--cross 4 | --split test) [--json]``"""

import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.console import Console

from docs.tools.results import show
from experiments.pairs.parts import Annotated as AnnotatedStrokes
from experiments.pairs.parts import Part, crossed
from experiments.pairs.results import results
from experiments.pairs.strokes import components
from experiments.truth.matches import in_splits, strokes_of
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.runs import describe
from shuttle_marl.commands.cli import entry_point
from shuttle_marl.data import Split, read_matches
from shuttle_marl.game.shipped import model_folder


def pairs(
    *,
    data: Path,
    split: Split | None = None,
    cross: int | None = None,
    model: str = "default",
    seed: int = 0,
    fits: Path = Path("runs/pairs"),
    out: Path | None = None,
    json_output: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> None:
    """Compare the games of pairs of players with matches that were not used to fit them.

    Args:
        data: folder of the download, or a Parquet file of `data convert`.
        split: matches to compare with a shipped model, which was fitted to the training matches.
        cross: instead of one split, fit this many models, each without one part of the training and validation matches, and
            compare every match with the model that was fitted without it.
        model: with --split, the shipped model or model folder to compare.
        seed: random seed of the parts and the fits.
        fits: cache folder of fitted models.
        out: JSON file for the result, with its provenance.
        json_output: print JSON.
    """
    if (split is None) == (cross is None):
        raise ShuttleError("expected either --split NAME or --cross NUMBER")
    if cross is not None and cross < 2:
        raise ShuttleError(f"--cross {cross}: expected 2 or more parts")
    console = Console(stderr=True, highlight=False)
    table = read_matches(data)
    every = AnnotatedStrokes(strokes=strokes_of(table), game=table["game"].to_numpy().astype(np.int64))
    if cross is not None:
        sources = dict(zip(table["match"].to_pylist(), table["source"].to_pylist(), strict=True))
        played = every.take(in_splits(every.strokes, "train", "validation"))
        parts = crossed(played, sources, cross, fits, seed=seed, report=lambda line: console.print(line, markup=False))
    else:
        seen, unseen = (every.take(in_splits(every.strokes, one)) for one in ("train", split or "validation"))
        parts = [Part(folder=model_folder(model), seen=seen, unseen=unseen)]
    about = {**describe(("numpy", "torch")), "split": split, "cross": cross}
    result = {**about, **results(parts), "components": components(parts)}
    show(result, "pair_results", "pair_strokes", as_json=json_output, out=out)


main = entry_point(pairs, "python -m experiments.pairs", __doc__ or "")


if __name__ == "__main__":
    sys.exit(main())
