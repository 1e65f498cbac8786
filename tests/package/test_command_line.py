"""What all command lines share: exit statuses, and messages instead of tracebacks."""

import importlib
import sys
from collections.abc import Callable

import pytest

from shuttle_marl import cli
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
