"""Model cards: data, scores, and properties of the game."""

from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import replace_sealed
from shuttle_marl.dynamics.evaluate import criteria
from shuttle_marl.game.shipped import CARD, FILES, NETWORKS, OPTIONAL_FILES, read_model_card
from shuttle_marl.game.stroke import SHOTS

_OBSERVED: Final = (
    "**The data are observational.** Players chose these strokes in positions and against opponents that the state does not "
    "contain. The success of a stroke for the players who chose it is not its success for a player who would choose it "
    "elsewhere or more often. The further a policy departs from human play, the weaker its support in the data. Values of the "
    "game are exact consequences of its tables, not evidence about badminton."
)
_REWARDED: Final = (
    "**What the game must not reward.** In the game of version 0.2.0, a net kill of a lift was legal at the back line, "
    "because people had played such kills somewhere, and it won as often there as the few short lifts that were killed at "
    "the net. Perfect play was 75 % net shots, and a third of the strokes of trained agents were of shot types that people "
    "hardly play there, while log-loss and calibration were good. It was noticed on the live court, where such kills were "
    "praised, and by counting these strokes. Now a stroke is legal where the average player chooses its shot type, and the "
    "state says whether the striker is hurried. A fit is refused if impossible strokes are legal, or if perfect play or the best "
    "response rely on rare strokes or on strokes without real ones."
)
_NAMED: Final = (
    "**Named players.** Results of public matches are summarised with numbers of strokes and intervals. They describe these "
    "matches; they do not judge persons, and are not for selection, contracts or betting."
)

_NEXT: Final = {"shot_type": "shot type", "area": "area", "area_given_type": "area, shot type known"}
_SCORES: Final = (
    "model", "rows", "log-loss", "trees", "ratio", "difference (95 %, by match)", "Brier", "AUC", "ECE", "ECE of trees",
)  # fmt: skip
_MARKED_BY: Final = {
    "table": "as the rallies recorded it",
    "index": "by the index of the model: the worst quarter of strokes against an incoming shot type from a contact height",
    "prior": "by the index of the prior model",
    None: "because their positions and times are not known: the game does not use this bit",
}


def strokes_hash(strokes: pa.Table) -> str:
    """SHA-256 of the columns of a stroke table without metadata, equal for the raw files and for Parquet."""
    sink = pa.BufferOutputStream()
    table = strokes.cast(pa.schema([field.remove_metadata() for field in strokes.schema])).combine_chunks()
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    return sha256(sink.getvalue()).hexdigest()


def write_card(folder: Path, card: dict[str, Any]) -> None:
    """Write the card of a model with the hashes of its files.

    Raises:
        FileWriteError: it cannot be written.
    """
    files = [*FILES, *(name for name in OPTIONAL_FILES if (folder / name).is_file())]
    hashes = {name: sha256((folder / name).read_bytes()).hexdigest() for name in files}
    replace_sealed(folder / CARD, {**card, "sha256": hashes})


def add_truth(folder: Path, truth: dict[str, Any]) -> None:
    """Store the result of ``experiments.truth --json`` in the card of a model.

    Raises:
        ShuttleError: the result lacks a field.
        GameError: the model card cannot be read.
        FileWriteError: it cannot be written.
    """
    wanted = ("split", "cross", "train_only", "matches", "strokes", "decision_slope", "promised_realised")
    if missing := [name for name in wanted if name not in truth]:
        raise ShuttleError(f"not a result of experiments.truth: {', '.join(missing)} missing; create one with --json")
    write_card(folder, {**read_model_card(folder), "truth": {name: truth[name] for name in wanted}})


def as_markdown(card: dict[str, Any]) -> str:
    """The card as Markdown."""
    health, scores = card["health"], card["validation"]
    scored = [name for name in ("success", "return", "contact", "hurried") if name in scores]
    lines = [
        f"# Model card: {card['name']}",
        "",
        f"Version {card['version']}, game `{card['game_hash'][:16]}`, weights `{card['sha256'][NETWORKS][:16]}`, "
        f"data `{card['data']['hash'][:16]}`.",
        "",
        f"Fitted on {card['data']['train_strokes']:,} strokes of {card['data']['train_matches']} matches; settings "
        f"were chosen on {card['data']['validation_strokes']:,} strokes of {card['data']['validation_matches']} other matches. "
        f"Seed {card['seed']}.",
        "",
        _OBSERVED,
        "",
        _NAMED,
        "",
        _REWARDED,
        "",
        f"The game: {card['game']['strokes']} strokes, {card['game']['states']:,} states, {card['game']['legal_pairs']:,} legal "
        f"pairs; {100 * card['game']['clipped']:.1f} % of them were clipped to the range supported by the data. Its areas are "
        "those that a right-handed receiver sees: right is the forehand side. The variant `opposite` is the game of a "
        "right-hander and a left-hander.",
        "",
        "## Predictions on the validation matches",
        "",
        *_table(_SCORES, *(_scores(name, scores[name]) for name in scored)),
    ]
    top = [(title, *(f"{x:.3f}" for x in scores["next_stroke"][key])) for key, title in _NEXT.items()]
    lines += ["", *_table(("next stroke", "top-1", "top-2", "top-3", "top-4"), *top)]
    lines += ["", "### Reliability", "", "Mean prediction and observed frequency in fifteen bins of equal mass.", ""]
    for name in scored:
        bins = scores[name]["reliability"]
        rows = [(key, *(f"{b[key]:.3f}" for b in bins)) for key in ("predicted", "observed")]
        lines += [*_table((name, *(str(i + 1) for i in range(len(bins)))), *rows), ""]
    if prior := card["chosen"].get("prior"):
        shifts = ", ".join(f"{name} {shift:+.3f}" for name, shift in prior["shifts"].items())
        lines += [
            f"The models of game `{prior['game'][:16]}`, corrected: shifts of the log-odds of a fault (success), of a return and "
            f"of a contact above the net: {shifts}. Scores are those of the corrected models.",
            "",
        ]
    lines += _situations(card)
    if card.get("history"):
        lines += _history(card["history"])
    lines += _recovery(card.get("recovery"))
    if "skill" in card:
        lines += _skill(card["skill"])
    lines += _solved(health)
    if "truth" in card:
        lines += _truth(card["truth"])
    lines += ["", "## Extreme probabilities and what supports them", "", card["support_rule"], ""]
    head = ("probability", "strokes", "events", "supported range", "stroke", "state")
    for title, pairs in card["extremes"].items():
        rows = [
            (
                *(f"{pair['probability']:.4f}", f"{pair['strokes']:g}", f"{pair['events']:g}"),
                *("{:.4f} to {:.4f}".format(*pair["range"]), pair["stroke"], pair["state"]),
            )
            for pair in pairs
        ]
        lines += [f"**{title}**", "", *_table(head, *rows), ""]
    return "\n".join(lines)


def _scores(name: str, score: dict[str, Any]) -> tuple[str, ...]:
    """Row of a model below :data:`_SCORES`."""
    trees, difference = score["trees"], score["difference"]
    return (
        *(name, f"{score['rows']:,}", f"{score['log_loss']:.5f}", f"{trees['log_loss']:.5f}"),
        *(f"{score['log_loss'] / trees['log_loss']:.4f}", "{mean:+.5f} ({low:+.5f} to {high:+.5f})".format(**difference)),
        *(f"{score['brier']:.5f}", f"{score['auc']:.4f}", f"{score['ece']:.4f}", f"{trees['ece']:.4f}"),
    )


def _table(*rows: Sequence[str]) -> list[str]:
    """Lines of a table in Markdown; the first row is its head."""
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return [lines[0], "|---" * len(rows[0]) + "|", *lines[1:]]


def _history(scores: dict[str, dict[str, float]]) -> list[str]:
    kinds = {"choice": "shot types and techniques", "target": "target areas"}
    losses = (f"{kinds[name]} {score['cross_entropy']:.4f} (`bc` {score['of_average']:.4f})" for name, score in scores.items())
    return [
        "`bc:history` shifts the choices of `bc` by the strokes three and four before. Cross-entropy on the validation matches "
        f"(nats): {', '.join(losses)}. It makes simulated matches look real; it is no stronger opponent and no better forecast.",
        "",
    ]


def _situations(card: dict[str, Any]) -> list[str]:
    situations = card["chosen"]["situations"]
    effort = ", ".join(f"{np.exp(offset):.3f}" for offset in situations["effort"])
    lines = ["## Hurried strikers, effort, duels and variants", ""]
    known = card["hurried"]
    lines.append(
        f"Hurried strikers: {100 * known['share']:.1f} % of the training strokes, {_MARKED_BY[known['by']]}. Serves are never "
        "hurried; strokes without positions or times count as not hurried."
    )
    lines.append(
        f"Relative odds of a fault after 0, 1, … own attacks (smashes, half-smashes) in the rally; the last level includes more "
        f"attacks: {effort}. Relative odds of a fault of a net shot after three or more consecutive net shots: "
        f"{np.exp(situations['duel']):.3f}. Both were fitted to out-of-fold predictions of the networks."
    )
    if "share" in card["game"]:
        share = " and ".join(f"{100 * part:.1f} % {name}" for name, part in card["game"]["share"].items())
        lines.append(f"The game is an average over disciplines, weighted by their strokes ({share}).")
    if card.get("variants"):
        lines.append(
            f"Variants: {', '.join(card['variants'])}. The numbered ones are refits on resampled training matches; their "
            "differences show the uncertainty of the fit."
        )
    return [*lines, ""]


def _recovery(recovery: dict[str, Any] | None) -> list[str]:
    """Where people wait, and the coefficients of what that changes."""
    lines = ["## Positions of receivers", ""]
    if recovery is None:
        return [*lines, "The model has none: too few strokes have the position of the receiver.", ""]
    rows = [
        (effect, group, *(f"{value:+.2f}" for value in line.values()))
        for effect, groups in recovery["coefficients"].items()
        for group, line in groups.items()
    ]
    head = ("outcome", "stroke", *next(iter(next(iter(recovery["coefficients"].values())).values())))
    return [
        *lines,
        f"Fitted to {recovery['strokes']:,} strokes: {recovery['feasible']:.2f} positions are feasible on average, and "
        f"{100 * recovery['inside']:.1f} % of people's positions are among them. Log-odds of an outcome for each metre by which "
        "a position lies to a side of the place where such a stroke is met, behind it, or in front of it:",
        "",
        *_table(head, *rows),
        "",
    ]


def _skill(skill: dict[str, Any]) -> list[str]:
    """Variances of the players' offsets, and the check of their shrinkage."""
    names = list(next(iter(skill["deviations"].values())))
    lines = [
        "## Skill of players",
        "",
        f"Offsets of {skill['players']} players, from matches of {' to '.join(skill['days'])}. Standard deviations of the "
        "log-odds: general offsets and those of groups of shots for strikers and receivers, change in a year, and nuisance "
        "effects of the match, the side, the group of shots in a match, and the group of shots in a data set. Slope of truth on "
        "offsets that were estimated from other matches; 1 if the shrinkage is right.",
        "",
    ]
    rows = []
    for component, deviations in skill["deviations"].items():
        slope = skill["check"].get(component)
        checked = "too few matches" if slope is None else f"{slope['slope']:.2f} ({slope['low']:.2f} to {slope['high']:.2f})"
        rows.append((component, *(f"{deviations[name]:.3f}" for name in names), checked))
    head = ("component", *(name.replace("_", " and ") for name in names), "slope (95 %, by match)")
    return [*lines, *_table(head, *rows), ""]


def _solved(health: dict[str, Any]) -> list[str]:
    rare, unsupported, thin = (
        ", ".join(f"{name.replace('_', ' ')} {100 * share:.1f} %" for name, share in health[kind].items())
        for kind in ("rare", "unsupported", "thin")
    )
    refits = [
        f"Over the refits, {name.replace('_', ' ')}: median {of['median']:.3g} ({of['low']:.3g} to {of['high']:.3g})."
        for name, of in health.get("refits", {}).items()
    ]
    lines = [
        "## The solved game",
        "",
        f"Minimax self-play: {health['minimax']['mean_rally']:.1f} strokes a rally, most frequent shot type "
        f"{100 * health['largest_shot_share']:.1f} %, {health['shot_types_above_2_percent']} shot types above 2 %, value at the "
        f"serve {health['value_at_serve']:+.3f}. Largest probability that a rally continues after a legal stroke other than a "
        f"serve: {health['largest_continuation']:.4f}. The best response to BC wins "
        f"{100 * health['best_response_to_bc_wins']:.1f} % of rallies. BC against BC: {health['bc']['mean_rally']:.2f} strokes. "
        f"Strokes of a shot type that people play there in less than 1 % of cases: {rare}. Without a real stroke in their "
        f"innermost cell: {unsupported}; with fewer than five: {thin}.",
        "",
        *([" ".join(refits), ""] if refits else []),
        *(f"- {'' if within else '**Warning**: '}{text}" for text, within in criteria(health).values()),
        "",
        "No fit was selected by these values; rules of legality were compared by them.",
        "",
    ]
    mixes = [(who, *(f"{100 * health[who]['shot_mix'][shot]:.1f} %" for shot in SHOTS)) for who in ("minimax", "bc")]
    return [*lines, *_table(("share of strokes", *SHOTS), *mixes)]


def _truth(truth: dict[str, Any]) -> list[str]:
    """Predicted and realised advantages, from ``experiments.truth``."""
    evaluation = f"{truth['cross']} games, each evaluated on held-out matches" if truth["cross"] else truth["split"]
    slopes = truth["decision_slope"]
    rows = []
    for shot, advantage in truth["promised_realised"].items():
        realised = advantage["realised"]
        spread = f"{realised['low']:+.2f} to {realised['high']:+.2f}"
        rows.append((shot, f"{advantage['promised']:+.2f}", f"{realised['points']:+.2f}", spread, f"{realised['n']:,}"))
    return [
        "",
        "## Predicted and realised",
        "",
        f"Compared with {truth['matches']} matches ({evaluation}). Slope of realised on predicted advantages: "
        + ", ".join(f"{key} {s['value']:.2f} ({s['low']:.2f} to {s['high']:.2f})" for key, s in slopes.items())
        + "; 1 if calibrated. Advantage of choosing a shot type, per cent of rallies:",
        "",
        *_table(("shot type", "predicted", "realised", "95 %, by match", "strokes"), *rows),
    ]


def plot_reliability(card: dict[str, Any], path: Path) -> None:
    """Plot the three reliability diagrams."""
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
