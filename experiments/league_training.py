"""Ways to train a league compared on the same budget: exact exploitability of the main agent, with several seeds each.

    python -m experiments.league_training [--budget 5m] [--seeds N] [--ways NAME ...] [--jobs N] [--out FOLDER] [--json FILE]

Every run has the whole budget and one worker, and as many runs as there are cores run side by side, so that a budget of time is
the same for all. The reference is psro with the exact best response as oracle: iterated best responses, without any learning.
Exploitability is exact, of the main agent that was least exploitable after a round, and of the one after the last round;
intervals are those of the interquartile mean over the seeds. A run that was broken off is continued with --resume.
"""

import dataclasses
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_args

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from experiments.saving import save_results
from experiments.spread import IQM
from shuttle_marl import runs
from shuttle_marl.commands.cli import run as run_command
from shuttle_marl.errors import ShuttleError
from shuttle_marl.game import load_game
from shuttle_marl.training.league.config import LeagueTrainingConfig

Variant = Literal["plain", "fictitious", "prioritised", "psro-ppo", "psro-exact"]
HEADINGS: Final = ("way", "exploitability", "95 %", "after the last round", "matches won against bc, %", "M strokes", "rounds")
_MILESTONES: Final = (0.25, 0.5, 0.75, 1.0)
"""Shares of the time at which the least exploitability so far is told."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class LeagueStudy:
    """Settings of the experiment."""

    ways: tuple[Variant, ...] = get_args(Variant)
    """Ways of training: plain, fictitious and prioritised self-play, psro with a learner and with the exact best response."""
    budget: str = "5m"
    """Time for each run."""
    seeds: int = 3
    """Runs of every way; psro with the exact best response draws nothing, so it runs once."""
    workers: int = 1
    """Processes of each run."""
    jobs: int = min(2, os.cpu_count() or 1)
    """Runs side by side: jobs times workers should not exceed the cores."""
    game: str = "default"
    """Model whose game is played."""
    quick: bool = False
    """Two seeds and a few strokes each: to see that all works, not to compare."""
    out: Path | None = None
    """Run folder; default runs/league_training, with a number behind it if that exists."""
    resume: bool = False
    """Continue the run in --out."""
    overwrite: bool = False
    """Replace the run in --out."""

    def __post_init__(self) -> None:
        if not self.ways or self.seeds < 2 or min(self.workers, self.jobs) < 1:
            raise ShuttleError(
                "--ways, --seeds, --workers, --jobs: expected one way or more, 2 seeds or more, and 1 or more of the others"
            )

    def sized(self) -> "LeagueStudy":
        """These settings with what --quick changes."""
        return dataclasses.replace(self, seeds=2) if self.quick else self

    def fixed(self) -> dict[str, Any]:
        """Settings that decide the result, as JSON."""
        fields = {name: getattr(self, name) for name in ("budget", "seeds", "workers", "jobs", "game", "quick")}
        return {"ways": list(self.ways), **fields}

    def training(self, folder: Path) -> dict[Variant, list[LeagueTrainingConfig]]:
        """The runs of each way."""
        return {way: [self._config(way, seed, folder) for seed in range(self._seeds(way))] for way in self.ways}

    def _seeds(self, way: Variant) -> int:
        return 1 if way == "psro-exact" else self.seeds

    def _config(self, way: Variant, seed: int, folder: Path) -> LeagueTrainingConfig:
        kind, _, oracle = way.partition("-")
        size: dict[str, Any] = {"budget": self.budget}
        if self.quick:
            size = {"rounds": 2} if oracle == "exact" else {"rounds": 2, "strokes": 3000, "batch": 512}
        settings: dict[str, Any] = {"variant": kind, "seed": seed, "game": self.game, "workers": self.workers, **size}
        if oracle:
            settings["oracle"] = oracle
        return LeagueTrainingConfig(**settings, out=folder / "training" / f"{way}-{seed}")


def train_one(config: LeagueTrainingConfig) -> None:
    """Start or continue a run."""
    from shuttle_marl.training.league.run import train_league  # noqa: PLC0415  torch

    assert config.out is not None
    train_league(dataclasses.replace(config, resume=(config.out / runs.CONFIG).exists()))


def measure(training: dict[Variant, list[LeagueTrainingConfig]]) -> list[dict[str, Any]]:
    """A row for each way, from the results of its runs."""
    rows = []
    for way, configs in training.items():
        found = []
        for config in configs:
            assert config.out is not None
            found.append(runs.read_json(config.out / "results.json"))
        best = [each["exploitability"] for each in found]
        rows.append(
            {
                "way": way,
                "seeds": len(configs),
                "exploitability": {"mean": float(np.mean(best)), "worst": max(best), "iqm": _interval(best)},
                "last_exploitability": float(np.mean([each["last_exploitability"] for each in found])),
                "match_win": float(np.mean([_line(each)["match_win"] for each in found])),
                "strokes": float(np.mean([each["strokes"] for each in found])),
                "rounds": float(np.mean([each["rounds"] for each in found])),
                "seconds": float(np.mean([each["seconds"] for each in found])),
                "over_time": {str(share): float(np.mean([_least(each, share) for each in found])) for share in _MILESTONES},
                "each": best,
            }
        )
    return rows


def _interval(values: list[float]) -> dict[str, Any] | None:
    return IQM.of([values]).as_json() if len(values) > 1 else None


def _line(result: dict[str, Any]) -> dict[str, Any]:
    """The line of the curve of the main agent that a run ended with."""
    line: dict[str, Any] = next(line for line in result["curve"] if line["policy"] == result["main_agent"])
    return line


def _least(result: dict[str, Any], share: float) -> float:
    """Least exploitability up to a share of the time of a run; before the first round it is that of the first."""
    before = [line["exploitability"] for line in result["curve"] if line["seconds"] <= share * result["seconds"]]
    return float(min(before, default=result["curve"][0]["exploitability"]))


def table_rows(result: dict[str, Any]) -> list[tuple[str, ...]]:
    """Cells of the table of results, under :data:`HEADINGS`."""
    rows: list[tuple[str, ...]] = []
    for row in result["rows"]:
        iqm = row["exploitability"]["iqm"]
        figures = (f"{row['exploitability']['mean']:.5f}", f"{iqm['low']:.5f} to {iqm['high']:.5f}" if iqm else "draws nothing")
        last, won = f"{row['last_exploitability']:.5f}", f"{100 * row['match_win']:.2f}"
        rows.append((row["way"], *figures, last, won, f"{row['strokes'] / 1e6:.0f}", f"{row['rounds']:.0f}"))
    return rows


def league_training(
    config: tyro.conf.OmitArgPrefixes[LeagueStudy], save: Annotated[Path | None, tyro.conf.arg(name="json")] = None
) -> None:
    """Train, and print the table.

    Args:
        config: what to train.
        save: also write the results here.
    """
    from shuttle_marl.training.study import side_by_side  # noqa: PLC0415  torch

    config = config.sized()
    console = Console(stderr=True, highlight=False, markup=False)
    with runs.open_run(config.out, "league_training", config.fixed(), resume=config.resume, overwrite=config.overwrite) as folder:
        training = config.training(folder)
        # One seed of every way after another, so that what is there after a part of the time can be compared.
        ordered = [configs[seed] for seed in range(config.seeds) for configs in training.values() if seed < len(configs)]
        side_by_side(train_one, ordered, config.jobs, console)
        result = {"game_hash": load_game(config.game).hash, **config.fixed(), "rows": measure(training)}
        result = save_results(folder, json.loads(json.dumps(result)), save)
    table = Table(*HEADINGS, title=f"Exploitability after {config.budget}, exact")
    for row in table_rows(result):
        table.add_row(*row)
    out = Console(highlight=False, width=None if sys.stdout.isatty() else 130)
    out.print(table)
    out.print(f"everything is in {folder}", markup=False)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line."""
    return run_command(league_training, prog="experiments.league_training", description=__doc__ or "", argv=argv)


if __name__ == "__main__":
    sys.exit(main())
