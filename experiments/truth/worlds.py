"""Games fitted on subsets of the matches, with their average players and the number of examples of each stroke.

Transfer: a game is fitted on each half of the training matches. The fraction of rallies that a policy wins in the game in which
it was computed (home) is compared with the other game (away), both against the average player of the game.
"""

import dataclasses
import functools
import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.numpy import load_file, save
from scipy import stats

from experiments.truth.decisions import Promises, promises
from experiments.truth.matches import Strokes, folds_of, report
from shuttle_marl.base.arrays import F64, Bools
from shuttle_marl.base.files import replace_file, replace_sealed
from shuttle_marl.base.tensor_files import read_tensors
from shuttle_marl.dynamics.boosting import fit_hurry
from shuttle_marl.dynamics.choices import Arrays, fit_history
from shuttle_marl.dynamics.compiled import load_support, pair_log_choices
from shuttle_marl.dynamics.features import Hurry, load_hurry
from shuttle_marl.dynamics.fit import Fit, fit
from shuttle_marl.dynamics.fitted import FittedModels
from shuttle_marl.dynamics.models import QUICK
from shuttle_marl.dynamics.recovery import FittedRecovery, fit_recovery, load_recovery
from shuttle_marl.exact import best_response, evaluate, solve
from shuttle_marl.exact.profile import moved
from shuttle_marl.game.policy import TabulatedPolicy, from_pair_probabilities
from shuttle_marl.game.shipped import CARD, NETWORKS, PROFILES, load_game, model_folder, variant_of
from shuttle_marl.game.tables import Game
from shuttle_marl.policy import baselines
from shuttle_marl.policy.baselines import HistoryPolicy

_FILES: Final = ("history", "hurry", "recovery", "between", "game")  # parts of a cached fit; the game is written last
_SOURCES: Final = Path(__file__).parents[2] / "shuttle_marl" / "dynamics"
"""Source code of the models; fits are cached by its hash."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class World:
    """A game and how people play it."""

    bc: TabulatedPolicy  # the average player, on the game
    behind: F64  # [E] real strokes in the innermost cell of every edge: how much data stands behind a stroke
    hurry: Hurry | None = None  # index that decides which strikers are hurried in the game, if it knows them
    recovery: FittedRecovery | None = None  # where receivers wait and what that changes, if the strokes of its fit tell
    models: FittedModels | None = None  # the models that the game was compiled from; None: they are not known
    history: HistoryPolicy | None = None  # the average player who remembers the rally; None: the model has none
    between: "World | None" = None  # the world of players with different hands; None: the same one

    @property
    def game(self) -> Game:
        """The tables."""
        return self.bc.game

    def parts(self, strokes: Strokes) -> "Iterator[tuple[World, Bools]]":
        """The worlds of equal and of different hands in which strokes were played, with ``[N]`` which ones."""
        opposite = (strokes.rows.codes["hands"] == 1) & (self.between is not None)
        for world, which in ((self, ~opposite), (self.between, opposite)):
            if world is not None and which.any():
                yield world, which

    def judge(self, strokes: Strokes, of: "Callable[[World, Strokes], Sequence[NDArray[Any]]]") -> list[NDArray[Any]]:
        """``[N]`` arrays that a function finds for strokes, each in the world of its players' hands."""
        found: list[NDArray[Any]] = []
        for world, which in self.parts(strokes):
            arrays = of(world, strokes.take(which))
            found = found or [np.zeros(len(strokes), array.dtype) for array in arrays]
            for whole, array in zip(found, arrays, strict=True):
                whole[which] = array
        return found


def shipped_world(model: str, discipline: int | None = None) -> World:
    """The world of a shipped model or of a model folder, of both disciplines or of one."""
    folder, name = model_folder(model), None if discipline is None else PROFILES[discipline]
    worlds = []
    for opposite in (True, False):
        variant = variant_of(name, opposite=opposite)
        game = load_game(model if variant is None else f"{model}:{variant}")
        worlds.append(
            World(
                bc=baselines.load(None, game),
                behind=load_support(folder, opposite=opposite).strokes,
                hurry=load_hurry(folder),
                recovery=load_recovery(folder),
                models=FittedModels.load(folder),
                history=baselines.load_remembering(game) if baselines.remembers(game) else None,
            )
        )
    return dataclasses.replace(worlds[1], between=worlds[0])


def fingerprint(settings: str, strokes: Strokes) -> str:
    """SHA-256 of settings of a fit, of the source code of the models, and of strokes."""
    digest = hashlib.sha256(settings.encode())
    for source in sorted(_SOURCES.glob("*.py")):
        digest.update(source.read_bytes())
    for name, code in sorted(strokes.rows.codes.items()):
        digest.update(name.encode() + np.ascontiguousarray(code).tobytes())
    return digest.hexdigest()


class Fitter:
    """Fits worlds on subsets of the matches, and caches them in a folder.

    Args:
        strokes: of all matches.
        folder: cache; the key of a fit is a hash of its strokes, its layout, its seed and the source code of
            :mod:`shuttle_marl.dynamics`.
        seed: random seed of the fits.
    """

    def __init__(self, strokes: Strokes, folder: Path, *, seed: int) -> None:
        self._strokes, self._folder, self._seed = strokes, folder, seed
        self._version = fingerprint(str((seed, torch.__version__)), strokes)

    def fit(self, matches: Sequence[str], layout: Sequence[str] | None = None, *, discipline: int | None = None) -> World:
        """Fit the models on some matches, and compile their game.

        Args:
            matches: names of the training matches.
            layout: names of the matches whose game has the same strokes and the same legal replies, between equal hands; None:
                these. Worlds that share a layout can exchange policies.
            discipline: index into :data:`~shuttle_marl.dynamics.features.DISCIPLINES` of the one whose game it is; None: the
                average of both.
        """
        names, arranged = sorted(matches), sorted(layout or matches)
        key = hashlib.sha256(json.dumps([self._version, names, arranged, discipline]).encode()).hexdigest()[:16]
        file = {part: self._folder / f"{key}.{part}.safetensors" for part in _FILES}
        models = self._folder / f"{key}.models"
        if not file["game"].is_file():
            models.mkdir(parents=True, exist_ok=True)
            empty = None if arranged == names else self.fit(arranged).game
            fitted, hurry, recovery, shifts = self._fitted(tuple(names), empty)
            replace_file(file["history"], save(shifts))
            if hurry is not None:
                hurry.save(file["hurry"])
            if recovery is not None:
                replace_file(file["recovery"], recovery.to_bytes())
            replace_sealed(models / CARD, {"sha256": {NETWORKS: fitted.models.save(models)}})
            if empty is None:
                _save(file["between"], fitted.between_hands)
            _save(file["game"], fitted if discipline is None else fitted.profile(discipline))
        hurry = Hurry.checked(read_tensors(file["hurry"])) if file["hurry"].is_file() else None
        recovery = FittedRecovery.checked(read_tensors(file["recovery"])) if file["recovery"].is_file() else None
        world = _loaded(file["game"], file["history"], hurry)
        world = dataclasses.replace(world, recovery=recovery, models=FittedModels.load(models))
        between = _loaded(file["between"], file["history"], hurry) if file["between"].is_file() else None
        return dataclasses.replace(world, between=between)

    # The games of both disciplines, and of equal and different hands, come from one fit, one after the other.
    @functools.lru_cache(maxsize=1)  # noqa: B019  a fitter lives as long as its program
    def _fitted(self, names: tuple[str, ...], layout: Game | None) -> tuple[Fit, Hurry | None, FittedRecovery | None, Arrays]:
        train = self._strokes.rows.in_matches(names)
        hurry = fit_hurry(train, seed=self._seed)
        marked = train if hurry is None else hurry.marked(train)
        fitted = fit(marked, None, seed=self._seed, config=QUICK, layout=layout, report=report)
        found = fit_recovery(marked, fitted.predicted)
        return fitted, hurry, found, fit_history(fitted.models.choosers, marked, None, QUICK.folds)[0]


def _save(file: Path, fitted: Fit) -> None:
    """Write a compiled game, with the average player's choices and the support beside it."""
    game, _ = fitted.compiled()
    log_choice = pair_log_choices(fitted.models, game).astype(np.float64)
    replace_file(file.with_suffix(".tables"), save({"log_choice": log_choice, "behind": fitted.support.strokes}))
    game.save(file)


def _loaded(file: Path, history_file: Path, hurry: Hurry | None) -> World:
    game, tables = Game.load(file), load_file(file.with_suffix(".tables"))
    weight = np.tile(np.exp(tables["log_choice"]), game.n_blocks)
    bc = from_pair_probabilities(game, game.normalized(weight))
    return World(bc=bc, behind=tables["behind"], hurry=hurry, history=HistoryPolicy.of(bc, load_file(history_file)))


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


def judged_by(parts: Sequence[tuple[World, Strokes]]) -> tuple[Strokes, Promises]:
    """The strokes of all parts, and their promises."""
    found = [world.judge(strokes, lambda w, part: tuple(vars(promises(w.bc, part)).values())) for world, strokes in parts]
    return Strokes.joined([strokes for _, strokes in parts]), Promises.joined([Promises(*arrays) for arrays in found])


def transfer(strokes: Strokes, fitter: Fitter, *, halvings: int, seed: int) -> dict[str, dict[str, float]]:
    """Fraction of rallies won at home and away, and the fraction ``kept`` of the advantage over one half.

    Args:
        strokes: of the matches to halve.
        fitter: fits the games.
        halvings: how often; each gives two directions.
        seed: of the halvings.

    Returns:
        For ``best_response`` and ``minimax``: ``home``, ``away``, ``kept``, and its 95 % interval ``low`` to ``high``
        (Student's t over the directions) with their number ``directions``.
    """
    pairs = []
    for number in range(halvings):
        half = folds_of(strokes, 2, seed + number)
        one, other = (fitter.fit(strokes.take(half == side).matches, layout=strokes.matches) for side in (0, 1))
        pairs += [(one, other), (other, one)]
    return transferred(pairs)


def transferred(pairs: Iterable[tuple[World, World]]) -> dict[str, dict[str, float]]:
    """Figures of :func:`transfer` for pairs of home and away worlds with the same layout."""
    found: dict[str, list[tuple[float, float]]] = {"best_response": [], "minimax": []}
    for home, away in pairs:
        policies = {"best_response": best_response(home.bc).policy, "minimax": solve(home.game).policy[0]}
        for name, policy in policies.items():
            found[name].append((wins(policy, home), wins(policy, away)))
    return {name: _summary(np.array(pairs)) for name, pairs in found.items()}


def wins(policy: TabulatedPolicy, world: World) -> float:
    """Share of the rallies that a policy wins against the average player of a world with the same layout."""
    return float(evaluate(moved(policy, world.game), world.bc).odds().rally)


def _summary(pairs: Any) -> dict[str, float]:
    home, away = pairs.T
    kept = (away - 0.5) / (home - 0.5)
    width = stats.t.ppf(0.975, len(kept) - 1) * stats.sem(kept)
    return {
        "home": float(home.mean()),
        "away": float(away.mean()),
        "kept": float(kept.mean()),
        "low": float(kept.mean() - width),
        "high": float(kept.mean() + width),
        "directions": len(kept),
    }
