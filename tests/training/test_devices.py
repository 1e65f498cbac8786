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
from shuttle_marl.training.a2c import make_a2c
from shuttle_marl.training.collecting import RallyCollector
from shuttle_marl.training.learner import Tensors
from shuttle_marl.training.networks import imitate
from shuttle_marl.training.ppo import make_ppo
from shuttle_marl.training.sac import make_sac
from shuttle_marl.training.self_play import SelfPlay, slots
from tests.reduced import reduced_game, reduced_model
from tests.training.pretended import MixedDevicesError, pretended_cuda

GAME = reduced_game()
BC = tabulate(resolve("bc", GAME), GAME, "bc")
SMALL: dict[str, Any] = {"game": reduced_model(), "batch": 64, "growth": 0.0, "width": 8, "strokes": 64 * 4, "sampler": "torch"}
SELF: dict[str, Any] = {**SMALL, "opponent": ("self",)}
LEARNERS: dict[str, tuple[Callable[..., Any], TrainingConfig]] = {
    "ppo": (make_ppo, PPOConfig(**SMALL)),
    "a2c": (make_a2c, A2CConfig(**SMALL, fault_cost=0.3)),
    "sac": (make_sac, SACConfig(**SMALL, warm_up=50, minibatch=64, buffer=150)),
    "magnet": (make_ppo, PPOConfig(**SELF, way="magnet", renew=2)),
    "restarts": (make_ppo, PPOConfig(**SELF, way="restarts", renew=2)),
    "pool": (make_ppo, PPOConfig(**SELF, way="pool", renew=2, pool=2)),
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
    collected: dict[str, Any] = {}
    for start in (0, 2):
        torch.manual_seed(start)
        learner = make(config, GAME)
        met = [BC] * slots(config) if isinstance(config, PPOConfig) and config.self_play else [BC]
        collector = RallyCollector(config, GAME, met, learner.assess, distinct=learner.distinct)
        assert all(weight.device.type == config.device for weight in learner.actor.parameters())
        if state:
            learner.restore(state)
            collector.load_state_dict(collected)
        partners = None
        if isinstance(config, PPOConfig) and config.self_play:
            partners = SelfPlay(config, GAME, learner, collector.sampler)
            partners.restore(state)
        collector.begin(start)
        if partners is not None:
            partners.prepare(start, first=True, seed=1)
        data = collector.collect()
        assert not learner.distinct or data["observation"].device.type == config.device
        assert learner.learn(data, 1 - start / 4)
        learner.check_weights()
        state, collected = learner.state(), collector.state_dict()
        if partners is not None:
            state |= partners.state()
        assert all(part.device.type == "cpu" for part in state.values())
    return state


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name in ("magnet", "restarts", "pool") else ()) for name in LEARNERS]
)
def test_learning_mixes_no_devices(name: str) -> None:
    make, config = LEARNERS[name]
    usual = learned(make, config)
    with pretended_cuda():
        found = learned(make, dataclasses.replace(config, device="cuda"))
    assert found.keys() == usual.keys()
    assert all(torch.equal(found[part], usual[part]) for part in usual)


def test_imitating_mixes_no_devices() -> None:
    weights = []
    for device in ("cpu", "cuda"):
        with pretended_cuda():
            torch.manual_seed(0)
            actor = make_ppo(PPOConfig(**SMALL, device=device), GAME).actor
            imitate(actor, BC, np.ones(GAME.n_states), steps=3)
            weights.append([weight.detach().cpu() for weight in actor.parameters()])
    assert all(map(torch.equal, *weights))


def test_a_run_mixes_no_devices(tmp_path: Path) -> None:
    config = PPOConfig(**SMALL, checkpoint_every=2, record="all", exploitability=False)
    usual = train(dataclasses.replace(config, out=tmp_path / "cpu"))
    with pretended_cuda():
        done = train(dataclasses.replace(config, out=tmp_path / "cuda", device="cuda", sampler="auto"))
    assert done.evaluation == usual.evaluation
    for name in ("agent/network.safetensors", "rallies.mcap"):
        assert (done.folder / name).read_bytes() == (usual.folder / name).read_bytes()
