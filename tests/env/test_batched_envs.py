"""The batched TorchRL environments against ``rally_v0``, and TorchRL's own checks."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import shuttle_marl
from shuttle_marl.game import default_game
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel import RallyBatch
from tests.exact.exact_games import random_policy, tiring_game

EITHER = pytest.mark.parametrize("name", ["RallyEnv", "VersusEnv"])


def steps(env: Any, n: int, *, fused: bool = True) -> Iterator[tuple[Any, Any]]:
    """Tensordicts before and with each of n steps of random legal strokes; rows whose rally is over begin the next one."""
    now = env.reset()
    for _ in range(n):
        acted = env.rand_action(now)
        if fused:
            stepped, following = env.step_and_maybe_reset(acted)
        else:
            stepped = env.step(acted)
            following = env.maybe_reset(stepped["next"].clone())
        yield now, stepped
        now = following


@EITHER
@pytest.mark.parametrize("batch", [1, 8, 1024])
def test_specs(name: str, batch: int) -> None:
    import torch
    from torchrl.envs.utils import check_env_specs

    env = getattr(shuttle_marl, name)(batch)
    check_env_specs(env, seed=0)
    assert env.batch_size == torch.Size([batch])


@EITHER
@pytest.mark.parametrize("game", ["default", "default:recovery"])
def test_a_collector_without_a_policy_plays_legal_strokes(name: str, game: str) -> None:
    import torch
    from torchrl.collectors import Collector

    collector = Collector(getattr(shuttle_marl, name)(64, game=game), None, frames_per_batch=64 * 20, total_frames=64 * 40)
    strokes = torch.cat([batch["action"].ravel() for batch in collector])
    collector.shutdown()
    assert len(strokes) == 64 * 40
    assert len(strokes.unique()) > 100, "an illegal stroke is an error, so many different ones were legal"


@pytest.mark.parametrize("game", [default_game(), tiring_game()], ids=["default", "tiring"])
@pytest.mark.parametrize("seat", [None, 0, 1])
def test_rallies_are_those_of_the_kernel(seat: int | None, game: Game) -> None:
    options: dict[str, Any] = {} if seat is None else {"opponents": random_policy(game, 1), "seat": seat}
    env: Any = (shuttle_marl.RallyEnv if seat is None else shuttle_marl.VersusEnv)(64, game=game, seed=5, threads=2, **options)
    if seat is not None:
        options["opponents"] = [options["opponents"]]
    batch = RallyBatch(game, 64, seed=5, **options)
    seen = batch.new_observations()
    batch.observe(seen)
    ended = 0
    for now, stepped in steps(env, 100):
        assert np.array_equal(now["observation"].numpy(), seen.tokens)
        assert np.array_equal(now["action_mask"].numpy(), seen.mask)
        reward, over = batch.step(now["action"].numpy(), observed=seen)
        assert np.array_equal(stepped["next", "reward"].squeeze(-1).numpy(), reward)
        assert np.array_equal(stepped["next", "terminated"].squeeze(-1).numpy(), over)
        ended += over.sum()
    assert ended > 500
