"""The paper's second table: win rates in 1,000 matches of agents trained against a fixed opponent.

    python -m experiments.win_rates [--quick] [--out FOLDER] [--resume] [--json FILE]

Every algorithm is trained with its default settings and several seeds against one opponent, the behaviour-cloned average
player `bc`, then plays 1,000 recorded matches against it. In addition to the sampled win rate, the following are exact: the
probability of winning a rally and a match, the normalised score (0 for `bc`, 1 for the best response), exploitability, and the
same against opponents that no agent was trained against. Self-play is trained without any opponent.

The run folder holds the training runs, the matches, and `results.json`; --resume continues an interrupted run.
"""

import dataclasses
import functools
import json as json_format
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import tyro
from rich.console import Console
from rich.progress import track

from experiments.saving import Study, finish, iqm, mean_and_deviation, ship
from shuttle_marl.base import runs
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.commands.cli import entry_point
from shuttle_marl.exact.odds import best_odds, of_pair, over, pair_odds
from shuttle_marl.game import load_game
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.game.shipped import refits_of
from shuttle_marl.game.tables import Game
from shuttle_marl.league.entrants import LeagueConfig
from shuttle_marl.league.run import run_league
from shuttle_marl.policy.agents import read_card
from shuttle_marl.policy.registry import resolve
from shuttle_marl.training import A2CConfig, Evaluator, PPOConfig, SACConfig, TrainingConfig
from shuttle_marl.training.run import train_all

AGENTS: Final[dict[str, TrainingConfig]] = {
    "a2c": A2CConfig(),
    "ppo": PPOConfig(),
    "sac": SACConfig(),
    "ppo, self-play": PPOConfig(opponent=("self",), variant="best-response", strokes=200_000_000),
}
OPPONENT: Final = "bc"  # opponent of the agents, in training and in the matches
FIXED: Final = {"bc": "bc@1", "best response": f"best-response:{OPPONENT}", "minimax": "minimax"}
"""Rows without training; `bc@1` is `bc` under a second name, so that it can play against itself. It then wins exactly half:
each match is played twice with the seats swapped and the same draws."""
OPPONENTS: Final = ("bc", "attacking", "defensive", "safe", "random", "minimax")
QUICK_STROKES: Final = {"a2c": 100_000, "ppo": 100_000, "sac": 40_000, "ppo, self-play": 100_000}


@dataclasses.dataclass(frozen=True, kw_only=True)
class WinRates(Study):
    """Settings of the experiment."""

    matches: int = 1000
    """Matches that every trained agent plays against the opponent; an even number."""
    ship: bool = False
    """Copy the agents of the first seed into the package."""

    def training(self, folder: Path) -> dict[tuple[str, int], TrainingConfig]:
        """The training runs, by agent and seed."""
        configs = {}
        for agent, base in AGENTS.items():
            changes: dict[str, Any] = {} if base.self_play else {"opponent": (OPPONENT,)}
            changes |= {"strokes": QUICK_STROKES[agent]} if self.quick else {}
            for seed in range(self.seeds):
                out = folder / "training" / f"{agent.replace(', ', '-')}-{seed}"
                configs[agent, seed] = dataclasses.replace(base, seed=seed, out=out, record="none", **changes)
        return configs


def fraction_won(name: str, config: WinRates, seed: int, folder: Path) -> float:
    """Fraction of the matches that a policy wins against the opponent; all rallies are recorded."""
    out = folder / "matches" / f"{name.replace(':', '-').replace('/', '-')}-{seed}"
    league = LeagueConfig(
        pool=(name, OPPONENT), matches=config.matches, seed=seed, exact=False, out=out, resume=(out / runs.CONFIG).exists()
    )
    (result,) = run_league(league).results
    if result.forfeit:
        raise ShuttleError(f"{' v '.join(result.names)}: {result.reason}")
    won = result.seen_by(name)
    return won["wins"] / won["matches"]


def measure(config: WinRates, folder: Path, console: Console) -> dict[str, Any]:
    """Play the matches and compute the exact figures of every agent."""
    game = load_game("default")
    evaluator = Evaluator(game, [tabulate(resolve(OPPONENT, game), game)])
    others = {name: tabulate(resolve(name, game), game) for name in OPPONENTS}
    training = config.training(folder)
    named = {row: [name] * config.seeds for row, name in FIXED.items()}
    for (agent, _), run in training.items():
        named.setdefault(agent, []).append(f"agent:{run.out}/agent")
    # Two of the refits show that all works.
    refits = refits_of(game)[: 2 if config.quick else None]
    rows, matrix = [], {}
    known: dict[str, dict[str, float]] = {}
    for row, names in track(named.items(), "matches", console=console, transient=True):
        found, against, policies = [], [], []
        for seed, name in enumerate(names):
            policy = tabulate(resolve(name, game), game)
            # Rows without training play the same policy with every seed.
            figures = known.get(policy.hash) or dataclasses.asdict(evaluator.evaluate(policy))
            known[policy.hash] = figures
            found.append({"seed": seed, "matches_won": fraction_won(name, config, seed, folder), **figures})
            against.append(_match_odds(policy, others))
            policies.append(policy)
        away = over(refits, functools.partial(_away, policies, others[OPPONENT])) if len(refits) > 1 else None
        rows.append(
            {
                **_row(row, found, [run for (agent, _), run in training.items() if agent == row]),
                "away": None if away is None else {name: figure._asdict() for name, figure in away.items()},
            }
        )
        matrix[row] = {name: float(np.mean([odds[name] for odds in against])) for name in others}
    return {
        "game": game.hash,
        "opponent": OPPONENT,
        **config.fixed(),
        "rows": rows,
        "exact_match_win_against": matrix,
        "exploitability_of_bc": _exploitability(game, "bc"),
        "curves": _curves(training),
    }


def _row(agent: str, found: list[dict[str, float]], training: list[TrainingConfig]) -> dict[str, Any]:
    columns = ("matches_won", "match_win", "rally_win", "normalised_score", "exploitability")
    spread = {name: mean_and_deviation([seed[name] for seed in found]) for name in columns}
    row: dict[str, Any] = {"agent": agent, **spread, "seeds": found}
    if training:
        row["normalised_score"]["iqm"] = iqm([seed["normalised_score"] for seed in found])
        cards = [read_card(_out(run) / "agent") for run in training]
        row["strokes"] = cards[0]["strokes"]
        row["seconds"] = mean_and_deviation([card["seconds"] for card in cards])
        row["config"] = {name: value for name, value in training[0].fixed().items() if name != "seed"}
    return row


def _out(run: TrainingConfig) -> Path:
    assert run.out is not None
    return run.out


def _away(policies: Sequence[TabulatedPolicy], opponent: TabulatedPolicy, refit: Game) -> dict[str, float]:
    """``rally_win`` and ``match_win`` of a row's policies against the opponent in a refit, means over the seeds."""
    found = [of_pair(policy, opponent, refit) for policy in {policy.hash: policy for policy in policies}.values()]
    return {name: float(np.mean([odds[name] for odds in found])) for name in found[0]}


def _match_odds(policy: TabulatedPolicy, others: dict[str, TabulatedPolicy]) -> dict[str, float]:
    found = pair_odds([(policy, other) for other in others.values()])
    return {name: odds.match() for name, odds in zip(others, found, strict=True)}


def _exploitability(game: Game, name: str) -> float:
    return best_odds([tabulate(resolve(name, game), game)])[0].value


def _curves(training: dict[tuple[str, int], TrainingConfig]) -> dict[str, list[list[dict[str, float]]]]:
    """The exact figures of every evaluation, by agent and seed."""
    kept = ("strokes", "seconds", "match_win", "normalised_score", "exploitability")
    curves: dict[str, list[list[dict[str, float]]]] = {}
    for (agent, _), run in training.items():
        lines = (_out(run) / "metrics.jsonl").read_text(encoding="utf-8").splitlines()
        points = [json_format.loads(line) for line in lines]
        curves.setdefault(agent, []).append([{name: round(point[name], 5) for name in kept} for point in points])
    return curves


def win_rates(config: tyro.conf.OmitArgPrefixes[WinRates], json: Path | None = None) -> None:
    """Train, play, and print the table.

    Args:
        config: what to train and to play.
        json: write the results here too.
    """
    config, console = config.sized(matches=100), Console(stderr=True, highlight=False)
    with config.open("win_rates") as folder:
        train_all(list(config.training(folder).values()), config.jobs, console)
        finish(folder, measure(config, folder, console), "win_rates", "win_rates_matrix", copy=json)
        if config.ship:
            first = {agent: run for (agent, seed), run in config.training(folder).items() if seed == 0}
            ship({agent.replace(", ", ":"): _out(run) / "agent" for agent, run in first.items()})


main = entry_point(win_rates, "python -m experiments.win_rates", __doc__ or "")


if __name__ == "__main__":
    sys.exit(main())
