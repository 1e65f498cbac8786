"""``python -m experiments.truth --data DATA (--split validation | --cross 4) [--json]``"""

import json as json_format
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from experiments.truth import decisions, likeness
from experiments.truth.calibration import calibration
from experiments.truth.decisions import Promises
from experiments.truth.legality import illegal, judged_strokes
from experiments.truth.matches import Strokes, of_splits, strokes_of
from experiments.truth.memory import memory
from experiments.truth.paired import differences, load_values, save_values
from experiments.truth.recovery import recovery_effects
from experiments.truth.transfer import thin_support, transfer
from experiments.truth.worlds import Fitter, World, by_discipline, cross_parts, judged_by, marked, shipped_world
from shuttle_marl.analysis.strokes import simulate
from shuttle_marl.base.arrays import I64
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.runs import describe, write_json
from shuttle_marl.commands.cli import run
from shuttle_marl.data import Split, load_strokes
from shuttle_marl.exact import evaluate
from shuttle_marl.game.pairs import Looks
from shuttle_marl.game.policy import UniformPolicy
from shuttle_marl.game.shipped import factors_of, model_folder
from shuttle_marl.game.tabulated import tabulate

_SIMULATED: Final = 4
"""Simulated matches for every real one."""


def truth(
    *,
    data: Path,
    split: Split | None = None,
    cross: int | None = None,
    game: str = "default",
    train_only: bool = False,
    profiles: bool = False,
    halvings: int = 2,
    seed: int = 0,
    fits: Path = Path("runs/truth"),
    values: Path | None = None,
    against: Path | None = None,
    out: Path | None = None,
    json_output: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> None:
    """Compare the predictions of a game with matches that were not used to fit it.

    Args:
        data: folder of the download, or a Parquet file of `data convert`.
        split: matches to compare with the game.
        cross: instead of one split, fit this many games, each without one part of the training and validation matches, and
            compare every match with the game that was fitted without it.
        game: with --split, the shipped model or model folder to compare.
        train_only: with --cross, use the training matches only: the factors of the model card (`card --truth`).
        profiles: compare every match with the game of its own discipline instead of the game of both.
        halvings: halvings of the training matches for the transfer; two games are fitted for each; 0: no transfer.
        seed: random seed of the fits, halvings and simulated matches.
        fits: cache folder of fitted games.
        values: file for the values and advantages of all strokes, for --against.
        against: file of --values of another game on the same matches; adds the paired differences to it.
        out: JSON file for the result, with its provenance.
        json_output: print JSON.
    """
    if (split is None) == (cross is None):
        raise ShuttleError("expected either --split NAME or --cross NUMBER")
    if cross is not None and cross < 2:
        raise ShuttleError(f"--cross {cross}: expected 2 or more parts")
    console = Console(stderr=True, highlight=False)
    strokes = strokes_of(load_strokes(data))
    fitter = Fitter(strokes, fits, seed=seed, report=lambda line: console.print(line, markup=False))
    if cross is not None:
        judged = of_splits(strokes, "train") if train_only else of_splits(strokes, "train", "validation")
        parts = cross_parts(judged, cross, fitter, seed=seed, profiles=profiles)
    else:
        judged = of_splits(strokes, split or "validation")
        parts = marked((shipped_world(game, discipline), part) for discipline, part in by_discipline(judged, profiles))
    real, promised = judged_by(parts)
    factors = None if cross is not None else factors_of(model_folder(game))
    result: dict[str, Any] = {"split": split, "cross": cross, "train_only": train_only, **compare(parts, real, promised, seed)}
    if cross is not None or factors is not None:
        result["calibration"] = calibration(real, promised, parts_of(parts), factors, seed)
    if values is not None:
        save_values(values, real, promised)
    if against is not None:
        result["against"] = differences(real, promised, load_values(against, real), seed)
    if halvings:
        result["transfer"] = transfer(of_splits(strokes, "train"), fitter, halvings=halvings, seed=seed)
    if out is not None:
        write_json(out, {**describe(("numpy", "torch")), **result})
    if json_output:
        sys.stdout.write(json_format.dumps(result) + "\n")
    else:
        _print(result)


def compare(parts: Sequence[tuple[World, Strokes]], real: Strokes, promised: Promises, seed: int) -> dict[str, Any]:
    """All figures but the calibration and the transfer.

    Args:
        parts: worlds, each with matches that took no part in fitting it.
        real, promised: their strokes and promises, see :func:`judged_by`.
        seed: random seed of the simulated matches and of the resampling.
    """
    legality = [world.judge(strokes, lambda w, part: judged_strokes(w.game, part)) for world, strokes in parts]
    known, forbidden = (np.concatenate(side) for side in zip(*legality, strict=True))
    simulated = Strokes.joined([_simulated(world, strokes, seed + i) for i, (world, strokes) in enumerate(parts)])
    remembers = all(world.history is not None for world, _ in parts)
    remembered = [_simulated(world, strokes, seed + i, history=True) for i, (world, strokes) in enumerate(parts) if remembers]
    return {
        "matches": len(np.unique(real.rows.match)),
        "strokes": len(real),
        "decision_slope": decisions.decision_slope(real, promised),
        "value_error": decisions.value_error(real, promised),
        "promised_realised": decisions.promised_realised(real, promised),
        "value_log_loss": decisions.value_log_loss(real, promised),
        "forecasts": decisions.forecast_errors(real, promised, seed),
        "memory": memory(real, promised),
        "illegal": illegal(real, promised, known, forbidden),
        "two_sample_auc": likeness.two_sample_auc(simulated, real, seed),
        "two_sample_auc_history": likeness.two_sample_auc(Strokes.joined(remembered), real, seed) if remembered else None,
        "rally_length": likeness.rally_length(simulated, real, seed),
        "divergence": likeness.divergence(simulated, real, seed),
        "recovery": recovery_effects(parts, seed),
        "random_vs_bc": float(np.mean([_random_wins(world) for world, _ in parts])),
        "support": _mean([thin_support(world) for world, _ in parts]),
    }


def parts_of(parts: Sequence[tuple[World, Strokes]]) -> I64:
    """``[N]`` part of each stroke of :func:`judged_by`."""
    return np.repeat(np.arange(len(parts)), [len(strokes) for _, strokes in parts])


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


def _print(result: dict[str, Any]) -> None:
    console = Console(highlight=False)
    slopes = Table(
        "strokes later", "slope", "95 % interval", title="Regression of outcomes on predicted advantages (1 in a correct game)"
    )
    for horizon, slope in result["decision_slope"].items():
        slopes.add_row(horizon, f"{slope['value']:.2f}", f"{slope['low']:.2f} to {slope['high']:.2f}")
    console.print(slopes)
    errors = Table(
        "shot", "after own", "95 % interval", "after incoming", "95 % interval", title="Points won above the predicted value"
    )
    for shot, roles in result["value_error"].items():
        cells = [shot]
        for role in ("own", "incoming"):
            found = roles.get(role)
            cells += ["", ""] if found is None else [f"{found['points']:+.1f}", f"{found['low']:+.1f} to {found['high']:+.1f}"]
        errors.add_row(*cells)
    console.print(errors)
    strokes = Table("shot", "promised", "realised", "95 % interval", title="Points that choosing a shot type adds")
    for shot, found in result["promised_realised"].items():
        brought = found["realised"]
        strokes.add_row(
            shot, f"{found['promised']:+.2f}", f"{brought['points']:+.2f}", f"{brought['low']:+.2f} to {brought['high']:+.2f}"
        )
    console.print(strokes)
    auc, remembering, length = (result[name] for name in ("two_sample_auc", "two_sample_auc_history", "rally_length"))
    forbidden = result["illegal"]
    error = forbidden["value_error"]
    lines = [
        *(
            f"slope on calibrated advantages, {name}: {found['slope']:.2f} ({found['low']:.2f} to {found['high']:.2f}), "
            f"factor {found['factor']:.2f}"
            for name, found in result.get("calibration", {}).items()
        ),
        f"illegal strokes: {100 * forbidden['share']:.2f} %, after a drop met above the net "
        f"{100 * forbidden['after_drop_above']:.1f} %, where the value errs by {error['points']:+.1f} points "
        f"({error['low']:+.1f} to {error['high']:+.1f})",
        "memory of an advantage 1 to 8 strokes ago: "
        + ", ".join(f"{lag}: {found['value']:+.2f}" for lag, found in result["memory"].items()),
        *(
            f"against the other game, {name}: {found['value']:+.5f} ({found['low']:+.5f} to {found['high']:+.5f})"
            for name, found in result.get("against", {}).items()
        ),
        *(
            f"calibration error of the forecast, {name}: {found['ece']:.4f} (of a game without errors {found['chance']:.4f}, "
            f"at most {found['chance_high']:.4f})"
            for name, found in result["forecasts"].items()
        ),
        *(
            f"position of the receiver, {name}: log-loss {1e5 * found['log_loss_change']:+.0f}e-5 "
            f"({1e5 * found['low']:+.0f}e-5 to {1e5 * found['high']:+.0f}e-5), slope on its effect {found['slope']:.2f} "
            f"({found['slope_low']:.2f} to {found['slope_high']:.2f})"
            for name, found in (result["recovery"] or {}).items()
        ),
        f"log-loss of the value: {result['value_log_loss']:.5f}",
        f"classifying simulated and real rallies: AUC {auc['value']:.3f} (real from real {auc['real_against_real']:.3f}), by "
        + ", ".join(auc["gives_away"]),
        *([] if remembering is None else [f"the same with players who remember the rally: AUC {remembering['value']:.3f}"]),
        f"rally length: {length['simulated']:.2f} simulated, {length['real']:.2f} real, "
        f"KS {length['ks']:.3f} (real against real {length['ks_real']:.3f})",
        *(
            f"divergence of {name}: {found['value']:.5f} bits (real against real {found['real_against_real']:.5f})"
            for name, found in result["divergence"].items()
        ),
        f"random against bc: {100 * result['random_vs_bc']:.1f} % of rallies",
        "strokes with fewer than five examples in the data: "
        + ", ".join(f"{name} {100 * share:.0f} %" for name, share in result["support"].items()),
        *(
            f"{name}: wins {100 * found['home']:.1f} % at home, {100 * found['away']:.1f} % away; "
            f"{found['kept']:.2f} of the advantage over 50 % is retained ({found['low']:.2f} to {found['high']:.2f})"
            for name, found in result.get("transfer", {}).items()
        ),
    ]
    for line in lines:
        console.print(line, markup=False)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    return run(truth, prog="experiments.truth", description=__doc__ or "", argv=argv)


if __name__ == "__main__":
    sys.exit(main())
