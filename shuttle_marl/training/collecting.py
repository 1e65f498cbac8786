"""Strokes to learn from: TorchRL's collectors on the batched environments, and how the rewards that they bring are shaped.

A collector is named by a seed that can be given again. Shaped rewards hold a bonus for shot types, and aversion to losing points
by one's own faults: the return of a rally is G = +1 or -1, and -1 - c where it was lost by an own fault, with c the cost of a
fault. Aversion to risk is the entropic risk measure: the agent minimises rho(-G) = log(E exp(-b G)) / b (Föllmer & Schied 2002)
with b the aversion. As G takes three values only, this is the same as maximising an expected reward with u(g) = -exp(-b g),
scaled so that u(1) = 1 and u(-1) = -1: a loss by an own fault counts -1 - k, where

    k = 2 (exp(b (1 + c)) - exp(b)) / (exp(b) - exp(-b)),    k = c for b = 0.

So without a cost of faults (c = 0) no aversion to risk changes anything: a rally is won or lost, and minimising the
risk of losing is maximising the probability of winning. The cost is charged as its expectation, k times the probability of
a fault of the stroke chosen, which is the same on average and varies less.
"""

import functools
import importlib
import math
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl import collectors
from torchrl._utils import seed_generator
from torchrl.envs import EnvBase
from torchrl.modules import ProbabilisticActor

from shuttle_marl.env.batched import RallyEnv, VersusEnv
from shuttle_marl.game.rally import ONE, Game
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.table import TabulatedPolicy
from shuttle_marl.training.config import TrainingConfig, TrainingError

_SEEDS = 1 << 31
"""TorchRL hands seeds to numpy and torch, which take 32 bits."""


def seeds(seed: int, processes: int) -> tuple[int, ...]:
    """Seeds of the environments of all processes, of which :meth:`Collector.begin` is given one number."""
    found = [seed % _SEEDS]
    while len(found) < processes:
        found.append(seed_generator(found[-1]))  # as TorchRL hands them on
    return tuple(found)


class Collector:
    """Collects the strokes of one iteration after another.

    Args:
        config: rows, steps, processes, device.
        game: the tables.
        opponents: of the learner; none in self-play.
        actor: the policy that collects.
    """

    def __init__(
        self, config: TrainingConfig, game: Game, opponents: Sequence[TabulatedPolicy], actor: ProbabilisticActor
    ) -> None:
        self._config, self._actor = config, actor
        rows = config.rows // config.processes
        self._make: Callable[[], EnvBase] = functools.partial(_environment, game, tuple(opponents), rows)
        self._collector: Any = None

    def begin(self, seed: int) -> None:
        """Begin again: from here on, what is collected depends on this seed and on the weights alone."""
        seed %= _SEEDS
        torch.manual_seed(seed)
        if self._config.processes == 1 and self._config.collector == "local":
            self.close()
            env = self._make()
            env.set_seed(seed)
            self._collector = self._one(env)
        elif self._collector is None:
            self._collector = self._several()
            self._collector.set_seed(seed)
        else:
            self._collector.set_seed(seed)  # which also begins again

    def collect(self) -> TensorDictBase:
        """``[rows, steps]`` strokes by the present weights."""
        assert self._collector is not None, "begin() comes first"
        self._collector.update_policy_weights_()
        data: TensorDictBase = self._collector.next()
        return data.reshape(self._config.rows, self._config.steps)

    def close(self) -> None:
        """End the processes."""
        if self._collector is not None:
            self._collector.shutdown()
            self._collector = None

    def _options(self) -> dict[str, Any]:
        device = torch.device(self._config.device)
        devices = {} if device.type == "cpu" else {"policy_device": device, "storing_device": device, "env_device": "cpu"}
        return {"frames_per_batch": self._config.frames, **devices}

    def _one(self, env: EnvBase) -> collectors.Collector:
        return collectors.Collector(
            env,
            self._actor,
            total_frames=-1,
            track_traj_ids=False,
            auto_register_policy_transforms=False,
            **self._options(),
        )

    def _several(self) -> Any:
        makers = [self._make] * self._config.processes
        if self._config.collector == "ray":
            return _ray_collector(makers, self._actor, self._options())
        return collectors.MultiSyncCollector(
            makers,
            self._actor,
            total_frames=-1,
            cat_results=0,
            auto_register_policy_transforms=False,
            **self._options(),
        )


class _SeededCollector(collectors.Collector):
    """A collector in a process of its own, which `set_seed` begins again, as it does those of MultiSyncCollector."""

    def set_seed(self, seed: int, static_seed: bool = False) -> int:
        torch.manual_seed(seed)
        following = super().set_seed(seed, static_seed)
        self.reset()
        return int(following)


def _ray_collector(makers: Sequence[Callable[[], EnvBase]], actor: ProbabilisticActor, options: dict[str, Any]) -> Any:
    """A collector on the Ray cluster that RAY_ADDRESS names, or on one that is started on this machine.

    Raises:
        TrainingError: Ray is not installed.
    """
    try:
        ray = importlib.import_module("ray")
    except ModuleNotFoundError as error:
        raise TrainingError("--collector ray: Ray is not installed; `pip install ray` on every machine installs it") from error
    from torchrl.collectors.distributed import RayCollector  # noqa: PLC0415

    # Ray would hide GPUs from processes that asked for none, and says so at length.
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    if not ray.is_initialized():
        ray.init(
            log_to_driver=False, logging_level="ERROR", **({} if "RAY_ADDRESS" in os.environ else {"include_dashboard": False})
        )
    return RayCollector(
        list(makers),
        actor,
        total_frames=sys.maxsize,
        sync=True,
        collector_class=_SeededCollector,
        collector_kwargs={"track_traj_ids": False, "auto_register_policy_transforms": False},
        remote_configs={"num_cpus": 1, "num_gpus": 0},
        ray_init_config={},
        **options,
    )


def _environment(game: Game, opponents: Sequence[TabulatedPolicy], rows: int) -> EnvBase:
    return VersusEnv(rows, opponents=opponents, game=game) if opponents else RallyEnv(rows, game=game)


def fault_penalty(cost: float, aversion: float) -> float:
    """Penalty k above: a loss by an own fault counts -1 - k.

    Args:
        cost: c, from 0 on.
        aversion: b, from 0 on.
    """
    if aversion == 0:
        return cost
    return 2 * math.exp(aversion) * math.expm1(aversion * cost) / (2 * math.sinh(aversion))


class RewardShaping:
    """Adds bonus and penalty to rewards.

    Args:
        config: of the run.
        game: the tables.
    """

    def __init__(self, config: TrainingConfig, game: Game) -> None:
        bonus = np.zeros(len(SHOTS))
        for shot, points in config.bonuses().items():
            bonus[SHOTS.index(shot)] = points
        penalty = fault_penalty(config.fault_cost, config.risk_aversion)
        fault = game.threshold[:, 0].astype(np.float64) / ONE
        self._game = game
        self._added = (bonus[game.catalogue.shot[game.pair_stroke]] - penalty * fault).astype(np.float32)

    def rewards(self, data: TensorDictBase) -> torch.Tensor:
        """``[..., 1]`` rewards of what was collected, with bonus and penalty added to those of the rules."""
        game = self._game
        state = game.state_of(*np.moveaxis(data["observation"].cpu().numpy(), -1, 0))
        pair = game.pair(state, data["action"].cpu().numpy())
        reward: torch.Tensor = data["next", "reward"]
        return reward + torch.from_numpy(self._added[pair]).unsqueeze(-1).to(reward.device)
