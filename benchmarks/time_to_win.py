"""Time until an agent that starts from nothing wins: PPO of this package beside sb3-contrib's MaskablePPO.

    python -m benchmarks.time_to_win [--seeds N] [--limit SECONDS] [--json]

Three targets against `bc`: 98 % of the matches, and .95 and .99 of the normalised score, which is 1 for the best response. All
learners meet the same opponent in the same game, one after another in one process with one thread of PyTorch. The clock runs from
the call to the evaluation that reaches the target; evaluations are exact, and computing them now and then is part of the time.
Ours has a budget for each target, by which its learning rate and entropy fall; MaskablePPO plays `shuttle_marl/Rally-v0` as it
comes, with settings like ours where it has them, and is watched until it has reached all targets or its time is up.
"""

import contextlib
import dataclasses
import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Final, cast

import numpy as np
import numpy.typing as npt
import torch
import tyro
from rich.console import Console
from rich.table import Table
from sb3_contrib import MaskablePPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env

from benchmarks.machine import this_machine
from shuttle_marl.game import default_game
from shuttle_marl.game.observation import features, with_efforts
from shuttle_marl.game.policy import States
from shuttle_marl.game.rally import Game
from shuttle_marl.game.table import tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.training import Evaluation, Evaluator, PPOConfig, train

OPPONENT: Final = "bc"
THREADS: Final = 1
TARGETS: Final[dict[str, tuple[str, float]]] = {
    "98 % of matches": ("match_win", 0.98),
    ".95 of the optimum": ("normalised_score", 0.95),
    ".99 of the optimum": ("normalised_score", 0.99),
}
"""Figures of an evaluation, and what they have to reach."""
OURS: Final = {
    "98 % of matches": PPOConfig(strokes=1_000_000, clip=0.4, evaluate_every=8, record="none", exploitability=False, target=0.98),
    ".95 of the optimum": PPOConfig(strokes=8_000_000, evaluate_every=25, record="none", exploitability=False, target_score=0.95),
    ".99 of the optimum": PPOConfig(
        strokes=100_000_000,
        entropy=0.02,
        clip=0.4,
        learning_rate=4e-3,
        evaluate_every=50,
        record="none",
        exploitability=False,
        target_score=0.99,
    ),
}
"""Settings of this package's PPO by target."""
LIKE_OURS: Final[dict[str, Any]] = {
    "n_steps": 128,
    "batch_size": 1024,
    "n_epochs": 4,
    "gamma": 1.0,
    "gae_lambda": 0.7,
    "learning_rate": 1e-3,
    "ent_coef": 0.01,
    "policy_kwargs": {"net_arch": [128]},
}
"""Of MaskablePPO; its environments step one by one, so it learns more often and from less than ours."""
_ENVS: Final = 64


@dataclasses.dataclass(frozen=True, kw_only=True)
class Reached:
    """When a learner reached a target, or where it stood when its time was up.

    Attributes:
        learner: which one.
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
    name, wanted = TARGETS[target]
    found: float | None = getattr(evaluation, name)
    return found is not None and found >= wanted


def ours(seed: int, target: str) -> Reached:
    """PPO of this package."""
    with tempfile.TemporaryDirectory() as folder:
        config = dataclasses.replace(OURS[target], opponent=(OPPONENT,), seed=seed, threads=THREADS, out=Path(folder) / "run")
        begun = time.perf_counter()
        done = train(config)
        seconds = time.perf_counter() - begun
    return Reached(
        learner="shuttle_marl PPO",
        target=target,
        seed=seed,
        reached=_reaches(done.evaluation, target),
        seconds=seconds,
        strokes=done.strokes,
    )


class Learned:
    """A MaskablePPO as a policy, so that its probabilities of winning can be computed."""

    def __init__(self, model: MaskablePPO, game: Game) -> None:
        self._model, self._rows = model, features(game)

    def probabilities(self, states: States) -> npt.NDArray[np.float64]:
        """``[B, n]`` as its network gives them."""
        mask = states.mask.copy()  # torch warns about arrays that cannot be written to
        seen = {
            "observation": torch.from_numpy(with_efforts(states.game, self._rows, states.state)),
            "action_mask": torch.from_numpy(mask.astype(np.int8)),
        }
        with torch.no_grad():
            distribution = cast(Any, self._model.policy.get_distribution(seen, action_masks=mask)).distribution
        found: npt.NDArray[np.float64] = distribution.probs.double().numpy() * mask
        return found / found.sum(axis=1, keepdims=True)


class _Watch(BaseCallback):
    """Notes when stable-baselines reaches the targets, and ends the training at the last of them or when time is up."""

    def __init__(self, evaluated: Callable[[], Evaluation], limit: float, every: int) -> None:
        super().__init__()
        self._evaluated, self._limit, self._every = evaluated, limit, every
        self._begun, self._next = time.perf_counter(), every
        self.reached: dict[str, tuple[float, int]] = {}
        """Seconds and strokes by target."""

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        # Between learning and collecting: here the weights are those that an evaluation should see.
        if self.num_timesteps >= self._next:
            self._next = self.num_timesteps + self._every
            evaluation = self._evaluated()
            for target in TARGETS:
                if target not in self.reached and _reaches(evaluation, target):
                    self.reached[target] = time.perf_counter() - self._begun, self.num_timesteps
        if len(self.reached) == len(TARGETS) or time.perf_counter() - self._begun > self._limit:
            raise _Over


class _Over(Exception):
    pass


def theirs(seed: int, limit: float) -> list[Reached]:
    """MaskablePPO of sb3-contrib."""
    game = default_game()
    evaluator = Evaluator(game, [tabulate(resolve(OPPONENT, game), game, OPPONENT)])
    begun = time.perf_counter()
    env = make_vec_env("shuttle_marl/Rally-v0", n_envs=_ENVS, seed=seed, env_kwargs={"opponent": OPPONENT})
    model = MaskablePPO("MultiInputPolicy", env, seed=seed, device="cpu", **LIKE_OURS)
    watch = _Watch(lambda: evaluator.evaluate(tabulate(Learned(model, game), game), exploitability=False), limit, every=16_384)
    with contextlib.suppress(_Over):
        model.learn(1_000_000_000, callback=watch)
    over = time.perf_counter() - begun, model.num_timesteps
    found = []
    for target in TARGETS:
        seconds, strokes = watch.reached.get(target, over)
        found.append(
            Reached(
                learner="sb3-contrib MaskablePPO",
                target=target,
                seed=seed,
                reached=target in watch.reached,
                seconds=seconds,
                strokes=strokes,
            )
        )
    return found


def summary(found: list[Reached]) -> list[dict[str, Any]]:
    """A row for each learner and target; where a seed did not reach it, its seconds are a lower bound."""
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


def main(*, seeds: int = 5, limit: float = 600.0, as_json: Annotated[bool, tyro.conf.arg(name="json")] = False) -> None:
    """Measure and print.

    Args:
        seeds: runs of every learner.
        limit: seconds after which MaskablePPO is stopped.
        as_json: print JSON instead of a table.
    """
    torch.set_num_threads(THREADS)
    with tempfile.TemporaryDirectory() as folder:  # compiles the kernels, which every installation does once
        train(PPOConfig(strokes=1, batch=64, out=Path(folder) / "run"))
    found = []
    for seed in range(seeds):
        found += [ours(seed, target) for target in TARGETS]
        found += theirs(seed, limit)
    rows = summary(found)
    if as_json:
        print(json.dumps(rows, indent=2))
        return
    table = Table("learner", "target", "seconds", "slowest", "strokes", "reached")
    for row in rows:
        sign = "" if row["reached"] == row["seeds"] else "> "
        table.add_row(
            row["learner"],
            row["target"],
            f"{sign}{row['seconds_median']:.1f}",
            f"{sign}{row['seconds_worst']:.1f}",
            f"{row['strokes']:,}",
            f"{row['reached']} of {row['seeds']}",
        )
    Console(width=None if sys.stdout.isatty() else 120).print(table)
    print(json.dumps(this_machine()))


if __name__ == "__main__":
    tyro.cli(main)
