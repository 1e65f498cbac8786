"""Parts of learners: learning rates, references of self-play, checkpoints and imitation."""

import math
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch import nn

from shuttle_marl.base import runs
from shuttle_marl.training import PPOConfig
from shuttle_marl.training.learner import set_learning_rate
from shuttle_marl.training.self_play import ReferencePolicy


def test_learning_rates_fall_to_a_fiftieth() -> None:
    optimizer = torch.optim.Adam([nn.Parameter(torch.zeros(1))], lr=0.5)
    for remaining, rate in ((1.0, 8.0), (0.5, 4.0), (0.02, 0.16), (0.01, 0.16), (0.0, 0.16)):
        set_learning_rate(optimizer, 8.0, remaining)
        assert optimizer.param_groups[0]["lr"] == pytest.approx(rate)


def reference(variant: Any, rate: float = 0.25) -> tuple[ReferencePolicy, nn.Linear]:
    network = nn.Linear(1, 2, bias=False)
    with torch.no_grad():
        network.weight.copy_(torch.tensor([[0.0], [math.log(3)]]))
    config = PPOConfig(opponent=("self",), variant=variant, magnet_rate=rate, update_interval=4)
    return ReferencePolicy(config, network), network


@pytest.mark.parametrize(
    ("variant", "rate", "expected"),
    [
        *((variant, 0.25, [2.0, 3.5, 4.625, 5.46875]) for variant in ("magnet", "emagnet")),
        ("emagnet", 0.0, [0, 0, 0, 0]),
        ("emagnet", 1.0, [8, 8, 8, 8]),
        ("nash", 0.25, [0, 0, 0, 8]),
    ],
)
def test_magnets_average_parameters_and_nash_copies_them(variant: str, rate: float, expected: list[float]) -> None:
    own, network = reference(variant, rate)
    with torch.no_grad():
        network.weight += 8.0
    moved = []
    for iteration in (1, 2, 3, 4):
        own.update(iteration)
        moved.append(next(own.network.parameters())[0].item())
    assert moved == pytest.approx(expected)


def test_the_divergence_is_that_of_the_policy_from_the_reference() -> None:
    own, network = reference("magnet")
    data = TensorDict({"observation": torch.ones(2, 1), "action_mask": torch.tensor([[True, True], [False, True]])}, [])
    assert own.divergence(data).tolist() == pytest.approx([0, 0])
    with torch.no_grad():
        network.weight.zero_()
    # Of (1/2, 1/2) from (1/4, 3/4), and of the only legal stroke from itself.
    expected = 0.5 * math.log(2) + 0.5 * math.log(2 / 3)
    assert own.divergence(data).tolist() == pytest.approx([expected, 0], abs=1e-6)


def test_the_latest_two_checkpoints_are_kept(tmp_path: Path) -> None:
    run = runs.Run(tmp_path)
    assert (run.saved(), run.last) == (None, 0)
    for iteration in (3, 20, 100):
        run.save(iteration, {"iteration": iteration}, {"x": str(iteration).encode()})
    (tmp_path / "checkpoints" / "00000999").mkdir()  # incomplete
    assert sorted(path.name for path in (tmp_path / "checkpoints").iterdir()) == ["00000020", "00000100", "00000999"]
    about, content = run.saved("x") or ({}, [])
    assert (run.last, about["iteration"], content) == (100, 100, [b"100"])
    run.save(100, {"iteration": 100}, {"x": b"5"})
    assert (run.saved("x") or ({}, []))[1] == [b"5"]
    (tmp_path / "file").touch()
    with pytest.raises(runs.RunError, match=r"00000001: cannot be written .* continue with --resume"):
        runs.Run(tmp_path / "file").save(1, {}, {})
