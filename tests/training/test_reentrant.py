"""Training and PyTorch's global state: trainings in several threads, and what the caller has set."""

import contextlib
import dataclasses
import hashlib
import random
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from shuttle_marl.base.pytorch import own_settings
from shuttle_marl.training import PPOConfig, SACConfig, TrainingConfig, train
from tests.reduced import reduced_model

SMALL: dict[str, Any] = {"game": reduced_model(), "batch": 512, "width": 8, "evaluate_every": 4, "checkpoint_every": 3}
CONFIGS: dict[str, TrainingConfig] = {
    "ppo": PPOConfig(**SMALL, strokes=512 * 6, growth=0.0),
    "self-play": PPOConfig(**SMALL, strokes=512 * 6, growth=0.0, opponent=("self",), variant="pool", update_interval=2),
    "sac": SACConfig(**SMALL, strokes=512 * 6, warm_up=600, minibatch=64, buffer=900, critics=2),
}


def trained(config: TrainingConfig, folder: Path) -> dict[str, str]:
    """Hashes of what a training writes and that does not hold times."""
    run = train(dataclasses.replace(config, out=folder)).folder
    files = [path for path in sorted(run.rglob("*")) if path.suffix in (".safetensors", ".mcap")]
    assert len(files) > 3
    return {str(path.relative_to(run)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def global_state() -> list[Any]:
    """What is global in PyTorch, NumPy and Python."""
    numbers: Any = np.random.get_state()  # noqa: NPY002  what is global
    with ThreadPoolExecutor(1) as new_thread:
        threads = torch.get_num_threads(), new_thread.submit(torch.get_num_threads).result()
    return [
        *(torch.get_rng_state().tolist(), torch.initial_seed(), threads, torch.get_num_interop_threads()),
        *(torch.get_default_dtype(), torch.get_default_device(), torch.are_deterministic_algorithms_enabled()),
        *(torch.is_grad_enabled(), torch.get_float32_matmul_precision(), torch.is_inference_mode_enabled()),
        *(numbers[1].tolist(), numbers[2:], random.getstate()),
    ]


@pytest.mark.parametrize("name", ["self-play", "sac"])
def test_two_trainings_in_two_threads_equal_two_in_a_row(name: str, tmp_path: Path) -> None:
    configs = [dataclasses.replace(CONFIGS[name], seed=seed) for seed in (1, 2)]
    before = global_state()
    in_a_row = [trained(config, tmp_path / f"row-{config.seed}") for config in configs]
    assert global_state() == before
    with ThreadPoolExecutor(2) as pool:
        at_once = list(pool.map(lambda config: trained(config, tmp_path / f"thread-{config.seed}"), configs))
    assert at_once == in_a_row
    assert in_a_row[0] != in_a_row[1]
    assert global_state() == before


@contextlib.contextmanager
def other_defaults() -> Iterator[None]:
    """A caller who has changed what PyTorch has as a default."""
    threads, state = torch.get_num_threads(), torch.get_rng_state()
    torch.manual_seed(5)
    torch.set_default_dtype(torch.float64)
    torch.set_default_device("meta")
    torch.set_num_threads(3)
    torch.use_deterministic_algorithms(True)
    try:
        with torch.no_grad():
            yield
    finally:
        torch.set_default_dtype(torch.float32)
        torch.set_default_device(None)
        torch.set_num_threads(threads)
        torch.use_deterministic_algorithms(False)
        torch.set_rng_state(state)


@pytest.mark.parametrize("name", ["ppo", "sac"])
def test_defaults_of_the_caller_change_nothing(name: str, tmp_path: Path) -> None:
    usual = trained(CONFIGS[name], tmp_path / "usual")
    with other_defaults():
        before = global_state()
        other = trained(CONFIGS[name], tmp_path / "other")
        assert global_state() == before
    # Adam counts its steps in the default dtype unless it is fused, as that of the temperature of SAC is not.
    assert [file for file in usual if other[file] != usual[file] and not (name == "sac" and "checkpoints" in file)] == []
    assert other.keys() == usual.keys()


def test_threads_of_others_are_theirs() -> None:
    before = global_state()
    with ThreadPoolExecutor(1) as old:
        others = old.submit(torch.get_num_threads).result()
        with own_settings(others + 2), ThreadPoolExecutor(1) as new:
            assert torch.get_num_threads() == others + 2
            assert [thread.submit(torch.get_num_threads).result() for thread in (old, new)] == [others, others]
            assert global_state() != before
    assert global_state() == before
