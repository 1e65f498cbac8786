"""``python -m shuttle_marl.training ppo | a2c | sac``: train an agent."""

from collections.abc import Sequence
from typing import Final

import tyro
from rich.console import Console

from shuttle_marl.commands.cli import Command, run
from shuttle_marl.training.a2c import A2CConfig
from shuttle_marl.training.config import TrainingConfig
from shuttle_marl.training.ppo import PPOConfig
from shuttle_marl.training.sac import SACConfig


def _train(config: TrainingConfig) -> None:
    from shuttle_marl.training.run import train  # noqa: PLC0415  torch

    done = train(config, Console(stderr=True, highlight=False))
    figures = done.evaluation
    out = Console(highlight=False, soft_wrap=True, markup=False)
    against = "bc" if config.self_play else " and ".join(config.opponent)
    out.print(
        f"against {against}: wins {figures.rally_win:.2%} of rallies and {figures.match_win:.2%} of matches (exact), "
        f"{figures.score_text}, {figures.exploitability_text}"
    )
    out.print(f"agent: {done.folder}/agent, played as agent:{done.folder}/agent")


def ppo(config: tyro.conf.OmitArgPrefixes[PPOConfig]) -> None:
    """Proximal policy optimisation."""
    _train(config)


def a2c(config: tyro.conf.OmitArgPrefixes[A2CConfig]) -> None:
    """Advantage actor-critic."""
    _train(config)


def sac(config: tyro.conf.OmitArgPrefixes[SACConfig]) -> None:
    """Soft actor-critic for discrete actions."""
    _train(config)


COMMANDS: Final[dict[str, Command]] = {"ppo": ppo, "a2c": a2c, "sac": sac}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    return run(COMMANDS, prog="python -m shuttle_marl.training", description=__doc__ or "", argv=argv)
