"""Comparison of the variants of league training with the same budget: exact exploitability of the main agent, several seeds each.

    python -m experiments.league_training [--budget 5m] [--seeds N] [--variants NAME ...] [--jobs N] [--out FOLDER] [--json FILE]

Every run has the whole budget and one worker, and at most as many runs as there are cores run in parallel, so that a time budget
is comparable. The baseline is psro with an exact oracle: iterated best responses, without learning. Exploitability is exact, of
the least exploitable main agent of all rounds, and of the last round; intervals are those of the interquartile mean over the
seeds. --resume continues an interrupted run.
"""

import dataclasses
import json
import os
import sys
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_args

import numpy as np
import tyro
from rich.console import Console

from experiments.saving import Study, finish, iqm
from shuttle_marl.base import runs
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.commands.cli import entry_point
from shuttle_marl.game import load_game
from shuttle_marl.training.league.config import LeagueTrainingConfig

Variant = Literal["plain", "fictitious", "prioritised", "psro-ppo", "psro-exact"]
_MILESTONES: Final = (0.25, 0.5, 0.75, 1.0)
"""Fractions of the time at which the least exploitability so far is reported."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class LeagueStudy(Study):
    """Settings of the experiment."""

    variants: tuple[Variant, ...] = get_args(Variant)
    """Variants: plain, fictitious and prioritised self-play, psro with a learner and with an exact oracle."""
    budget: str = "5m"
    """Time for each run."""
    seeds: int = 3
    """Runs of each variant; psro with an exact oracle is deterministic, so it runs once."""
    workers: int = 1
    """Worker processes of each run."""
    jobs: int = min(2, os.cpu_count() or 1)
    """Number of parallel runs; jobs times workers should not exceed the cores."""
    game: str = "default"
    """Model of the game."""
    quick: bool = False
    """Two seeds and few strokes: a smoke test without meaningful results."""

    def __post_init__(self) -> None:
        if not self.variants or self.workers < 1:
            raise ShuttleError("--variants, --workers: expected at least 1 variant and 1 worker")
        self.check(seeds=self.seeds, jobs=self.jobs)

    def sized(self) -> "LeagueStudy":
        """These settings, adjusted by --quick."""
        return dataclasses.replace(self, seeds=2) if self.quick else self

    def fixed(self) -> dict[str, Any]:
        """Settings that determine the result, as JSON; here how many runs share the cores too."""
        return {**super().fixed(), "jobs": self.jobs}

    def training(self, folder: Path) -> dict[Variant, list[LeagueTrainingConfig]]:
        """The runs of each variant."""
        return {
            variant: [self._config(variant, seed, folder) for seed in range(self._seeds(variant))] for variant in self.variants
        }

    def _seeds(self, variant: Variant) -> int:
        return 1 if variant == "psro-exact" else self.seeds

    def _config(self, variant: Variant, seed: int, folder: Path) -> LeagueTrainingConfig:
        kind, _, oracle = variant.partition("-")
        size: dict[str, Any] = {"budget": self.budget}
        if self.quick:
            size = {"rounds": 2} if oracle == "exact" else {"rounds": 2, "strokes": 3000, "batch": 512}
        settings: dict[str, Any] = {"variant": kind, "seed": seed, "game": self.game, "workers": self.workers, **size}
        if oracle:
            settings["oracle"] = oracle
        return LeagueTrainingConfig(**settings, record="none", out=folder / "training" / f"{variant}-{seed}")


def train_one(config: LeagueTrainingConfig) -> None:
    """Start or continue a run."""
    from shuttle_marl.training.league.run import train_league  # noqa: PLC0415  torch

    assert config.out is not None
    train_league(dataclasses.replace(config, resume=(config.out / runs.CONFIG).exists()))


def measure(training: dict[Variant, list[LeagueTrainingConfig]]) -> list[dict[str, Any]]:
    """A row for each variant, from the results of its runs."""
    rows = []
    for variant, configs in training.items():
        results = []
        for config in configs:
            assert config.out is not None
            results.append(runs.read_json(config.out / "results.json", dict[str, Any]))
        best = [each["exploitability"] for each in results]
        rows.append(
            {
                "variant": variant,
                "seeds": len(configs),
                "exploitability": {"mean": float(np.mean(best)), "worst": max(best), "iqm": _interval(best)},
                "last_exploitability": float(np.mean([each["last_exploitability"] for each in results])),
                "match_win": float(np.mean([_line(each)["match_win"] for each in results])),
                "strokes": float(np.mean([each["strokes"] for each in results])),
                "rounds": float(np.mean([each["rounds"] for each in results])),
                "seconds": float(np.mean([each["seconds"] for each in results])),
                "over_time": {str(share): float(np.mean([_least(each, share) for each in results])) for share in _MILESTONES},
                "each": best,
            }
        )
    return rows


def _interval(values: list[float]) -> dict[str, Any] | None:
    return iqm([values]) if len(values) > 1 else None


def _line(result: dict[str, Any]) -> dict[str, Any]:
    """Learning curve entry of the final main agent of a run."""
    line: dict[str, Any] = next(line for line in result["curve"] if line["policy"] == result["main_agent"])
    return line


def _least(result: dict[str, Any], share: float) -> float:
    """Least exploitability up to a fraction of the time of a run; before the first round, the value of the first round."""
    before = [line["exploitability"] for line in result["curve"] if line["seconds"] <= share * result["seconds"]]
    return float(min(before, default=result["curve"][0]["exploitability"]))


def league_training(
    config: tyro.conf.OmitArgPrefixes[LeagueStudy], save: Annotated[Path | None, tyro.conf.arg(name="json")] = None
) -> None:
    """Train, and print the table.

    Args:
        config: what to train.
        save: also write the results here.
    """
    from shuttle_marl.training.run import train_all  # noqa: PLC0415  torch

    config = config.sized()
    console = Console(stderr=True, highlight=False, markup=False)
    with config.open("league_training") as folder:
        training = config.training(folder)
        # All variants of one seed before the next seed, so that an unfinished study can be compared.
        ordered = [configs[seed] for seed in range(config.seeds) for configs in training.values() if seed < len(configs)]
        train_all(ordered, config.jobs, console, train_one)
        result = {"game_hash": load_game(config.game).hash, **config.fixed(), "rows": measure(training)}
        finish(folder, json.loads(json.dumps(result)), "league_training", copy=save)


main = entry_point(league_training, "python -m experiments.league_training", __doc__ or "")


if __name__ == "__main__":
    sys.exit(main())
