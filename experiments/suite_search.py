"""Search of settings of the learners of ``exploit-v1`` without tables, on the dev split.

    python -m experiments.suite_search [--budgets STROKES …] [--out FOLDER] [--resume] [--json FILE]

Every setting of the space plays every opponent of dev with seed 0, at each budget; its figure is the mean gain. The best one of
a method and a budget is what `shuttle_marl.suite.methods.players` has. Strokes are those of all runs of the search.
"""

import dataclasses
import json as json_format
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import tyro

from experiments.saving import RunFolder, save_results
from shuttle_marl.base import runs
from shuttle_marl.commands.cli import run as run_command
from shuttle_marl.game.shipped import resolve_game
from shuttle_marl.game.tables import Game
from shuttle_marl.suite.exploit import PlayerSetting, opponent_of
from shuttle_marl.suite.methods.adapters import TOLERANCE
from shuttle_marl.suite.methods.players import Boosting, estimated, learner, planned
from shuttle_marl.suite.offline import in_game
from shuttle_marl.suite.results import TASKS, arena_of
from shuttle_marl.suite.task import gains

TASK: Final = "exploit-v1"
_EPOCHS: Final = {"growth": 0.0, "epochs": 4, "minibatches": 4, "learning_rate": 3e-3}
PPO: Final[dict[int, list[dict[str, Any]]]] = {
    10**5: [{"own": own, "batch": 2048, **_EPOCHS} for own in (0.0, 0.25)],
    10**6: [{"own": own, "batch": 4096, **_EPOCHS} for own in (0.0, 0.25)],
}
"""Settings of ``ppo-restricted`` by budget."""
P: Final = (0.6, 0.75, 0.9)  # restrictions of the response of ``model-boosted``
BOOSTING: Final[dict[int, list[dict[str, Any]]]] = {
    10**5: [{"leaves": 8, "trees": 150}, {"leaves": 16, "trees": 150}],
    10**6: [{"leaves": 16, "trees": 200}, {"leaves": 8, "trees": 200}],
    10**7: [{"leaves": 31, "trees": 250, "most": 1_000_000}],
}
"""Settings of ``model-boosted`` by budget; each with all of :data:`P`."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Search(RunFolder):
    """Settings of the search."""

    budgets: tuple[int, ...] = (10**5, 10**6, 10**7)
    """Budgets, in strokes."""

    def fixed(self) -> dict[str, Any]:
        """Settings that every run has in common, as JSON."""
        return {"task": TASK, "game": resolve_game("default:recovery").hash}


def trials(budget: int) -> list[tuple[str, dict[str, Any]]]:
    """Methods and settings of a budget."""
    boosted = [("model-boosted", each) for each in BOOSTING.get(budget, ())]
    return [*boosted, *(("ppo-restricted", each) for each in PPO.get(budget, ()))]


def played(method: str, options: dict[str, Any], setting: PlayerSetting) -> Iterator[tuple[dict[str, Any], Any, int]]:
    """Settings, player and strokes of a trial; restrictions share the play."""
    if method == "model-boosted":
        estimate, strokes = estimated(setting, Boosting(**options))
        for p in P:
            yield {**options, "p": p}, in_game(planned(setting, estimate, p), setting.game), strokes
    else:
        found = learner(setting, "ppo", **options)
        yield options, found.player, found.strokes or 0


def search(config: tyro.conf.OmitArgPrefixes[Search], json: Path | None = None) -> None:
    """Run the search, and write its runs.

    Args:
        config: what to run.
        json: write the results here too.
    """
    with config.open("suite-search") as folder:
        for budget in config.budgets:
            arena = arena_of(TASKS[TASK], "default", "dev", budget=budget)
            game: Game = arena.game
            for number, (method, options) in enumerate(trials(budget)):
                for case in TASKS[TASK].cases(arena):
                    path = folder / f"{budget}-{number}-{case.options['opponent'].replace('/', '-')}.json"
                    if path.exists():
                        continue
                    opponent, begun = opponent_of(arena, case), time.process_time()
                    table = folder / f"{opponent.hash[:16]}.npz"  # tables are known by name
                    opponent.save(table)
                    setting = PlayerSetting(
                        game=game, model=arena.model, opponent=f"table:{table}", budget=budget, seed=0, folder=folder
                    )
                    rows = [
                        {
                            "method": method,
                            "budget": budget,
                            "settings": settings,
                            "opponent": case.options["opponent"],
                            "gain": round(gains(arena, [(player, opponent)], tolerance=TOLERANCE)[0], 4),
                            "strokes": strokes,
                        }
                        for settings, player, strokes in played(method, options, setting)
                    ]
                    runs.write_json(path, {"rows": rows, "seconds": time.process_time() - begun})
        found = [row for path in sorted(folder.glob("*-*.json")) for row in json_format.loads(path.read_text())["rows"]]
        save_results(folder, summary(found), json)


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Mean gain of each setting, best first, by budget and method."""
    groups: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for row in rows:
        named = f"{row['method']}, {row['budget']:,} strokes"
        groups.setdefault(named, {}).setdefault(json_format.dumps(row["settings"]), []).append(row)
    found = {
        name: sorted(
            (
                {
                    "settings": those[0]["settings"],
                    "gain": round(float(np.mean([row["gain"] for row in those])), 4),
                    "gains": {row["opponent"]: row["gain"] for row in those},
                    "strokes": sum(row["strokes"] for row in those),
                }
                for those in settings.values()
            ),
            key=lambda row: -row["gain"],
        )
        for name, settings in groups.items()
    }
    return {"task": TASK, "seed": 0, "settings": found}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line."""
    return run_command(search, prog="experiments.suite_search", description=__doc__ or "", argv=argv)


if __name__ == "__main__":
    sys.exit(main())
