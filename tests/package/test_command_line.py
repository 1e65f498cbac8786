"""What all command lines share: exit statuses, and messages instead of tracebacks."""

import importlib
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from shuttle_marl.commands import cli
from shuttle_marl.errors import ShuttleError


def status_of(command: Callable[[], None]) -> int:
    return cli.run(command, prog="tea", description="Serves tea.", argv=[])


def raising(error: BaseException) -> Callable[[], None]:
    def command() -> None:
        """Raise."""
        raise error

    return command


def test_success_is_0() -> None:
    assert status_of(lambda: None) == 0


def test_an_error_that_users_can_mend_is_a_message(capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of(raising(ShuttleError("pot [red] is empty; fill it"))) == 1
    assert capsys.readouterr().err == "error: tea: pot [red] is empty; fill it\n"


def test_an_interrupt_is_130() -> None:
    assert status_of(raising(KeyboardInterrupt())) == 130


TALKS = """
import sys
from shuttle_marl.commands import cli

def command() -> None:
    for i in range({lines}):
        sys.stdout.write(f"{{i:100}}\\n")

sys.exit(cli.run(command, prog="tea", description="Talks.", argv=[]))
"""


@pytest.mark.parametrize("flags", [(), ("-u",)], ids=["buffered", "unbuffered"])
@pytest.mark.parametrize("lines", [1, 10_000], ids=["at the end", "on the way"])
def test_nobody_reads_to_the_end(lines: int, flags: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PYTHONUNBUFFERED", raising=False)
    command = [sys.executable, *flags, "-c", TALKS.format(lines=lines)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        assert program.stderr is not None
        program.stdout.close()
        assert program.stderr.read() == ""
        assert program.wait(60) == 141


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a full disk")
@pytest.mark.parametrize("flags", [(), ("-u",)], ids=["buffered", "unbuffered"])
def test_the_output_does_not_fit_on_the_disk(flags: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PYTHONUNBUFFERED", raising=False)
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, *flags, "-c", TALKS.format(lines=1)]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False, timeout=60)
    assert done.stderr == "error: tea: the output cannot be written (No space left on device); make room\n"
    assert done.returncode == 1


def test_another_error_of_the_system_is_a_defect_and_not_hidden() -> None:
    with pytest.raises(BrokenPipeError):
        status_of(raising(BrokenPipeError()))


@pytest.mark.parametrize(
    ("library", "extra"), [("torch", "train"), ("torch.nn", "train"), ("pygame", "render"), ("foxglove.messages", "scene")]
)
def test_a_library_of_an_extra_that_is_missing_is_named(
    library: str, extra: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in (library.partition(".")[0], library):
        monkeypatch.setitem(sys.modules, name, None)
    assert status_of(lambda: importlib.import_module(library)) == 1
    message = capsys.readouterr().err
    assert f"needs {library.partition('.')[0]}, which is not installed" in message
    assert f"pip install 'shuttle-marl[{extra}]'" in message


def test_another_missing_module_is_a_defect_and_not_hidden() -> None:
    with pytest.raises(ModuleNotFoundError, match="no_such_module"):
        status_of(lambda: importlib.import_module("no_such_module"))
