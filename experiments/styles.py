"""Agents with a style: PPO with shaped rewards, and how their play differs.

    python -m experiments.styles [--quick] [--out FOLDER] [--resume] [--json FILE]

Every style is a documented change of the reward (`shuttle_marl.training.learner`), trained with several seeds against
`bc`. The figures of an agent are exact (expected visits of every state against `bc`), so only the training varies between
seeds. Styles are compared by Welch's t-test over seeds, and with `bc` by a one-sample t-test; p-values are adjusted for
multiple comparisons (Benjamini & Yekutieli 2001, which allows for dependence).
"""

import dataclasses
import itertools
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np
import tyro
from rich.console import Console
from scipy.stats import false_discovery_control, ttest_1samp, ttest_ind

from experiments.saving import Study, finish, mean_and_deviation, ship
from shuttle_marl import exact
from shuttle_marl.base.arrays import F64
from shuttle_marl.commands.cli import entry_point
from shuttle_marl.court.staging.draw import load_measured
from shuttle_marl.game import load_game
from shuttle_marl.game.court import area_centre
from shuttle_marl.game.draws import ONE
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.registry import resolve
from shuttle_marl.training import PPOConfig
from shuttle_marl.training.run import train_all

OPPONENT: Final = "bc"
STYLES: Final[dict[str, PPOConfig]] = {
    "plain": PPOConfig(strokes=15_000_000),
    "attacking": PPOConfig(
        strokes=15_000_000, bonus=("smash=0.1", "half-smash=0.1", "net-kill=0.1", "drive=0.1", "push=-0.05", "lift=-0.05")
    ),
    "defensive": PPOConfig(
        strokes=15_000_000,
        bonus=(
            *(f"{shot}=0.07" for shot in ("lift", "clear", "block")),
            *(f"{shot}=-0.07" for shot in ("smash", "half-smash", "push", "drive", "net-kill")),
        ),
    ),
    "cautious": PPOConfig(strokes=15_000_000, fault_cost=0.5, risk_aversion=1.0),
}
"""Training settings by name; `plain` has no reward shaping."""
QUICK_STROKES: Final = 200_000
ATTACK: Final = ("smash", "half-smash", "net-kill", "drive")
FIGURES: Final = {
    "attack": "fraction of strokes hit hard, flat or down: smash, half smash, net kill, drive",
    "net": "fraction of strokes, serves aside, aimed at the front of the court",
    "tempo": "strokes a second, from the median flight time of each shot type in the matches",
    "faults": "own faults a stroke",
    "movement": "metres from where the opponent struck to the middle of the area aimed at",
}


def style_of(policy: TabulatedPolicy, opponent: TabulatedPolicy) -> dict[str, float]:
    """The :data:`FIGURES` of a policy against an opponent, exactly, both serving equally often."""
    game = policy.game
    seen = exact.visits(policy, opponent)
    own, theirs = (seen.base_pairs(seat).sum(axis=0) for seat in (0, 1))
    shot = game.catalogue.shot[game.base_pair_stroke]
    both = own + theirs
    rally = own * ~game.catalogue.is_serve[game.base_pair_stroke]
    moved = np.isfinite(metres := _metres(game))
    return {
        "attack": float(own[np.isin(shot, [SHOTS.index(name) for name in ATTACK])].sum() / own.sum()),
        "net": float(rally[game.catalogue.area[game.base_pair_stroke] < 3].sum() / rally.sum()),
        "tempo": float(both.sum() / (both @ load_measured().flight_time[shot, 1])),
        "faults": float((seen.base_pairs(0) * game.limits[..., 0]).sum() / ONE / own.sum()),
        "movement": float(own[moved] @ metres[moved] / own[moved].sum()),
    }


def _metres(game: Game) -> F64:
    """``[base pairs]`` distance from the area of the own last stroke, where the opponent struck, to the next; NaN without one."""
    centres = np.append(area_centre(game.catalogue.area), np.full((1, 2), np.nan), axis=0)
    before = centres[game.own(game.base_pair_state)]
    return np.asarray(np.linalg.norm(centres[game.base_pair_stroke] - before, axis=1))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Styles(Study):
    """Settings of the experiment."""

    seeds: int = 3
    """Training runs of each style."""
    jobs: int = 2
    """Number of parallel training runs; does not change the result."""
    ship: bool = False
    """Copy the agents of the first seed into the package."""

    def training(self, folder: Path) -> dict[str, list[PPOConfig]]:
        """The training runs of every style."""
        return {
            style: [
                dataclasses.replace(
                    config,
                    opponent=(OPPONENT,),
                    seed=seed,
                    out=folder / f"{style}-{seed}",
                    record="none",
                    strokes=QUICK_STROKES if self.quick else config.strokes,
                )
                for seed in range(self.seeds)
            ]
            for style, config in STYLES.items()
        }


def measure(training: dict[str, list[PPOConfig]]) -> dict[str, Any]:
    """Figures of every style and of the opponent, and which differ."""
    game = load_game("default")
    opponent = tabulate(resolve(OPPONENT, game), game)
    found: dict[str, list[dict[str, float]]] = {OPPONENT: [_figures(opponent, opponent)]}
    for style, configs in training.items():
        names = [f"agent:{config.out}/agent" for config in configs]
        found[style] = [_figures(tabulate(resolve(name, game), game), opponent) for name in names]
    rows = [
        {
            "style": style,
            **{name: mean_and_deviation([agent[name] for agent in agents]) for name in agents[0] if len(agents) > 1},
            **({name: {"mean": value} for name, value in agents[0].items()} if len(agents) == 1 else {}),
        }
        for style, agents in found.items()
    ]
    return {"rows": rows, "different": differences(found)}


def _figures(policy: TabulatedPolicy, opponent: TabulatedPolicy) -> dict[str, float]:
    odds = exact.evaluate(policy, opponent).odds()
    return {**style_of(policy, opponent), "rally_win": odds.rally, "match_win": odds.match()}


def differences(found: dict[str, list[dict[str, float]]]) -> list[dict[str, Any]]:
    """Adjusted p-value of every figure for every two styles; a style with one agent is a fixed point."""
    tests = []
    for (first, a), (second, b) in itertools.combinations(found.items(), 2):
        for name in FIGURES:
            x, y = ([agent[name] for agent in agents] for agents in (a, b))
            p = ttest_1samp(y, x[0]).pvalue if len(x) == 1 else ttest_ind(x, y, equal_var=False).pvalue
            tests.append({"styles": [first, second], "figure": name, "difference": float(np.mean(y) - np.mean(x)), "p": float(p)})
    adjusted = false_discovery_control([test["p"] for test in tests], method="by")
    return [{**test, "adjusted_p": float(p)} for test, p in zip(tests, adjusted, strict=True)]


def styles(config: tyro.conf.OmitArgPrefixes[Styles], json: Path | None = None) -> None:
    """Train the styles, measure their play, and print the table.

    Args:
        config: what to train.
        json: write the results here too.
    """
    config, console = config.sized(), Console(stderr=True, highlight=False)
    with config.open("styles") as folder:
        training = config.training(folder)
        train_all(list(itertools.chain(*training.values())), config.jobs, console)
        objectives = {
            style: {name: run[0].fixed()[name] for name in ("bonus", "fault_cost", "risk_aversion", "strokes")}
            for style, run in training.items()
        }
        finish(folder, {**config.fixed(), "objectives": objectives, **measure(training)}, "styles", copy=json)
        if config.ship:
            ship({f"ppo:{style}": folder / f"{style}-0" / "agent" for style in STYLES if style != "plain"})


main = entry_point(styles, "python -m experiments.styles", __doc__ or "")


if __name__ == "__main__":
    sys.exit(main())
