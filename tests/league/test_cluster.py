"""Leagues on a cluster: what is lost is played again, and nothing differs from a run on one machine."""

import contextlib
import importlib.util
import os
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock

from shuttle_marl.base import cluster as module
from shuttle_marl.base.cluster import ClusterError, open_cluster
from shuttle_marl.commands.league import main
from shuttle_marl.league import LeagueConfig, run_league
from shuttle_marl.training.league.config import LeagueTrainingConfig
from shuttle_marl.training.league.run import train_league
from tests.league.test_league_training import final
from tests.reduced import reduced_model

PLAYED: dict[str, Any] = {
    "pool": ("bc", "attacking", "safe", "random"), "matches": 40, "batch": 80, "exact": False
}  # fmt: skip
TRAINED: dict[str, Any] = {
    "strokes": 1500, "rounds": 3, "batch": 256, "width": 8, "update_interval": 2, "patience": 2, "pool": ("attacking", "safe")
}  # fmt: skip


def product(a: int, b: int) -> int:
    if b == 13:
        raise ValueError("unlucky")
    return a * b


def _files(folder: Path) -> dict[str, bytes]:
    """Files of a tournament, but the one that says when it was played."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file() and path.name != "manifest.json"}


def _tables(folder: Path) -> dict[str, bytes]:
    """Frozen policies, networks and states of learners: the whole of them."""
    return {
        str(p.relative_to(folder)): p.read_bytes() for name in ("tables", "learners") for p in (folder / name).glob("*.[sz]*")
    }


@pytest.mark.parametrize("command", [[], ["train"]])
def test_ray_that_is_missing_is_named(
    command: list[str], small_model: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    flags = ["--ray", "auto", "--pool", "attacking", "safe", "--game", small_model, "--out", str(tmp_path / "run")]
    assert main([*command, *flags]) == 1
    message = capsys.readouterr().err
    assert "--ray auto: Ray is not installed; `pip install" in message
    assert "[ray]" in message
    assert not (tmp_path / "run").exists()


def test_workers_with_other_versions_refuse(monkeypatch: pytest.MonkeyPatch) -> None:
    versions = module._versions(("numpy",))
    assert module._call(product, versions, 3, 4) == 12
    with pytest.raises(ClusterError, match=r"numpy 1\.0 there, .* here\); install the same"):
        module._call(product, {**versions, "numpy": "1.0"}, 3, 4)


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


@pytest.mark.slow(minutes=True)
@needs_ray
def test_training_on_two_nodes_of_which_one_dies(nodes: tuple[str, Callable[[], None]], tmp_path: Path) -> None:
    address, kill = nodes
    config: dict[str, Any] = {**TRAINED, "strokes": 20_000, "rounds": 4, "game": reduced_model()}
    train_league(LeagueTrainingConfig(**config, workers=1, out=tmp_path / "serial"))
    with Half(tmp_path / "cluster" / "metrics.jsonl", 2, kill) as half:
        train_league(LeagueTrainingConfig(**config, ray=address, out=tmp_path / "cluster"))
    assert half.done
    assert final(tmp_path / "cluster") == final(tmp_path / "serial")
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
    with open_cluster("local", ()) as cluster:
        ten = cluster.share(10)
        assert [task() for task in [cluster.submit(product, ten, b) for b in range(3)]] == [0, 10, 20]
        with pytest.raises(ValueError, match="unlucky"):
            cluster.submit(product, 1, 13)()
        with pytest.raises(ClusterError, match=r"lost 4 times with its worker.*--resume"):
            cluster.submit(os._exit, 1)()
    with pytest.raises(ClusterError, match="no cluster can be reached"), open_cluster("auto", ()):
        pass
