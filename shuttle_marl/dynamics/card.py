"""Model cards: data, scores, and properties of the game."""

import math
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import content_hash, replace_sealed, with_hashes
from shuttle_marl.dynamics.evaluate import criteria
from shuttle_marl.game.shipped import CARD, FILES, NETWORKS, OPTIONAL_FILES, read_model_card
from shuttle_marl.game.stroke import SHOTS

_SCORED: Final = ("success", "return", "contact", "hurried")
_TEMPLATES: Final = Path(__file__).with_name("templates")


def strokes_hash(strokes: pa.Table) -> str:
    """SHA-256 of the columns of a stroke table without metadata, equal for the raw files and for Parquet."""
    sink = pa.BufferOutputStream()
    table = strokes.cast(pa.schema([field.remove_metadata() for field in strokes.schema])).combine_chunks()
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    return content_hash(sink.getvalue())


def write_card(folder: Path, card: dict[str, Any]) -> None:
    """Write the card of a model with the hashes of its files.

    Raises:
        FileWriteError: it cannot be written.
    """
    files = [*FILES, *(name for name in OPTIONAL_FILES if (folder / name).is_file())]
    replace_sealed(folder / CARD, with_hashes(card, {name: (folder / name).read_bytes() for name in files}))


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
    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES), undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"as": format, "percent": lambda share: f"{100 * share:.1f} %"}
    return environment.get_template("card.md").render(
        card=card,
        scored={name: card["validation"][name] for name in _SCORED if name in card["validation"]},
        criteria=criteria(card["health"]).values(),
        networks=NETWORKS,
        shots=SHOTS,
        exp=math.exp,
    )


def plot_reliability(card: dict[str, Any], path: Path) -> None:
    """Plot the three reliability diagrams."""
    from matplotlib.figure import Figure  # noqa: PLC0415  slow to import

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
