"""Run folders: one process in each, found again by name, and clear errors for those that cannot be used."""

import json
import multiprocessing
import os
import shutil
import sys
import time
from multiprocessing.synchronize import Barrier
from pathlib import Path
from typing import Any

import pytest

from shuttle_marl.base import runs
from shuttle_marl.base.runs import CONFIG, RunError, open_run
from shuttle_marl.league.entrants import LeagueConfig
from shuttle_marl.training.config import PPOConfig
from shuttle_marl.training.league.config import LeagueTrainingConfig

FIXED = {"seed": 0}
ROUNDS = 100


def opened(out: Path | None, *, name: str = "league-1", resume: bool = False, overwrite: bool = False) -> Path:
    with open_run(out, name, FIXED, resume=resume, overwrite=overwrite) as run:
        return run.folder


def unfinished(folder: Path) -> None:
    folder.mkdir(parents=True)
    (folder / CONFIG).write_text(json.dumps(FIXED))


@pytest.mark.parametrize("config", [PPOConfig, LeagueConfig, LeagueTrainingConfig])
def test_settings_take_a_path_as_text(config: Any) -> None:
    assert config(out="runs/mine").out == Path("runs/mine")


def test_settings_take_one_name_in_place_of_several() -> None:
    assert PPOConfig(opponent="bc").opponent == ("bc",)  # type: ignore[arg-type]


def test_resume_finds_no_run_whose_name_only_begins_alike(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("league-1", "league-1-2", "league-10", "league-1-old"):
        unfinished(tmp_path / "runs" / name)
        time.sleep(0.01)
    assert opened(None, resume=True) == Path("runs/league-1-2")
    shutil.rmtree("runs/league-1-2")
    assert opened(None, resume=True) == Path("runs/league-1")
    shutil.rmtree("runs/league-1")
    with pytest.raises(RunError, match="no run to resume named league-1"):
        opened(None, resume=True)


def starts(folder: Path, ways: tuple[dict[str, Any], ...], barrier: Barrier, results: Any) -> None:
    """Start in the same folder as another process at the same time, again and again; report an overlap."""
    for round_number in range(ROUNDS):
        barrier.wait(60)
        held = 0
        try:
            with open_run(folder, "race", FIXED, **ways[round_number % len(ways)]):
                held = 1
                inside = folder / "inside"
                try:
                    inside.mkdir()
                except FileExistsError:
                    results.put("two processes hold the folder")
                time.sleep(0.002)
                inside.rmdir()
        except RunError:
            pass
        except OSError as error:
            results.put(repr(error))
        results.put(held)


def test_two_processes_never_hold_a_folder_at_once(tmp_path: Path) -> None:
    """One replaces or resumes the run while the other replaces it: the configuration is a new file each time."""
    folder = tmp_path / "run"
    opened(folder)
    context = multiprocessing.get_context("spawn")
    barrier, results = context.Barrier(2), context.Queue()
    replaces, resumes = {"resume": False, "overwrite": True}, {"resume": True, "overwrite": False}
    ways = replaces, replaces, resumes, replaces
    both = [context.Process(target=starts, args=(folder, ways[i:] + ways[:i], barrier, results)) for i in range(2)]
    for process in both:
        process.start()
    found = [results.get(timeout=60) for _ in range(2 * ROUNDS)]
    for process in both:
        process.join(60)
        assert process.exitcode == 0
    assert set(found) <= {0, 1}
    assert sum(found) >= ROUNDS / 2


def test_a_new_run_takes_a_name_of_its_own_while_another_holds_the_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with open_run(None, "race", FIXED, resume=False, overwrite=False) as run:
        first = run.folder
        assert opened(None, name="race") == Path("runs/race-2")
        with pytest.raises(RunError, match=r"another process \(\d+\) runs there"):
            opened(first, overwrite=True)
        with pytest.raises(RunError, match=r"another process \(\d+\) runs there"):
            opened(first, resume=True)
    assert opened(first, overwrite=True) == first


def test_a_run_is_not_resumed_and_replaced(tmp_path: Path) -> None:
    opened(tmp_path / "run")
    with pytest.raises(RunError, match="--resume continues a run and --overwrite replaces it; give one of them"):
        opened(tmp_path / "run", resume=True, overwrite=True)


def test_runs_that_cannot_be_created_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("runs").symlink_to("none")
    with pytest.raises(RunError, match="cannot be used"):
        opened(None)


def test_a_run_killed_before_its_configuration_was_written_can_be_started_again(tmp_path: Path) -> None:
    (tmp_path / f".{CONFIG}.1.part").touch()
    assert opened(tmp_path) == tmp_path


def test_a_run_whose_replacement_was_broken_off_can_be_replaced_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "run"
    opened(folder)
    (folder / "checkpoints").mkdir()
    (folder / "a.txt").write_text("a")

    def breaks(path: Path, *_: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(shutil, "rmtree", breaks)
        with pytest.raises(KeyboardInterrupt):
            opened(folder, overwrite=True)
    opened(folder, overwrite=True)
    assert {path.name for path in folder.iterdir()} == {CONFIG, runs.LOCK}


@pytest.mark.skipif(sys.platform == "win32", reason="names of bytes")
@pytest.mark.parametrize(
    ("out", "message"),
    [
        (Path("a" * 256), "File name too long"),
        (Path(os.fsdecode(b"caf\xe9")), r"'caf\\udce9': expected a name in UTF-8"),
        (Path("a\0b"), "null (byte|character)"),
    ],
)
@pytest.mark.parametrize("flags", [{}, {"resume": True}])
def test_names_that_no_folder_can_have(
    out: Path, message: str, flags: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RunError, match=message) as raised:
        opened(out, **flags)
    str(raised.value).encode()
    assert not list(tmp_path.iterdir())
