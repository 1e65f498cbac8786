"""Refusals of a training run: damaged files, machines that are too small, networks that diverged, and files from others."""

import dataclasses
import json
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

from shuttle_marl.base import runs
from shuttle_marl.base.files import read_sealed, seal
from shuttle_marl.base.runs import RunError
from shuttle_marl.policy.agents import load_agent, read_card
from shuttle_marl.training import A2CConfig, PPOConfig, SACConfig, TrainingConfig, TrainingError, train
from shuttle_marl.training.config import DivergedError
from tests.reduced import reduced_game, reduced_model

GAME = reduced_game()
TINY: dict[str, Any] = {
    "game": reduced_model(),
    "batch": 64,
    "growth": 0.0,
    "width": 4,
    "evaluate_every": 1,
    "checkpoint_every": 1,
    "record": "none",
}
CONFIG = PPOConfig(**TINY, strokes=64 * 2)


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a finished run of CONFIG; not to be changed."""
    return train(dataclasses.replace(CONFIG, out=tmp_path_factory.mktemp("training") / "run")).folder


@pytest.fixture
def run(finished: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    shutil.copytree(finished, tmp_path / "run")
    return tmp_path / "run"


def resume(folder: Path, **changes: Any) -> Any:
    return train(dataclasses.replace(CONFIG, out=folder, resume=True, **changes))


def checkpoint(folder: Path) -> Path:
    return max((folder / "checkpoints").iterdir())


# Damage.


def test_a_checkpoint_that_is_deleted_leaves_the_one_before(finished: Path, run: Path) -> None:
    (checkpoint(run) / "state.safetensors").write_bytes(b"junk")
    with pytest.raises(TrainingError, match="delete it to continue from the one before"):
        resume(run)
    shutil.rmtree(checkpoint(run))
    resume(run)
    name = "agent/network.safetensors"
    assert (run / name).read_bytes() == (finished / name).read_bytes()


def test_junk_among_the_evaluations_is_named_and_behind_them_taken_away(run: Path) -> None:
    path = run / "metrics.jsonl"
    whole = path.read_bytes()
    path.write_bytes(whole + b'junk\n{"iteration": 9}\n[')
    resume(run)
    assert path.read_bytes() == whole
    path.write_bytes(b"junk" + whole[4:])
    with pytest.raises(runs.RunError, match=r"metrics.jsonl: line 1 is damaged .*start the run again"):
        resume(run)
    path.unlink()
    with pytest.raises(runs.RunError, match=r"metrics.jsonl: 0 lines, expected \d"):
        resume(run)


@pytest.mark.parametrize(
    "change",
    [
        {"iteration": "two"},
        {"rallies": {}},
        {"metrics": 300},
        {"metrics": -1},
        {"game": "0" * 64},
    ],
)
def test_a_checkpoint_of_another_kind_is_named(change: dict[str, Any], run: Path) -> None:
    """Its checksums fit, so somebody wrote it."""
    about = checkpoint(run) / "about.json"
    about.write_bytes(seal({**read_sealed(about), **change}))
    says = r"another kind of run|metrics.jsonl: \d lines, expected 300|was trained on game 000000000000, this is"
    with pytest.raises((TrainingError, runs.RunError), match=says):
        resume(run)


# Files from others.


def test_a_run_folder_runs_no_code(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder that names a module as opponent: the flags name the opponent, and the two must agree."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "evil_opponent.py").write_text("raise SystemExit('it ran')\n")
    named = "evil_opponent:Policy"
    config = json.loads((run / "config.json").read_text())
    card = read_card(run / "agent")
    about = read_sealed(checkpoint(run) / "about.json")
    for key in ("opponent", "warm_start", "game"):
        changed = {**config, key: [named] if key == "opponent" else named}
        (run / "config.json").write_text(json.dumps(changed))
        with pytest.raises(RunError, match="was started with other flags"):
            resume(run)
    (run / "config.json").write_text(json.dumps(config))
    (run / "agent" / "card.json").write_bytes(seal({**card, "config": {"opponent": [named]}, "policy": named}))
    (checkpoint(run) / "about.json").write_bytes(seal({**about, "opponent": [named], "policy": named, "learner": named}))
    load_agent(run / "agent", GAME)
    resume(run)
    assert "evil_opponent" not in sys.modules


# The machine.


@pytest.mark.parametrize("device", ["cuda:7", "meta", "nonsense"])
def test_a_device_that_is_not_there_is_refused(device: str, tmp_path: Path) -> None:
    if device.startswith("cuda") and torch.cuda.is_available():
        pytest.skip("there is one")
    with pytest.raises(TrainingError, match=rf"^--device {device}: cannot be used here \(.+\); --device cpu can"):
        train(dataclasses.replace(CONFIG, device=device, out=tmp_path / "run"))
    assert not (tmp_path / "run").exists()


def test_a_device_whose_memory_does_not_suffice_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def collect(*_: Any, **__: Any) -> None:
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB.\nMore about it")

    monkeypatch.setattr("shuttle_marl.kernel.sampling.RallySampler.collect", collect)
    with pytest.raises(TrainingError, match=r"^--device cpu: its memory .+Tried to allocate 2.00 GiB\.\); .+smaller --batch"):
        train(dataclasses.replace(CONFIG, out=tmp_path / "run"))


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (PPOConfig(batch=10**8, growth=1000, strokes=10**15), "--batch and --growth"),
        (PPOConfig(strokes=10**15, batch=16, growth=0, checkpoint_every=1), "--strokes with so small"),
        (PPOConfig(width=10**7), "--width and --hidden"),
        (SACConfig(buffer=10**13), "--buffer"),
        (SACConfig(minibatch=10**12), "--minibatch"),
    ],
)
def test_a_run_that_does_not_fit_into_the_memory_is_refused(config: TrainingConfig, message: str, tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match=rf"{message}.*: such a run needs [\d,]+ GB of memory or more, and this machine has"):
        train(dataclasses.replace(config, out=tmp_path / "run"))
    assert not (tmp_path / "run").exists()


# Learning that diverges.


@pytest.mark.parametrize("config", [PPOConfig, A2CConfig, SACConfig])
def test_a_network_that_diverged_is_named(config: type[PPOConfig | A2CConfig | SACConfig], tmp_path: Path) -> None:
    changes: dict[str, Any] = {"warm_up": 0, "minibatch": 64} if config is SACConfig else {}
    with pytest.raises(DivergedError, match=r"learning diverged in iteration [1-4]: .+ with a lower --learning-rate"):
        train(config(**TINY, **changes, strokes=64 * 8, learning_rate=1e30, out=tmp_path / "run"))


# The normalised score.
