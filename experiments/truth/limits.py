"""``python -m experiments.truth.limits --data DATA [--json]``: why predicted advantages are realised only in part.

The decision slope (:mod:`experiments.truth.decisions`) of a fitted game may be below 1 for two reasons, which this module
separates:

- **Few matches.** A fit overrates some of its best strokes. Two games are fitted on halves of the matches; one is assumed to be
  correct, and the exact slope of the other in it is the slope of a game of the right structure. The noise in the variance of a
  fit shrinks with the number of matches, which gives the slope to expect of a fit on more matches.
- **Memory.** If the state is Markov, V of the current state is the best prediction of the result, and an earlier advantage adds
  nothing to it: the slope of (result - V) on it is 0, however inaccurate the advantages, except for errors of V that are
  correlated within a rally. A negative slope means that the result depends on history that is not in the state.
"""

import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.console import Console

from docs.tools.results import show
from experiments.truth.decisions import HORIZONS, decision_slope, promises, slope, worth
from experiments.truth.matches import Strokes, folds_of, of_splits, strokes_of
from experiments.truth.memory import memory
from experiments.truth.worlds import Fitter, World, cross_parts, judged_by
from shuttle_marl.base.arrays import F64
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.runs import describe
from shuttle_marl.commands.cli import entry_point
from shuttle_marl.data import read_matches
from shuttle_marl.exact import evaluate


def limits(
    *,
    data: Path,
    cross: int = 4,
    halvings: int = 2,
    seed: int = 0,
    fits: Path = Path("runs/truth"),
    out: Path | None = None,
    json_output: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> None:
    """Separate two reasons why predicted advantages are realised only in part: few matches, and history that is not in the state.

    Args:
        data: folder of the download, or a Parquet file of `data convert`.
        cross: fit this many games, each without one part of the training and validation matches, and evaluate every match
            with the game that was fitted without it.
        halvings: halvings of the training matches for the slope that can be expected; two games are fitted for each.
        seed: random seed of the fits and halvings.
        fits: cache folder of fitted games.
        out: JSON file for the result, with its provenance.
        json_output: print JSON.
    """
    if cross < 2 or halvings < 1:
        raise ShuttleError(f"--cross {cross} --halvings {halvings}: expected 2 or more parts, and 1 or more halvings")
    console = Console(stderr=True, highlight=False)
    strokes = strokes_of(read_matches(data))
    fitter = Fitter(strokes, fits, seed=seed, report=lambda line: console.print(line, markup=False))
    parts = cross_parts(of_splits(strokes, "train", "validation"), cross, fitter, seed=seed)
    real, promised = judged_by(parts)
    matches = len(real.matches) * (cross - 1) / cross
    result = {
        **describe(("numpy", "torch")),
        "cross": cross,
        "matches": len(real.matches),
        "decision_slope": decision_slope(real, promised),
        "attainable": attainable(of_splits(strokes, "train"), fitter, halvings=halvings, seed=seed, matches=matches),
        "memory": memory(real, promised),
    }
    show(result, "truth_limits", "truth_memory", as_json=json_output, out=out)


def attainable(strokes: Strokes, fitter: Fitter, *, halvings: int, seed: int, matches: float) -> dict[str, dict[str, float]]:
    """Slopes to expect of a fit if the structure of the game is right.

    Args:
        strokes: of the matches to halve.
        fitter: fits the games.
        halvings: how often; each gives two directions.
        seed: of the halvings.
        matches: number of matches of the fit.

    Returns:
        For each horizon ``halves``, the mean slope of the game of one half in the game of the other, and ``value``, the slope of
        a fit on that number of matches.
    """
    found: list[dict[str, float]] = []
    for number in range(halvings):
        half = folds_of(strokes, 2, seed + number)
        worlds = [fitter.fit(strokes.take(half == side).matches, layout=strokes.matches) for side in (0, 1)]
        found += [slopes_if_true(said, true, strokes) for said, true in (worlds, worlds[::-1])]
    share = len(strokes.matches) / 2 / matches
    out = {}
    for horizon in found[0]:
        halves = float(np.mean([one[horizon] for one in found]))
        out[horizon] = {"halves": halves, "value": 1 / (1 + (1 / halves - 1) * share)}
    return out


def slopes_if_true(said: World, true: World, strokes: Strokes) -> dict[str, float]:
    """Exact slopes of one world's promises, at the states and strokes of real matches, if another world of its layout is true."""
    # The same state in both worlds: what is hurried is decided by one of them.
    strokes = strokes.marked(true.hurry)
    promised = promises(said.bc, strokes)
    played = true.bc.pair_probabilities()
    expected: dict[str, F64] = {}
    following = evaluate(said.bc, said.bc).striking[0]
    for horizon in range(1, max(HORIZONS) + 1):
        if horizon in HORIZONS:
            expected[str(horizon)] = worth(true.bc, strokes, following)
        following = true.game.sum_by_state(played * true.game.stroke_values(following))
    expected["end"] = worth(true.bc, strokes, evaluate(true.bc, true.bc).striking[0])
    return {horizon: slope(strokes, promised, happens)["value"] for horizon, happens in expected.items()}


main = entry_point(limits, "python -m experiments.truth.limits", __doc__ or "")


if __name__ == "__main__":
    sys.exit(main())
