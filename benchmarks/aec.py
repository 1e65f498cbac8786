"""Steps per second of PettingZoo's loop in ``rally_v0`` and ``match_v0``, compared with two classic environments.

    python -m benchmarks.aec [--seconds S] [--repeat N] [--json]

All environments run in one process, through the same loop (``agent_iter``, ``last``, ``step``) with the same policy: a
uniformly random action of the mask. They alternate in turns of S seconds, N times, so that other load affects all
equally; the median is reported. Only steps with an action are counted; the time includes resets and the steps of agents that
are done. Seconds are CPU seconds of the process, which has one thread.
"""

import dataclasses
import os
import random
import statistics
import time
import warnings
from collections.abc import Callable
from typing import Annotated, Any, Final

import numpy as np
import tyro
from pettingzoo import AECEnv
from pettingzoo.utils import wrappers

from benchmarks.machine import this_machine
from docs.tools.results import show
from shuttle_marl import match_v0, rally_v0

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # the modules will move to a registry
    from pettingzoo.classic import connect_four_v3, tictactoe_v3

_REFERENCE: Final = "connect_four_v3"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Speed:
    """Speed of one environment.

    Attributes:
        environment: its name.
        steps_per_second: median over the turns.
        slowest: slowest turn.
        fastest: fastest turn.
        ratio: median speed over that of ``connect_four_v3``.
    """

    environment: str
    steps_per_second: float
    slowest: float
    fastest: float
    ratio: float


def classic_wrappers(env: AECEnv) -> AECEnv:
    """The three wrappers with which PettingZoo's own classic environments come."""
    env = wrappers.TerminateIllegalWrapper(env, illegal_reward=-1)
    return wrappers.OrderEnforcingWrapper(wrappers.AssertOutOfBoundsWrapper(env))


ENVIRONMENTS: Final[dict[str, Callable[[], Any]]] = {
    "rally_v0": rally_v0.env,
    "match_v0": match_v0.env,
    "rally_v0 in three classic wrappers": lambda: classic_wrappers(rally_v0.raw_env()),
    "tictactoe_v3": tictactoe_v3.env,
    _REFERENCE: connect_four_v3.env,
}


def steps_of_an_episode(env: AECEnv, rng: random.Random) -> int:
    """Play an episode with random legal actions; returns how many that were."""
    steps = 0
    env.reset()
    for _ in env.agent_iter():
        observation, _, terminated, truncated, _ = env.last()
        if terminated or truncated:
            env.step(None)
        else:
            env.step(rng.choice(np.flatnonzero(observation["action_mask"]).tolist()))
            steps += 1
    return steps


def steps_per_second(env: AECEnv, seconds: float, rng: random.Random) -> float:
    """Play whole episodes until the time is up."""
    steps = 0
    start = time.process_time()
    end = start + seconds
    while time.process_time() < end:
        steps += steps_of_an_episode(env, rng)
    return steps / (time.process_time() - start)


def measure(seconds: float, repeat: int) -> list[Speed]:
    """Let all environments take turns."""
    rng = random.Random(0)
    envs = {name: make() for name, make in ENVIRONMENTS.items()}
    turns: dict[str, list[float]] = {name: [] for name in envs}
    for env in envs.values():
        env.reset(seed=0)
        steps_per_second(env, seconds / 5, rng)
    for _ in range(repeat):
        for name, env in envs.items():
            turns[name].append(steps_per_second(env, seconds, rng))
    reference = statistics.median(turns[_REFERENCE])
    return [
        Speed(
            environment=name,
            steps_per_second=statistics.median(speeds),
            slowest=min(speeds),
            fastest=max(speeds),
            ratio=statistics.median(speeds) / reference,
        )
        for name, speeds in turns.items()
    ]


def main(*, seconds: float = 1.0, repeat: int = 5, as_json: Annotated[bool, tyro.conf.arg(name="json")] = False) -> None:
    """Measure and print.

    Args:
        seconds: CPU seconds of each turn.
        repeat: turns of each environment.
        as_json: print JSON instead of a table.
    """
    speeds = measure(seconds, repeat)
    show({**this_machine(), "environments": [dataclasses.asdict(s) for s in speeds]}, "aec", as_json=as_json)


if __name__ == "__main__":
    tyro.cli(main)
