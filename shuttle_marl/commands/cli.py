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
        0, or 1 after a :class:`ShuttleError` (its message goes to standard error) or when the extra that a command needs is
        not installed or the output cannot be written, or 130 after an interrupt, or 141 when nobody reads the output any more.
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
        console.print(f"[bold red]error:[/] {prog}: ", end="")
        console.print(printable(str(error), keep="\n"), markup=False)
        return 1
    except ModuleNotFoundError as error:
        library = (error.name or "").partition(".")[0]
        if library not in _EXTRAS:
            raise
        advice = f"`make install` installs it, or `pip install 'shuttle-marl[{_EXTRAS[library]}]'`"
        console.print(f"[bold red]error:[/] {prog}: ", end="")
        console.print(f"this needs {library}, which is not installed; {advice}", markup=False)
        return 1
    except OSError as error:
        if isinstance(error, BrokenPipeError) and _nobody_reads():
            _drop_output()
            return 141
        if error.errno not in NO_ROOM:
            raise
        _drop_output()
        console.print(f"[bold red]error:[/] {prog}: ", end="")
        console.print(
            f"{printable(str(error.filename or 'the output'))} cannot be written ({error.strerror}); make room", markup=False
        )
        return 1
    except KeyboardInterrupt:
        console.print("interrupted; what was written is whole")
        return 130
    return 0


def _nobody_reads() -> bool:
    """Whether standard output is a pipe of which the other end is closed."""
    if not hasattr(select, "poll"):
        return True
    pipe = select.poll()
    pipe.register(sys.stdout.fileno(), select.POLLOUT)
    return any(state & select.POLLERR for _, state in pipe.poll(0))


def _drop_output() -> None:
    """Let what still waits to be written go nowhere; the interpreter would try once more when it ends, and complain."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
