"""``shuttle-marl --completion SHELL``: the completion of all commands and their flags, as a script for a shell."""

import contextlib
import importlib
from collections.abc import Mapping

from tyro.extras import SubcommandApp


def write(shell: str, commands: Mapping[str, str]) -> None:
    """Print the script.

    Args:
        shell: bash, zsh or fish.
        commands: what each command is for, by its name.
    """
    app = SubcommandApp()
    for name, about in commands.items():
        command = importlib.import_module(f"shuttle_marl.commands.{name}").COMMANDS
        if not isinstance(command, dict):
            app.command(command, name=name, help=about)
            continue
        inner = SubcommandApp()
        for part, body in command.items():
            inner.command(body, name=part)
        app.command(inner, name=name, help=about)
    # Tyro ends the program where the script is printed.
    with contextlib.suppress(SystemExit):
        app.cli(prog="shuttle-marl", args=["--tyro-write-completion", shell, "-"])
