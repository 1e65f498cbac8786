"""Train an agent with PPO, A2C or SAC. `--config FILE` takes settings from a JSON file, such as config.json of a run."""

import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final

import tyro
from rich.console import Console

from shuttle_marl.base.files import replace_file
from shuttle_marl.base.runs import PAGE, RALLIES, interrupts_held
from shuttle_marl.commands.cli import by_name, entry_point, named, print_json, say, tell, watching, words
from shuttle_marl.commands.options import Json
from shuttle_marl.game.shipped import resolve_game
from shuttle_marl.policy.registry import resolve
from shuttle_marl.training.config import CONFIGS, A2CConfig, PPOConfig, SACConfig, TrainingConfig


def _train(config: TrainingConfig, seeds: int, jobs: int, json_output: bool) -> None:
    # Unknown names are reported before PyTorch is imported, which takes seconds.
    game = resolve_game(config.game, config.profile)
    for name in () if config.self_play else config.opponent:
        if ":" not in name:
            resolve(name, game)
    if seeds != 1:
        _train_seeds(config, seeds, jobs, json_output)
        return
    with interrupts_held():
        from shuttle_marl.training.run import train  # noqa: PLC0415  torch

    done = train(config, Console(stderr=True, highlight=False))
    figures = done.evaluation
    against = "bc" if config.self_play else " and ".join(config.opponent)
    report, log = _report(done.folder, [done.folder]), done.folder / RALLIES
    told = [
        f"against {against}: wins {figures.rally_win:.2%} of rallies and {figures.match_win:.2%} of matches (exact), "
        f"{figures.text}",
        f"agent: {done.folder}/agent, played as agent:{done.folder}/agent",
        f"report: {report}",
        *([watching(log, config.game, config.profile)] if log.exists() else []),
    ]
    run = {"run": str(done.folder), "collector": config.collector, "seed": config.seed}
    numbers = {"iterations": done.iterations, "strokes": done.strokes, "seconds": done.seconds}
    if json_output:
        print_json({**run, **numbers, **dataclasses.asdict(figures), "report": str(report)})
    else:
        say(*told)


def _report(folder: Path, runs: Sequence[Path]) -> Path:
    from shuttle_marl.league.page import compare  # noqa: PLC0415  scipy

    path = folder / PAGE
    replace_file(path, compare(runs))
    return path


def _train_seeds(config: TrainingConfig, seeds: int, jobs: int, json_output: bool) -> None:
    with interrupts_held():
        from shuttle_marl.training import train_seeds  # noqa: PLC0415  torch

    done = train_seeds(config, seeds, jobs, Console(stderr=True, highlight=False))
    figures = {words(name): of for name, of in done.figures.items()}
    folders = [done.folder / f"seed-{seed}" for seed in range(config.seed, config.seed + seeds)]
    report = _report(done.folder, folders)
    if json_output:
        print_json({"run": str(done.folder), "figures": done.figures, "seeds": done.evaluations, "report": str(report)})
        return
    tell(
        named("Exact figures: interquartile mean, 95 % interval, lowest and highest seed", figures),
        f"{seeds} agents are in {done.folder}; the first is played as agent:{folders[0] / 'agent'}",
        f"report: {report}",
    )


Seeds = Annotated[int, tyro.conf.arg(help="number of seeds to train, starting at --seed; prints the spread of their results.")]
Jobs = Annotated[int, tyro.conf.arg(help="number of parallel training runs; does not change the result.")]
_JOBS: Final = os.cpu_count() or 1


def ppo(config: tyro.conf.OmitArgPrefixes[PPOConfig], seeds: Seeds = 1, jobs: Jobs = _JOBS, json_output: Json = False) -> None:
    """Proximal policy optimisation."""
    _train(config, seeds, jobs, json_output)


def a2c(config: tyro.conf.OmitArgPrefixes[A2CConfig], seeds: Seeds = 1, jobs: Jobs = _JOBS, json_output: Json = False) -> None:
    """Advantage actor-critic."""
    _train(config, seeds, jobs, json_output)


def sac(config: tyro.conf.OmitArgPrefixes[SACConfig], seeds: Seeds = 1, jobs: Jobs = _JOBS, json_output: Json = False) -> None:
    """Soft actor-critic for discrete actions."""
    _train(config, seeds, jobs, json_output)


COMMANDS: Final = by_name(ppo, a2c, sac)


def _with_settings(words: list[str]) -> list[str]:
    """The command line with the settings of ``--config FILE`` as flags before the others, which replace them."""
    if "--config" not in words[1:-1] or words[0] not in CONFIGS:
        return words
    at = words.index("--config", 1)
    kind, flags = CONFIGS[words[0]], list[str]()
    config, usual = kind.load(words[at + 1]), kind()
    for field in dataclasses.fields(kind):
        value, flag = getattr(config, field.name), field.name.replace("_", "-")
        if isinstance(value, bool):
            flags.append(f"--{flag}" if value else f"--no-{flag}")
        elif value != getattr(usual, field.name):
            flags += [f"--{flag}", *(value if isinstance(value, tuple) else [str(value)])]
    return [words[0], *flags, *words[1:at], *words[at + 2 :]]


main: Final = entry_point(COMMANDS, "python -m shuttle_marl.training", __doc__ or "", _with_settings)
