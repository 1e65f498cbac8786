"""Models fitted without some matches, together with those matches."""

import dataclasses
import json
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from experiments.truth.matches import Strokes, folds_of
from experiments.truth.worlds import fingerprint
from shuttle_marl.base.arrays import I64
from shuttle_marl.dynamics.choices import player_choices
from shuttle_marl.dynamics.fit import fit
from shuttle_marl.dynamics.hurried import fit_hurry
from shuttle_marl.dynamics.make import save_fit, save_variants
from shuttle_marl.dynamics.network import QUICK
from shuttle_marl.dynamics.skill import summary
from shuttle_marl.game.shipped import CARD

Report = Callable[[str], None]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Annotated:
    """N annotated strokes.

    Attributes:
        strokes: in their rallies.
        game: ``[N]`` game of the match, from 1.
    """

    strokes: Strokes
    game: I64

    def take(self, which: npt.NDArray[np.bool_]) -> "Annotated":
        """The strokes of whole rallies, by mask."""
        return Annotated(strokes=self.strokes.take(which), game=self.game[which])


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Part:
    """A model and matches that took no part in fitting it.

    Attributes:
        folder: of the model.
        seen: the strokes that it was fitted to.
        unseen: the others.
    """

    folder: Path
    seen: Annotated
    unseen: Annotated


def crossed(
    played: Annotated, sources: Mapping[str, str], count: int, folder: Path, *, seed: int, report: Report
) -> list[Part]:  # fmt: skip
    """Models that are each fitted without one part of the matches.

    Args:
        played: strokes of all matches.
        sources: data set of each match by name.
        count: number of parts.
        folder: cache of the models; their names are hashes of the strokes, the seed and the source code of the dynamics.
        seed: of the parts and of the fits.
        report: called with a line before each stage of a fit.
    """
    fold = folds_of(played.strokes, count, seed)
    parts = []
    for k in range(count):
        seen = played.take(fold != k)

        def report_part(line: str, number: int = k + 1) -> None:
            report(f"part {number} of {count}: {line}")

        model = _fitted(seen, sources, folder, seed, report_part)
        parts.append(Part(folder=model, seen=seen, unseen=played.take(fold == k)))
    return parts


def _fitted(seen: Annotated, sources: Mapping[str, str], cache: Path, seed: int, report: Report) -> Path:
    """Folder of the model that is fitted to some strokes."""
    rows = seen.strokes.rows
    folder = cache / fingerprint(json.dumps([seed, torch.__version__, seen.strokes.matches]), seen.strokes)[:16]
    if not (folder / CARD).is_file():
        hurry = fit_hurry(rows, seed=seed)
        fitted = fit(rows if hurry is None else hurry.marked(rows), None, seed=seed, config=QUICK, report=report)
        report("choices of players")
        choices, _ = player_choices(fitted.models.choosers, rows, None, QUICK.folds)
        fitted = dataclasses.replace(fitted, models=dataclasses.replace(fitted.models, choices=choices))
        # Compared with real strokes and results only: how it is played best does not matter.
        written = save_fit(folder, fitted, sources, None, report=report, check=False)
        # The card comes last: a folder with a card is complete.
        save_variants(folder, written.game, written.variants, {"name": folder.name, "skill": summary(written.skill, {})})
    return folder
