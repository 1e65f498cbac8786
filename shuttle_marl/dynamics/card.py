"""Model cards: what it was fitted on, how it scores, and what the game that it makes looks like."""

from hashlib import sha256
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from shuttle_marl.dynamics.evaluate import criteria
from shuttle_marl.errors import ShuttleError
from shuttle_marl.files import replace_file, seal
from shuttle_marl.game.shipped import BC, CARD, GAME, NETWORKS, SUPPORT, VARIANTS, read_model_card
from shuttle_marl.game.stroke import SHOTS

_OBSERVED: Final = (
    "**The data are observational.** Players chose these strokes where they thought that they would work, against opponents and "
    "in positions that the state does not hold. What a stroke brought to those who chose it is not what it would bring to a "
    "player who chose it elsewhere or more often, and the further a policy departs from what people play, the less of what the "
    "game says about it was ever seen. The game says what its tables imply, exactly; it is no proof that badminton would agree."
)


def strokes_hash(strokes: pa.Table) -> str:
    """SHA-256 of the columns of a stroke table, not of their descriptions: the same from the raw files and from Parquet."""
    sink = pa.BufferOutputStream()
    table = strokes.cast(pa.schema([field.remove_metadata() for field in strokes.schema])).combine_chunks()
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    return sha256(sink.getvalue()).hexdigest()


def write_card(folder: Path, card: dict[str, Any]) -> None:
    """Write the card of a model, and with it the hashes of the files that stand in the folder.

    Raises:
        FileWriteError: it cannot be written.
    """
    files = [name for name in (GAME, BC, NETWORKS, SUPPORT, VARIANTS) if (folder / name).is_file() or name != VARIANTS]
    hashes = {name: sha256((folder / name).read_bytes()).hexdigest() for name in files}
    replace_file(folder / CARD, seal({**card, "sha256": hashes}))


def add_truth(folder: Path, truth: dict[str, Any]) -> None:
    """Keep in the card of a model what the measure of truth (``experiments.truth --json``) found about its game.

    Raises:
        ShuttleError: it is no result of the measure.
        GameError: the model card cannot be read.
        FileWriteError: it cannot be written.
    """
    wanted = ("split", "cross", "matches", "strokes", "decision_slope", "promised_realised")
    if missing := [name for name in wanted if name not in truth]:
        raise ShuttleError(f"no result of the measure of truth: {', '.join(missing)} missing; make one with --json")
    write_card(folder, {**read_model_card(folder), "truth": {name: truth[name] for name in wanted}})


def as_markdown(card: dict[str, Any]) -> str:
    """The card for people."""
    health, scores = card["health"], card["validation"]
    lines = [
        f"# Model card: {card['name']}",
        "",
        f"Version {card['version']}, game `{card['game_hash'][:16]}`, weights `{card['sha256'][NETWORKS][:16]}`, "
        f"data `{card['data']['hash'][:16]}`.",
        "",
        f"Fitted on {card['data']['train_strokes']:,} strokes of {card['data']['train_matches']} matches; everything that was "
        f"chosen was chosen on {card['data']['validation_strokes']:,} strokes of {card['data']['validation_matches']} others. "
        f"Seed {card['seed']}.",
        "",
        _OBSERVED,
        "",
        f"The game: {card['game']['strokes']} strokes, {card['game']['states']:,} states, {card['game']['legal_pairs']:,} legal "
        f"pairs; {100 * card['game']['clipped']:.1f} % of them were moved into the range that the data supports.",
        "",
        "## Predictions on the validation matches",
        "",
        "| model | rows | log-loss | trees | ratio | difference (95 %, by match) | Brier | AUC | ECE | ECE of trees |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name in ("success", "return", "contact"):
        s = scores[name]
        d = s["difference"]
        lines.append(
            f"| {name} | {s['rows']:,} | {s['log_loss']:.5f} | {s['trees']['log_loss']:.5f} | "
            f"{s['log_loss'] / s['trees']['log_loss']:.4f} | {d['mean']:+.5f} ({d['low']:+.5f} to {d['high']:+.5f}) | "
            f"{s['brier']:.5f} | {s['auc']:.4f} | {s['ece']:.4f} | {s['trees']['ece']:.4f} |"
        )
    following = scores["next_stroke"]
    lines += ["", "| next stroke | top-1 | top-2 | top-3 | top-4 |", "|---|---|---|---|---|"]
    for key, title in (("shot_type", "shot type"), ("area", "area"), ("area_given_type", "area, shot type known")):
        lines.append(f"| {title} | " + " | ".join(f"{x:.3f}" for x in following[key]) + " |")
    lines += ["", "### Reliability", "", "Mean prediction and observed share in fifteen bins of equal mass.", ""]
    for name in ("success", "return", "contact"):
        bins = scores[name]["reliability"]
        lines += [
            f"| {name} | " + " | ".join(str(i + 1) for i in range(len(bins))) + " |",
            "|---" * (len(bins) + 1) + "|",
            "| predicted | " + " | ".join(f"{b['predicted']:.3f}" for b in bins) + " |",
            "| observed | " + " | ".join(f"{b['observed']:.3f}" for b in bins) + " |",
            "",
        ]
    if prior := card["chosen"].get("prior"):
        shifts = ", ".join(f"{name} {shift:+.3f}" for name, shift in prior["shifts"].items())
        lines += [
            f"The models of game `{prior['game'][:16]}`, corrected: log-odds of a fault (success), of a return and of a contact "
            f"above the net moved by {shifts}. Scores are those of the corrected models.",
            "",
        ]
    lines += _situations(card)
    lines += _solved(health)
    if "truth" in card:
        lines += _truth(card["truth"])
    lines += ["", "## Extreme probabilities and what supports them", "", card["support_rule"], ""]
    for title, rows in card["extremes"].items():
        lines += [
            f"**{title}**",
            "",
            "| probability | strokes | events | supported range | stroke | state |",
            "|---|---|---|---|---|---|",
        ]
        lines += [
            f"| {r['probability']:.4f} | {r['strokes']:g} | {r['events']:g} | {r['range'][0]:.4f} to {r['range'][1]:.4f} | "
            f"{r['stroke']} | {r['state']} |"
            for r in rows
        ]
        lines.append("")
    return "\n".join(lines)


def _situations(card: dict[str, Any]) -> list[str]:
    found = card["chosen"]["situations"]
    effort = ", ".join(f"{np.exp(offset):.3f}" for offset in found["effort"])
    lines = ["## Effort, duels and variants", ""]
    lines.append(
        f"Odds of a fault after 0, 1, … own attacks (smashes, half-smashes) in the rally, at the last level so many or more: "
        f"{effort}. Odds of a fault of a net shot after three or more net shots in a row: {np.exp(found['duel']):.3f}. Both are "
        "relative to those of other strokes and were fitted on matches that the networks did not see."
    )
    if "share" in card["game"]:
        share = " and ".join(f"{100 * part:.1f} % {name}" for name, part in card["game"]["share"].items())
        lines.append(f"The game is an average over disciplines, weighted by their strokes ({share}): the game of neither.")
    if card.get("variants"):
        lines.append(
            f"Variants: {', '.join(card['variants'])}. Those by number are refits on resampled training matches; what differs "
            "between them is what the data leaves open."
        )
    return [*lines, ""]


def _solved(health: dict[str, Any]) -> list[str]:
    thin = ", ".join(f"{name.replace('_', ' ')} {100 * share:.0f} %" for name, share in health["thin"].items())
    lines = [
        "## The solved game",
        "",
        f"Minimax self-play: {health['minimax']['mean_rally']:.1f} strokes a rally, largest shot type "
        f"{100 * health['largest_shot_share']:.1f} %, {health['shot_types_above_2_percent']} shot types above 2 %, value at the "
        f"serve {health['value_at_serve']:+.3f}. Largest probability that a rally continues after a legal stroke (no serve): "
        f"{health['largest_continuation']:.4f}. The best response to BC wins "
        f"{100 * health['best_response_to_bc_wins']:.1f} % of rallies. BC against BC: {health['bc']['mean_rally']:.2f} strokes. "
        f"Strokes with fewer than five real ones in their innermost cell of data: {thin}.",
        "",
        *(f"- {'' if kept else '**Warning**: '}{told}" for told, kept in criteria(health).values()),
        "",
        "These figures are reported, and no fit was chosen by them.",
        "",
        "| share of strokes | " + " | ".join(SHOTS) + " |",
        "|---" * (len(SHOTS) + 1) + "|",
    ]
    for who in ("minimax", "bc"):
        lines.append(f"| {who} | " + " | ".join(f"{100 * health[who]['shot_mix'][shot]:.1f} %" for shot in SHOTS) + " |")
    return lines


def _truth(truth: dict[str, Any]) -> list[str]:
    """Promises of the game beside what came true, from the measure of truth."""
    judged = f"{truth['cross']} games, each without the matches it is compared with" if truth["cross"] else truth["split"]
    slopes = truth["decision_slope"]
    lines = [
        "",
        "## Promised and realised",
        "",
        f"Compared with {truth['matches']} matches ({judged}). Slope of what happened on what was promised: "
        + ", ".join(f"{key} {s['value']:.2f} ({s['low']:.2f} to {s['high']:.2f})" for key, s in slopes.items())
        + "; 1 in a true game. Points that choosing a shot type adds, per cent of rallies:",
        "",
        "| shot type | promised | brought | 95 %, by match | strokes |",
        "|---|---|---|---|---|",
    ]
    for shot, found in truth["promised_realised"].items():
        brought = found["realised"]
        lines.append(
            f"| {shot} | {found['promised']:+.2f} | {brought['points']:+.2f} | {brought['low']:+.2f} to {brought['high']:+.2f} | "
            f"{brought['n']:,} |"
        )
    return lines


def plot_reliability(card: dict[str, Any], path: Path) -> None:
    """Draw the three reliability diagrams."""
    import matplotlib as mpl  # noqa: PLC0415  slow to import
    from matplotlib.figure import Figure  # noqa: PLC0415

    mpl.use("Agg")
    figure = Figure(figsize=(10, 3.4), layout="constrained")
    for axes, name in zip(figure.subplots(1, 3), ("success", "return", "contact"), strict=True):
        bins = card["validation"][name]["reliability"]
        predicted, observed = (np.array([b[key] for b in bins]) for key in ("predicted", "observed"))
        spread = 1.96 * np.sqrt(np.maximum(observed * (1 - observed), 1e-6) / np.array([b["rows"] for b in bins]))
        low = min(predicted.min(), observed.min()) - 0.02
        axes.plot([low, 1], [low, 1], color="0.7", linewidth=1)
        axes.errorbar(predicted, observed, yerr=spread, fmt="o", markersize=4, color="#0b6e4f", linewidth=1)
        axes.set(title=f"{name} (ECE {card['validation'][name]['ece']:.4f})", xlabel="predicted", ylabel="observed")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
