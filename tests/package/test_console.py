"""The console script and the public names."""

import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

import shuttle_marl

SCRIPT = str(Path(sysconfig.get_path("scripts")) / "shuttle-marl")
LAUNCHERS = pytest.mark.parametrize("launcher", [[SCRIPT], [sys.executable, "-m", "shuttle_marl"]], ids=["script", "module"])


def call(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL)


@LAUNCHERS
def test_help_lists_every_command(launcher: list[str]) -> None:
    done = call(*launcher, "--help")
    assert (done.returncode, done.stderr) == (0, "")
    found = {path.parent.name for path in Path(shuttle_marl.__file__).parent.glob("*/__main__.py")}
    assert found
    assert {line.split()[0] for line in done.stdout.splitlines() if line.startswith("  ")} == found


@LAUNCHERS
def test_no_command_and_an_unknown_one(launcher: list[str]) -> None:
    assert "league" in call(*launcher).stdout
    done = call(*launcher, "serve-tea")
    assert (done.returncode, done.stdout) == (2, "")
    assert "league" in done.stderr


def test_arguments_reach_the_command() -> None:
    done = call(SCRIPT, "league", "--help")
    assert done.returncode == 0, done.stderr
    assert "--matches" in done.stdout


def test_every_public_name_can_be_imported() -> None:
    assert "rally_v0" in shuttle_marl.__all__
    for name in shuttle_marl.__all__:
        assert getattr(shuttle_marl, name) is not None
    assert set(shuttle_marl.__all__) <= set(dir(shuttle_marl))
