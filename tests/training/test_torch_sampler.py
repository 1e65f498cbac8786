"""Rallies played by PyTorch: those of the compiled kernel on every device; a training run on one mixes no tensors."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from shuttle_marl.game import draws
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.kernel import RallySampler
from shuttle_marl.policy.registry import resolve
from shuttle_marl.training import A2CConfig, PPOConfig, SACConfig, TrainingConfig, train
from shuttle_marl.training.learner import RallyCollector
from shuttle_marl.training.sac import SAC
from shuttle_marl.training.torch_sampler import TorchSampler, draw, extend, mix, sums
from tests.kernel.episodes import network
from tests.reduced import reduced_game, reduced_model

GAME = reduced_game()
RANDOM, BC, SAFE = (tabulate(resolve(name, GAME), GAME) for name in ("random", "bc", "safe"))
NO_GPU = pytest.mark.skipif(not torch.cuda.is_available(), reason="PyTorch finds no CUDA device on this machine")
DEVICES = ["cpu", pytest.param("cuda", marks=NO_GPU)]
EXACT = ("state", "visits", "start", "row", "stroke", "log_probability", "strokes", "rallies", "won", "played")


def compare(kernel: RallySampler, device: TorchSampler) -> None:
    """Compare the last iterations of both: whole numbers are equal, and sums up to rounding."""
    assert (kernel.known == device.known).all()
    assert (kernel.numbers == device.numbers).all()
    order = np.random.default_rng(0).permutation(len(kernel.known))
    expected, found = kernel.take(order), device.take(order)
    for name in EXACT:
        ours, theirs = getattr(expected, name), getattr(found, name)
        assert np.array_equal(ours, theirs), name
        assert np.asarray(ours).dtype == np.asarray(theirs).dtype
    np.testing.assert_allclose(found.returns, expected.returns, atol=1e-5)
    np.testing.assert_allclose(found.advantage, expected.advantage, rtol=1e-4, atol=1e-4)
    assert found.deviation == pytest.approx(expected.deviation, rel=1e-12)


@pytest.mark.parametrize("device", DEVICES)
def test_the_draws_are_those_of_the_game(device: str) -> None:
    extremes = [0, 1, (1 << 63) - 1, 1 << 63, (1 << 64) - 1]
    numbers = np.concatenate([np.array(extremes, np.uint64), np.random.default_rng(0).integers(0, 1 << 64, 10_000, np.uint64)])
    there = torch.from_numpy(numbers.view(np.int64)).to(device)

    def bits(tensor: torch.Tensor) -> np.ndarray:
        return tensor.cpu().numpy().view(np.uint64)

    with np.errstate(over="ignore"):
        assert (bits(mix(there)) == draws.mix(numbers)).all()
    for number in (0, 1, 255, 1 << 40):
        assert (bits(draw(there, number)) == draws.draw(numbers, number)).all()
    key = draws.stream(11)
    assert (bits(extend(int(key.view(np.int64)[0]), there)) == draws.extend(key, numbers)).all()


SHAPING = np.random.default_rng(1).uniform(-0.2, 0.2, GAME.limits[..., 0].size).astype(np.float32)
MET: dict[str, tuple[tuple[TabulatedPolicy, ...], dict[str, Any]]] = {
    "self-play": ((), {"gae_lambda": 0.8, "cache_iterations": 4}),
    "fixed": ((BC,), {"gae_lambda": 0.7, "cache_iterations": 8}),
    "shaped": ((RANDOM,), {"gae_lambda": 0.95, "shaping": SHAPING}),
    "many": ((RANDOM, BC, SAFE), {"gae_lambda": 1.0, "cache_iterations": 2, "shaping": SHAPING}),
    "without-trace": ((BC, RANDOM), {"gae_lambda": 0.0}),
}


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("met", MET)
def test_what_is_played_is_what_the_kernel_plays(met: str, device: str) -> None:
    opponents, options = MET[met]
    pair: tuple[RallySampler, TorchSampler] = (
        RallySampler(GAME, opponents, **options), TorchSampler(GAME, opponents, device=device, **options)
    )  # fmt: skip
    for sampler in pair:
        sampler.reset(17)
    for iteration in range(5):
        for sampler in pair:
            if iteration == 2 and opponents:
                sampler.replace_opponent(0, SAFE)
                sampler.assign(np.array([0, -1, len(opponents) - 1, -1]))
            if iteration == 3:
                sampler.restart(np.flatnonzero(GAME.playable)[100:300], 0.3)
            if iteration == 4:
                sampler.reset(18, sampler.known)
            sampler.collect(2500, network(iteration))
        compare(*pair)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("opponents", [(), (BC,)], ids=["self-play", "fixed"])
def test_the_strokes_one_by_one_are_the_same(opponents: tuple[TabulatedPolicy, ...], device: str) -> None:
    pair = RallySampler(GAME, opponents, gae_lambda=0.6), TorchSampler(GAME, opponents, device=device, gae_lambda=0.6)
    for iteration in range(3):
        for sampler in pair:
            # In a first iteration the kernel's list may grow, and rallies that wait for that come later.
            sampler.collect(3000, network(iteration), keep=iteration > 0)
        compare(*pair)
        expected, found = (sampler.strokes for sampler in pair)
        for name, ours, theirs in zip(expected._fields, expected, found, strict=True):
            assert np.array_equal(ours, theirs), name
            assert ours.dtype == theirs.dtype
        assert len(found.state) == (0 if iteration == 0 else pair[1].count)
    assert not np.isfinite(pair[1].take().returns).any()


@pytest.mark.parametrize("device", DEVICES)
def test_the_kernel_plays_the_same_rallies_again_for_the_log(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shuttle_marl.kernel.sampling._LONG", 1)
    sampler = TorchSampler(GAME, [BC], device=device)
    sampler.collect(4000, network(0))
    played = sampler.record(sampler.numbers, figures=True)
    assert played.length.sum() == sampler.take().played
    own = np.isfinite(played.log_probability)
    assert own.sum() == sampler.count


@pytest.mark.parametrize("device", DEVICES)
def test_sums_do_not_depend_on_the_order(device: str) -> None:
    rng = np.random.default_rng(5)
    amounts = torch.from_numpy(rng.normal(size=20_000) * 10.0 ** rng.integers(-6, 7, 20_000)).to(device)
    group = torch.from_numpy(rng.integers(0, 50, 20_000)).to(device)
    found = sums(group, amounts, 51)
    for _ in range(3):
        order = torch.from_numpy(rng.permutation(20_000)).to(device)
        assert (sums(group[order], amounts[order], 51) == found).all()
    expected = np.bincount(group.cpu(), amounts.cpu(), 51)
    np.testing.assert_allclose(found.cpu(), expected, atol=float(amounts.abs().max()) * 1e-12)
    assert found[50] == 0
    assert not sums(group[:0], amounts[:0], 3).any()
    assert not sums(group, amounts * 0, 50).any()
    tiny = torch.full((3,), 1e-310, dtype=torch.float64)
    assert sums(torch.zeros(3, dtype=torch.int64), tiny, 1) < 1e-300


def test_the_first_strokes_of_sac_are_those_of_the_kernel() -> None:
    config = SACConfig(game=reduced_model(), batch=512, width=8)
    found = []
    for sampler in ("kernel", "torch"):
        torch.manual_seed(0)
        learner = SAC(config, GAME)
        collector = RallyCollector(dataclasses.replace(config, sampler=sampler), GAME, [BC], learner.predict, distinct=False)
        collector.set_seed(3)
        found.append(collector.collect())
    assert found[0].keys() == found[1].keys()
    for name in ("state", "pair", "following", "reward"):
        assert torch.equal(found[0][name].sort().values, found[1][name].sort().values)


CONFIG = PPOConfig(game=reduced_model(), batch=64, growth=0.0, width=8, strokes=64 * 4, checkpoint_every=2, record="all")
CONFIGS: dict[str, TrainingConfig] = {
    "ppo": dataclasses.replace(CONFIG, warm_start="bc"),
    "a2c": A2CConfig(game=reduced_model(), batch=64, growth=0.0, width=8, strokes=64 * 4, fault_cost=0.3),
    "sac": SACConfig(game=reduced_model(), batch=64, width=8, strokes=64 * 4, warm_up=50, minibatch=64, buffer=150),
    "pool": dataclasses.replace(CONFIG, opponent=("self",), variant="pool", update_interval=2, pool_size=2),
}


@NO_GPU
@pytest.mark.parametrize("name", CONFIGS)
def test_a_run_on_a_gpu_mixes_no_devices_and_is_resumed(name: str, tmp_path: Path) -> None:
    config = dataclasses.replace(CONFIGS[name], device="cuda", out=tmp_path / "run")
    assert train(config).iterations == 4
    assert train(dataclasses.replace(config, resume=True)).iterations == 4
