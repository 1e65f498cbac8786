"""Learners of other projects on this game, each with its defaults and with settings tuned for this game.

Each learner is a function that trains until its :class:`Watch` ends it. Learners use the environments of the package only. Their
policies are evaluated at the softmax temperature of this package, to remove exploration.
"""

import contextlib
import time
from collections.abc import Callable
from typing import Any, Final, cast

import gymnasium
import numpy as np
import numpy.typing as npt
import torch
from sb3_contrib import MaskablePPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from torch import nn

import shuttle_marl  # noqa: F401  registers the environments
from shuttle_marl.base.arrays import F64
from shuttle_marl.game.layout import features, with_efforts
from shuttle_marl.game.policy import States, TabulatedPolicy, tabulate
from shuttle_marl.game.tables import Game
from shuttle_marl.training.config import SHARP

OPPONENT: Final = "bc"
TEMPERATURE: Final = SHARP
_FOREVER: Final = 1_000_000_000
Scores = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
"""Probabilities of all strokes from a batch of observations and masks."""


class Over(Exception):
    """All targets are reached, or the time limit is exceeded."""


class Watch:
    """Evaluates the policy of a learner periodically, records when it reaches targets, and ends the training.

    Args:
        reached: targets that a policy reaches.
        targets: all targets.
        limit: time limit in seconds.
        every: strokes between evaluations.
    """

    def __init__(self, reached: Callable[[TabulatedPolicy], set[str]], targets: set[str], *, limit: float, every: int) -> None:
        self._reached, self._targets, self._limit, self._every = reached, targets, limit, every
        self._begun, self._next = time.perf_counter(), every
        self.found: dict[str, tuple[float, int]] = {}
        """Seconds and strokes by target."""
        self.strokes = 0

    @property
    def seconds(self) -> float:
        """Seconds since the start."""
        return time.perf_counter() - self._begun

    def look(self, strokes: int, policy: Callable[[], TabulatedPolicy]) -> None:
        """Evaluate the policy if an evaluation is due.

        Raises:
            Over: the training ends.
        """
        self.strokes = strokes
        if strokes >= self._next:
            self._next = strokes + self._every
            for target in self._reached(policy()) - set(self.found):
                self.found[target] = self.seconds, strokes
        if set(self.found) == self._targets or self.seconds > self._limit:
            raise Over


class Learned:
    """Policy of a network of another project."""

    def __init__(self, scores: Scores, game: Game) -> None:
        self._scores, self._rows = scores, features(game)

    def probabilities(self, states: States) -> F64:
        """``[B, n]`` probabilities at :data:`TEMPERATURE`."""
        mask = states.mask.copy()  # torch warns about arrays that cannot be written to
        with torch.no_grad():
            seen = torch.from_numpy(with_efforts(states.game, self._rows, states.state))
            found: F64 = self._scores(seen, torch.from_numpy(mask)).double().numpy() * mask
        # Relative to the most probable stroke, so that no row underflows.
        found = (found / found.max(axis=1, keepdims=True)) ** (1 / TEMPERATURE)
        return np.asarray(found / found.sum(axis=1, keepdims=True))


class _Callback(BaseCallback):
    """Passes the policy of a Stable-Baselines3 learner to a watch."""

    def __init__(self, watch: Watch, policy: Callable[[], TabulatedPolicy]) -> None:
        super().__init__()
        self._watch, self._policy = watch, policy

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        # The weights are those after an update and before the next rollout.
        self._watch.look(self.num_timesteps, self._policy)


def _learn(model: BaseAlgorithm, scores: Scores, watch: Watch, game: Game) -> None:
    with contextlib.suppress(Over):
        model.learn(_FOREVER, callback=_Callback(watch, lambda: tabulate(Learned(scores, game), game)))


def masked_scores(model: MaskablePPO) -> Scores:
    """Probabilities of a MaskablePPO."""

    def scores(seen: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
        observation = {"observation": seen, "action_mask": mask.to(torch.int8)}
        policy = cast(Any, model.policy).get_distribution(observation, action_masks=mask.numpy())
        return cast(torch.Tensor, policy.distribution.probs)

    return scores


def maskable_ppo(seed: int, watch: Watch, game: Game, *, tuned: bool) -> None:
    """MaskablePPO of sb3-contrib on ``shuttle_marl/Rally-v0``."""
    chosen: dict[str, Any] = {
        "n_steps": 128,
        "batch_size": 1024,
        "n_epochs": 4,
        "gamma": 1.0,
        "gae_lambda": 0.7,
        "learning_rate": 1e-3,
        "ent_coef": 0.01,
        "policy_kwargs": {"net_arch": [128]},
    }
    env = make_vec_env("shuttle_marl/Rally-v0", n_envs=64 if tuned else 1, seed=seed, env_kwargs={"opponent": OPPONENT})
    model = MaskablePPO("MultiInputPolicy", env, seed=seed, device="cpu", **(chosen if tuned else {}))
    _learn(model, masked_scores(model), watch, game)


def single_file_ppo(seed: int, watch: Watch, game: Game, *, tuned: bool) -> None:
    """PPO in the style of CleanRL, one loop in one function, on the vector environment, with masked logits."""
    rows, steps, rate, discount, decay, epochs, parts, entropy, width, layer = (
        (512, 32, 2e-3, 1.0, 0.7, 1, 4, 0.01, 128, nn.ReLU) if tuned else (4, 128, 2.5e-4, 0.99, 0.95, 4, 4, 0.01, 64, nn.Tanh)
    )
    torch.manual_seed(seed)
    env = gymnasium.make_vec("shuttle_marl/Rally-v0", num_envs=rows, opponent=OPPONENT)
    inputs = cast(Any, env.single_observation_space)["observation"].shape[0]

    def network(outputs: int) -> nn.Sequential:
        return nn.Sequential(
            nn.Linear(inputs, width), layer(), nn.Linear(width, width), layer(), nn.Linear(width, outputs)
        )  # fmt: skip

    actor, critic = network(game.n_strokes), network(1)
    parameters = [*actor.parameters(), *critic.parameters()]
    optimiser = torch.optim.Adam(parameters, lr=rate, eps=1e-5)

    def choices(seen: torch.Tensor, mask: torch.Tensor) -> torch.distributions.Categorical:
        return torch.distributions.Categorical(logits=actor(seen).masked_fill(~mask, -1e9))

    def tensors(observation: dict[str, npt.NDArray[Any]]) -> tuple[torch.Tensor, torch.Tensor]:
        return torch.from_numpy(observation["observation"]), torch.from_numpy(observation["action_mask"]).bool()

    policy = Learned(lambda seen, mask: choices(seen, mask).probs, game)
    observation, _ = env.reset(seed=seed)
    strokes = 0
    with contextlib.suppress(Over):
        while True:
            watch.look(strokes, lambda: tabulate(policy, game))
            played = []
            for _ in range(steps):
                seen, mask = tensors(observation)
                with torch.no_grad():
                    distribution = choices(seen, mask)
                    action = distribution.sample()
                observation, reward, over, _, _ = env.step(action.numpy())
                ended, gained = torch.from_numpy(over).float(), torch.from_numpy(np.asarray(reward)).float()
                played.append((seen, mask, action, distribution.log_prob(action), gained, ended))
            strokes += rows * steps
            seen, mask, action, before, gained, ended = (torch.stack(column) for column in zip(*played, strict=True))
            with torch.no_grad():
                value = critic(torch.cat([seen, tensors(observation)[0][None]])).squeeze(-1)
            advantage, following = torch.zeros_like(gained), torch.zeros(rows)
            for t in reversed(range(steps)):
                error = gained[t] + discount * (1 - ended[t]) * value[t + 1] - value[t]
                advantage[t] = following = error + discount * decay * (1 - ended[t]) * following
            columns = [x.flatten(0, 1) for x in (seen, mask, action, before, advantage, advantage + value[:-1])]
            for _ in range(epochs):
                for part in torch.randperm(rows * steps).chunk(parts):
                    seen, mask, action, before, gain, target = (column[part] for column in columns)
                    gain = (gain - gain.mean()) / (gain.std() + 1e-8)
                    distribution = choices(seen, mask)
                    ratio = (distribution.log_prob(action) - before).exp()
                    surrogate = torch.min(ratio * gain, ratio.clamp(0.8, 1.2) * gain).mean()
                    loss = 0.5 * (critic(seen).squeeze(-1) - target).square().mean() - surrogate
                    optimiser.zero_grad()
                    (loss - entropy * distribution.entropy().mean()).backward()
                    nn.utils.clip_grad_norm_(parameters, 0.5)
                    optimiser.step()


Peer = Callable[..., None]
PEERS: Final[dict[str, Peer]] = {
    "sb3-contrib MaskablePPO": maskable_ppo,
    "CleanRL-style PPO": single_file_ppo,
}
