"""Time until an agent that starts from nothing wins 98 % of matches against `bc`: ours beside sb3-contrib's MaskablePPO.

    python -m benchmarks.time_to_win [--seeds N] [--target P] [--limit SECONDS] [--json]

All learners meet the same opponent in the same game, one after another in one process with two threads of PyTorch. The
clock runs from the call to the evaluation that reaches the target; the probability to win a match is exact, and computing it
now and then is part of the time. MaskablePPO plays `shuttle_marl/Rally-v0` as it comes, with settings like ours where it has
them.
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
THREADS: Final = 2
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
    """When a learner reached the target, or where it stood when its time was up.

    Attributes:
        learner: which one.
        seed: of its run.
        reached: whether it did.
        seconds: wall-clock time.
        strokes: strokes of the learner.
        match_win: exact probability to win a match at the end.
    """

    learner: str
    seed: int
    reached: bool
    seconds: float
    strokes: int
    match_win: float


def ours(seed: int, target: float) -> Reached:
    """PPO of this package with its default settings, evaluated after every other iteration."""
    with tempfile.TemporaryDirectory() as folder:
        config = PPOConfig(
            opponent=(OPPONENT,),
            seed=seed,
            target=target,
            evaluate_every=2,
            threads=THREADS,
            out=Path(folder) / "run",
        )
        begun = time.perf_counter()
        done = train(config)
        seconds = time.perf_counter() - begun
    match_win = done.evaluation.match_win
    return Reached(
        learner="shuttle_marl PPO",
        seed=seed,
        reached=match_win >= target,
        seconds=seconds,
        strokes=done.strokes,
        match_win=match_win,
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


class _Stop(BaseCallback):
    """Ends the training of stable-baselines at the target or when time is up."""

    def __init__(self, evaluated: Callable[[], Evaluation], target: float, limit: float, every: int) -> None:
        super().__init__()
        self._evaluated, self._target, self._limit, self._every = evaluated, target, limit, every
        self._begun, self._next = time.perf_counter(), every
        self.match_win = 0.0

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        # Between learning and collecting: here the weights are those that an evaluation should see.
        if self.num_timesteps >= self._next:
            self._next = self.num_timesteps + self._every
            self.match_win = self._evaluated().match_win
        over = self.match_win >= self._target or time.perf_counter() - self._begun > self._limit
        if over:
            raise _Over


class _Over(Exception):
    pass


def theirs(seed: int, target: float, limit: float) -> Reached:
    """MaskablePPO of sb3-contrib."""
    game = default_game()
    evaluator = Evaluator(game, [tabulate(resolve(OPPONENT, game), game, OPPONENT)])
    begun = time.perf_counter()
    env = make_vec_env("shuttle_marl/Rally-v0", n_envs=_ENVS, seed=seed, env_kwargs={"opponent": OPPONENT})
    model = MaskablePPO("MultiInputPolicy", env, seed=seed, device="cpu", **LIKE_OURS)
    stop = _Stop(lambda: evaluator.evaluate(tabulate(Learned(model, game), game)), target, limit, every=16_384)
    with contextlib.suppress(_Over):
        model.learn(1_000_000_000, callback=stop)
    return Reached(
        learner="sb3-contrib MaskablePPO",
        seed=seed,
        reached=stop.match_win >= target,
        seconds=time.perf_counter() - begun,
        strokes=model.num_timesteps,
        match_win=stop.match_win,
    )


def summary(found: list[Reached]) -> list[dict[str, Any]]:
    """Medians by learner, and how many times as long as ours."""
    rows = []
    own = float(np.median([r.seconds for r in found if r.learner == found[0].learner]))
    for learner in dict.fromkeys(r.learner for r in found):
        runs = [r for r in found if r.learner == learner]
        seconds = [r.seconds for r in runs]
        rows.append(
            {
                "learner": learner,
                "reached": all(r.reached for r in runs),
                "seconds": float(np.median(seconds)),
                "slowest": max(seconds),
                "strokes": int(np.median([r.strokes for r in runs])),
                "match_win": float(np.median([r.match_win for r in runs])),
                "times": float(np.median(seconds)) / own,
            }
        )
    return rows


def main(
    *, seeds: int = 3, target: float = 0.98, limit: float = 600.0, as_json: Annotated[bool, tyro.conf.arg(name="json")] = False
) -> None:
    """Measure and print.

    Args:
        seeds: runs of every learner.
        target: exact probability to win a match.
        limit: seconds after which MaskablePPO is stopped.
        as_json: print JSON instead of a table.
    """
    torch.set_num_threads(THREADS)
    train_once = dataclasses.replace(PPOConfig(), strokes=1)
    with tempfile.TemporaryDirectory() as folder:  # compiles the kernels, which every installation does once
        train(dataclasses.replace(train_once, out=Path(folder) / "run"))
    found = []
    for seed in range(seeds):
        found.append(ours(seed, target))
        found.append(theirs(seed, target, limit))
    rows = summary(found)
    if as_json:
        result = {
            **this_machine(),
            "target": target,
            "limit": limit,
            "learners": rows,
            "runs": [dataclasses.asdict(r) for r in found],
        }
        print(json.dumps(result, indent=2))
        return
    table = Table(*("learner", "seconds", "slowest", "strokes", "match", "times ours"))
    for row in rows:
        sign = "" if row["reached"] else "> "
        table.add_row(
            row["learner"],
            f"{sign}{row['seconds']:.0f}",
            f"{row['slowest']:.0f}",
            f"{row['strokes']:,}",
            f"{row['match_win']:.1%}",
            f"{sign}{row['times']:.1f}",
        )
    Console(width=None if sys.stdout.isatty() else 120).print(table)


if __name__ == "__main__":
    tyro.cli(main)
