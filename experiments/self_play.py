"""Comparison of the variants of self-play: exploitability of PPO after several training budgets, with several seeds each.

    python -m experiments.self_play [--game NAME] [--seeds N] [--variants NAME ...] [--strokes N ...] [--out FOLDER] [--json]

Learning rate and entropy decay over the budget of each run, so a short run is no prefix of a long one. Exploitability is exact,
of the last policy and of the best evaluated one. Seconds include evaluations and depend on the machine. Runs are trained in
parallel, in folders of their own, so a study can be resumed with additional variants, budgets or seeds.
"""

import dataclasses
import sys
from pathlib import Path
from typing import Annotated, Any, Final, get_args

import numpy as np
import tyro
from rich.console import Console

from experiments.saving import Study, finish, iqm
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.commands.cli import entry_point
from shuttle_marl.game import load_game
from shuttle_marl.policy.agents import read_card
from shuttle_marl.training import PPOConfig
from shuttle_marl.training.config import SelfPlayVariant
from shuttle_marl.training.run import train_all

STROKES: Final = (40_000_000, 200_000_000, 1_000_000_000)
"""Budgets: about 15 s, 1 min and 3 min on one core, including evaluations."""
_EVALUATE_EVERY: Final = 100  # iterations between evaluations, which take about half a second each


@dataclasses.dataclass(frozen=True, kw_only=True)
class SelfPlayStudy(Study):
    """Settings of the experiment."""

    variants: tuple[SelfPlayVariant, ...] = get_args(SelfPlayVariant)
    """Variants of self-play."""
    strokes: tuple[int, ...] = STROKES
    """Strokes of a training run, for each budget."""
    game: str = "default"
    """The game."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.variants or not self.strokes or min(self.strokes) < 1:
            raise ShuttleError("--variants and --strokes: expected at least one variant and one budget")

    def compared(self) -> dict[str, Any]:
        """Variants, budgets and seeds of the study, as JSON."""
        return {"variants": list(self.variants), "strokes": list(self.strokes), "seeds": self.seeds}

    def fixed(self) -> dict[str, Any]:
        """Settings that all runs share; variants, budgets and seeds may be added to a study."""
        return {"evaluate_every": _EVALUATE_EVERY}

    def training(self, folder: Path) -> dict[tuple[SelfPlayVariant, int], list[PPOConfig]]:
        """The training runs, by variant and budget."""
        return {
            (variant, strokes): [
                PPOConfig(
                    opponent=("self",),
                    game=self.game,
                    variant=variant,
                    strokes=strokes,
                    seed=seed,
                    evaluate_every=_EVALUATE_EVERY,
                    record="none",
                    out=folder / "training" / f"{variant}-{strokes}-{seed}",
                )
                for seed in range(self.seeds)
            ]
            for variant in self.variants
            for strokes in self.strokes
        }


def measure(training: dict[tuple[SelfPlayVariant, int], list[PPOConfig]]) -> list[dict[str, Any]]:
    """A row for each variant and budget, from the cards of the agents."""
    rows = []
    for (variant, strokes), configs in training.items():
        cards = []
        for config in configs:
            assert config.out is not None
            cards.append([read_card(config.out / name) for name in ("agent", "best")])
        last, best = ([card[part]["evaluation"]["exploitability"] for card in cards] for part in (0, 1))
        rows.append(
            {
                "variant": variant,
                "strokes": strokes,
                "seconds": float(np.median([card[0]["seconds"] for card in cards])),
                "seeds": len(configs),
                "exploitability": {"mean": float(np.mean(last)), "worst": max(last), "iqm": iqm(last)},
                "exploitability_of_the_best": {"mean": float(np.mean(best)), "worst": max(best)},
                "each": last,
            }
        )
    return rows


def self_play(
    config: tyro.conf.OmitArgPrefixes[SelfPlayStudy], as_json: Annotated[bool, tyro.conf.arg(name="json")] = False
) -> None:
    """Train, and print the table.

    Args:
        config: settings.
        as_json: print JSON instead of a table.
    """
    config, console = config.sized(strokes=(200_000,)), Console(stderr=True, highlight=False)
    with config.open("self_play") as folder:
        training = config.training(folder)
        train_all([run for group in training.values() for run in group], config.jobs, console)
        settings = {
            name: value for name, value in next(iter(training.values()))[0].fixed().items() if name not in ("seed", "variant")
        }
        result = {"game": load_game(config.game).hash, **config.compared(), "config": settings, "rows": measure(training)}
        finish(folder, result, "self_play", as_json=as_json)


main = entry_point(self_play, "python -m experiments.self_play", __doc__ or "")


if __name__ == "__main__":
    sys.exit(main())
