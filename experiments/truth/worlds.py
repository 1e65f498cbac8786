"""Games fitted on subsets of the matches, with their average players and the number of examples of each stroke."""

import dataclasses
import functools
import hashlib
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import torch
from safetensors.numpy import load_file, save

from experiments.truth.matches import Strokes, folds_of
from shuttle_marl.base.arrays import F64
from shuttle_marl.base.files import replace_file
from shuttle_marl.base.tensor_files import read_tensors
from shuttle_marl.dynamics.compiled import pair_log_choices
from shuttle_marl.dynamics.fit import Fit, fit, layout_of, supports
from shuttle_marl.dynamics.hurried import Hurry, fit_hurry, load_hurry
from shuttle_marl.dynamics.make import load_support
from shuttle_marl.dynamics.models import known_outcome
from shuttle_marl.dynamics.network import QUICK
from shuttle_marl.game.shipped import load_game, model_folder
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, from_pair_probabilities
from shuttle_marl.policy import baselines

Report = Callable[[str], None]
SOURCES: Final = Path(__file__).parents[2] / "shuttle_marl" / "dynamics"
"""Source code of the models; fits are cached by its hash."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class World:
    """A game and how people play it.

    Attributes:
        bc: the average player, on the game.
        behind: ``[E]`` real strokes in the innermost cell of every edge: how much data stands behind a stroke.
        hurry: index that decides which strikers are hurried in the game, if it knows them.
    """

    bc: TabulatedPolicy
    behind: F64
    hurry: Hurry | None = None

    @property
    def game(self) -> Game:
        """The tables."""
        return self.bc.game


def shipped_world(model: str) -> World:
    """The world of a shipped model or of a model folder."""
    game = load_game(model)
    folder = model_folder(model)
    return World(bc=baselines.load(None, game), behind=load_support(folder).strokes, hurry=load_hurry(folder))


class Fitter:
    """Fits worlds on subsets of the matches, and caches them in a folder.

    Args:
        strokes: of all matches.
        folder: cache; the key of a fit is a hash of its strokes, its layout, its seed and the source code of
            :mod:`shuttle_marl.dynamics`.
        seed: random seed of the fits.
        report: called with a line before each stage of a fit.
    """

    def __init__(self, strokes: Strokes, folder: Path, *, seed: int, report: Report) -> None:
        self._strokes, self._folder, self._seed, self._report = strokes, folder, seed, report
        digest = hashlib.sha256(str((seed, torch.__version__)).encode())
        for source in sorted(SOURCES.glob("*.py")):
            digest.update(source.read_bytes())
        for name, code in sorted(strokes.rows.codes.items()):
            digest.update(name.encode() + np.ascontiguousarray(code).tobytes())
        self._version = digest.hexdigest()

    def fit(self, matches: Sequence[str], layout: Sequence[str] | None = None, *, discipline: int | None = None) -> World:
        """Fit the models on some matches, and compile their game.

        Args:
            matches: names of the training matches.
            layout: names of the matches whose strokes define the catalogue and the legal replies; None: the same.
                Worlds that share a layout can exchange policies.
            discipline: index into :data:`~shuttle_marl.dynamics.features.DISCIPLINES` of the one whose game it is; None: the
                average of both.
        """
        names, arranged = sorted(matches), sorted(layout or matches)
        key = hashlib.sha256(json.dumps([self._version, names, arranged, discipline]).encode()).hexdigest()[:16]
        game_file, hurry_file, tables_file = (self._folder / f"{key}.{part}.safetensors" for part in ("game", "hurry", "tables"))
        if not tables_file.is_file():
            fitted, hurry = self._fitted(tuple(names), tuple(arranged))
            if hurry is not None:
                hurry.save(hurry_file)
            if discipline is not None:
                fitted = fitted.profile(discipline)
            game, _ = fitted.compiled()
            game.save(game_file)
            log_choice = pair_log_choices(fitted.models, game).astype(np.float64)
            replace_file(tables_file, save({"log_choice": log_choice, "behind": fitted.support.strokes}))
        game, tables = Game.load(game_file), load_file(tables_file)
        weight = np.tile(np.exp(tables["log_choice"]), game.n_blocks)
        hurry = Hurry.checked(read_tensors(hurry_file)) if hurry_file.is_file() else None
        return World(bc=from_pair_probabilities(game, game.normalized(weight)), behind=tables["behind"], hurry=hurry)

    def of_shares(self, matches: Sequence[str], layout: Sequence[str], shares: Sequence[float]) -> list[World]:
        """Worlds of one fit with several minimum shares of a legal shot type, not cached; arguments as for :meth:`fit`."""
        rows, found = self._strokes.rows, []
        fitted, hurry = self._fitted(tuple(sorted(matches)), tuple(sorted(layout)))
        train = rows.in_matches(matches) if hurry is None else hurry.marked(rows.in_matches(matches))
        for share in shares:
            empty = layout_of(rows.in_matches(layout), share)
            support, _ = supports(fitted.models, train.take(known_outcome(train)), empty)
            game, _ = dataclasses.replace(fitted, game=empty, support=support).compiled()
            weight = np.tile(np.exp(pair_log_choices(fitted.models, game).astype(np.float64)), game.n_blocks)
            bc = from_pair_probabilities(game, game.normalized(weight))
            found.append(World(bc=bc, behind=support.strokes, hurry=hurry))
        return found

    # The games of both disciplines come from one fit, one after the other.
    @functools.lru_cache(maxsize=1)  # noqa: B019  a fitter lives as long as its program
    def _fitted(self, names: tuple[str, ...], arranged: tuple[str, ...]) -> tuple[Fit, Hurry | None]:
        rows = self._strokes.rows
        layout, train = layout_of(rows.in_matches(arranged)), rows.in_matches(names)
        hurry = fit_hurry(train, seed=self._seed)
        marked = train if hurry is None else hurry.marked(train)
        return fit(marked, None, seed=self._seed, config=QUICK, layout=layout, report=self._report), hurry


def by_discipline(strokes: Strokes, profiles: bool) -> list[tuple[int | None, Strokes]]:
    """The strokes of each discipline, or of all matches as they are."""
    if not profiles:
        return [(None, strokes)]
    found = strokes.rows.codes["discipline"]
    return [(int(discipline), strokes.take(found == discipline)) for discipline in np.unique(found)]


def cross_parts(
    strokes: Strokes, count: int, fitter: Fitter, *, seed: int, profiles: bool = False
) -> list[tuple[World, Strokes]]:
    """Games that are each fitted without one part of the matches, with the strokes of that part.

    Args:
        strokes: of all matches.
        count: number of parts.
        fitter: fits the games.
        seed: of the parts.
        profiles: whether to fit a separate game for each discipline.
    """
    fold = folds_of(strokes, count, seed)
    return marked(
        (fitter.fit(strokes.take(fold != k).matches, discipline=discipline), part)
        for k in range(count)
        for discipline, part in by_discipline(strokes.take(fold == k), profiles)
    )


def marked(parts: Iterable[tuple[World, Strokes]]) -> list[tuple[World, Strokes]]:
    """Worlds with strokes, whose strikers are hurried where the index of their world says so."""
    return [(world, strokes.marked(world.hurry)) for world, strokes in parts]
