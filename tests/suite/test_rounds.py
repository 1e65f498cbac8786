"""Rounds: commitments, draws, reruns behind a boundary, and what a competitor tries."""

import datetime as dt
import json
import os
import re
from pathlib import Path
from typing import Any

import pytest

import shuttle_marl
from shuttle_marl.suite.board import rows_of
from shuttle_marl.suite.options import RerunOptions, Resources, SuiteError, VerifyOptions
from shuttle_marl.suite.remote import Container, Namespaces, find_boundary
from shuttle_marl.suite.run import commit, draw_round, rerun, time_of, write
from tests.reduced import reduced_model

METHODS = (Path(__file__).parent / "strange_methods.py").read_text(encoding="utf-8")
BEACON, RANDOM, OTHER = 20_000_000, "ab" * 32, "cd" * 32
DRAWN = time_of(BEACON)
BEFORE = DRAWN - dt.timedelta(days=1)
TASK = "exploit-v0"


@pytest.fixture(scope="module")
def boundary() -> None:
    try:
        find_boundary(Path(__file__).parent)
    except SuiteError as error:
        if "inside, one sees" in str(error):
            raise  # the boundary leaks, which is no reason to skip its tests
        pytest.skip("needs namespaces of Linux")


def code(place: Path) -> Path:
    """A folder of a stranger."""
    folder = place / "code"
    folder.mkdir()
    (folder / "strange.py").write_text(METHODS.replace("PACKAGE", str(Path(shuttle_marl.__file__).parent)))
    return folder


def entered(place: Path, folder: Path, method: str, *, randomness: str = RANDOM) -> Path:
    """The file of a round with one entry."""
    write(place / "commitment.json", commit(folder, task=TASK, method=method, author="alice", now=BEFORE))
    path = place / "round.json"
    write(path, draw_round([place / "commitment.json"], beacon=BEACON, randomness=randomness))
    return path


def reran(place: Path, path: Path, folder: Path) -> Path:
    asked = RerunOptions(task=TASK, author="alice", randomness=RANDOM, by="bob")
    return rerun(path, folder, asked, Resources(quick=True, game=reduced_model(), out=place / "run"))


@pytest.mark.usefixtures("boundary")
def test_methods_get_episodes(tmp_path: Path) -> None:
    folder, left = code(tmp_path), list[str]()
    made = reran(tmp_path, entered(tmp_path, folder, "strange:learner"), folder)
    (row,) = rows_of([], reran=[made], given=VerifyOptions(game=reduced_model(), beacon=RANDOM), failed=left.append)
    assert (row["access"], row["reran_by"], left) == ("samples", ["bob"], [])


@pytest.mark.usefixtures("boundary")
@pytest.mark.parametrize(
    ("method", "reason"),
    [
        ("imports", "No module named 'shuttle_marl'"),
        ("opens", "No such file"),
        ("calls_out", "unreachable|PermissionError"),
        ("writes", "Read-only|Permission"),
    ],
)
def test_code_behind_the_boundary_reaches_nothing(method: str, reason: str, tmp_path: Path) -> None:
    folder = code(tmp_path)
    with pytest.raises(Exception, match=reason):
        reran(tmp_path, entered(tmp_path, folder, f"strange:{method}"), folder)


def test_an_invented_beacon_is_found(tmp_path: Path) -> None:
    folder = code(tmp_path)
    path = entered(tmp_path, folder, "strange:learner", randomness=OTHER)
    with pytest.raises(SuiteError, match=f"not that of round {BEACON} of the beacon"):
        reran(tmp_path, path, folder)
    changed = json.loads(path.read_text())
    path.write_text(json.dumps({**changed, "randomness": RANDOM}))
    with pytest.raises(SuiteError, match="checksum"):
        reran(tmp_path, path, folder)


def test_commitments_are_checked(tmp_path: Path) -> None:
    folder = code(tmp_path)
    with pytest.raises(SuiteError, match="no commitment"):
        commit(folder, task=TASK, method="ppo", author="alice")
    with pytest.raises(SuiteError, match="has no rounds"):
        commit(folder, task="text-v0", method="strange:learner", author="alice")
    (folder / "link").symlink_to("/etc/passwd")
    with pytest.raises(SuiteError, match="is a link"):
        commit(folder, task=TASK, method="strange:learner", author="alice")


@pytest.mark.usefixtures("boundary")
@pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="another user needs root")
@pytest.mark.parametrize("part", ["--bounding-set=-all", "--no-new-privs", "--pid"])
def test_a_boundary_that_leaks_is_refused(part: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = Namespaces().command

    def leaky(_: Namespaces, code: Path, arguments: Any) -> list[str]:
        return [each.replace(part, "") for each in whole(code, arguments) if each != part]

    monkeypatch.setattr(Namespaces, "command", leaky)
    with pytest.raises(SuiteError, match="cannot be rerun here"):
        find_boundary(tmp_path)


def test_containers_have_no_network_and_no_privileges(tmp_path: Path) -> None:
    command = Container("podman", "python:3.12").command(tmp_path, ["-c", "pass"])
    for part in ("--network=none", "--read-only", "--cap-drop=ALL", f"--volume={tmp_path}:/code:ro"):
        assert part in command
    assert any(re.fullmatch(r"--user=(\d{10}):\1", part) for part in command)
    assert command[-5:] == ["python:3.12", "python", "-I", "-c", "pass"]
