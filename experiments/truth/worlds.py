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
from shuttle_marl.dynamics.fit import Fit, fit, layouts_of, supports
from shuttle_marl.dynamics.history import Arrays, fit_history
from shuttle_marl.dynamics.hurried import Hurry, fit_hurry, load_hurry
from shuttle_marl.dynamics.make import load_support
from shuttle_marl.dynamics.models import known_outcome
from shuttle_marl.dynamics.network import QUICK
from shuttle_marl.game.shipped import PROFILES, load_game, model_folder, variant_of
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, from_pair_probabilities
from shuttle_marl.policy import baselines, history
from shuttle_marl.policy.history import HistoryPolicy

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
        opposite: whether the players have different hands.
        history: the average player who remembers the rally; None: the model has none.
    """

    bc: TabulatedPolicy
    behind: F64
    hurry: Hurry | None = None
    opposite: bool = False
    history: HistoryPolicy | None = None

    @property
    def game(self) -> Game:
        """The tables."""
        return self.bc.game


def shipped_world(model: str, discipline: int | None, *, opposite: bool) -> World:
    """The world of a shipped model or of a model folder, in one of its games."""
    folder, variant = model_folder(model), variant_of(None if discipline is None else PROFILES[discipline], opposite=opposite)
    game = load_game(model if variant is None else f"{model}:{variant}")
    behind = load_support(folder, opposite=opposite).strokes
    remembers = history.load(game) if history.known_for(game) else None
    return World(bc=baselines.load(None, game), behind=behind, hurry=load_hurry(folder), opposite=opposite, history=remembers)


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

    def fit(
        self,
        matches: Sequence[str],
        layout: Sequence[str] | None = None,
        *,
        discipline: int | None = None,
        opposite: bool = False,
    ) -> World:
        """Fit the models on some matches, and compile their game.

        Args:
            matches: names of the training matches.
            layout: names of the matches whose game has the same strokes and the same legal replies; None: these. Worlds that
                share a layout can exchange policies.
            discipline: index into :data:`~shuttle_marl.dynamics.features.DISCIPLINES` of the one whose game it is; None: the
                average of both.
            opposite: whether the players have different hands.
        """
        names, arranged = sorted(matches), sorted(layout or matches)
        key = hashlib.sha256(json.dumps([self._version, names, arranged, discipline, opposite]).encode()).hexdigest()[:16]
        names_of_files = ("game", "hurry", "history", "tables")
        game_file, hurry_file, history_file, tables_file = (self._folder / f"{key}.{part}.safetensors" for part in names_of_files)
        if not tables_file.is_file():
            empty = None if arranged == names else self.fit(arranged).game
            fitted, hurry, shifts = self._fitted(tuple(names), empty)
            replace_file(history_file, save(shifts))
            if hurry is not None:
                hurry.save(hurry_file)
            if discipline is not None:
                fitted = fitted.profile(discipline)
            if opposite:
                fitted = fitted.between_hands
            game, _ = fitted.compiled()
            game.save(game_file)
            log_choice = pair_log_choices(fitted.models, game).astype(np.float64)
            replace_file(tables_file, save({"log_choice": log_choice, "behind": fitted.support.strokes}))
        game, tables = Game.load(game_file), load_file(tables_file)
        weight = np.tile(np.exp(tables["log_choice"]), game.n_blocks)
        hurry = Hurry.checked(read_tensors(hurry_file)) if hurry_file.is_file() else None
        bc = from_pair_probabilities(game, game.normalized(weight))
        remembers = HistoryPolicy.of(bc, load_file(history_file))
        return World(bc=bc, behind=tables["behind"], hurry=hurry, opposite=opposite, history=remembers)

    def layouts(self, matches: Sequence[str], shares: Sequence[float]) -> list[Game]:
        """Layouts of the game of some matches with several minimum shares of a legal shot type, not cached."""
        names = tuple(sorted(matches))
        rows, (fitted, *_) = self._strokes.rows.in_matches(names), self._fitted(names, None)
        return [layouts_of(rows, fitted.models, share)[0] for share in shares]

    def of_layouts(self, matches: Sequence[str], layouts: Sequence[Game]) -> list[World]:
        """Worlds of one fit with several layouts, not cached."""
        found, names = [], tuple(sorted(matches))
        fitted, hurry, _ = self._fitted(names, None)
        rows = self._strokes.rows.in_matches(names)
        train = rows if hurry is None else hurry.marked(rows)
        for empty in layouts:
            support, _ = supports(fitted.models, train.take(known_outcome(train)), empty)
            game, _ = dataclasses.replace(fitted, game=empty, support=support).compiled()
            weight = np.tile(np.exp(pair_log_choices(fitted.models, game).astype(np.float64)), game.n_blocks)
            bc = from_pair_probabilities(game, game.normalized(weight))
            found.append(World(bc=bc, behind=support.strokes, hurry=hurry))
        return found

    # The games of both disciplines, and of equal and different hands, come from one fit, one after the other.
    @functools.lru_cache(maxsize=1)  # noqa: B019  a fitter lives as long as its program
    def _fitted(self, names: tuple[str, ...], layout: Game | None) -> tuple[Fit, Hurry | None, Arrays]:
        train = self._strokes.rows.in_matches(names)
        hurry = fit_hurry(train, seed=self._seed)
        marked = train if hurry is None else hurry.marked(train)
        fitted = fit(marked, None, seed=self._seed, config=QUICK, layout=layout, report=self._report)
        return fitted, hurry, fit_history(fitted.models.networks, marked, None, QUICK.folds)[0]


def by_game(strokes: Strokes, profiles: bool) -> list[tuple[int | None, bool, Strokes]]:
    """The strokes of each discipline, or of both (None), between players of equal and of different hands."""
    codes = strokes.rows.codes
    kind = codes["discipline"] if profiles else np.full(len(strokes), -1)
    groups = np.unique(np.stack([kind, codes["hands"]]), axis=1).T
    return [
        (int(discipline) if profiles else None, bool(hands), strokes.take((kind == discipline) & (codes["hands"] == hands)))
        for discipline, hands in groups
    ]


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
        (fitter.fit(strokes.take(fold != k).matches, discipline=discipline, opposite=opposite), part)
        for k in range(count)
        for discipline, opposite, part in by_game(strokes.take(fold == k), profiles)
    )


def marked(parts: Iterable[tuple[World, Strokes]]) -> list[tuple[World, Strokes]]:
    """Worlds with strokes, whose strikers are hurried where the index of their world says so."""
    return [(world, strokes.marked(world.hurry)) for world, strokes in parts]
