"""From a stroke table to a model folder, and back to its scores."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import torch
from safetensors.numpy import save

from shuttle_marl import __version__
from shuttle_marl.arrays import F32
from shuttle_marl.data import load_strokes
from shuttle_marl.data.upstream import Split
from shuttle_marl.dynamics.card import strokes_hash, write_card
from shuttle_marl.dynamics.compiled import (
    CREDIBLE,
    LEAST_END,
    PRIOR_STROKES,
    Support,
    compile_game,
    pair_log_choices,
    pair_probabilities,
)
from shuttle_marl.dynamics.evaluate import evaluate, extremes, health
from shuttle_marl.dynamics.features import Rows, rows_from_strokes
from shuttle_marl.dynamics.fit import THREADS, fit
from shuttle_marl.dynamics.fitted import FittedModels, ModelError
from shuttle_marl.dynamics.network import QUICK, TrainingConfig
from shuttle_marl.dynamics.players import PlayerChoices
from shuttle_marl.dynamics.prior import Prior, fit_from
from shuttle_marl.dynamics.splits import LEAST_FOR_REFITS, require_enough, rows_of, train_and_validation
from shuttle_marl.errors import ShuttleError
from shuttle_marl.exact.profile import PairPolicy
from shuttle_marl.files import replace_file
from shuttle_marl.game.shipped import (
    BC,
    GAME,
    PROFILES,
    REFITS,
    SUPPORT,
    VARIANTS,
    load_game,
    model_folder,
    read_model,
    read_model_card,
)
from shuttle_marl.game.stroke import N_SHOTS, N_TECHNIQUES
from shuttle_marl.game.tables import Game
from shuttle_marl.game.variants import packed
from shuttle_marl.tensor_files import checked

_RULE: Final = (
    f"Faults and winners are counted in nested cells: shot type and area; the whole stroke; against one incoming shot type; "
    f"against one incoming shot type and area. Each cell's rate is shrunk to that of the cell around it with the weight of "
    f"{PRIOR_STROKES:g} strokes. The predicted probabilities of a legal pair lie inside the central {100 * CREDIBLE:g} % of the "
    f"Beta posterior of its innermost cell. Of every stroke but the serve at least {100 * LEAST_END:g} % end the rally. Strokes "
    f"and events are those of the innermost cell; faults whose target is not known count in parts."
)


_CITATIONS: Final = {"ShuttleSet": "arXiv:2306.04948 (ShuttleSet)", "ShuttleSet22": "arXiv:2306.15664 (ShuttleSet22)"}


def make_model(
    data: Path,
    out: Path,
    *,
    seed: int,
    refits: int | None = None,
    validation_share: float | None = None,
    prior: str | None = None,
    config: TrainingConfig | None = None,
    report: Callable[[str], None],
) -> dict[str, Any]:
    """Fit, compile, check and write a model folder.

    Args:
        data: folder of the download, or a Parquet file.
        out: folder to write.
        seed: of all random numbers.
        refits: number of fits on resampled matches, whose games become variants; None: the usual number, none for few matches.
        validation_share: of the matches of no published data set that are for validation; None: there are none of those.
        prior: model that is corrected instead of a fit from nothing: a shipped one or a folder.
        config: of the networks; None: the default, and quick refits.
        report: called with a line before each stage.

    Returns:
        The model card.

    Raises:
        ShuttleError: the data are too few, or their matches have no split.
    """
    report("reading strokes")
    strokes = load_strokes(data)
    rows = rows_from_strokes(strokes)
    train, validation = train_and_validation(rows, validation_share)
    require_enough(train, validation, prior=prior is not None)
    refits = _checked_refits(refits, len(np.unique(train.match)))
    start = None if prior is None else _prior(prior)
    fitted = (
        fit(train, validation, seed=seed, config=config, report=report)
        if start is None
        else fit_from(start, train, validation, report=report)
    )
    report("compiling the game")
    game, probabilities = fitted.compiled()
    log_choice = pair_log_choices(fitted.models, game)
    report("compiling the games of men's and women's singles")
    # Of one discipline alone, the game is that of this discipline already.
    played = np.flatnonzero(fitted.models.share).tolist()
    profiles = {PROFILES[discipline]: fitted.profile(discipline) for discipline in played} if len(played) > 1 else {}
    variants = {name: profile.compiled()[0] for name, profile in profiles.items()}
    of_profiles = {name: pair_log_choices(profile.models, game) for name, profile in profiles.items()}
    report("solving the game")
    weight = np.tile(np.exp(log_choice.astype(np.float64)), game.n_blocks)
    solved = health(PairPolicy(game=game, probability=game.normalized(weight)), fitted.support.strokes)
    fitted.models.save(out)
    save_support(out, fitted.support)
    game.save(out / GAME)
    save_clones(out, fitted.models.choices, log_choice, of_profiles)
    scores = evaluate(fitted.models, train, validation, report=report)
    card = {
        "name": out.name,
        "version": __version__,
        "seed": seed,
        "game_hash": game.hash,
        "data": {
            "hash": strokes_hash(strokes),
            "train_matches": len(np.unique(train.match)),
            "train_strokes": len(train),
            "validation_matches": len(np.unique(validation.match)),
            "validation_strokes": len(validation),
            "validation_share": validation_share,
            "sources": sorted(set(strokes["source"].unique().to_pylist())),
        },
        "game": {
            "strokes": game.n_strokes,
            "states": game.n_states,
            "legal_pairs": game.n_pairs,
            "efforts": game.levels,
            "clipped": float(probabilities.clipped.mean()),
            "share": dict(zip(PROFILES, fitted.models.share.tolist(), strict=True)),
        },
        "players": list(fitted.models.choices.players),
        "chosen": fitted.chosen,
        "validation": scores,
        "health": solved,
        "support_rule": _RULE,
        "extremes": extremes(game, fitted.support),
        "citations": [
            citation for source, citation in _CITATIONS.items() if prior or source in set(strokes["source"].to_pylist())
        ],
    }
    save_variants(out, game, variants, card)
    for number in range(1, refits + 1):
        told = _behind(f"refit {number} of {refits}: ", report)
        drawn = resampled(train, [seed, number])
        refit = (
            fit(drawn, None, seed=seed + 1000 * number, config=config or QUICK, layout=game, report=told)
            if start is None
            else fit_from(start, drawn, None, report=told)
        )
        told("compiling")
        variants[str(number)] = refit.compiled()[0]
        # After each one, so that what is there is whole if the command is interrupted.
        save_variants(out, game, variants, card)
    return read_model_card(out)


def _checked_refits(refits: int | None, matches: int) -> int:
    """The number of refits for a number of train matches.

    Raises:
        ShuttleError: refits were asked for, and the matches are too few.
    """
    if refits is None:
        return REFITS if matches >= LEAST_FOR_REFITS else 0
    if refits and matches < LEAST_FOR_REFITS:
        raise ShuttleError(
            f"--refits {refits}: {matches} train matches, at least {LEAST_FOR_REFITS} needed: a resample of fewer holds hardly "
            "more than a half of them; give --refits 0"
        )
    return refits


def _prior(name: str) -> Prior:
    folder = model_folder(name)
    return Prior(folder=folder, models=FittedModels.load(folder), game=load_game(str(folder)), support=load_support(folder))


def _behind(words: str, report: Callable[[str], None]) -> Callable[[str], None]:
    return lambda line: report(words + line)


def resampled(rows: Rows, seed: Sequence[int]) -> Rows:
    """As many matches of each discipline as there are, drawn with replacement: a resample of the bootstrap.

    A match that was drawn twice keeps its one number, so networks that leave it out leave out both copies.
    """
    rng = np.random.default_rng(seed)
    matches, first = np.unique(rows.match, return_index=True)
    discipline = rows.codes["discipline"][first]
    drawn = [rng.choice(matches[discipline == kind], (discipline == kind).sum()) for kind in np.unique(discipline)]
    return rows.take(np.concatenate([np.flatnonzero(rows.match == match) for match in np.sort(np.concatenate(drawn))]))


def save_clones(
    folder: Path,
    choices: PlayerChoices,
    log_choice: F32,
    profiles: Mapping[str, F32],
) -> None:
    """Write the behaviour-cloned players of a model.

    Args:
        folder: of the model.
        choices: shifts of single players.
        log_choice: ``[base pairs]`` of the average player.
        profiles: the same of the average player of each discipline.
    """
    clones: dict[str, npt.NDArray[Any]] = {
        "log_choice": log_choice,
        **{f"log_choice.{name}": values.astype(np.float16) for name, values in profiles.items()},
        "style": choices.style.reshape(*choices.style.shape[:3], N_SHOTS, N_TECHNIQUES),
        "area": choices.area,
    }
    replace_file(folder / BC, save(clones, metadata={"players": json.dumps(choices.players)}))


def save_variants(folder: Path, game: Game, variants: Mapping[str, Game], card: dict[str, Any]) -> None:
    """Write the variants of a model, and its card with them."""
    if variants:
        replace_file(folder / VARIANTS, packed(game, variants))
    else:
        (folder / VARIANTS).unlink(missing_ok=True)  # of a model that is replaced
    write_card(folder, {**card, "variants": list(variants)})


def evaluate_model(data: Path, folder: Path, split: Split, *, report: Callable[[str], None]) -> dict[str, Any]:
    """Scores of a model folder on a split; see :func:`shuttle_marl.dynamics.evaluate.evaluate`.

    Matches of no published data set are split as they were for the fit.

    Raises:
        ShuttleError: the data hold no match of the split.
    """
    torch.set_num_threads(THREADS)
    report("reading strokes")
    rows = rows_from_strokes(load_strokes(data))
    share = read_model_card(folder)["data"].get("validation_share")
    if share is None:
        train, test = rows_of(rows, "train"), rows_of(rows, split)
    elif split == "test":
        raise ShuttleError("--split test: only the published matches have one; choose train or validation")
    else:
        train, validation = train_and_validation(rows, share)
        test = train if split == "train" else validation
    return evaluate(FittedModels.load(folder), train, test, report=report)


def save_support(folder: Path, support: Support) -> None:
    """Write the support of a model."""
    fields = ("strokes", "faults", "winners", "fault_range", "winner_range")
    replace_file(folder / SUPPORT, save({name: np.ascontiguousarray(getattr(support, name)) for name in fields}))


def load_support(folder: Path) -> Support:
    """Read the support of a model.

    Raises:
        ModelError: the file is missing or not the one of the model card, or is no support.
        GameError: the model card cannot be read.
    """
    try:
        arrays = read_model(folder, SUPPORT).arrays
        edges = arrays["strokes"].shape[:1]
        shapes = {"strokes": edges, "faults": edges, "winners": edges, "fault_range": (*edges, 2), "winner_range": (*edges, 2)}
        return Support(**{name: checked(arrays[name], np.float64, shape) for name, shape in shapes.items()})
    except (OSError, KeyError, ValueError) as error:
        raise ModelError(f"{folder / SUPPORT}: no readable support ({error}); fit or install the model again") from error


def reference_game(folder: Path, game: Game, *, pessimism: float = 0.0) -> Game:
    """Compile the tables again from the torch models: the reference for the tables in the folder."""
    models = FittedModels.load(folder)
    return compile_game(game, pair_probabilities(models, game, load_support(folder), pessimism=pessimism))
