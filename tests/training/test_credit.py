"""Credit assignment: advantages under the exact value function, and rallies that the learner never saw."""

from typing import Any

import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.objectives.value import GAE

from shuttle_marl import exact
from shuttle_marl.env.batched import RallyEnv, VersusEnv
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.policy.registry import resolve
from tests.reduced import reduced_game

GAME = reduced_game()
BC = tabulate(resolve("bc", GAME), GAME, "bc")
RANDOM = tabulate(resolve("random", GAME), GAME, "random")


class ExactValue(nn.Module):
    """The value of the state behind an observation, looked up."""

    def __init__(self, value: np.ndarray) -> None:
        super().__init__()
        seen = GAME.observation(np.arange(GAME.n_states))
        table = np.zeros(seen.max(axis=0) + 1)
        table[tuple(seen.T)] = value
        self.table = torch.from_numpy(table).float()

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        return self.table[observation.long().unbind(-1)].unsqueeze(-1)


def rollout(env: Any, policy: TabulatedPolicy, steps: int) -> Any:
    """Rows of a rollout by a tabulated policy."""
    rng = np.random.default_rng(0)
    upper = torch.from_numpy(policy.padded.astype(np.int64))

    rows, current = [], env.reset()
    for _ in range(steps):
        state = env.states
        k = (upper[state] <= torch.from_numpy(rng.integers(0, 65535, len(state)))[:, None]).sum(-1).numpy()
        current.set("action", torch.from_numpy(GAME.pair_stroke[GAME.pair_start[state] + k].astype(np.int64)))
        row, current = env.step_and_maybe_reset(current)
        rows.append(row)
    return torch.stack(rows, dim=1)


def advantages(data: Any, value: np.ndarray, gamma: float) -> Any:
    critic = TensorDictModule(ExactValue(value), in_keys=["observation"], out_keys=["state_value"])
    with torch.no_grad():
        return (
            GAE(gamma=gamma, lmbda=0.95, value_network=critic, vectorized=False)(data)["advantage"].squeeze(-1).double().numpy()
        )


@pytest.mark.parametrize("opponent", [None, RANDOM])
def test_advantages_are_the_exact_ones_under_the_exact_values(opponent: TabulatedPolicy | None) -> None:
    env: Any = RallyEnv(2048, game=GAME) if opponent is None else VersusEnv(2048, opponents=opponent, game=GAME)
    gamma = -1.0 if opponent is None else 1.0
    striking, others = exact.evaluate(BC, opponent or BC).striking
    data = rollout(env, BC, 40)
    found = advantages(data, striking, gamma)

    state = GAME.state_of(*data["observation"].numpy().reshape(-1, 7).T)
    pair = GAME.pair(state, data["action"].numpy().ravel())
    outcome = GAME.outcome_probabilities(pair)
    quality = outcome[:, 1] - outcome[:, 0] - (outcome[:, 2:] * others[GAME.arrivals(pair)]).sum(axis=1)
    noise = found.ravel() - (quality - striking[state])
    # Lambda 0.95 adds later advantages, whose mean is zero under the exact values: so is the mean of the difference.
    assert abs(noise.mean()) < 4 * noise.std() / np.sqrt(len(noise))
    strong = np.abs(quality - striking[state]) > 0.2
    assert strong.sum() > 100
    assert abs(noise[strong].mean()) < 4 * noise[strong].std() / np.sqrt(strong.sum())
