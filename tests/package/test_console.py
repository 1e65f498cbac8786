"""The console script and the public names."""

import json
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

import shuttle_marl
from shuttle_marl.__main__ import main
from shuttle_marl.base.errors import command
from shuttle_marl.game import default_game
from shuttle_marl.policy import registry
from tests.package.closed_pipe import check_closed_pipe

SCRIPT = str(Path(sysconfig.get_path("scripts")) / "shuttle-marl")
LAUNCHERS = pytest.mark.parametrize("launcher", [[SCRIPT], [sys.executable, "-m", "shuttle_marl"]], ids=["script", "module"])


def call(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL)


@LAUNCHERS
def test_help_lists_every_command(launcher: list[str]) -> None:
    done = call(*launcher, "--help")
    assert (done.returncode, done.stderr) == (0, "")
    found = {path.parent.name for path in Path(shuttle_marl.__file__).parent.glob("*/__main__.py")}
    found |= {"policies", "report", "scout"}  # commands that are no package
    assert len(found) > 5
    assert {line.split()[0] for line in done.stdout.splitlines() if line.startswith("  ")} == found
    done = call(*launcher, "serve-tea")
    assert (done.returncode, done.stdout) == (2, "")
    assert "league" in done.stderr


@pytest.mark.parametrize(("typed", "meant"), [("legaue", "league"), ("policy", "policies"), ("--verson", "--version")])
def test_a_command_that_is_nearly_one(typed: str, meant: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([typed]) == 2
    assert f"no command '{typed}'; did you mean {meant}" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["--help"], ["--version"], ["--completion", "bash"]], ids=str)
def test_a_closed_pipe_is_no_traceback(words: list[str]) -> None:
    command = [sys.executable, "-m", "shuttle_marl", *words]
    check_closed_pipe(command)


@pytest.mark.parametrize("arguments", [["powershell"], []])
def test_completion_for_an_unknown_shell(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--completion", *arguments]) == 2
    assert "one of bash, zsh, fish" in capsys.readouterr().err


def test_policies_are_listed_with_a_line_each(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"shuttle_marl {shuttle_marl.__version__}\n"
    assert main(["policies", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert tuple(listed["policies"]) == registry.names(default_game())
    assert all(listed["policies"].values())
    assert {"agent:FOLDER", "table:FILE", "MODULE:ATTRIBUTE"} <= set(listed["forms"])
    assert all(listed["forms"].values())
    assert main(["policies"]) == 0
    shown = capsys.readouterr().out
    assert all(any(line.split()[0] == name for line in shown.splitlines()) for name in listed["policies"])


def test_every_public_name_can_be_imported() -> None:
    assert "rally_v0" in shuttle_marl.__all__
    for name in shuttle_marl.__all__:
        assert getattr(shuttle_marl, name) is not None
    assert set(shuttle_marl.__all__) <= set(dir(shuttle_marl))


def test_printed_commands_name_the_interpreter_in_use(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    environment = tmp_path / "my env"
    (environment / "bin").mkdir(parents=True)
    (environment / "bin" / "python").touch(0o755)
    monkeypatch.setattr(sys, "executable", str(environment / "bin" / "python"))
    monkeypatch.setenv("PATH", str(environment / "bin"))
    assert command("watch", "--replay", "a b.mcap") == "python -m shuttle_marl.watch --replay 'a b.mcap'"
    monkeypatch.setenv("PATH", "/nowhere")
    assert command("data") == f"'{environment}/bin/python' -m shuttle_marl.data"
    monkeypatch.chdir(tmp_path)
    assert command("data") == "'my env/bin/python' -m shuttle_marl.data"
