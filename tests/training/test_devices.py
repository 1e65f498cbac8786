"""Devices of tensors in training: on a pretended CUDA device nothing is mixed, and the weights are those of the CPU."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.training import A2CConfig, PPOConfig, SACConfig, TrainingConfig, train
from shuttle_marl.training.a2c import A2C
from shuttle_marl.training.learner import RallyCollector, Tensors, Trainer
from shuttle_marl.training.ppo import PPO
from shuttle_marl.training.sac import SAC
from shuttle_marl.training.self_play import SelfPlayOpponents, n_opponents
from tests.reduced import reduced_game, reduced_model
from tests.training.pretended import MixedDevicesError, pretended_cuda

GAME = reduced_game()
BC = tabulate(resolve("bc", GAME), GAME, "bc")
SMALL: dict[str, Any] = {"game": reduced_model(), "batch": 64, "growth": 0.0, "width": 8, "strokes": 64 * 4, "sampler": "torch"}
SELF: dict[str, Any] = {**SMALL, "opponent": ("self",)}
LEARNERS: dict[str, tuple[Callable[..., Any], TrainingConfig]] = {
    "ppo": (PPO, PPOConfig(**SMALL)),
    "a2c": (A2C, A2CConfig(**SMALL, fault_cost=0.3)),
    "sac": (SAC, SACConfig(**SMALL, warm_up=50, minibatch=64, buffer=150)),
    "pool": (PPO, PPOConfig(**SELF, variant="pool", update_interval=2, pool_size=2)),
}


def test_the_pretended_device_refuses_what_a_gpu_refuses() -> None:
    with pretended_cuda():
        there, here = torch.arange(3.0, device="cuda"), torch.arange(3.0)
        assert there.device.type == "cuda"
        assert (there * 2).device.type == "cuda"
        assert there.cpu().device.type == "cpu"
        assert here.to("cuda:0").device.type == "cuda"
        assert here.device.type == "cpu"
        assert (there * torch.tensor(2.0)).sum().item() == 6
        assert there[torch.tensor([1])].device.type == "cuda"
        assert (there.cpu().numpy() == [0, 1, 2]).all()
        for mixed in (
            lambda: there + here,
            lambda: torch.where(there > 1, here, there),
            lambda: here[there.long()],
            lambda: there.index_add_(0, there.long(), here),
            lambda: torch.nn.functional.linear(here[None], there[None]),
            there.numpy,
            lambda: np.asarray(there),
        ):
            with pytest.raises(MixedDevicesError):
                mixed()
        weight = there.clone().requires_grad_()
        (weight**2).sum().backward()
        assert weight.grad is not None
        assert weight.grad.device.type == "cuda"


def learned(make: Callable[..., Any], config: TrainingConfig) -> Tensors:
    """State of a learner after two iterations, between which another one takes over."""
    state: Tensors = {}
    for start in (0, 2):
        torch.manual_seed(start)
        learner = make(config, GAME)
        met = [BC] * n_opponents(config) if isinstance(config, PPOConfig) and config.self_play else [BC]
        collector = RallyCollector(config, GAME, met, learner.predict, distinct=learner.distinct)
        assert all(weight.device.type == config.device for weight in learner.actor.parameters())
        trainer = Trainer(learner, collector)
        if state:
            trainer.load_state_dict(state)
        self_play = None
        if isinstance(config, PPOConfig) and config.self_play:
            self_play = SelfPlayOpponents(config, GAME, learner, collector.sampler)
            self_play.load_state_dict(state)
        collector.set_seed(start)
        if self_play is not None:
            self_play.set_seed(1)
            self_play.update(start)
        data = collector.collect()
        assert not learner.distinct or data["observation"].device.type == config.device
        assert learner.update(data, 1 - start / 4)
        state = trainer.state_dict()
        if self_play is not None:
            state |= self_play.state_dict()
        assert all(part.device.type == "cpu" for part in state.values())
    return state


@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.slow if name == "pool" else ()) for name in LEARNERS])
def test_learning_mixes_no_devices(name: str) -> None:
    make, config = LEARNERS[name]
    usual = learned(make, config)
    with pretended_cuda():
        found = learned(make, dataclasses.replace(config, device="cuda"))
    assert found.keys() == usual.keys()
    assert all(torch.equal(found[part], usual[part]) for part in usual)


def test_a_run_mixes_no_devices(tmp_path: Path) -> None:
    config = PPOConfig(**SMALL, checkpoint_every=2, record="all", exploitability=False, warm_start="bc")
    usual = train(dataclasses.replace(config, out=tmp_path / "cpu"))
    with pretended_cuda():
        done = train(dataclasses.replace(config, out=tmp_path / "cuda", device="cuda", sampler="auto"))
    assert done.evaluation == usual.evaluation
    for name in ("agent/network.safetensors", "rallies.mcap"):
        assert (done.folder / name).read_bytes() == (usual.folder / name).read_bytes()
