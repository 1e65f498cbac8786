"""Copy trained agents into the package: the first seed of each experiment, not the best one.

    python -m experiments.ship_agents --win-rates runs/win_rates --styles runs/styles

Their names are `ppo`, `a2c`, `sac`, `ppo:self-play`, `ppo:attacking`, `ppo:defensive` and `ppo:cautious`. A model that is fitted
again needs new agents.
"""

import shutil
import sys
from pathlib import Path
from typing import Final

from shuttle_marl.commands.cli import entry_point
from shuttle_marl.game import load_game, model_folder
from shuttle_marl.policy.agents import load_agent, shipped_folder

OF_WIN_RATES: Final = {"ppo": "ppo-0", "a2c": "a2c-0", "sac": "sac-0", "ppo:self-play": "ppo-self-play-0"}
OF_STYLES: Final = {"ppo:attacking": "attacking-0", "ppo:defensive": "defensive-0", "ppo:cautious": "cautious-0"}


def ship_agents(win_rates: Path | None = None, styles: Path | None = None) -> None:
    """Copy the agents.

    Args:
        win_rates: run folder of experiments.win_rates.
        styles: run folder of experiments.styles.
    """
    game, model = load_game("default"), model_folder()
    sources: dict[str, Path] = {}
    if win_rates is not None:
        sources.update({name: win_rates / "training" / run / "agent" for name, run in OF_WIN_RATES.items()})
    if styles is not None:
        sources.update({name: styles / run / "agent" for name, run in OF_STYLES.items()})
    for folder in sources.values():
        load_agent(folder, game)  # raises an error for a damaged agent or another game before files are replaced
    for name, folder in sources.items():
        target = shipped_folder(name, model)
        shutil.rmtree(target, ignore_errors=True)
        shutil.copytree(folder, target)
        sys.stdout.write(f"{name}: {target}\n")


main = entry_point(ship_agents, "python -m experiments.ship_agents", __doc__ or "")


if __name__ == "__main__":
    sys.exit(main())
