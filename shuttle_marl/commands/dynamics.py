"""Fit, evaluate and describe the models of the game."""

import json as json_format
import os
import sys
from pathlib import Path
from typing import Annotated, Any, Final

import tyro

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import FileReadError, read_json
from shuttle_marl.commands.cli import by_name, check_free, console, entry_point, say, show, table
from shuttle_marl.commands.options import HandsTold, hands_told
from shuttle_marl.data.upstream import Split
from shuttle_marl.game.shipped import model_folder, read_model_card


def _report(line: str) -> None:
    console(stderr=True).print(f"{line} …", style="dim")


_BEST: Final = "the strongest play of this game"
_REPLY: Final = "the strongest play against the average player of this game"
_WARNINGS: Final = {
    "impossible": "this game has strokes that nobody can play",
    "minimax rare": f"{_BEST} often chooses a shot that hardly anybody plays there",
    "best response rare": f"{_REPLY} often chooses a shot that hardly anybody plays there",
    "minimax unsupported": f"{_BEST} often chooses a stroke that nobody played there in the matches",
    "best response unsupported": f"{_REPLY} often chooses a stroke that nobody played there in the matches",
    "minimax thin": f"{_BEST} often chooses a stroke with fewer than five real ones behind it",
    "best response thin": f"{_REPLY} often chooses a stroke with fewer than five real ones behind it",
    "largest shot share": f"{_BEST} repeats one shot more than people do: share of this shot",
    "shot types above 2 percent": f"{_BEST} uses fewer shots than people do: number of shots",
    "minimax mean rally": "rallies between two of the strongest players are not as long as real ones: mean strokes",
    "largest continuation": "in some positions rallies hardly ever end: probability of another stroke",
}
"""What each warning of a model card means to a coach."""


def fit(
    data: Path,
    out: Path,
    seed: int = 0,
    refits: int | None = None,
    validation_share: float | None = None,
    hand: HandsTold = (),
    jobs: int | None = None,
    overwrite: bool = False,
) -> None:
    """Fit the models to the training matches and compile the game; takes a few minutes, and a few more for each refit.

    Args:
        data: folder of the download, or a Parquet file of `data convert` or `data import`.
        out: model folder to write.
        seed: random seed; equal seeds give equal weights.
        refits: number of refits on resampled matches, which show the uncertainty of the fit, as variants OUT:1, OUT:2, …;
            default: 8, or 0 for fewer than 6 training matches.
        validation_share: fraction of your own matches for validation, such as 0.2; the published matches have a fixed split.
        hand: hand of a player, such as kento-momota=left. Default: strokes around the head tell it.
        jobs: number of refits at once; default: one for each core, at most 4.
        overwrite: replace an existing model.
    """
    from shuttle_marl.dynamics.make import fit_model  # noqa: PLC0415  torch

    check_free(out, overwrite=overwrite)
    jobs = min(4, os.cpu_count() or 1) if jobs is None else jobs
    if jobs < 1:
        raise ShuttleError(f"--jobs {jobs}: expected 1 or more")
    with hands_told(hand):
        card = fit_model(data, out, seed=seed, refits=refits, validation_share=validation_share, jobs=jobs, report=_report)
    warnings = card["health"]["warnings"]
    variants = f", variants {', '.join(card['variants'])}" if card["variants"] else ""
    game = card["game"]
    say(f"{out}: {game['strokes']} strokes, {game['legal_pairs']:,} legal pairs, game {card['game_hash'][:16]}{variants}")
    for warning in warnings:
        name, _, figure = warning.partition(": ")
        say(f"warning: {_WARNINGS[name]} ({figure})")
    if warnings:
        say("More matches help. Reports advise only strokes with enough real ones behind them.")


def evaluate(data: Path, split: Split = "validation", model: str = "default", json: bool = False) -> None:
    """Score the models on a split, and boosted trees fitted to the training matches.

    Args:
        data: folder of the download, or a Parquet file of `data convert`.
        split: train, validation or test.
        model: name of a shipped model, or a model folder.
        json: print JSON instead of a table.
    """
    from shuttle_marl.dynamics.make import evaluate_model  # noqa: PLC0415  torch

    result = evaluate_model(data, model_folder(model), split, report=_report)
    rows = []
    for name in ("success", "return", "contact"):
        figures, trees = result[name], result[name]["trees"]["log_loss"]
        loss = (figures["log_loss"], trees, figures["log_loss"] / trees)
        rows.append((name, figures["rows"], *loss, figures["brier"], figures["auc"], figures["ece"]))
    headings = ("", "rows", "log-loss", "trees", "ratio", "Brier", "AUC", "ECE")
    following = (
        f"{key}: " + ", ".join(f"top-{k + 1} {x:.3f}" for k, x in enumerate(result["next_stroke"][key]))
        for key in ("shot_type", "area", "area_given_type")
    )
    show(result, json, table(f"{split} split: models and boosted trees", headings, rows), *following)


def card(model: str = "default", json: bool = False, truth: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None) -> None:
    """Print the card of a model.

    Args:
        model: name of a shipped model, or a model folder.
        json: print JSON instead of Markdown.
        truth: first store this output of `python -m experiments.truth --json` in the card.
    """
    from jinja2 import UndefinedError  # noqa: PLC0415  these keep --help quick

    from shuttle_marl.dynamics.evaluate import add_truth, as_markdown  # noqa: PLC0415  scipy

    if truth is not None:
        try:
            add_truth(model_folder(model), read_json(truth, dict[str, Any]))
        except FileReadError as error:
            raise ShuttleError(f"{truth}: cannot be read as JSON ({error})") from error
    content = read_model_card(model_folder(model))
    try:
        sys.stdout.write(json_format.dumps(content) + "\n" if json else as_markdown(content))
    except (UndefinedError, LookupError, TypeError, ValueError, ArithmeticError, AttributeError) as error:
        raise ShuttleError(f"{model}: its card lacks what this version writes ({error!r:.200}); fit the model again") from error


COMMANDS: Final = by_name(fit, evaluate, card)
main: Final = entry_point(COMMANDS, "python -m shuttle_marl.dynamics", __doc__ or "")
