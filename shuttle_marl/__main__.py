"""``shuttle-marl COMMAND …`` is short for ``python -m shuttle_marl.COMMAND …``."""

import difflib
import importlib
import io
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from shuttle_marl import __version__

COMMANDS: Final = {
    "analysis": "summaries of recorded rallies, compared with real matches",
    "data": "download, convert, import, summarise and check annotated matches",
    "dynamics": "fit, evaluate and describe the models of the game",
    "exact": "solve the game, and measure policies against the solution",
    "league": "play a tournament between policies",
    "policies": "list all policies by name",
    "recording": "read, check, recover and export rally logs",
    "report": "what decided a match: a report for coaches",
    "scout": "how to play against an opponent: a report for coaches",
    "suite": "run the benchmark suite: tasks with exact scores, leaderboard",
    "training": "train an agent with PPO, A2C or SAC",
    "watch": "watch matches in 3D, analyse them, and play yourself",
}
"""Description of each command."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command named by the first argument.

    Args:
        argv: the command and its own arguments; default ``sys.argv[1:]``.

    Returns:
        The exit status.
    """
    _prepare_output()
    words = [*(sys.argv[1:] if argv is None else argv)] or ["--help"]
    try:
        status = _run(*words)
        sys.stdout.flush()
        return status
    except BrokenPipeError:
        if words[0] in COMMANDS:  # they handle theirs
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except KeyboardInterrupt:  # while the command is imported
        sys.stderr.write("interrupted\n")
        return 130


def _prepare_output() -> None:
    """Escape what a terminal cannot show, such as names outside its character set, and discard what is printed nowhere."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed by the caller
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115  until the process ends
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _run(name: str, *arguments: str) -> int:
    if name in COMMANDS:
        command = importlib.import_module(f"shuttle_marl.commands.{name}")
        return int(command.main(list(arguments)))
    if name in ("--help", "-h"):
        sys.stdout.write(_usage())
        return 0
    if name == "--version":
        sys.stdout.write(f"shuttle_marl {__version__}\n")
        return 0
    close = difflib.get_close_matches(name, [*COMMANDS, "--help", "--version"], n=2, cutoff=0.5)
    hint = f"; did you mean {' or '.join(close)}?" if close else ""
    sys.stderr.write(f"error: shuttle-marl: no command {name!a}{hint}\n\n{_usage()}")
    return 2


def _usage() -> str:
    lines = "\n".join(f"  {command:10} {text}" for command, text in COMMANDS.items())
    return (
        f"usage: shuttle-marl COMMAND …\n\n{lines}\n\n"
        "`shuttle-marl COMMAND --help` lists the options of a command, and `--version` prints the version.\n"
    )


if __name__ == "__main__":
    sys.exit(main())
