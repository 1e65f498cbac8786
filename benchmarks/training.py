"""Speed of PPO training in strokes per second, and the overhead of recording all rallies.

    python -m benchmarks.training [--strokes N] [--repeats N] [--device cuda] [--json]

Measured with one PyTorch thread, or on `--device`, over late iterations of the default schedule, without evaluations: rollouts,
updates, and for the overhead recording of all rallies. `strokes_trained_per_s` is per second of wall-clock time;
`strokes_trained_per_cpu_s` is per second of CPU time of all threads, which depends less on other programs.
"""

import dataclasses
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
import tyro

from docs.tools.results import Json, show, this_machine
from shuttle_marl.game import default_game
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.registry import resolve
from shuttle_marl.training import PPOConfig, TrainingError
from shuttle_marl.training.learner import Callback, Learner
from shuttle_marl.training.ppo import PPO
from shuttle_marl.training.rally_log import RunLog, open_log
from shuttle_marl.training.run import check_device

MEASURED: Final = 100  # measured iterations; enough to make the time for closing the log negligible


class _Run(Callback):
    """PPO in the last iteration of a run."""

    def __init__(self, config: PPOConfig, game: Game, opponents: list[TabulatedPolicy]) -> None:
        torch.manual_seed(0)
        self.config = config
        self.game, self.opponents = game, opponents
        self.learner = PPO(self.config, game, opponents)
        self.collector = self.learner.collector
        self.collector.set_seed(1)
        for _ in range(self.config.iterations - 1):
            self.iterate()
        self.collector.iteration -= 1

    def iterate(self, log: RunLog | None = None, update: int = 0) -> int:
        """One iteration, recorded as in a run; returns its strokes."""
        remaining = max(0.02, 1 - self.collector.iteration / self.config.iterations)
        self.log, self.update = log, update
        self.learner.iterate(remaining, self)
        return self.collector.strokes

    def collected(self, learner: Learner) -> None:
        """Record the rallies, while the learner learns from them."""
        if self.log is not None:
            self.log.record(learner.collector.sampler, 0, self.update)

    def learned(self, learner: Learner, losses: dict[str, float]) -> None:  # noqa: ARG002
        """Wait for the rallies."""
        if self.log is not None:
            self.log.settle()

    def measure(self, *, record: bool) -> tuple[float, float, int]:
        """Seconds, CPU seconds and strokes of some iterations."""
        with tempfile.TemporaryDirectory() as folder:
            log = open_log(Path(folder), self.config, self.game, self.opponents, [1]) if record else None
            strokes, begun, cpu = 0, time.perf_counter(), time.process_time()
            for update in range(MEASURED):
                strokes += self.iterate(log, update)
                self.collector.iteration -= 1
            if log is not None:
                log.close()
            return time.perf_counter() - begun, time.process_time() - cpu, strokes


def rows(base: PPOConfig, repeats: int) -> list[dict[str, Any]]:
    """A row for training against ``bc``, and one for self-play."""
    game = default_game()
    found = []
    for opponent in ("bc", "self"):
        opponents = [] if opponent == "self" else [tabulate(resolve(opponent, game), game)]
        run = _Run(dataclasses.replace(base, opponent=(opponent,)), game, opponents)
        # Interleaved, because the speed of a machine varies over time.
        times = [(run.measure(record=False), run.measure(record=True)) for _ in range(repeats)]
        plain, logged = np.array(times).transpose(1, 0, 2)
        wall, cpu = (float(np.median(plain[:, 2] / plain[:, part])) for part in (0, 1))
        found.append(
            {
                "opponent": opponent,
                "strokes_trained_per_s": wall,
                "strokes_trained_per_cpu_s": cpu,
                "recording_overhead": float(np.median(plain[:, 2] / plain[:, 0]) / np.median(logged[:, 2] / logged[:, 0]) - 1),
                "distinct_states": len(run.collector.sampler.known),
                "strokes_an_iteration": run.config.batch_of(run.config.iterations - 1),
            }
        )
    return found


def _name(device: str) -> str:
    """Model of a GPU; otherwise the name of the device."""
    return torch.cuda.get_device_name(device) if torch.device(device).type == "cuda" else device


def main(*, strokes: int = 20_000_000, repeats: int = 3, device: str = "cpu", as_json: Json = False) -> None:
    """Measure and print.

    Args:
        strokes: strokes of the run whose last iteration is measured.
        repeats: number of measurements; the median is reported.
        device: PyTorch device, such as cuda.
        as_json: print JSON instead of a table.
    """
    try:
        check_device(device)
    except TrainingError as error:
        sys.exit(f"error: {error}")
    torch.set_num_threads(1)
    config = PPOConfig(strokes=strokes, record="all", device=device)
    against, self_play = rows(config, repeats)
    result = {**this_machine(), "device": _name(device), "strokes": strokes, **against, "self_play": self_play}
    show(result, "training_speed", as_json=as_json)


if __name__ == "__main__":
    tyro.cli(main)
