"""``shuttle-marl COMMAND …`` is short for ``python -m shuttle_marl.COMMAND …``."""

import importlib
import sys
from collections.abc import Sequence
from typing import Final

_COMMANDS: Final = {
    "analysis": "figures and pictures of recorded rallies, beside real matches",
    "data": "download, convert, summarise and check annotated matches",
    "dynamics": "fit, evaluate and describe the models of the game",
    "exact": "solve the game, and measure policies against the solution",
    "league": "play a tournament between policies",
    "recording": "read, check, repair and export the log of every rally",
    "staging": "turn recorded rallies into motion, and measure it",
    "training": "train an agent with PPO, A2C or SAC",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command named by the first argument.

    Args:
        argv: the command and its own arguments; default ``sys.argv[1:]``.

    Returns:
        The exit status.
    """
    name, *arguments = (sys.argv[1:] if argv is None else argv) or ["--help"]
    if name not in _COMMANDS:
        lines = "\n".join(f"  {command:10} {text}" for command, text in _COMMANDS.items())
        out = sys.stdout if name in ("--help", "-h") else sys.stderr
        out.write(f"usage: shuttle-marl COMMAND …\n\n{lines}\n\n`shuttle-marl COMMAND --help` shows the flags of one.\n")
        return 0 if out is sys.stdout else 2
    command = importlib.import_module(f"shuttle_marl.commands.{name}")
    return int(command.main(arguments))


if __name__ == "__main__":
    sys.exit(main())
