"""Writes folders for the Hugging Face hub: ``python -m docs.tools.hub [--out FOLDER] [--quick]``. Nothing is uploaded.

- ``agents``: every shipped agent, with a model card. ``agent:agents/ppo`` names one in every command.
- ``sample``: the simulated sample, with a data set card and its Croissant description.
- ``suite``: the logs of ``offline-v0`` and the results of the suite as tables, with a card and a Croissant description.
"""

import json
import sys
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq
import yaml

from docs.tools import croissant
from docs.tools.markdown import ROOT, saved
from docs.tools.results import render
from shuttle_marl import __version__
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import replace_file
from shuttle_marl.base.table_files import write_parquet
from shuttle_marl.commands import cli
from shuttle_marl.game.rules import OUTCOMES
from shuttle_marl.game.shipped import model_folder
from shuttle_marl.policy.agents import AGENTS, CARD, NETWORK, read_card
from shuttle_marl.suite.registry import write_data

_TAGS: Final = ["badminton", "game-theory", "multi-agent", "reinforcement-learning", "sports"]
_CROISSANT: Final = "croissant.json"
_LOG_COLUMNS: Final = {
    name: text.format(outcomes=", ".join(f"{code} {outcome}" for code, outcome in enumerate(OUTCOMES)))
    for name, text in croissant.ABOUT["log_columns"].items()
}
_RESULT_COLUMNS: Final = pa.schema([
    pa.field(name, pa.type_for_alias(kind), metadata={"description": text})
    for name, (kind, text) in croissant.ABOUT["result_columns"].items()
])  # fmt: skip


def write_agents(out: Path) -> None:
    """Write the agents of the package and their card."""
    rows, results = [], []
    for folder in sorted(path.parent for path in (model_folder() / AGENTS).glob(f"*/{CARD}")):
        card = read_card(folder)
        for file in (NETWORK, CARD):
            replace_file(out / folder.name / file, (folder / file).read_bytes())
        scores = {name: card["evaluation"][name] for name in ("rally_win", "normalised_score", "exploitability")}
        rows.append({"name": folder.name, "scores": scores, **card})
        results.append({
            "name": folder.name,
            "results": [{
                "task": {"type": "reinforcement-learning"},
                "dataset": {"type": "shuttle_marl/Rally-v0", "name": f"rally_v0, game {card['game'][:12]}"},
                "metrics": [{"type": name, "value": round(score, 6), "verified": False} for name, score in scores.items()],
            }],
        })  # fmt: skip
    front = {
        "license": "mit",
        "library_name": "shuttle_marl",
        "pipeline_tag": "reinforcement-learning",
        "tags": _TAGS,
        "model-index": results,
    }
    _write_card(out, front, render("hub_agents", rows))


def write_sample(out: Path) -> None:
    """Write the simulated sample, its description and its card."""
    for name in ("strokes.parquet", _CROISSANT):
        replace_file(out / name, (croissant.FOLDER / name).read_bytes())
    card = (croissant.FOLDER / "CARD.md").read_text(encoding="utf-8")
    body = card.replace("[the datasheet](../../docs/datasheet.md)", "the datasheet")  # links would be broken on the hub
    _write_card(out, _dataset_front("Simulated sample of shuttle_marl", {"strokes": ["strokes.parquet"]}), body)


def write_suite(out: Path, *, quick: bool = False) -> None:
    """Write the logs of ``offline-v0``, the results of the suite, their description and their card.

    Args:
        out: folder.
        quick: the smallest log only.
    """
    write_data("offline-v0", out, "dev" if quick else "test", "default", 1 if quick else None, quick=quick)
    logs = sorted(path.name for path in out.glob("*.parquet") if path.name != "results.parquet")
    rows = [
        {**row, "exploitability": row["scores"].get("exploitability", {}).get("value")}
        for row in saved("experiments", "suite")["rows"]
    ]
    columns = {name: [row[name] for row in rows] for name in _RESULT_COLUMNS.names}
    write_parquet(out / "results.parquet", pa.table(columns, schema=_RESULT_COLUMNS))
    written = pq.read_schema(out / logs[0])
    log_schema = pa.schema([field.with_metadata({"description": _LOG_COLUMNS[field.name]}) for field in written])
    about_log = "A log: one row per stroke, rally after rally; the last number is the seed."
    tables = {name.removesuffix(".parquet"): (name, about_log, log_schema) for name in logs}
    tables["results"] = ("results.parquet", "One row per method, task, split and budget.", _RESULT_COLUMNS)
    described = croissant.dataset({**croissant.ABOUT["suite"], "version": __version__}, out, tables)
    replace_file(out / _CROISSANT, (json.dumps(described, indent=2, ensure_ascii=False) + "\n").encode())
    about = {"columns": _LOG_COLUMNS, "logs": logs, "split": "dev" if quick else "test"}
    files = {"logs": logs, "results": ["results.parquet"]}
    _write_card(out, _dataset_front("Logs and results of the shuttle_marl suite", files), render("hub_suite", about))


def _dataset_front(title: str, files: dict[str, list[str]]) -> dict[str, Any]:
    configs = [{"config_name": name, "data_files": found} for name, found in files.items()]
    front = {"license": "mit", "pretty_name": title, "task_categories": ["reinforcement-learning"], "tags": _TAGS}
    return {**front, "configs": configs}


def _write_card(out: Path, front: dict[str, Any], body: str) -> None:
    head = yaml.safe_dump(front, sort_keys=False, allow_unicode=True)
    replace_file(out / "README.md", f"---\n{head}---\n\n{body.strip()}\n".encode())


def main(*, out: Path = ROOT / "build" / "hub", quick: bool = False) -> None:
    """Write the folders.

    Args:
        out: Folder for them, which must not exist.
        quick: The smallest log only.
    """
    if out.exists():
        raise ShuttleError(f"{out}: already exists; name another folder, or remove it")
    write_agents(out / "agents")
    write_sample(out / "sample")
    write_suite(out / "suite", quick=quick)
    for folder in sorted(out.iterdir()):
        files = [path for path in folder.rglob("*") if path.is_file()]
        size = sum(path.stat().st_size for path in files) / 1e6
        sys.stdout.write(f"{folder}: {len(files)} files, {size:.1f} MB\n")


if __name__ == "__main__":
    sys.exit(cli.run(main, prog="python -m docs.tools.hub", description="Write folders for the Hugging Face hub."))
