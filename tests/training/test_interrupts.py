"""Ctrl-C in training: at any moment, one line that says what is saved, status 130, and the same result after resuming."""

import dataclasses
import functools
import os
import signal
import time
from collections.abc import Callable, Iterator
from multiprocessing import synchronize
from pathlib import Path
from typing import Any

import pytest

from shuttle_marl.base.cluster import ClusterError, WorkerPool, check_processes, in_processes
from shuttle_marl.base.interrupts import check_interrupt, interrupts_held
from shuttle_marl.commands import league, training
from shuttle_marl.game.shipped import resolve_game
from shuttle_marl.kernel import RallySampler
from shuttle_marl.training import Evaluator, PPOConfig, SACConfig, TrainingConfig, train
from shuttle_marl.training import run as training_run
from shuttle_marl.training.learner import Mean
from shuttle_marl.training.run import METRICS
from tests.reduced import reduced_model

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
        ("ppo", RallySampler, "collect", 1, "no iteration yet"),
        ("ppo", Mean, "add", 5, "iteration [024]"),
        ("sac", Mean, "add", 5, "iteration [024]"),
        ("sac", Evaluator, "evaluate", 1, "iteration 2 of 6"),
        ("ppo", training_run, "replace_file", 1, "iteration 2 of 6"),
    ],
)
def test_an_interrupt_waits_for_the_end_of_the_iteration(
    name: str, owner: Any, function: str, when: int, saved: str, whole: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, folder = CONFIGS[name], tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr(owner, function, interrupting(getattr(owner, function), when))
        with pytest.raises(KeyboardInterrupt, match=f"^interrupted; {saved}.* is saved; .*--resume --out {folder} continues$"):
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
