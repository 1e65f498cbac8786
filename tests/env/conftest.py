"""Players for the tests of the environments."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

Step = tuple[str, dict[str, Any], float, bool, bool, dict[str, Any], int | None]


@pytest.fixture
def play() -> Callable[..., Iterator[Step]]:
    """Plays one episode with random legal strokes; yields what each agent sees and does, before it is done."""

    def steps(env: Any, seed: int | None = None, *, policy_seed: int = 0, reset: bool = True) -> Iterator[Step]:
        rng = np.random.default_rng(policy_seed)
        if reset:
            env.reset(seed=seed)
        for agent in env.agent_iter():
            seen, reward, terminated, truncated, info = env.last()
            done = terminated or truncated
            action = None if done else int(rng.choice(np.flatnonzero(seen["action_mask"])))
            yield agent, seen, reward, terminated, truncated, info, action
            env.step(action)

    return steps
