"""Predictions corrected by the match so far: annotators name strokes in their own way, and players have their day.

Within each cell of strokes of a match, what was seen so far is compared with what was predicted. The odds of a shot type that
was seen n times where e were expected are multiplied by (n + k) / (e + k): the posterior mean of the ratio of the two rates
where its prior is a gamma distribution with mean 1 and weight k (Gelman et al., Bayesian Data Analysis, section 2.6). Cells are
nested, and each is compared with what the cells around it left unexplained.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.moments import CODES, moments_of
from shuttle_marl.game.stroke import N_SHOTS

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

TYPE_WEIGHTS: Final = (4.0, 15.0, 12.0, 20.0)
"""k of shot types in a match; from one height there; in reply to one shot type from one height; of one player."""
AREA_WEIGHTS: Final = (30.0, 20.0, 30.0)
"""k of areas in a match; of one shot type there; of one player's shot type."""


def adapted(probability: Floats, strokes: pa.Table, *, height_known: bool = True) -> Floats:
    """Predictions of an imitator, each corrected by the strokes of its match that were struck before.

    Nothing after the hit is read: what a stroke was corrects the later ones.

    Args:
        probability: ``[N, 13, 9]`` of each shot type and area, as :meth:`shuttle_marl.dynamics.imitator.Imitator.predict` gives.
        strokes: the N strokes, whole matches in playing order.
        height_known: whether the height at which the shuttle is met may be read.

    Returns:
        ``[N, 13, 9]`` probabilities.
    """
    codes = dict(zip(CODES, moments_of(strokes).codes.T.astype(np.int64), strict=True))
    match, player = (_coded(strokes, name)[:, None] for name in ("match", "player"))
    height, reply = codes["height"][:, None], codes["shot_1"][:, None]
    if not height_known:
        height = np.zeros_like(height)
    shot = strokes["shot"].to_numpy(zero_copy_only=False).astype(np.int64)
    area = strokes["area"].fill_null(-1).to_numpy(zero_copy_only=False).astype(np.int64)
    # A fault does not say where it was aimed, and a winner came down where no one met it.
    area = np.where(strokes["outcome"].to_numpy(zero_copy_only=False) == Outcome.RETURNED, area, -1)
    of_type = np.maximum(probability.sum(axis=2), 1e-12)
    types = _corrected(
        of_type[:, None],
        [_cells(match), _cells(match, height), _cells(match, height, reply), _cells(match, player)],
        TYPE_WEIGHTS,
        np.zeros_like(shot),
        shot,
    )
    every = np.arange(N_SHOTS)[None]
    areas = _corrected(
        probability / of_type[:, :, None],
        [_cells(match), _cells(match, every), _cells(match, player, every)],
        AREA_WEIGHTS,
        shot,
        area,
    )
    return np.asarray(types[:, 0, :, None] * areas)


def _coded(strokes: pa.Table, name: str) -> Ints:
    codes = strokes[name].combine_chunks().dictionary_encode().indices
    return np.asarray(codes.to_numpy(zero_copy_only=False), dtype=np.int64)


def _cells(*codes: Ints) -> Ints:
    """Numbers of the combinations of codes, ``[N, 1]`` each, or ``[1, R]`` for a code of every distribution."""
    cell = np.zeros((1, 1), dtype=np.int64)
    for code in codes:
        cell = cell * (int(code.max(initial=0)) + 1) + code
    return cell


def _corrected(probability: Floats, cells: Sequence[Ints], weights: Sequence[float], which: Ints, label: Ints) -> Floats:
    """Correct R distributions at each of N strokes by what was seen in the strokes before, cell by cell.

    Args:
        probability: ``[N, R, C]`` predictions.
        cells: for each level, outermost first, ``[N, R or 1]`` the cell of every distribution.
        weights: k of each level.
        which: ``[N]`` distribution that was drawn from.
        label: ``[N]`` what was drawn, -1 where that is not known.
    """
    out = np.empty_like(probability)
    counts = [np.zeros((2, int(cell.max(initial=0)) + 1, probability.shape[2])) for cell in cells]
    for i, predicted in enumerate(probability):
        now, drawn, seen = predicted, int(which[i]), int(label[i])
        for cell, weight, (n, e) in zip(cells, weights, counts, strict=True):
            here = cell[i]
            ratio = (n[here] + weight) / (e[here] + weight)
            if seen >= 0:
                mine = here[drawn if len(here) > 1 else 0]
                n[mine, seen] += 1
                e[mine] += now[drawn]
            now = now * ratio
            now = now / now.sum(axis=1, keepdims=True)
        out[i] = now
    return out
