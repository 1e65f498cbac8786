"""Believability of staged rallies, and the speed at which they are made.

    python -m benchmarks.staging [--rallies N] [--quick] [--json]

Rallies between two behaviour-cloned players are staged, right- and left-handers, male and female athletes in turn, and
measured as motion: positions, rotations, and the path of the shuttle. Seconds are CPU seconds of the process, which has one
thread (set OMP_NUM_THREADS=1).
"""

import json
import time
from typing import Annotated, Any, Final

import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.machine import this_machine
from shuttle_marl.game import default_game
from shuttle_marl.policy.registry import resolve
from shuttle_marl.staging import ATHLETES, measure, play_rallies, stage, summary

_HANDS: Final = ("right", "right", "left")
_QUICK: Final = 40


def run(rallies: int, seed: int, console: Console) -> dict[str, Any]:
    """Stage and measure; see the keys. Lengths are metres."""
    game = default_game()
    policy = resolve("bc", game)
    played = play_rallies(game, (policy, policy), rallies, seed=seed)
    stage(played[0], seed=0, athletes=ATHLETES)  # solves the libraries of poses, which are kept
    cpu, found = 0.0, []
    for i, rally in enumerate(track(played, "staging", console=console)):
        hands = (_HANDS[i % 3], _HANDS[i // 3 % 3])
        athletes = (ATHLETES[i % 2], ATHLETES[i // 2 % 2])
        begun = time.process_time()
        motion = stage(rally, seed=i, handedness=hands, athletes=athletes)
        cpu += time.process_time() - begun
        found.append(measure(motion))

    figures = summary(found)
    return {**this_machine(), **figures, "times_real_time": figures["seconds"] / cpu}


def main(
    *,
    rallies: int = 1000,
    seed: int = 0,
    quick: bool = False,
    as_json: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> None:
    """Measure and print.

    Args:
        rallies: how many are staged.
        seed: of the rallies.
        quick: stage 40 rallies.
        as_json: print JSON instead of a table.
    """
    result = run(_QUICK if quick else rallies, seed, Console(stderr=True))
    if as_json:
        print(json.dumps(result, indent=2))
        return
    table = Table("", "measured")
    for name, value in result.items():
        table.add_row(name.replace("_", " "), f"{value:,.4f}" if isinstance(value, float) else str(value))
    Console().print(table)


if __name__ == "__main__":
    tyro.cli(main)
