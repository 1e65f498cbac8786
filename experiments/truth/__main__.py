"""``python -m experiments.truth --data DATA (--split validation | --cross 4) [--json]``"""

import sys
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import tyro

from experiments.truth import decisions, likeness
from experiments.truth.decisions import Promises, calibration, judged_strokes, memory
from experiments.truth.matches import Comparison, Strokes, of_splits, strokes_of
from experiments.truth.recovery import recovery_effects
from experiments.truth.worlds import Fitter, World, by_discipline, cross_parts, judged_by, marked, shipped_world, transfer
from shuttle_marl.base.arrays import I64
from shuttle_marl.commands.cli import entry_point
from shuttle_marl.data import read_matches
from shuttle_marl.data.simulated import simulate
from shuttle_marl.dynamics.evaluate import health
from shuttle_marl.exact import evaluate
from shuttle_marl.game.pairs import Looks
from shuttle_marl.game.policy import UniformPolicy, tabulate
from shuttle_marl.game.shipped import factors_of, model_folder

_SIMULATED: Final = 4  # simulated matches for every real one


def truth(
    options: tyro.conf.OmitArgPrefixes[Comparison], *, train_only: bool = False, profiles: bool = False, halvings: int = 2
) -> None:
    """Compare the predictions of a game with matches that were not used to fit it.

    Args:
        options: what is compared.
        train_only: with --cross, use the training matches only: the factors of the model card (`card --truth`).
        profiles: compare every match with the game of its own discipline instead of the game of both.
        halvings: halvings of the training matches for the transfer; two games are fitted for each; 0: no transfer.
    """
    strokes, seed, game, cross = strokes_of(read_matches(options.data)), options.seed, options.game, options.cross
    training: list[tuple[World, Strokes]] = []
    fitter = Fitter(strokes, options.fits, seed=seed)
    if cross is not None:
        judged = of_splits(strokes, "train") if train_only else of_splits(strokes, "train", "validation")
        parts = cross_parts(judged, cross, fitter, seed=seed, profiles=profiles)
    else:
        judged = of_splits(strokes, options.split or "validation")
        parts = marked((shipped_world(game, discipline), part) for discipline, part in by_discipline(judged, profiles))
        if options.split != "train":
            seen = of_splits(strokes, "train")
            training = [(shipped_world(game, discipline), part) for discipline, part in by_discipline(seen, profiles)]
    real, promised = judged_by(parts)
    factors = None if cross is not None else factors_of(model_folder(game))
    result: dict[str, Any] = {"train_only": train_only, **compare(parts, real, promised, seed, training)}
    if cross is not None or factors is not None:
        result["calibration"] = calibration(real, promised, parts_of(parts), factors, seed)
    if halvings:
        result["transfer"] = transfer(of_splits(strokes, "train"), fitter, halvings=halvings, seed=seed)
    options.show(result, "truth", "truth_shots", "truth_memory", "truth_forecasts", "truth_told_apart")


def compare(
    parts: Sequence[tuple[World, Strokes]],
    real: Strokes,
    promised: Promises,
    seed: int,
    training: Sequence[tuple[World, Strokes]] = (),
) -> dict[str, Any]:
    """All figures but the calibration and the transfer.

    Args:
        parts: worlds, each with matches that took no part in fitting it.
        real, promised: their strokes and promises, see :func:`judged_by`.
        seed: random seed of the simulated matches and of the resampling.
        training: worlds with other matches, on which trees learn to tell simulated rallies from real ones; empty: on the same.
    """
    legality = [world.judge(strokes, lambda w, part: judged_strokes(w.game, part)) for world, strokes in parts]
    known, forbidden = (np.concatenate(side) for side in zip(*legality, strict=True))
    simulated = _rallies(parts, seed)

    def told_apart(rallies: Strokes, *, history: bool = False) -> dict[str, Any]:
        if not training:
            return likeness.two_sample_auc(rallies, real, seed)
        seen = _rallies(training, seed + len(parts), history=history), Strokes.joined([strokes for _, strokes in training])
        return likeness.two_sample_auc(rallies, real, seed, training=seen)

    remembers = all(world.history is not None for world, _ in parts)
    return {
        "matches": len(np.unique(real.rows.match)),
        "strokes": len(real),
        "decision_slope": decisions.decision_slope(real, promised),
        "value_error": decisions.value_error(real, promised),
        "promised_realised": decisions.promised_realised(real, promised),
        "value_log_loss": decisions.value_log_loss(real, promised),
        "forecasts": decisions.forecast_errors(real, promised, seed),
        "memory": memory(real, promised),
        "illegal": float(forbidden.sum() / known.sum()),
        "two_sample_auc": told_apart(simulated),
        "two_sample_auc_history": told_apart(_rallies(parts, seed, history=True), history=True) if remembers else None,
        "rally_length": likeness.rally_length(simulated, real, seed),
        "divergence": likeness.divergence(simulated, real, seed),
        "recovery": recovery_effects(parts, seed),
        "random_vs_bc": float(np.mean([_random_wins(world) for world, _ in parts])),
        "support": _mean([health(world.bc, world.behind)["thin"] for world, _ in parts]),
    }


def parts_of(parts: Sequence[tuple[World, Strokes]]) -> I64:
    """``[N]`` part of each stroke of :func:`judged_by`."""
    return np.repeat(np.arange(len(parts)), [len(strokes) for _, strokes in parts])


def _rallies(parts: Sequence[tuple[World, Strokes]], seed: int, *, history: bool = False) -> Strokes:
    return Strokes.joined([_simulated(world, strokes, seed + i, history=history) for i, (world, strokes) in enumerate(parts)])


def _simulated(world: World, real: Strokes, seed: int, *, history: bool = False) -> Strokes:
    """Simulated matches of average players, between equal and different hands as often as real ones."""
    found = []
    for side, which in world.parts(real):
        matches = _SIMULATED * len(np.unique(real.rows.match[which]))
        player = side.history if history and side.history is not None else side.bc
        looks = Looks(hands=("right", "right" if side is world else "left"))
        players = {"one": player, "other": player}
        found.append(strokes_of(simulate(side.game, players, matches=matches, seed=seed, looks=lambda *_, looks=looks: looks)))
    return Strokes.joined(found)


def _random_wins(world: World) -> float:
    return float(evaluate(tabulate(UniformPolicy(), world.game), world.bc).odds().rally)


def _mean(dictionaries: Sequence[dict[str, float]]) -> dict[str, float]:
    return {name: float(np.mean([one[name] for one in dictionaries])) for name in dictionaries[0]}


main = entry_point(truth, "python -m experiments.truth", __doc__ or "")


if __name__ == "__main__":
    sys.exit(main())
