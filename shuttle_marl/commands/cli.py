"""What all command lines share: commands generated from typed functions, and errors without traceback."""

import os
import select
import sys
from collections.abc import Callable, Sequence
from typing import Any, Final

import tyro
from rich.console import Console

from shuttle_marl.errors import ShuttleError
from shuttle_marl.files import NO_ROOM
from shuttle_marl.text import printable

Command = Callable[..., Any]

_EXTRAS: Final = {
    "foxglove": "scene",
    "lightgbm": "train",
    "matplotlib": "plot",
    "mcap_protobuf": "scene",
    "pygame": "render",
    "pygltflib": "scene",
    "torch": "train",
}
"""Which extra of the package installs a library that not every command needs."""


def run(commands: Command | dict[str, Command], *, prog: str, description: str, argv: Sequence[str] | None = None) -> int:
    """Parse the command line, call the command, and return the exit status.

    Args:
        commands: one function, or subcommands by name. Flags come from the signature, help from the docstring.
        prog: name of the program in help texts.
        description: first lines of the help.
        argv: arguments; default ``sys.argv[1:]``.

    Returns:
        0, or 1 after a :class:`ShuttleError` (its message goes to standard error), when the extra that a command needs is not
        installed, or when a file or the output cannot be used; 130 after an interrupt; 141 when no one reads the output any
        more.
    """
    args = list(sys.argv[1:] if argv is None else argv)
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    try:
        if isinstance(commands, dict):
            tyro.extras.subcommand_cli_from_dict(commands, prog=prog, description=description, args=args)
        else:
            tyro.cli(commands, prog=prog, description=description, args=args)
        sys.stdout.flush()
    except ShuttleError as error:
        return _fail(console, prog, str(error))
    except ModuleNotFoundError as error:
        library = (error.name or "").partition(".")[0]
        if library not in _EXTRAS:
            raise
        advice = f"`make install` installs it, or `pip install 'shuttle-marl[{_EXTRAS[library]}]'`"
        return _fail(console, prog, f"this needs {library}, which is not installed; {advice}")
    except OSError as error:
        if isinstance(error, BrokenPipeError) and _reader_is_gone():
            _drop_output()
            return 141
        if error.errno in NO_ROOM:
            _drop_output()
            what = error.filename or "the output"
            return _fail(console, prog, f"{what} cannot be written ({error.strerror}); make room")
        if error.filename is None:
            raise
        return _fail(console, prog, f"{error.filename} cannot be used ({error.strerror}); name another file or folder")
    except KeyboardInterrupt:
        console.print("interrupted; what was written is whole")
        return 130
    return 0


def _fail(console: Console, prog: str, message: str) -> int:
    """Print an error; returns the exit status."""
    console.print(f"[bold red]error:[/] {prog}: ", end="")
    console.print(printable(message, keep="\n"), markup=False)
    return 1


def _reader_is_gone() -> bool:
    """Whether standard output is a pipe of which the other end is closed."""
    if not hasattr(select, "poll"):
        return True
    pipe = select.poll()
    pipe.register(sys.stdout.fileno(), select.POLLOUT)
    return any(state & select.POLLERR for _, state in pipe.poll(0))


def _drop_output() -> None:
    """Let what still waits to be written go nowhere; the interpreter would try once more when it ends, and complain."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
