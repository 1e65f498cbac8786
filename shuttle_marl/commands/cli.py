"""Shared parts of the command lines: commands from typed functions, consoles, error messages, and tables of plain text."""

import contextlib
import dataclasses
import decimal
import errno
import functools
import inspect
import json
import os
import select
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

import tyro
from rich.console import Console
from rich.status import Status
from rich.table import Table
from rich.text import Text
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from shuttle_marl.base.errors import ShuttleError, command, isolated, printable
from shuttle_marl.base.extras import lacking
from shuttle_marl.base.files import NO_ROOM, check_replaceable

if TYPE_CHECKING:
    from shuttle_marl.game.shipped import Estimate
    from shuttle_marl.game.tables import Game

T = TypeVar("T")
Command = Callable[..., object]
Commands = Command | Mapping[str, Command]
Headlines = tuple[str, Mapping[str, float | None], "Mapping[str, Estimate] | None"]
"""Policy, its results in the game by name, and their spreads in the refits; None without refits."""
Figure = object
"""What is shown of a result: a number, a text, shares by name, or a number with an interval ``(value, low, high)``."""

_NUMBERS: Final = ConstructorRegistry()
_SCALES: Final = {"k": 10**3, "m": 10**6, "g": 10**9}
_MOST_DIGITS: Final = 30
_WIDTH: Final = 160  # width of output that is not to a terminal
_PAGES: Final = (".html", ".md")
_SHOWN: Final = 4  # number of the largest fractions that a cell of a table shows
_SHARES: Final = ("win", "won", "share", "thin", "rare", "against", "after", "runs")
"""Figures whose names have these words are fractions, which are shown in percent."""
_BOUNDS: Final = ("bound", "residual")  # figures whose names have these words are shown with their order of magnitude
_FIXABLE: Final = {
    errno.EACCES,
    errno.EEXIST,
    errno.EISDIR,
    errno.ELOOP,
    errno.ENAMETOOLONG,
    errno.ENOENT,
    errno.ENOTDIR,
    errno.EPERM,
    errno.EROFS,
}
"""System errors of files that users can fix."""


class Output(Console):
    """A console that leaves a closed pipe to :func:`run`."""

    def on_broken_pipe(self) -> None:
        """Raise the error again."""
        raise  # noqa: PLE0704  within the handler of the error


def console(*, stderr: bool = False) -> Console:
    """A console without markup; wide enough for tables if the output is not a terminal."""
    plain = functools.partial(Output, stderr=stderr, markup=False, emoji=False, highlight=False)
    default = plain()
    return default if default.is_terminal or stderr else plain(width=_WIDTH)


def working(what: str) -> Status:
    """Context that shows on a terminal that a command is at work, and on what."""
    return console(stderr=True).status(f"{what} …")


def progress(things: Sequence[T] | Iterable[T], what: str, total: int | None = None) -> Iterable[T]:
    """The things one by one, with a bar on a terminal that shows how many are done."""
    from rich.progress import track  # noqa: PLC0415  keeps --help quick

    return track(things, what, total, console=console(stderr=True), transient=True)


def run(
    commands: Commands,
    argv: Sequence[str] | None = None,
    *,
    prog: str,
    description: str,
    prepared: Callable[[list[str]], list[str]] = list,
) -> int:
    """Parse the command line, call the command, and return the exit status.

    Args:
        commands: a function, or subcommands by name. Options are generated from signatures, help from docstrings.
        argv: arguments; None: ``sys.argv[1:]``.
        prog: name of the program in help texts.
        description: description in the help.
        prepared: arguments from those that were given.

    Returns: 0; 1 after a :class:`ShuttleError` (with its message on standard error), if a required extra is not installed, or
        if a file or the output cannot be used; 130 after an interrupt; 141 if the output pipe is closed.
    """
    args = list(sys.argv[1:] if argv is None else argv)
    try:
        _check_encoding(args)
        args = prepared(args)
        with warnings.catch_warnings():
            warnings.showwarning = _warn
            if callable(commands):
                tyro.cli(_apart(commands), prog=prog, description=description, args=args, registry=_NUMBERS)
            elif args and args[0] in commands:  # alone, so that its errors point to its own help
                tyro.cli(_apart(commands[args[0]]), prog=f"{prog} {args[0]}", args=args[1:], registry=_NUMBERS)
            else:  # prints help
                every = dict(commands)
                tyro.extras.subcommand_cli_from_dict(every, prog=prog, description=description, args=args, registry=_NUMBERS)
        sys.stdout.flush()
    except ShuttleError as error:
        return _fail(prog, str(error))
    except ModuleNotFoundError as error:
        if (hint := lacking(error)) is None:
            raise
        return _fail(prog, hint)
    except OSError as error:
        if isinstance(error, BrokenPipeError) and _reader_is_gone():
            _drop_output()
            return 141
        if error.errno in NO_ROOM:
            _drop_output()
            return _fail(prog, f"{_file(error, 'the output')} cannot be written ({error.strerror}); free disk space")
        if error.errno not in _FIXABLE or error.filename is None:
            raise
        return _fail(prog, f"{_file(error, '')} cannot be used ({error.strerror}); name another file or folder")
    except MemoryError as error:
        return _fail(prog, f"not enough memory{f' ({error})' if str(error) else ''}; use fewer matches, or a machine with more")
    except KeyboardInterrupt as error:
        console(stderr=True).print(printable(str(error)) or "interrupted; no file is left half-written", soft_wrap=True)
        return 130
    return 0


def watching(log: Path, game: str, profile: str | None) -> str:
    """The line that tells how to watch a rally log."""
    flags = {"--game": None if game == "default" else game, "--profile": profile}
    words = (word for flag, value in flags.items() if value is not None for word in (flag, value))
    return f"watch it: {command('watch', '--replay', str(log), *words)}"


def by_name(*commands: Command) -> dict[str, Command]:
    """Subcommands by the names of their functions, such as ``new-submission`` of ``new_submission``."""
    return {command.__name__.rstrip("_").replace("_", "-"): command for command in commands}


def entry_point(
    commands: Commands, prog: str, description: str, prepared: Callable[[list[str]], list[str]] = list
) -> Callable[..., int]:
    """The function ``main(argv=None)`` of a command, see :func:`run`."""
    return functools.partial(run, commands, prog=prog, description=description, prepared=prepared)


def whole_number(text: str) -> int:
    """A whole number from text such as ``2000``, ``60_000``, ``1e6``, ``60k`` or ``2m`` (millions).

    Raises:
        ValueError: it is not one.
    """
    digits = text.lower()
    scale = _SCALES.get(digits[-1:], 1)
    try:
        number = decimal.Decimal(digits[:-1] if scale > 1 else digits) * scale
        if number.is_finite() and number.adjusted() <= _MOST_DIGITS and number == number.to_integral_value():
            return int(number)
    except decimal.DecimalException:
        pass
    raise ValueError(f"{text!r}: expected a whole number, such as 2000, 1e6, 60k or 2m")


@_NUMBERS.primitive_rule
def _whole_number_rule(type_info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[int] | None:
    if type_info.type is not int:
        return None
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar="INT",
        instance_from_str=lambda words: whole_number(words[0]),
        is_instance=lambda value: isinstance(value, int),
        str_from_instance=lambda value: [str(value)],
    )


def print_json(value: Any) -> None:
    """Print a value as one line of JSON, in ASCII: what a terminal cannot show would be replaced by what is no JSON."""
    sys.stdout.write(json.dumps(value) + "\n")


def check_free(path: Path, *, overwrite: bool = False) -> None:
    """Refuse to overwrite a file or a folder that is not empty, unless ``overwrite``; and what is neither, in any case.

    Raises:
        ShuttleError: the path exists.
    """
    if not path.is_dir():
        check_replaceable(path)
    taken = path.is_file() or (path.is_dir() and any(path.iterdir()))
    if taken and not overwrite:
        raise ShuttleError(f"{path}: already exists; --overwrite replaces it, --out names another")


def check_suffix(path: Path | None, suffix: str) -> None:
    """Refuse a file whose name promises another format than ``suffix``, before work begins."""
    if path is not None and path.suffix.lower() != suffix:
        raise ShuttleError(f"--out {path}: expected a name that ends in {suffix}")


def check_apart(written: Iterable[Path], read: Iterable[Path]) -> None:
    """Refuse to write over what is read.

    Args:
        written: files or folders.
        read: files, or folders in which every file but a page is an input.

    Raises:
        ShuttleError: a path is in both.
    """
    inputs = [path for path in read if _identity(path) is not None]
    for out in written:
        known, whole = _identity(out), Path(os.path.realpath(out))
        for other in inputs:
            around = (
                other.is_dir() and out.is_file() and out.suffix not in _PAGES and Path(os.path.realpath(other)) in whole.parents
            )
            if around or Path(os.path.realpath(other)) == whole or (known is not None and known == _identity(other)):
                raise ShuttleError(f"{out}: is not written, because it is read too ({other}); name another file or folder")


def _identity(path: Path) -> tuple[int, int] | None:
    with contextlib.suppress(OSError, ValueError):
        about = path.stat()
        return about.st_dev, about.st_ino
    return None


def _apart(command: Command) -> Command:

    @functools.wraps(command)
    def checked(*args: Any, **options: Any) -> object:
        given = list(_texts(inspect.signature(command).bind(*args, **options).arguments))
        read = [text for name, text in given if name != "out" and not text.startswith("default")]  # shipped models
        check_apart(
            (Path(text) for name, text in given if name == "out"),
            (Path(part) for text in read for part in (text, text.partition(":")[2]) if part),
        )
        return command(*args, **options)

    return checked


def _texts(value: Any, name: str = "") -> Iterator[tuple[str, str]]:
    """Texts and paths in the arguments of a command, with the names of their options."""
    if dataclasses.is_dataclass(value):
        value = vars(value)
    if isinstance(value, dict):
        for key, part in value.items():
            yield from _texts(part, str(key))
    elif isinstance(value, list | tuple):
        for part in value:
            yield from _texts(part, name)
    elif isinstance(value, str | Path):
        yield name, str(value)


def show(figures: "Mapping[str, Figure] | Sequence[Figure]", as_json: bool, *parts: "Table | str") -> None:
    """Print the result of a command: as JSON, or its figures line by line, and then tables and notes.

    Args:
        figures: by name; what has parts of its own (mappings of mappings, lists of these) only JSON has.
        as_json: print JSON.
        parts: tables and notes.
    """
    if as_json:
        print_json(figures)
        return
    grid = Table.grid(padding=(0, 3))
    for name, value in figures.items() if isinstance(figures, Mapping) else ():
        line = None if name == "home" or value is None else written(name, value)
        if line is not None:
            grid.add_row(Text(printable(words(name)), "dim"), Text(isolated(printable(line))))
    tell(grid, *parts)


def tell(*parts: "Table | str") -> None:
    """Print tables and lines of text, in which nothing is markup; nothing for an empty text or table."""
    for part in parts:
        if isinstance(part, str) and part:
            console().print(printable(part, keep="\n"))
        elif isinstance(part, Table) and part.row_count:
            console().print(part)


def say(*lines: str) -> None:
    """Print lines that may hold paths, which are not wrapped."""
    for line in lines:
        console().print(printable(line, keep="\n"), soft_wrap=True)


def words(name: str) -> str:
    """The name of a figure in words."""
    return name.replace("_", " ")


def written(name: str, value: Figure) -> str | None:
    """A figure as text; None for what has parts of its own."""
    match value:
        case None:
            return "-"
        case bool() | str() | Path():
            return printable(str(value), keep="\n")
        case int():
            return f"{value:,}"
        case float():
            if any(word in name for word in _BOUNDS):
                return f"{value:.1e}"
            # Adding 0 turns a rounded -0.0 into 0.0.
            return percent(value) if any(word in name for word in _SHARES) else f"{round(value, 4) + 0:.4f}"
        case (float(), float(), float()):
            return "{} ({} to {})".format(*(written(name, part) for part in value))
        case {"value": value, "low": low, "high": high}:
            return written(name, (value, low, high))
        case Mapping() if value and all(isinstance(part, float) for part in value.values()):
            return shares(value)
        case Mapping() if value and all(isinstance(part, int) for part in value.values()):
            return ", ".join(f"{words(key)} {part:,}" for key, part in value.items())
        case list() | tuple() if all(isinstance(part, str | int) for part in value):
            return ", ".join(printable(str(part)) for part in value) or "none"
    return None


def table(title: str, headings: Sequence[str], rows: Iterable[Sequence[Figure]]) -> Table:
    """Table of rows of figures; numbers are aligned right."""
    lines = [[written(heading, value) or "" for heading, value in zip(headings, row, strict=True)] for row in rows]
    found = Table(title=Text(printable(title)), title_justify="left", header_style="bold")
    for number, heading in enumerate(headings):
        figures = all(line[number][:1] in "+-0123456789" for line in lines)
        found.add_column(heading, justify="right" if figures else "left", no_wrap=number == 0, overflow="fold")
    for line in lines:
        found.add_row(*map(Text, map(isolated, line)))
    return found


def named(title: str, rows: Mapping[str, Mapping[str, Figure]]) -> Table:
    """Table of the figures of several by name."""
    keys = list(next(iter(rows.values()), {}))
    lines = ([name, *(row.get(key) for key in keys)] for name, row in rows.items())
    largest = ([shares(part, _SHOWN) if isinstance(part, Mapping) else part for part in line] for line in lines)
    return table(title, ("", *map(words, keys)), largest)


def shares(named: Mapping[str, float], count: int | None = None) -> str:
    """The largest fractions of a mapping, in percent."""
    order = sorted(named, key=lambda name: -named[name])[:count]
    return ", ".join(f"{words(name)} {percent(named[name])}" for name in order)


def home_and_away_json(home: Mapping[str, float | None], away: "Mapping[str, Estimate] | None") -> dict[str, Any]:
    """Results in the game and in its refits as JSON; ``away`` is null without refits."""
    return {"home": home, "away": None if away is None else {name: figure._asdict() for name, figure in away.items()}}


def home_and_away(rows: Sequence[Headlines], refits: "Sequence[Game]", *, asked: bool) -> list[Table | str]:
    """Results in the game and in its refits if requested, or why there are none."""
    if not asked or not rows:
        return []
    if not refits:
        return ["The model has no refits on resampled matches, so there are no results in refits."]
    lines = []
    for name, home, away in rows:
        for figure, there in (away or {}).items():
            mean, low, high = (min(1.0, max(0.0, part)) for part in there)
            lines.append((name, words(figure), written(figure, home[figure]), written(figure, (mean, low, high))))
    return [
        table("In the game and in its refits", ("policy", "result", "game", "refits"), lines),
        f"refits: the same policies, played in {len(refits)} refits of the game on resampled matches: mean, and 95 % interval "
        "for one more refit. Exploitability uses the best response in the refit.",
    ]


def matrix(title: str, names: Sequence[str], probabilities: Sequence[Sequence[float]]) -> Table:
    """Table of ``[N, N]`` probabilities of the row player against the column player."""
    rows = ([name, *map(percent, row)] for name, row in zip(names, probabilities, strict=True))
    return table(title, ("", *names), ([*row[: i + 1], "", *row[i + 2 :]] for i, row in enumerate(rows)))


def percent(share: float) -> str:
    """A fraction in percent."""
    return f"{100 * share:.1f} %"


def _check_encoding(args: Sequence[str]) -> None:
    for arg in args:
        try:
            arg.encode()
        except UnicodeEncodeError as error:
            raise ShuttleError(f"argument {arg!a}: expected text in UTF-8") from error


def _warn(message: Warning | str, *_: Any, **__: Any) -> None:
    console(stderr=True).print(f"warning: {printable(str(message))}", soft_wrap=True)


def _fail(prog: str, message: str) -> int:
    text = Text.assemble(("error:", "bold red"), f" {prog}: {printable(message, keep=chr(10))}")
    console(stderr=True).print(text, soft_wrap=True)
    return 1


def _file(error: OSError, default: str) -> str:
    return os.fsdecode(error.filename) if isinstance(error.filename, str | bytes) else default


def _reader_is_gone() -> bool:
    pipe = select.poll()
    pipe.register(sys.stdout.fileno(), select.POLLOUT)
    return any(state & select.POLLERR for _, state in pipe.poll(0))


def _drop_output() -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
