"""Writes the reference of all commands from their ``--help``: ``python -m docs.tools.command_reference [--check]``."""

import contextlib
import importlib
import io
import os
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Final
from unittest import mock

from docs.tools.markdown import ROOT, write_or_check
from shuttle_marl.__main__ import COMMANDS
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.commands import cli

PAGE: Final = ROOT / "docs" / "commands.md"
"""The list of all commands; each has a page of its own in the folder ``commands`` beside it."""
EXAMPLES: Final = tomllib.loads(Path(__file__).with_name("command_examples.toml").read_text(encoding="utf-8"))
_WIDTH: Final = 110
_OPTION: Final = re.compile(r"^  --?[a-z].*\n(?: {6,}.*\n)*", re.MULTILINE)
_HELP: Final = "-h, --help show this help message and exit"
_NOISE: Final = re.compile(r"\s*\(default:\s*(?:None|False)?\)|\n +-{9,}(?=\n)")  # no default, and rules
_NAMED: Final = 10  # options that a form repeats, from which on they are counted instead of named
_LEAGUE: Final = ("train", "report")
"""Forms of the command ``league`` with options of their own."""
_HEAD: Final = """# Commands

These pages list the options of every command, as `--help` does, and an example. Switches are off unless a default says
otherwise. `shuttle-marl NAME` is short for `python -m shuttle_marl.NAME`.

| command | what it does |
| --- | --- |
"""


class CommandError(ShuttleError):
    """A command has no help."""


def parts(command: str) -> list[tuple[str, list[str]]]:
    """The forms of a command with a help of their own: name, and arguments that choose it."""
    functions = importlib.import_module(f"shuttle_marl.commands.{command}").COMMANDS
    if isinstance(functions, dict):
        return [(f"{command} {name}", [name]) for name in functions]
    return [(command, []), *((f"{command} {name}", [name]) for name in _LEAGUE if command == "league")]


def help_of(command: str, arguments: list[str]) -> str:
    """Output of a command with ``--help``, without its usage.

    Raises:
        CommandError: it prints none.
    """
    printed = io.StringIO()
    status: object = None
    # A terminal of fixed width without colours.
    terminal = {"COLUMNS": str(_WIDTH), "LINES": "50", "NO_COLOR": "1", "TERM": "dumb"}
    with contextlib.redirect_stdout(printed), mock.patch.dict(os.environ, terminal):
        try:
            status = importlib.import_module(f"shuttle_marl.commands.{command}").main([*arguments, "--help"])
        except SystemExit as stop:
            status = stop.code
    if status not in (0, None):
        raise CommandError(f"shuttle-marl {command} --help: exit status {status}, expected 0")
    _usage, _, text = _NOISE.sub("", printed.getvalue().strip()).partition("\n\n")
    return "\n".join(line.rstrip() for line in text.splitlines())


def without_repeats(text: str, seen: set[str]) -> str:
    """A help text without the options that an earlier form of the command has with equal words; adds its own to ``seen``."""
    options = {found[0]: " ".join(found[0].split()) for found in _OPTION.finditer(f"{text}\n")}
    repeated = [option for option, words in options.items() if words in seen]
    seen.update(options.values())
    kept = _OPTION.sub(lambda found: "" if found[0] in repeated else found[0], f"{text}\n").strip()
    groups = [
        part for part in kept.split("\n\n") if not part.partition("\n")[0].endswith(" options") or _OPTION.search(f"{part}\n")
    ]
    names = [option.split("--")[1].split()[0].rstrip(",") for option in repeated if options[option] != _HELP]
    if names:
        many = len(names) >= _NAMED
        groups.append(f" {len(names)} more options are as above." if many else f" As above: --{', --'.join(names)}.")
    return "\n\n".join(groups)


def pages() -> Iterator[tuple[Path, str]]:
    """The pages, from the help of all commands."""
    yield PAGE, _HEAD + "".join(f"| [`{name}`](commands/{name}.md) | {about} |\n" for name, about in COMMANDS.items())
    for name, about in COMMANDS.items():
        text, seen = f"# shuttle-marl {name}\n\n{about[0].upper()}{about[1:]}.\n", {_HELP}
        for form, arguments in parts(name):
            if form != name:
                text += f"\n## {form}\n"
            if example := EXAMPLES.get(form):
                text += f"\n```bash\nshuttle-marl {example}\n```\n"
            text += f"\n```text\n{without_repeats(help_of(name, arguments), seen)}\n```\n"
        yield PAGE.with_suffix("") / f"{name}.md", text


def main(*, check: bool = False) -> None:
    """Write the pages, or check them.

    Args:
        check: Change nothing; fail if a page differs.
    """
    for path, text in pages():
        write_or_check(path, text, check=check, problem="not what the commands say")


if __name__ == "__main__":
    sys.exit(cli.run(main, prog="python -m docs.tools.command_reference", description="Write the reference of all commands."))
