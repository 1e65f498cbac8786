"""Training time until an agent wins: learners of this package and of other projects.

    python -m benchmarks.time_to_win [--seeds N] [--limit SECONDS] [--learners NAME …] [--json]

Three targets against `bc`: 98 % of the matches, and .95 and .99 of the normalised score, which is 1 for the best response. All
learners play the same opponent in the same game, one after another in one process with one PyTorch thread. The time ends with the
exact evaluation that reaches the target, and includes all evaluations. Our learners have a budget for each target, over which
learning rate and entropy decay. Those of :mod:`benchmarks.peers` run with their defaults and with settings tuned for this game,
until they reach all targets or a time limit.
"""

import dataclasses
import functools
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
import torch
import tyro
from rich.console import Console
from rich.progress import track

from benchmarks.machine import machine, this_machine
from benchmarks.peers import OPPONENT, PEERS, Watch
from docs.tools.results import show
from shuttle_marl.game import default_game
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.training import A2CConfig, Evaluation, Evaluator, PPOConfig, SACConfig, TrainingConfig, train

THREADS: Final = 1
TARGETS: Final[dict[str, tuple[str, float]]] = {
    "98 % of matches": ("match_win", 0.98),
    ".95 of the optimum": ("normalised_score", 0.95),
    ".99 of the optimum": ("normalised_score", 0.99),
}
"""Figures of an evaluation, and their target values."""
_QUIET: Final[dict[str, Any]] = {"record": "none", "exploitability": False, "opponent": (OPPONENT,), "threads": THREADS}
OURS: Final[dict[str, dict[str, TrainingConfig]]] = {
    "shuttle_marl PPO": {
        "98 % of matches": PPOConfig(
            strokes=1_000_000,
            gae_lambda=0.7,
            learning_rate=2e-2,
            entropy=0.015,
            minibatches=2,
            width=32,
            hidden=0,
            evaluate_every=3,
            target=0.98,
            **_QUIET,
        ),
        ".95 of the optimum": PPOConfig(
            strokes=3_200_000,
            batch=12_288,
            gae_lambda=0.5,
            learning_rate=1.4e-2,
            entropy=0.02,
            evaluate_every=40,
            target_score=0.95,
            **_QUIET,
        ),
        ".99 of the optimum": PPOConfig(strokes=30_000_000, evaluate_every=50, target_score=0.99, **_QUIET),
    },
    "shuttle_marl A2C": {".95 of the optimum": A2CConfig(strokes=6_000_000, evaluate_every=40, target_score=0.95, **_QUIET)},
    "shuttle_marl SAC": {
        ".95 of the optimum": SACConfig(
            strokes=3_000_000, updates=3, averaging=0.95, evaluate_every=10, target_score=0.95, **_QUIET
        )
    },
}
"""Settings of this package's learners by target."""
_LOOK: Final = {False: 8192, True: 16_384}
"""Strokes between two evaluations of a learner of another project with its defaults, and with the settings chosen here: a few
seconds of learning, so that evaluating takes a small part of the time."""


class Reached(NamedTuple):
    """Time at which a learner reached a target, or its state at the time limit.

    Attributes:
        learner: which one, with its settings.
        target: one of :data:`TARGETS`.
        seed: of its run.
        reached: whether it did.
        seconds: wall-clock time.
        strokes: strokes of the learner.
    """

    learner: str
    target: str
    seed: int
    reached: bool
    seconds: float
    strokes: int


def _reaches(evaluation: Evaluation, target: str) -> bool:
    name, minimum = TARGETS[target]
    figure: float | None = getattr(evaluation, name)
    return figure is not None and figure >= minimum


def ours(learner: str, target: str, seed: int) -> Reached:
    """A learner of this package."""
    with tempfile.TemporaryDirectory() as folder:
        config = dataclasses.replace(OURS[learner][target], seed=seed, out=Path(folder) / "run")
        begun = time.perf_counter()
        done = train(config)
        seconds = time.perf_counter() - begun
    return Reached(learner, target, seed, _reaches(done.evaluation, target), seconds, done.strokes)


def theirs(peer: str, seed: int, limit: float, *, tuned: bool) -> list[Reached]:
    """A learner of another project."""
    game = default_game()
    evaluator = Evaluator(game, [tabulate(resolve(OPPONENT, game), game)])

    def reached(policy: TabulatedPolicy) -> set[str]:
        evaluation = evaluator.evaluate(policy, exploitability=False)
        return {target for target in TARGETS if _reaches(evaluation, target)}

    watch = Watch(reached, set(TARGETS), limit=limit, every=_LOOK[tuned])
    PEERS[peer](seed, watch, game, tuned=tuned)
    name = f"{peer}, {'settings chosen here' if tuned else 'its defaults'}"
    over = watch.seconds, watch.strokes
    return [Reached(name, target, seed, target in watch.found, *watch.found.get(target, over)) for target in TARGETS]


def summary(found: list[Reached]) -> list[dict[str, Any]]:
    """A row for each learner and target; the seconds of seeds that did not reach it are lower bounds."""
    rows = []
    for learner, target in dict.fromkeys((r.learner, r.target) for r in found):
        runs = [r for r in found if (r.learner, r.target) == (learner, target)]
        seconds = [r.seconds for r in runs]
        rows.append(
            {
                "learner": learner,
                "target": target,
                "seconds_median": float(np.median(seconds)),
                "seconds_worst": max(seconds),
                "strokes": int(np.median([r.strokes for r in runs])),
                "seeds": len(runs),
                "reached": sum(r.reached for r in runs),
            }
        )
    return rows


def main(
    *,
    seeds: int = 5,
    limit: float = 120.0,
    learners: tuple[str, ...] = (),
    as_json: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> None:
    """Measure and print.

    Args:
        seeds: runs of each learner.
        limit: time limit of learners of other projects, in seconds.
        learners: substrings of the names of the measured learners; none: all.
        as_json: print JSON instead of a table.
    """
    torch.set_num_threads(THREADS)

    def wanted(name: str) -> bool:
        return not learners or any(part in name for part in learners)

    with tempfile.TemporaryDirectory() as folder:  # compiles the kernels, which every installation does once
        train(PPOConfig(strokes=1, batch=64, out=Path(folder) / "run"))
    jobs: list[Callable[[], list[Reached]]] = []
    for seed in range(seeds):
        for learner in filter(wanted, OURS):
            jobs += [functools.partial(lambda *job: [ours(*job)], learner, target, seed) for target in OURS[learner]]
        for peer in filter(wanted, PEERS):
            jobs += [functools.partial(theirs, peer, seed, limit, tuned=tuned) for tuned in (False, True)]
    console = Console(stderr=True)
    found = [each for job in track(jobs, "learning", console=console, transient=True) for each in job()]
    rows = [{**row, "limit": limit, "machine": machine(this_machine())} for row in summary(found)]
    show(rows, "time_to_win", as_json=as_json)


if __name__ == "__main__":
    tyro.cli(main)
