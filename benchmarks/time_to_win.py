"""Training time until an agent wins: learners of this package and of other projects.

    python -m benchmarks.time_to_win [--seeds N] [--limit SECONDS] [--learners NAME …] [--json]

Three targets against `bc`: 98 % of the matches, and .95 and .99 of the normalised score, which is 1 for the best response. All
learners play the same opponent in the same game, one after another in one process with one PyTorch thread. The time ends with the
exact evaluation that reaches the target, and includes all evaluations. Our learners have a budget for each target, over which
learning rate and entropy decay. The peer, MaskablePPO of sb3-contrib, runs with its defaults and with settings tuned for the game
until it reaches all targets or a time limit; its policy is evaluated at the softmax temperature of this package, to remove
exploration.
"""

import contextlib
import dataclasses
import functools
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple, cast

import numpy as np
import torch
import tyro
from rich.console import Console
from rich.progress import track
from sb3_contrib import MaskablePPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env

from docs.tools.results import Json, machine, show, this_machine
from shuttle_marl.base.arrays import F64
from shuttle_marl.game import default_game
from shuttle_marl.game.layout import features, with_efforts
from shuttle_marl.game.policy import States, tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.training import A2CConfig, Evaluation, Evaluator, PPOConfig, SACConfig, TrainingConfig, train
from shuttle_marl.training.config import SHARP

THREADS: Final = 1
OPPONENT: Final = "bc"
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
PEER: Final = "sb3-contrib MaskablePPO"
_TUNED: Final[dict[str, Any]] = {
    **{"n_steps": 128, "batch_size": 1024, "n_epochs": 4, "gamma": 1.0, "gae_lambda": 0.7, "learning_rate": 1e-3},
    **{"ent_coef": 0.01, "policy_kwargs": {"net_arch": [128]}},
}
_LOOK: Final = {False: 8192, True: 16_384}
"""Strokes between two evaluations of a learner of another project with its defaults, and with the settings chosen here: a few
seconds of learning, so that evaluating takes a small part of the time."""


class Reached(NamedTuple):
    """Time at which a learner reached a target, or its state at the time limit."""

    learner: str  # which one, with its settings
    target: str  # one of `TARGETS`
    seed: int  # of its run
    reached: bool  # whether it did
    seconds: float  # wall-clock time
    strokes: int  # strokes of the learner


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


class Over(Exception):
    """All targets are reached, or the time limit is exceeded."""


class Watch(BaseCallback):
    """Evaluates the policy of the peer periodically, records when it reaches targets, and ends the training.

    Args:
        limit: time limit [s].
        every: strokes between evaluations.
    """

    def __init__(self, limit: float, every: int) -> None:
        super().__init__()
        self.game = default_game()
        self._evaluator = Evaluator(self.game, [tabulate(resolve(OPPONENT, self.game), self.game)])
        self._limit, self._every, self._next, self._begun = limit, every, every, time.perf_counter()
        self.found: dict[str, tuple[float, int]] = {}
        """Seconds and strokes by target."""

    @property
    def seconds(self) -> float:
        """Seconds since the start."""
        return time.perf_counter() - self._begun

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        # The weights are those after an update and before the next rollout.
        if self.num_timesteps >= self._next:
            self._next = self.num_timesteps + self._every
            table = tabulate(Learned(cast(MaskablePPO, self.model), features(self.game)), self.game)
            evaluation = self._evaluator.evaluate(table, exploitability=False)
            for target in {target for target in TARGETS if _reaches(evaluation, target)} - set(self.found):
                self.found[target] = self.seconds, self.num_timesteps
        if set(self.found) == set(TARGETS) or self.seconds > self._limit:
            raise Over


@dataclasses.dataclass(frozen=True, eq=False)
class Learned:
    """Policy of the peer at the temperature of this package."""

    model: MaskablePPO
    rows: Any

    def probabilities(self, states: States) -> F64:
        """``[B, n]`` probabilities."""
        seen, mask = torch.from_numpy(with_efforts(states.game, self.rows, states.state)), states.mask.copy()
        with torch.no_grad():
            observation = {"observation": seen, "action_mask": torch.from_numpy(mask).to(torch.int8)}
            policy = cast(Any, self.model.policy).get_distribution(observation, action_masks=mask)
            found: F64 = policy.distribution.probs.double().numpy() * mask
        # Relative to the most probable stroke, so that no row underflows.
        found = (found / found.max(axis=1, keepdims=True)) ** (1 / SHARP)
        return np.asarray(found / found.sum(axis=1, keepdims=True))


def theirs(seed: int, limit: float, *, tuned: bool) -> list[Reached]:
    """MaskablePPO on ``shuttle_marl/Rally-v0``."""
    watch = Watch(limit, _LOOK[tuned])
    env = make_vec_env("shuttle_marl/Rally-v0", n_envs=64 if tuned else 1, seed=seed, env_kwargs={"opponent": OPPONENT})
    model = MaskablePPO("MultiInputPolicy", env, seed=seed, device="cpu", **(_TUNED if tuned else {}))
    with contextlib.suppress(Over):
        model.learn(1_000_000_000, callback=watch)
    name = f"{PEER}, {'settings chosen here' if tuned else 'its defaults'}"
    over = watch.seconds, watch.num_timesteps
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


def main(*, seeds: int = 5, limit: float = 120.0, learners: tuple[str, ...] = (), as_json: Json = False) -> None:
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
        if wanted(PEER):
            jobs += [functools.partial(theirs, seed, limit, tuned=tuned) for tuned in (False, True)]
    console = Console(stderr=True)
    found = [each for job in track(jobs, "learning", console=console, transient=True) for each in job()]
    rows = [{**row, "limit": limit, "machine": machine(this_machine())} for row in summary(found)]
    show(rows, "time_to_win", as_json=as_json)


if __name__ == "__main__":
    tyro.cli(main)
