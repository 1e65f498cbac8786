"""Refusals of a training run, and Ctrl-C at any moment: one line that says what is saved, and the same result after resuming."""

import dataclasses
import functools
import json
import os
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterator
from multiprocessing import synchronize
from pathlib import Path
from typing import Any

import pytest
import torch

from shuttle_marl.base import runs
from shuttle_marl.base.cluster import ClusterError, WorkerPool, check_processes, in_processes
from shuttle_marl.base.files import read_sealed, seal
from shuttle_marl.base.runs import METRICS, RunError, check_interrupt, interrupts_held
from shuttle_marl.commands import league, training
from shuttle_marl.game.policy import tabulate
from shuttle_marl.game.shipped import resolve_game
from shuttle_marl.kernel import RallySampler
from shuttle_marl.policy.agents import load_agent, read_card
from shuttle_marl.policy.registry import resolve
from shuttle_marl.training import A2CConfig, Evaluator, PPOConfig, SACConfig, TrainingConfig, TrainingError, train
from shuttle_marl.training.learner import Mean
from shuttle_marl.training.networks import DivergedError
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


def test_a_checkpoint_that_is_deleted_leaves_the_one_before(finished: Path, run: Path) -> None:
    (checkpoint(run) / "state.safetensors").write_bytes(b"junk")
    with pytest.raises(runs.RunError, match="delete it to continue from the one before"):
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


def test_no_seeds_are_not_one(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    flags = ["--seeds", "0", "--strokes", "64", "--game", reduced_model(), "--out", str(tmp_path / "run")]
    assert training.main(["ppo", *flags]) == 1
    assert "expected at least 2 seeds" in capsys.readouterr().err


def test_a_run_is_not_continued_against_an_opponent_that_changed(tmp_path: Path) -> None:
    for path in (table := tmp_path / "opponent", tmp_path / "other"):
        tabulate(resolve("safe" if path == table else "attacking", GAME), GAME).save(path)
    config = dataclasses.replace(CONFIG, opponent=(f"table:{table}",))
    folder = train(dataclasses.replace(config, out=tmp_path / "run")).folder
    again = dataclasses.replace(config, out=folder, resume=True)
    train(again)
    (tmp_path / "other").replace(table)
    with pytest.raises(RunError, match="the opponents changed after the run was started"):
        train(again)
    (folder / "manifest.json").write_text(json.dumps({"game": {"hash": "0" * 64}}))
    with pytest.raises(RunError, match="the game changed after the run was started; start a new run with another --out"):
        train(again)


@pytest.mark.parametrize("change", [{"iteration": "two"}, {"rallies": {}}, {"metrics": 300}, {"metrics": -1}])
def test_a_checkpoint_of_another_kind_is_named(change: dict[str, Any], run: Path) -> None:
    about = checkpoint(run) / "about.json"
    about.write_bytes(seal({**read_sealed(about), **change}))
    says = r"another kind of run|metrics.jsonl: \d lines, expected 300"
    with pytest.raises((TrainingError, runs.RunError), match=says):
        resume(run)


def test_a_run_folder_runs_no_code(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder that names a module as opponent: the flags name the opponent, and the two must agree."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "evil_opponent.py").write_text("raise SystemExit('it ran')\n")
    named = "evil_opponent:Policy"
    config = json.loads((run / "config.json").read_text())
    card = read_card(run / "agent")
    about = read_sealed(checkpoint(run) / "about.json")
    for key in ("opponent", "game"):
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


@pytest.mark.parametrize("device", ["cuda:7", "meta", "nonsense"])
def test_a_device_that_is_not_there_is_refused(device: str, tmp_path: Path) -> None:
    if device.startswith("cuda") and torch.cuda.is_available():
        pytest.skip("there is one")
    with pytest.raises(TrainingError, match=rf"^--device {device}: cannot be used here \(.+\); --device cpu can"):
        train(dataclasses.replace(CONFIG, device=device, out=tmp_path / "run"))
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("config", [PPOConfig, A2CConfig, SACConfig])
def test_a_network_that_diverged_is_named(config: type[PPOConfig | A2CConfig | SACConfig], tmp_path: Path) -> None:
    changes: dict[str, Any] = {"warm_up": 0, "minibatch": 64} if config is SACConfig else {}
    with pytest.raises(DivergedError, match=r"learning diverged in iteration [1-4]: .+ with a lower --learning-rate"):
        train(config(**TINY, **changes, strokes=64 * 8, learning_rate=1e30, out=tmp_path / "run"))


SMALL: dict[str, Any] = {"game": reduced_model(), "batch": 256, "width": 8, "evaluate_every": 3, "checkpoint_every": 2}
CONFIGS: dict[str, TrainingConfig] = {
    "ppo": PPOConfig(**SMALL, strokes=256 * 6, growth=0.0, record="all"),
    "sac": SACConfig(**SMALL, strokes=256 * 6, warm_up=100, minibatch=32, buffer=600),
}


@pytest.fixture(autouse=True)
def default_handler() -> Iterator[None]:
    """Ctrl-C as in a terminal; processes in the background ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def files(run: Path) -> dict[str, bytes]:
    return {name: (run / name).read_bytes() for name in ("agent/network.safetensors", "best/network.safetensors", "rallies.mcap")}


def interrupting(function: Callable[..., Any], when: int) -> Callable[..., Any]:
    """The function, with Ctrl-C in one of its calls."""
    calls = iter(range(1, 1000))

    def call(*arguments: Any, **options: Any) -> Any:
        if next(calls) == when:
            signal.raise_signal(signal.SIGINT)
        return function(*arguments, **options)

    return call


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Folders of the runs that were not interrupted."""
    return functools.cache(lambda name: train(dataclasses.replace(CONFIGS[name], out=tmp_path_factory.mktemp(name))).folder)


@pytest.mark.parametrize(
    ("name", "owner", "function", "when", "saved"),
    [
        ("ppo", RallySampler, "collect", 1, "no iteration is saved yet"),
        ("ppo", Mean, "add", 5, "iteration [024].* is saved"),
        ("sac", Evaluator, "evaluate", 1, "iteration 2 of 6.* is saved"),
    ],
)
def test_an_interrupt_waits_for_the_end_of_the_iteration(
    name: str, owner: Any, function: str, when: int, saved: str, whole: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, folder = CONFIGS[name], tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr(owner, function, interrupting(getattr(owner, function), when))
        with pytest.raises(KeyboardInterrupt, match=f"^interrupted; {saved}; .*--resume --out {folder} continues$"):
            train(dataclasses.replace(config, out=folder))
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    train(dataclasses.replace(config, out=folder, resume=True))
    assert files(folder) == files(whole(name))
    assert (folder / METRICS).exists()


def test_a_second_interrupt_does_not_wait() -> None:
    reached = []

    @interrupts_held()
    def interrupted_twice() -> None:
        with interrupts_held():  # the inner one leaves it to the outer one
            signal.raise_signal(signal.SIGINT)
        reached.append(1)
        signal.raise_signal(signal.SIGINT)
        reached.append(2)

    with pytest.raises(KeyboardInterrupt):
        interrupted_twice()
    assert reached == [1]
    with interrupts_held():
        check_interrupt()  # what was raised is over
    with pytest.raises(KeyboardInterrupt), interrupts_held():
        signal.raise_signal(signal.SIGINT)


def test_a_handler_of_the_caller_stays() -> None:
    caught: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: caught.append(number))
    with interrupts_held():
        signal.raise_signal(signal.SIGINT)
        check_interrupt()
    assert caught == [signal.SIGINT]


def test_an_interrupt_before_anything_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("shuttle_marl.commands.training.resolve_game", interrupting(resolve_game, 1))
    assert training.main(["ppo", "--game", reduced_model()]) == 130
    assert capsys.readouterr().err == "interrupted; no file is left half-written\n"
    assert not list(tmp_path.iterdir())


def test_workers_end_with_an_interrupt_that_does_not_reach_them() -> None:
    begun = time.monotonic()
    # A function that a worker finds without the tests and what they import.
    results: Any = in_processes(time.sleep, [0.0, 600.0, 600.0], 2)
    assert next(results) is None
    results.close()

    def interrupted() -> None:
        with WorkerPool(2) as pool:
            assert pool.submit(time.sleep, 0.0).result() is None
            pool.submit(time.sleep, 600.0)
            for process in pool._processes.values():
                assert process.pid
                os.kill(process.pid, signal.SIGINT)
            assert pool.submit(time.sleep, 0.0).result() is None, "blocked there"
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert time.monotonic() - begun < 590


def no_semaphore(*_: Any, **__: Any) -> None:
    raise OSError(38, "Function not implemented")


def test_without_semaphores_there_is_one_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(synchronize.SemLock, "__init__", no_semaphore)
    monkeypatch.chdir(tmp_path)
    check_processes(1)
    assert list(in_processes(abs, [-1, 2], 1)) == [1, 2]
    with pytest.raises(ClusterError, match=r"no semaphores here.*--workers 1 or --jobs 1"):
        next(in_processes(abs, [-1, 2], 2))
    for main, arguments in (
        (league.main, "train --rounds 1 --strokes 2000 --workers 2"),
        (training.main, "ppo --seeds 2 --jobs 2 --strokes 2000"),
    ):
        assert main([*arguments.split(), "--game", reduced_model(), "--out", "run"]) == 1
        assert "no semaphores here" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
    for config in CONFIGS.values():
        train(dataclasses.replace(config, out=tmp_path / "run", overwrite=True))
