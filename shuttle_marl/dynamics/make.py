"""Model folders: splits of the matches, fit, refits, files, and scores."""

import contextlib
import functools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shuttle_marl import __version__
from shuttle_marl.base.arrays import F32, I16
from shuttle_marl.base.cluster import WorkerPool, check_processes
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import content_hash, replace_file
from shuttle_marl.base.pytorch import own_settings
from shuttle_marl.base.tensor_files import tensor_bytes
from shuttle_marl.data import read_matches
from shuttle_marl.data.matches import copies
from shuttle_marl.data.table import strokes_hash
from shuttle_marl.data.upstream import Split, matches_of, split_of
from shuttle_marl.dynamics.boosting import fit_hurry
from shuttle_marl.dynamics.choices import fit_history
from shuttle_marl.dynamics.compiled import THREADS, pair_log_choices, save_support
from shuttle_marl.dynamics.evaluate import REQUIRED, criteria, evaluate, health, play_of_people, variety_of, write_card
from shuttle_marl.dynamics.features import Hurry, Rows, load_hurry, marked_rows, rows_from_strokes
from shuttle_marl.dynamics.fit import Fit, Report, fit
from shuttle_marl.dynamics.fitted import FittedModels, PlayerChoices
from shuttle_marl.dynamics.habits import save_habits
from shuttle_marl.dynamics.models import QUICK, EnsembleConfig
from shuttle_marl.dynamics.recovery import save_recovery
from shuttle_marl.dynamics.skill import FittedSkill, check, fit_skill, summary
from shuttle_marl.exact.profile import PairPolicy
from shuttle_marl.game import shipped
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.shipped import packed
from shuttle_marl.game.stroke import N_SHOTS, N_TECHNIQUES
from shuttle_marl.game.tables import Game

MIN_MATCHES_FOR_REFITS: Final = 6  # training matches of refits: most resamples of fewer contain only half of them
MIN_STROKES: Final = 1000  # training strokes: some nine for each shot type and area
MIN_MATCHES: Final = 2  # training matches: members of an ensemble leave one out


def rows_of(rows: Rows, split: Split) -> Rows:
    """Strokes of a split of the published matches. Raises ShuttleError: the data contain none of its matches."""
    chosen = rows.in_matches(matches_of(split))
    if not len(chosen):
        raise ShuttleError(f"no match of the split {split!r} in the data; is the download complete?")
    return chosen


def train_and_validation(rows: Rows, share: float | None) -> tuple[Rows, Rows]:
    """Split rows by match into training and validation; ``share``: fraction of the unpublished matches for validation, at least
    one and not all, in the order of the SHA-256 of their names (None: all matches are published ones, whose split is fixed).
    Raises ShuttleError: an invalid share, a share without unpublished matches or vice versa, or an empty split."""
    names = [rows.matches[i] for i in np.unique(rows.match)]
    own = sorted((name for name in names if split_of(name) is None), key=lambda name: content_hash(name.encode()))
    if share is None:
        if own:
            raise ShuttleError(
                f"{own[0]!r} is no published match, so it has no fixed split: "
                "--validation-share 0.2 takes a fifth of your matches to check the fit"
            )
        return rows_of(rows, "train"), rows_of(rows, "validation")
    if not 0 < share < 1:
        raise ShuttleError(f"--validation-share {share:g}: expected a number between 0 and 1, such as 0.2")
    if not own:
        raise ShuttleError("--validation-share: all matches are published ones, whose split is fixed; omit it")
    aside = min(max(1, math.ceil(round(share * len(own), 9))), len(own) - 1)
    validation = rows.in_matches([*own[:aside], *matches_of("validation")])
    train = rows.in_matches([*own[aside:], *matches_of("train")])
    return train, validation


def require_enough(train: Rows, validation: Rows) -> None:
    """Refuse too little data. Raises ShuttleError: too few matches or strokes; with the required number and the reason."""
    matches = len(np.unique(train.match))
    if matches < MIN_MATCHES or not len(validation):
        raise ShuttleError(
            f"number of matches: {matches + len(np.unique(validation.match))}; a model needs {MIN_MATCHES + 1} or more, one of "
            "them to check the fit and one that parts of the models leave out; reports need one, and no model"
        )
    if len(train) < MIN_STROKES:
        raise ShuttleError(
            f"{len(train)} strokes in {matches} train matches, at least {MIN_STROKES} needed: fewer are less than nine for each "
            f"of the {N_SHOTS * N_AREAS} kinds of stroke (shot type and area), too few to estimate rates; reports need no model"
        )


def resampled(rows: Rows, seed: Sequence[int]) -> Rows:
    """Bootstrap resample of the matches, by discipline. Copies of a match have the same number, so networks that leave it out
    leave out all copies."""
    rng = np.random.default_rng(seed)
    matches, first = np.unique(rows.match, return_index=True)
    discipline = rows.codes["discipline"][first]
    names = [rng.choice(matches[discipline == kind], (discipline == kind).sum()) for kind in np.unique(discipline)]
    return rows.take(np.concatenate([np.flatnonzero(rows.match == match) for match in np.sort(np.concatenate(names))]))


ENOUGH_STROKES: Final = 20_000  # they fill most cells, and show what people play in 1 % of cases; with fewer, a warning


@own_settings(THREADS)
def fit_model(
    data: Path | str,
    out: Path | str,
    *,
    seed: int = 0,
    refits: int | None = None,
    validation_share: float | None = None,
    config: EnsembleConfig | None = None,
    jobs: int = 1,
    report: Report = lambda _: None,
) -> dict[str, Any]:
    """Fit and compile models, and write them with their card.

    Args:
        data: folder of the download, or a Parquet file.
        refits: number of fits on resampled matches, whose games become variants; None: the default number, 0 for few matches.
        validation_share: fraction of the unpublished matches for validation; None: all matches are published ones.
        config: settings of the networks; None: the default, and quick refits.
        jobs: number of refits at once, one process each; it does not change the result.
        report: called with a line before each stage.

    Returns:
        The model card.

    Raises:
        ShuttleError: the data are too few, their matches have no split, or the game rewards strokes that nobody plays
            (:data:`shuttle_marl.dynamics.evaluate.REQUIRED`).
    """
    check_processes(jobs)
    data, out = Path(data), Path(out)
    report("reading strokes")
    strokes = read_matches(data)
    if twice := copies(strokes):
        raise ShuttleError(f"{data}: {twice[0]} The fit would count its strokes twice, and check itself with them; remove one")
    rows = rows_from_strokes(strokes)
    train, validation = train_and_validation(rows, validation_share)
    require_enough(train, validation)
    report("hurried strikers")
    hurry = fit_hurry(train, seed=seed)
    if hurry is not None:
        train, validation = hurry.marked(train), hurry.marked(validation)
    refits = _checked_refits(refits, len(np.unique(train.match)))
    sources = dict(zip(strokes["match"].to_pylist(), strokes["source"].to_pylist(), strict=True))
    fitted = fit(train, validation, seed=seed, config=config, report=report)
    game, variants, skill, clipped, solved = save_fit(out, fitted, sources, report=report)
    fitted_on = pa.array([train.matches[i] for i in np.unique(train.match).tolist()])
    if hurry is None:
        (out / shipped.HURRY).unlink(missing_ok=True)  # of a replaced model
    else:
        hurry.save(out / shipped.HURRY)
    report("positions of receivers")
    recovery = save_recovery(out, train, fitted.predicted)
    report("choices by the rally so far")
    shifts, history = fit_history(fitted.models.choosers, train, validation, (config or EnsembleConfig()).folds)
    replace_file(out / shipped.HISTORY, tensor_bytes(shifts, {}))
    save_habits(out, strokes.filter(pa.compute.is_in(strokes["match"], fitted_on)), skill.skill.players)
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
            "clipped": clipped,
            "share": dict(zip(shipped.PROFILES, fitted.models.share.tolist(), strict=True)),
        },
        "hurried": _hurried(train, hurry),
        "recovery": recovery,
        "people": play_of_people(Rows.joined([train, validation])),
        "players": list(fitted.models.choices.players),
        "chosen": fitted.chosen,
        "history": history,
        "skill": summary(skill, check(fitted.predicted, sources, skill.sd)),
        "validation": evaluate(fitted.models, train, validation, report=report),
        "health": solved,
    }
    save_variants(out, game, variants, card)
    if refits:
        task = functools.partial(_refit, train=train, layout=game, seed=seed, config=config or QUICK)
        with contextlib.nullcontext() if jobs == 1 else WorkerPool(min(jobs, refits)) as pool:
            apply = map if pool is None else pool.map
            for number, refit in enumerate(apply(task, range(1, refits + 1)), 1):
                report(f"refit {number} of {refits} is fitted")
                variants[str(number)] = refit
                # After each refit, so that an interrupted command leaves a complete folder.
                save_variants(out, game, variants, card)
    if others := [variant for name, variant in variants.items() if shipped.is_refit(name)]:
        report("solving the refits")
        write_card(out, {**card, "health": {**solved, "refits": variety_of(others)}, "variants": list(variants)})
    return shipped.read_model_card(out)


@own_settings(THREADS)
def _refit(number: int, *, train: Rows, layout: Game, seed: int, config: EnsembleConfig) -> Game:
    rows = resampled(train, [seed, number])
    # Processes share one terminal, so they report nothing.
    return fit(rows, None, seed=seed + 1000 * number, config=config, layout=layout, report=lambda _: None).compiled()[0]


def _hurried(train: Rows, hurry: Hurry | None) -> dict[str, Any]:
    rally = train.stroke > 1
    known = train.hurried[rally] >= 0
    by = None if not known.any() else "table" if hurry is None else "index"
    return {
        "share": float((train.hurried == 1).mean()),
        "known": float(known.mean()),
        "positions": bool(train.tracked.any()),
        "by": by,
    }


def save_fit(
    out: Path, fitted: Fit, sources: Mapping[str, str], *, report: Report, check: bool = True
) -> tuple[Game, dict[str, Game], FittedSkill, float, dict[str, Any]]:
    """Compile a fit, fit the skill of its players, and write all files of a model folder but the variants and the card.

    Args:
        sources: data set of each match by name.
        check: refuse a game whose best play consists of strokes that nobody plays.

    Returns:
        The game; those of men's and women's singles by name, none if the fit has a single discipline; the skill; the fraction of
        the legal pairs that were clipped to the supported range; and :func:`~shuttle_marl.dynamics.evaluate.health` of the game.

    Raises:
        ShuttleError: the game is refused; nothing is written.
    """
    report("compiling the game")
    game, probabilities = fitted.compiled()
    log_choice = pair_log_choices(fitted.models, game)
    report("solving the game")
    weight = np.tile(np.exp(log_choice.astype(np.float64)), game.n_blocks)
    solved = health(PairPolicy(game=game, probability=game.normalized(weight)), fitted.support.strokes)
    enough = fitted.support.strokes.sum() >= ENOUGH_STROKES
    required = REQUIRED if enough else {"impossible": REQUIRED["impossible"]}
    if check and (failed := [text for text, within in criteria(solved, required).values() if not within]):
        raise ShuttleError(
            f"the game of these strokes rewards what people do not play ({'; '.join(failed)}), so its best play would be no "
            "badminton; nothing was written. Add matches"
        )
    report("compiling the games of men's and women's singles, and of players with different hands")
    # With a single discipline, the game is that of this discipline.
    played = np.flatnonzero(fitted.models.share).tolist()
    profiles = {shipped.PROFILES[k]: fitted.profile(k) for k in played} if len(played) > 1 else {}
    variants = {name: profile.compiled()[0] for name, profile in profiles.items()}
    of_profiles = {name: pair_log_choices(profile.models, game) for name, profile in profiles.items()}
    between = fitted.between_hands
    opposite = between.compiled()[0]
    report("skill of players")
    skill = fit_skill(fitted.predicted, sources)
    fitted.models.save(out)
    save_support(out, fitted.support, between.support)
    game.save(out / shipped.GAME)
    opposite.save(out / shipped.OPPOSITE_GAME)
    save_clones(out, fitted.models.choices, log_choice, of_profiles, pair_log_choices(between.models, opposite))
    skill.save(out)
    return game, variants, skill, float(probabilities.clipped.mean()), solved


def _checked_refits(refits: int | None, matches: int) -> int:
    """Number of refits; refused where there are too few matches for them."""
    if refits is None:
        return shipped.REFITS if matches >= MIN_MATCHES_FOR_REFITS else 0
    if refits and matches < MIN_MATCHES_FOR_REFITS:
        raise ShuttleError(
            f"--refits {refits}: {matches} train matches, at least {MIN_MATCHES_FOR_REFITS} needed: a resample of fewer "
            "contains hardly more than half of them; use --refits 0"
        )
    return refits


def save_clones(folder: Path, choices: PlayerChoices, log_choice: F32, profiles: Mapping[str, F32], opposite: F32) -> None:
    """Write the behaviour-cloned players of a model; ``log_choice``: ``[base pairs]`` log-probabilities of the average player;
    ``profiles``: those of the average player of each discipline; ``opposite``: ``[base pairs]`` those in the game of players with
    different hands."""

    def units(values: F32) -> I16:
        return np.rint(values * shipped.CHOICE_UNITS).astype(np.int16)

    clones: dict[str, npt.NDArray[Any]] = {
        "choice": units(log_choice),
        # Differences of disciplines are small, and pack well.
        **{f"choice.{name}": units(values - log_choice) for name, values in profiles.items()},
        f"choice.{shipped.OPPOSITE}": units(opposite),
        "style": choices.style.reshape(*choices.style.shape[:3], N_SHOTS, N_TECHNIQUES),
        "area": choices.area,
    }
    replace_file(folder / shipped.BC, tensor_bytes(clones, {"players": json.dumps(choices.players)}, pack=True))


def save_variants(folder: Path, game: Game, variants: Mapping[str, Game], card: dict[str, Any]) -> None:
    """Write the variants of a model and its card."""
    if variants:
        replace_file(folder / shipped.VARIANTS, packed(game, variants, coarse=list(filter(shipped.is_refit, variants))))
    else:
        (folder / shipped.VARIANTS).unlink(missing_ok=True)  # of a replaced model
    write_card(folder, {**card, "variants": list(variants)})


@own_settings(THREADS)
def evaluate_model(data: Path, folder: Path, split: Split, *, report: Callable[[str], None]) -> dict[str, Any]:
    """Scores of a model folder on a split; see :func:`shuttle_marl.dynamics.evaluate.evaluate`.

    Unpublished matches are split as for the fit.

    Raises:
        ShuttleError: the data contain no match of the split.
    """
    report("reading strokes")
    rows = marked_rows(read_matches(data), load_hurry(folder))
    share = shipped.read_model_card(folder)["data"].get("validation_share")
    if share is None:
        train, test = rows_of(rows, "train"), rows_of(rows, split)
    elif split == "test":
        raise ShuttleError("--split test: only the published matches have one; choose train or validation")
    else:
        train, validation = train_and_validation(rows, share)
        test = train if split == "train" else validation
    return evaluate(FittedModels.load(folder), train, test, report=report)
