"""Leagues on a cluster: what is lost is played again, and nothing differs from a run on one machine."""

import contextlib
import importlib.util
import json
import os
import pickle
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock
from safetensors.numpy import load

from shuttle_marl.base import cluster as module
from shuttle_marl.base.cluster import Cluster, ClusterError, LostError, Shared, open_cluster
from shuttle_marl.commands.league import main
from shuttle_marl.league import LeagueConfig, run_league
from shuttle_marl.league import run as league_run
from shuttle_marl.training.league import run as training_run
from shuttle_marl.training.league.config import LeagueTrainingConfig
from shuttle_marl.training.league.run import MAIN, train_league
from tests.reduced import reduced_model

PLAYED: dict[str, Any] = {"pool": ("bc", "attacking", "safe", "random"), "matches": 40, "batch": 80, "record": "sample:3"}
TRAINED: dict[str, Any] = {
    "strokes": 1500, "rounds": 3, "batch": 256, "width": 8, "update_interval": 2, "patience": 2, "pool": ("attacking", "safe")
}  # fmt: skip


class Fake:
    """Runs tasks when they are waited for, the last one first, and loses some.

    Args:
        lost: how often each task is lost, by its number; later ones never are.
        slots: workers; 0: none is left, and no task ever ends.
    """

    def __init__(self, lost: Sequence[int] = (), slots: int = 2) -> None:
        self._lost, self._slots = list(lost), slots
        self.started: list[tuple[Callable[..., Any], Sequence[Any]]] = []
        self.put_values: list[Any] = []

    def slots(self) -> int:
        return self._slots

    def put(self, value: Any) -> Any:
        # A worker has no more than what travels.
        self.put_values.append(pickle.loads(pickle.dumps(value)))
        return f"reference {len(self.put_values) - 1}"

    def start(self, function: Callable[..., Any], arguments: Sequence[Any]) -> int:
        assert not any(isinstance(each, Shared) for each in arguments)
        self.started.append((function, arguments))
        return len(self.started) - 1

    def wait(self, started: Sequence[Any], seconds: float) -> Sequence[Any]:
        return [max(started)] if self._slots else []

    def get(self, started: int) -> Any:
        if started < len(self._lost) and self._lost[started]:
            # The next attempt is a task of its own number.
            self._lost.extend([0] * (len(self.started) - len(self._lost)) + [self._lost[started] - 1])
            raise LostError("node died")
        function, arguments = self.started[started]
        values = [self.put_values[int(e.split()[1])] if isinstance(e, str) else e for e in arguments]
        return function(*values)


def product(a: int, b: int) -> int:
    if b == 13:
        raise ValueError("unlucky")
    return a * b


def test_lost_tasks_are_started_again_and_results_keep_their_order() -> None:
    backend = Fake(lost=[0, 1, 0, 3])
    cluster = Cluster(backend)
    ten = cluster.share(10)
    tasks = [cluster.submit(product, ten, b) for b in range(6)]
    assert [task.result() for task in tasks] == [0, 10, 20, 30, 40, 50]
    assert len(backend.started) == 6 + 1 + 3
    assert backend.put_values == [10]


def test_a_task_that_is_lost_again_and_again_is_given_up_and_the_others_are_not() -> None:
    cluster = Cluster(Fake(lost=[9]))
    lost, kept = cluster.submit(product, 2, 3), cluster.submit(product, 4, 5)
    assert kept.result() == 20
    with pytest.raises(ClusterError, match=r"lost 4 times .*node died.*--resume"):
        lost.result()


def test_an_error_of_a_task_is_raised_where_its_result_is_asked_for() -> None:
    cluster = Cluster(Fake())
    first, second = cluster.submit(product, 1, 13), cluster.submit(product, 1, 2)
    assert second.result() == 2
    with pytest.raises(ValueError, match="unlucky"):
        first.result()


def test_tasks_are_taken_here_when_no_worker_is_left() -> None:
    cluster = Cluster(Fake(slots=0))
    seven = cluster.share(7)
    assert [task.result() for task in [cluster.submit(product, seven, b) for b in range(3)]] == [0, 7, 14]
    assert cluster.slots == 1


@contextlib.contextmanager
def _lossy(address: str, packages: Sequence[str]) -> Iterator[Cluster]:
    yield Cluster(Fake(lost=[1, 0, 2], slots=int(address)))


def _files(folder: Path) -> dict[str, bytes]:
    """Files of a tournament, but the one that says when it was played."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file() and path.name != "manifest.json"}


@pytest.mark.parametrize("slots", [0, 2])
def test_a_tournament_that_loses_tasks_has_the_same_bytes(
    slots: int, small_model: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(league_run, "open_cluster", _lossy)
    config: dict[str, Any] = {**PLAYED, "pool": ("attacking", "safe", "random"), "game": small_model, "batch": 40}
    run_league(LeagueConfig(**config, out=tmp_path / "serial"))
    run_league(LeagueConfig(**config, ray=str(slots), out=tmp_path / "cluster"))
    assert _files(tmp_path / "cluster") == _files(tmp_path / "serial")


def _final(folder: Path) -> tuple[dict[str, Any], bytes]:
    """All results of a league but the time that it took."""
    figures = json.loads((folder / "results.json").read_text())
    for line in (figures, *figures["curve"]):
        del line["seconds"]
    return figures, load((folder / MAIN).read_bytes())["cumulative"].tobytes()


def _tables(folder: Path) -> dict[str, bytes]:
    """Frozen policies, networks and states of learners: the whole of them."""
    return {
        str(p.relative_to(folder)): p.read_bytes() for name in ("tables", "learners") for p in (folder / name).glob("*.[sz]*")
    }


def test_training_that_loses_turns_has_the_same_results(
    small_model: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training_run, "open_cluster", _lossy)
    config: dict[str, Any] = {**TRAINED, "strokes": 400, "rounds": 2, "game": small_model}
    train_league(LeagueTrainingConfig(**config, workers=1, out=tmp_path / "serial"))
    train_league(LeagueTrainingConfig(**config, ray="2", out=tmp_path / "cluster"))
    assert _final(tmp_path / "cluster") == _final(tmp_path / "serial")
    assert _tables(tmp_path / "cluster") == _tables(tmp_path / "serial")


@pytest.mark.parametrize("command", [[], ["train"]])
def test_ray_that_is_missing_is_named(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    assert main([*command, "--ray", "auto", "--pool", "attacking", "safe", "--out", str(tmp_path / "run")]) == 1
    message = capsys.readouterr().err
    assert "--ray auto: Ray is not installed; `pip install" in message
    assert "[ray]" in message
    assert not (tmp_path / "run").exists()


def test_workers_with_other_versions_refuse(monkeypatch: pytest.MonkeyPatch) -> None:
    versions = module._versions(("numpy",))
    assert module._call(product, [3, 4], versions) == 12
    with pytest.raises(ClusterError, match=r"numpy 1\.0 there, .* here\); install the same"):
        module._call(product, [3, 4], {**versions, "numpy": "1.0"})


needs_ray = pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="Ray is not installed")


@pytest.fixture
def no_other_cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """No other test runs Ray meanwhile: ``auto`` finds any cluster of the machine."""
    with FileLock(tmp_path_factory.getbasetemp().parent / "ray.lock"):
        yield


@pytest.fixture
def nodes(no_other_cluster: None, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[str, Callable[[], None]]]:
    """A cluster of two nodes with a processor each: its address, and what kills the second one."""
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    # Workers import the tests' game and the package from where these tests do.
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    from ray.cluster_utils import Cluster as Nodes

    found = Nodes(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    try:
        second = found.add_node(num_cpus=1)
        yield found.address, lambda: found.remove_node(second, allow_graceful=False)
    finally:
        found.shutdown()


class Half:
    """Kills a node when half of something is done, and says so."""

    def __init__(self, path: Path, lines: int, kill: Callable[[], None]) -> None:
        self.done, self._over = False, threading.Event()
        self._thread = threading.Thread(target=self._wait, args=(path, lines, kill))

    def _wait(self, path: Path, lines: int, kill: Callable[[], None]) -> None:
        while not self._over.wait(0.02):
            with contextlib.suppress(OSError):
                if path.read_bytes().count(b"\n") >= lines:
                    kill()
                    self.done = True
                    return

    def __enter__(self) -> "Half":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()


def _slowly(tournament: Any, group: Any) -> Any:
    time.sleep(0.3)
    return tournament._play_group(group, None)


@pytest.mark.slow(minutes=True)
@needs_ray
def test_a_tournament_on_two_nodes_of_which_one_dies(
    nodes: tuple[str, Callable[[], None]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    address, kill = nodes
    pool = (*PLAYED["pool"], "defensive", "safe@0.5", "safe@2", "attacking@2")
    config: dict[str, Any] = {**PLAYED, "pool": pool, "batch": 40, "game": reduced_model()}
    run_league(LeagueConfig(**config, out=tmp_path / "serial"))
    # Pairings of this game end within milliseconds, before a node could die.
    monkeypatch.setattr("shuttle_marl.league.tournament._play_remote", _slowly)
    with Half(tmp_path / "cluster" / "pairings.jsonl", 10, kill) as half:
        run_league(LeagueConfig(**config, ray=address, out=tmp_path / "cluster"))
    assert half.done
    assert _files(tmp_path / "cluster") == _files(tmp_path / "serial")


@pytest.mark.slow
@needs_ray
def test_training_on_two_nodes_of_which_one_dies(nodes: tuple[str, Callable[[], None]], tmp_path: Path) -> None:
    address, kill = nodes
    config: dict[str, Any] = {**TRAINED, "strokes": 20_000, "rounds": 4, "game": reduced_model()}
    train_league(LeagueTrainingConfig(**config, workers=1, out=tmp_path / "serial"))
    with Half(tmp_path / "cluster" / "metrics.jsonl", 2, kill) as half:
        train_league(LeagueTrainingConfig(**config, ray=address, out=tmp_path / "cluster"))
    assert half.done
    assert _final(tmp_path / "cluster") == _final(tmp_path / "serial")
    assert _tables(tmp_path / "cluster") == _tables(tmp_path / "serial")


@pytest.mark.slow
@needs_ray
def test_ray_on_this_machine_and_no_cluster_anywhere(
    no_other_cluster: None, small_model: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    config: dict[str, Any] = {**PLAYED, "pool": ("attacking", "safe", "random"), "game": small_model}
    run_league(LeagueConfig(**config, out=tmp_path / "serial"))
    run_league(LeagueConfig(**config, ray="local", out=tmp_path / "local"))
    assert _files(tmp_path / "local") == _files(tmp_path / "serial")
    with pytest.raises(ClusterError, match="no cluster can be reached"), open_cluster("auto", ()):
        pass
