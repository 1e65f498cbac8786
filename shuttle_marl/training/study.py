"""Training with many seeds in parallel, and the spread of the results."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, TypeVar

from rich.console import Console
from rich.progress import track

from shuttle_marl.base import runs
from shuttle_marl.base.cluster import check_processes, in_processes
from shuttle_marl.base.intervals import interquartile_mean
from shuttle_marl.policy.agents import read_card
from shuttle_marl.training.config import TrainingConfig, TrainingError
from shuttle_marl.training.run import AGENT, train

RESULTS: Final = "results.json"
_PACKAGES: Final = ("numpy", "scipy", "torch", "torchrl", "tensordict", "numba")
_Config = TypeVar("_Config")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Study:
    """Finished runs that differ only in their seeds.

    Attributes:
        folder: run folder, with a folder ``seed-N`` for each seed.
        evaluations: by seed, its last exact figures by name.
        figures: by name, the interquartile mean over the seeds with its 95 % interval, and the lowest and highest value.
    """

    folder: Path
    evaluations: dict[int, dict[str, float | None]]
    figures: dict[str, dict[str, float]]


def train_seeds(config: TrainingConfig, seeds: int, jobs: int, console: Console | None = None) -> Study:
    """Train with the seeds ``config.seed`` to ``config.seed + seeds - 1``.

    Args:
        config: settings of each run; ``out``, ``resume`` and ``overwrite`` are those of the common folder.
        seeds: number of runs, 2 or more.
        jobs: number of parallel processes; does not change the results.
        console: shows progress; None: silent.

    Raises:
        TrainingError: too few seeds or jobs, or a run failed (:func:`~shuttle_marl.training.run.train`); finished runs are kept.
        RunError: the folder cannot be used.
        ClusterError: processes cannot be started.
        KeyboardInterrupt: Ctrl-C; the message says what is saved.
    """
    if seeds < 2 or jobs < 1:
        raise TrainingError(f"--seeds {seeds} --jobs {jobs}: expected at least 2 seeds and 1 job")
    check_processes(min(jobs, seeds))
    fixed = {**config.fixed(), "seeds": seeds}
    name = f"{config.algorithm}-{seeds}-seeds"
    with runs.open_run(config.out, name, fixed, resume=config.resume, overwrite=config.overwrite) as run:
        run.begin(_PACKAGES, same={})
        folder = run.folder
        numbers = range(config.seed, config.seed + seeds)
        configs = [
            dataclasses.replace(config, seed=seed, out=folder / f"seed-{seed}", resume=False, overwrite=False) for seed in numbers
        ]

        def finished() -> str:
            return f"{sum(runs.is_finished(folder / f'seed-{seed}') for seed in numbers)} of {seeds} runs are finished"

        with run.resumable(finished):
            train_all(configs, jobs, console or Console(quiet=True))
        evaluations = {seed: read_card(folder / f"seed-{seed}" / AGENT)["evaluation"] for seed in numbers}
        study = Study(folder=folder, evaluations=evaluations, figures=_figures(list(evaluations.values())))
        found = {"figures": study.figures, "seeds": {str(seed): each for seed, each in evaluations.items()}}
        runs.write_json(folder / RESULTS, {**runs.describe(_PACKAGES), **found})
        run.finish()
    return study


def _figures(evaluations: Sequence[dict[str, float | None]]) -> dict[str, dict[str, float]]:
    figures = {}
    for name in evaluations[0]:
        values = [value for evaluation in evaluations if (value := evaluation[name]) is not None]
        if len(values) == len(evaluations):
            middle = interquartile_mean([values])
            figures[name] = {**middle._asdict(), "lowest": min(values), "highest": max(values)}
    return figures


def train_all(configs: Sequence[TrainingConfig], jobs: int, console: Console) -> None:
    """Start or resume training runs, in parallel.

    Args:
        jobs: number of parallel processes; does not change the results.
    """
    side_by_side(_train, configs, jobs, console)


def side_by_side(work: Callable[[_Config], None], configs: Sequence[_Config], jobs: int, console: Console) -> None:
    """Call a function with each configuration, in processes that end with this one.

    Args:
        work: function of a module, called with one configuration.
        configs: the configurations, in the order in which they start.
    """
    for _ in track(
        in_processes(work, configs, min(jobs, len(configs))), "training", len(configs), console=console, transient=True
    ):
        pass


def _train(config: TrainingConfig) -> None:
    assert config.out is not None
    train(dataclasses.replace(config, resume=(config.out / runs.CONFIG).exists()))
