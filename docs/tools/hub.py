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
from docs.tools.markdown import ROOT, markdown, saved
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
_NAMED_PLAYERS: Final = (
    "The game is fitted to public matches of elite players. Agents and logs are simulated: they describe no person, and are not "
    "for selection, contracts or betting."
)
_LOG_COLUMNS: Final = {
    "rally": "Number of the rally, from 0.",
    "own": "Whether the behaviour policy struck; else its opponent.",
    "state": "Index of the state of the game in which the stroke was struck.",
    "own_last": "Previous stroke of the striker in the rally.",
    "incoming": "Stroke that the striker replies to.",
    "contact": "Contact offered to the striker: 0 below the net, 1 above.",
    "hurried": "Whether the striker was hurried: 1, else 0.",
    "stroke": "Shot type, target area, contact height and technique.",
    "outcome": f"Outcome: {', '.join(f'{code} {name}' for code, name in enumerate(OUTCOMES))}.",
    "probability": "Probability of the stroke under the behaviour policy; NaN for strokes of the opponent.",
    "won": "Whether the behaviour policy won the rally.",
}
_RESULT_COLUMNS: Final = {
    "task": (pa.string(), "Name of the task."),
    "split": (pa.string(), "Part of the task: dev, test or round."),
    "budget": (pa.int64(), "Strokes of the learner, if the task has a budget."),
    "method": (pa.string(), "Name of the method."),
    "metric": (pa.string(), "Name of the score that orders methods."),
    "score": (pa.float64(), "Aggregate of the score over seeds and cases."),
    "low": (pa.float64(), "Lower end of the 95 % bootstrap interval of the score."),
    "high": (pa.float64(), "Upper end of the 95 % bootstrap interval of the score."),
    "exploitability": (pa.float64(), "Rallies that the best response wins above half, in points."),
    "seeds": (pa.int64(), "Number of seeds."),
    "strokes": (pa.int64(), "Strokes that the method declared, over all seeds and cases."),
    "seconds": (pa.float64(), "Time of all seeds and cases."),
    "verified": (pa.bool_(), "Whether all scores were recomputed from the stored policies."),
    "game": (pa.string(), "SHA-256 of the game."),
}
_SUITE: Final = {
    "name": "shuttle_marl_suite",
    "description": "Logs of rallies for offline reinforcement learning (offline-v0), generated from seeds, and results of the "
    "tasks of the benchmark suite.",
    **croissant.OWNER,
    "keywords": ["badminton", "benchmark", "offline reinforcement learning", "simulation"],
    "isLiveDataset": False,
    "version": __version__,
    "datePublished": "2026-11-25",
    "rai:dataCollection": "Logs: `shuttle-marl suite data offline-v0` plays policies on the shipped game; nothing was observed. "
    "Results: `python -m experiments.suite`.",
    "rai:dataCollectionType": "Simulation",
    "rai:dataUseCases": "Offline reinforcement learning, off-policy evaluation, and comparison of methods; not for statements "
    "about people or about badminton outside the game.",
    "rai:dataLimitations": "The state has no positions, no fatigue across rallies and no score; logs have one opponent, bc.",
    **croissant.SIMULATED,
}


def write_agents(out: Path) -> None:
    """Write the agents of the package and their card."""
    rows, results = [], []
    for folder in sorted((model_folder() / AGENTS).iterdir()):
        card = read_card(folder)
        for file in (NETWORK, CARD):
            replace_file(out / folder.name / file, (folder / file).read_bytes())
        scores = {name: card["evaluation"][name] for name in ("rally_win", "normalised_score", "exploitability")}
        opponents = ", ".join(card["config"]["opponent"])
        rows.append(
            (
                f"`{folder.name}`",
                card["algorithm"].upper(),
                opponents,
                f"{card['strokes']:,}",
                *(f"{s:.3f}" for s in scores.values()),
            )
        )
        results.append({
            "name": folder.name,
            "results": [{
                "task": {"type": "reinforcement-learning"},
                "dataset": {"type": "shuttle_marl/Rally-v0", "name": f"rally_v0, game {card['game'][:12]}"},
                "metrics": [{"type": name, "value": round(score, 6), "verified": False} for name, score in scores.items()],
            }],
        })  # fmt: skip
    headings = (
        "agent",
        "algorithm",
        "trained against",
        "strokes",
        "rallies won against bc",
        "normalised score",
        "exploitability",
    )
    table = markdown(headings, rows, left=headings[:3])
    front = {
        "license": "mit",
        "library_name": "shuttle_marl",
        "pipeline_tag": "reinforcement-learning",
        "tags": _TAGS,
        "model-index": results,
    }
    body = f"""# Agents of shuttle_marl

Agents for two-player badminton, trained with TorchRL. Scores are exact: 0 is `bc`, the imitation
of the average elite player, and 1 the best response to it; exploitability is the gain of a best response to the agent.

{table}

```bash
pip install shuttle-marl
shuttle-marl exact evaluate agent:ppo bc   # in this folder
```

{_NAMED_PLAYERS} `card.json` of each agent has its configuration, its game, and hashes.
"""
    _write_card(out, front, body)


def write_sample(out: Path) -> None:
    """Write the simulated sample, its description and its card."""
    for name in ("strokes.parquet", _CROISSANT):
        replace_file(out / name, (croissant.FOLDER / name).read_bytes())
    # Links of the repository would be broken on the hub.
    body = (
        (croissant.FOLDER / "CARD.md")
        .read_text(encoding="utf-8")
        .replace("[the datasheet](../../docs/datasheet.md)", "the datasheet")
    )
    _write_card(out, _dataset_front("Simulated sample of shuttle_marl", {"strokes": ["strokes.parquet"]}), body)


def write_suite(out: Path, *, quick: bool = False) -> None:
    """Write the logs of ``offline-v0``, the results of the suite, their description and their card.

    Args:
        out: folder.
        quick: the smallest log only.
    """
    write_data("offline-v0", out, "dev" if quick else "test", "default", 1 if quick else None, quick=quick)
    logs = sorted(path.name for path in out.glob("*.parquet") if path.name != "results.parquet")
    columns = {name: [row[name] for row in saved("experiments", "suite")["rows"]] for name in _RESULT_COLUMNS}
    schema = pa.schema([pa.field(name, kind, metadata={"description": text}) for name, (kind, text) in _RESULT_COLUMNS.items()])
    write_parquet(out / "results.parquet", pa.table(columns, schema=schema))
    written = pq.read_schema(out / logs[0])
    log_schema = pa.schema([field.with_metadata({"description": _LOG_COLUMNS[field.name]}) for field in written])
    tables = {
        name.removesuffix(".parquet"): (
            name,
            "A log: one row per stroke, rally after rally; the last number is the seed.",
            log_schema,
        )
        for name in logs
    }
    tables["results"] = ("results.parquet", "One row per method, task, split and budget.", schema)
    described = croissant.dataset(_SUITE, out, tables)
    replace_file(out / _CROISSANT, (json.dumps(described, indent=2, ensure_ascii=False) + "\n").encode())
    shown = markdown(
        ("column", "content"), [(f"`{name}`", text) for name, text in _LOG_COLUMNS.items()], left=("column", "content")
    )
    body = f"""# Logs and results of the shuttle_marl suite

Logs of `offline-v0` ({len(logs)}): strokes of one policy against `human:0.05`. A file is named by the policy, its number of own
strokes, and the seed. `results.parquet` has the aggregated scores of the methods that were run.

{shown}

```python
import pyarrow.parquet as pq

log = pq.read_table("{logs[0]}")
```

`shuttle-marl suite data offline-v0 --split {"dev" if quick else "test"} --out FOLDER` makes the same logs. {_NAMED_PLAYERS}
"""
    files = {"logs": logs, "results": ["results.parquet"]}
    _write_card(out, _dataset_front("Logs and results of the shuttle_marl suite", files), body)


def _dataset_front(title: str, files: dict[str, list[str]]) -> dict[str, Any]:
    configs = [{"config_name": name, "data_files": found} for name, found in files.items()]
    return {
        "license": "mit",
        "pretty_name": title,
        "task_categories": ["reinforcement-learning"],
        "tags": _TAGS,
        "configs": configs,
    }


def _write_card(out: Path, front: dict[str, Any], body: str) -> None:
    head = yaml.safe_dump(front, sort_keys=False, allow_unicode=True)
    replace_file(out / "README.md", f"---\n{head}---\n\n{body}".encode())


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
