"""Shared parts of the command lines: commands from typed functions, consoles, error messages, tables, and shell completion.

Table cells are plain text, not markup.
"""

import contextlib
import dataclasses
import decimal
import errno
import functools
import importlib
import inspect
import json
import os
import select
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import tyro
from rich.console import Console
from rich.status import Status
from rich.table import Table
from rich.text import Text
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo
from tyro.extras import SubcommandApp

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.errors import ShuttleError, command, printable
from shuttle_marl.base.extras import lacking
from shuttle_marl.base.files import NO_ROOM, check_replaceable

if TYPE_CHECKING:
    from shuttle_marl.exact.away import Spread
    from shuttle_marl.exact.regret import Holes
    from shuttle_marl.game.tables import Game
    from shuttle_marl.league.pairs import PlayerRow, Prediction
    from shuttle_marl.policy.scorecard import Scorecard
    from shuttle_marl.reports.scouting import ListedPlayer

Command = Callable[..., object]
Headlines = tuple[str, Mapping[str, float | None], "Mapping[str, Spread] | None"]
"""Policy, its results in the game by name, and their spreads in the refits; None without refits."""

_NUMBERS: Final = ConstructorRegistry()
_SCALES: Final = {"k": 10**3, "m": 10**6, "g": 10**9}
_MOST_DIGITS: Final = 30
_WIDTH: Final = 160
"""Width of output that is not to a terminal."""
_SHOWN_SHOTS: Final = 5
_WRITTEN: Final = ("out", "pdf")
"""Options that name what a command writes."""
_PAGES: Final = (".html", ".md", ".pdf")
_FIGURES: Final = {
    "rally_win_vs_bc": "rallies won against bc",
    "match_win_vs_bc": "matches won against bc",
    "rally_win": "rallies won",
    "match_win": "matches won",
    "match_share": "matches won against all others",
    "server_win": "rallies won by the server",
    "exploitability": "exploitability",
}
"""Descriptions of results."""
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


def run(
    commands: Command | dict[str, Command],
    *,
    prog: str,
    description: str,
    argv: Sequence[str] | None = None,
    prepared: Callable[[list[str]], list[str]] = list,
) -> int:
    """Parse the command line, call the command, and return the exit status.

    Args:
        commands: a function, or subcommands by name. Options are generated from signatures, help from docstrings.
        prog: name of the program in help texts.
        description: description in the help.
        argv: arguments; None: ``sys.argv[1:]``.
        prepared: arguments from those that were given.

    Returns: 0; 1 after a :class:`ShuttleError` (with its message on standard error), if a required extra is not installed, or
        if a file or the output cannot be used; 130 after an interrupt; 141 if the output pipe is closed.
    """
    args = list(sys.argv[1:] if argv is None else argv)
    commands = {name: _apart(each) for name, each in commands.items()} if isinstance(commands, dict) else _apart(commands)
    try:
        _check_encoding(args)
        args = prepared(args)
        if isinstance(commands, dict) and args and args[0] in commands:  # alone, so that its errors point to its own help
            tyro.cli(commands[args[0]], prog=f"{prog} {args[0]}", args=args[1:], registry=_NUMBERS)
        elif isinstance(commands, dict):
            tyro.extras.subcommand_cli_from_dict(commands, prog=prog, description=description, args=args, registry=_NUMBERS)
        else:
            tyro.cli(commands, prog=prog, description=description, args=args, registry=_NUMBERS)
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


def entry_point(
    commands: Command | dict[str, Command], prog: str, description: str, prepared: Callable[[list[str]], list[str]] = list
) -> Callable[..., int]:
    """The function ``main(argv=None)`` of a command, which runs its command line and returns the exit status."""

    def main(argv: Sequence[str] | None = None) -> int:
        return run(commands, prog=prog, description=description, argv=argv, prepared=prepared)

    return main


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


def write_completion(shell: str, commands: Mapping[str, str]) -> None:
    """Print the completion script of all commands and their options.

    Args:
        shell: bash, zsh or fish.
        commands: description by name of the command.
    """
    app = SubcommandApp()
    for name, description in commands.items():
        module = importlib.import_module(f"shuttle_marl.commands.{name}")
        command = getattr(module, "completed", module.COMMANDS)
        if not isinstance(command, dict):
            app.command(command, name=name, help=description)
            continue
        subcommands = SubcommandApp()
        for part, function in command.items():
            subcommands.command(function, name=part)
        app.command(subcommands, name=name, help=description)
    # Tyro exits after printing the script.
    with contextlib.suppress(SystemExit):
        app.cli(prog="shuttle-marl", args=["--tyro-write-completion", shell, "-"])


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


def check_apart(written: Iterable[Path], read: Iterable[Path]) -> None:
    """Refuse to write over what is read.

    Args:
        written: files or folders.
        read: files, or folders in which every file but a page is an input.

    Raises:
        ShuttleError: a path is in both, or written twice.
    """
    outputs, inputs = list(written), [path for path in read if _identity(path) is not None]
    for number, out in enumerate(outputs):
        known, whole = _identity(out), Path(os.path.realpath(out))
        for other in (*inputs, *outputs[:number]):
            around = (
                other.is_dir() and out.is_file() and out.suffix not in _PAGES and Path(os.path.realpath(other)) in whole.parents
            )
            if around or Path(os.path.realpath(other)) == whole or (known is not None and known == _identity(other)):
                role = "read" if other in inputs else "written"
                raise ShuttleError(f"{out}: is not written, because it is {role} too ({other}); name another file or folder")


def _identity(path: Path) -> tuple[int, int] | None:
    """Numbers that two names of a file share; None for what does not exist."""
    with contextlib.suppress(OSError, ValueError):
        about = path.stat()
        return about.st_dev, about.st_ino
    return None


def _apart(command: Command) -> Command:
    """The command, which refuses to write over its inputs."""

    @functools.wraps(command)
    def checked(*args: Any, **options: Any) -> object:
        given = list(_texts(inspect.signature(command).bind(*args, **options).arguments))
        read = [text for name, text in given if name not in _WRITTEN and not text.startswith("default")]  # shipped models
        check_apart(
            (Path(text) for name, text in given if name in _WRITTEN),
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


def _table(title: str | Text, *left: str, right: Sequence[str] = ()) -> Table:
    """Empty table with columns aligned left, then columns aligned right."""
    table = Table(title=title, title_justify="left", header_style="bold")
    for heading in left:
        table.add_column(heading)
    for heading in right:
        table.add_column(heading, justify="right")
    return table


def facts(rows: Mapping[str, str]) -> Table:
    """Table of names and values, one per line."""
    table = Table.grid(padding=(0, 3))
    for name, value in rows.items():
        table.add_row(Text(printable(name), "dim"), Text(printable(value)))
    return table


def shares(named: Mapping[str, float], count: int | None = None) -> str:
    """The largest fractions of a mapping, in percent."""
    order = sorted(named, key=lambda name: -named[name])[:count]
    return ", ".join(f"{name} {percent(named[name])}" for name in order)


def scorecards(cards: Sequence["Scorecard"]) -> Table:
    """Table of scorecards, one policy per row."""
    right = ("rallies won", "matches won", "normalised", "exploitability", "regret a rally", "strokes a rally", "thin")
    table = _table("Against bc, its best response, and perfect play", "policy", right=right)
    table.columns[0].no_wrap = True
    for card in cards:
        rally = _with_interval(card.rally_win_vs_bc, card.rally_interval)
        match = _with_interval(card.match_win_vs_bc, card.match_interval)
        figures = (card.normalised_score, card.exploitability, card.regret_per_rally)
        thin = "-" if card.thin_vs_bc is None else percent(card.thin_vs_bc)
        table.add_row(_name(card.policy), rally, match, *map(_number, figures), f"{card.rally_length_vs_bc:.2f}", thin)
    return table


def play(cards: Sequence["Scorecard"]) -> Table:
    """Endings and shots of rallies against bc, one policy per row."""
    table = _table("Rallies against bc", "policy", "endings", f"its {_SHOWN_SHOTS} most frequent shots")
    for card in cards:
        if card.endings_vs_bc is not None and card.shot_mix_vs_bc is not None:
            table.add_row(_name(card.policy), shares(card.endings_vs_bc), shares(card.shot_mix_vs_bc, _SHOWN_SHOTS))
    return table


def depth(found: Mapping[str, Any]) -> tuple[Table, Table, Table]:
    """Tables of :func:`shuttle_marl.policy.scorecard.depth`: play, the same beside people's, and the best that read little."""
    right = ("shot types", "bits", "strokes a rally", "rare")
    play = _table("Play against itself and against bc", "policy", "opponent", "its most frequent shots", right=right)
    for name, against in found["policies"].items():
        for opponent, of in against.items():
            figures = (str(of["types"]), f"{of['bits']:.2f}", f"{of['length']:.2f}", percent(of["rare"]))
            play.add_row(_name(name), opponent, shares(of["shots"], _SHOWN_SHOTS), *figures)
    columns = ("clear", "drop", "smash after a lift", "net runs", "kinds")
    beside = _table("Play beside people", "policy", "opponent", "returns of a short serve", right=columns)
    everyone = {**found["policies"], **({"people": {"people": found["people"]}} if found["people"] else {})}
    for name, against in everyone.items():
        for opponent, of in against.items():
            parts = of["shots"]["clear"], of["shots"]["drop"], of["smash_after_lift"], of["net_runs"]
            beside.add_row(_name(name), opponent, shares(of["short_serve_replies"], 2), *map(percent, parts), str(of["kinds"]))
    best = _table("Best policies that read", "", right=("normalised", "exploitability", "against minimax"))
    for name, of in found["lists"].items():
        won = percent(of["against_minimax"])
        best.add_row(name.replace("_", " "), f"{of['score']:.3f}", f"{of['exploitability']:z.3f}", won)
    return play, beside, best


def holes(policy: str, found: "Holes") -> Table:
    """The states in which a policy loses most, one per row."""
    title = Text(f"Largest losses of {printable(policy)} to its best response")
    right = ("in self-play", "against its best response", "lost a stroke", "lost a rally")
    table = _table(title, "state", "plays, better", right=right)
    for column in table.columns[:2]:
        column.overflow = "fold"
    for hole in found.holes:
        played = f"{hole.played} {percent(hole.played_share)}{_real(hole.played_real)}"
        better = "" if hole.best == hole.played else f"\n{hole.best} {percent(hole.best_share)}{_real(hole.best_real)}"
        seen = (f"{share:.4f}" if share >= 1e-4 else f"{share:.0e}" for share in (hole.in_self_play, hole.against_best_response))
        state = hole.description.replace(", ", "\n", 2)
        table.add_row(Text(state), Text(played + better), *seen, f"{hole.regret:.4f}", f"{hole.loss:.5f}", end_section=True)
    return table


def _real(number: float | None) -> str:
    return "" if number is None else f"\n{number:,.0f} real strokes"


def home_and_away_json(home: Mapping[str, float | None], away: "Mapping[str, Spread] | None") -> dict[str, Any]:
    """Results in the game and in its refits as JSON; ``away`` is null without refits."""
    return {"home": home, "away": None if away is None else {name: figure.as_json() for name, figure in away.items()}}


def print_home_and_away(rows: Sequence[Headlines], refits: "Sequence[Game]", *, asked: bool) -> None:
    """Print results in the game and in its refits if requested, or why there are none."""
    if not asked or not rows:
        return
    out = console()
    if not refits:
        out.print("The model has no refits on resampled matches, so there are no results in refits.")
        return
    table = _table("In the game and in its refits", "", "result", right=("game", "refits", "95 %"))
    table.columns[0].no_wrap = True
    for name, home, away in rows:
        known = [(figure, value, away[figure]) for figure, value in home.items() if away is not None and value is not None]
        for i, (figure, value, there) in enumerate(known):
            # Exploitability is a value from 0 to 1, as everywhere; the others are probabilities.
            written = (lambda part: f"{part:z.3f}") if figure == "exploitability" else percent
            mean, low, high = (written(min(1.0, max(0.0, float(part)))) for part in (there.value, there.low, there.high))
            table.add_row(Text("") if i else _name(name), _FIGURES[figure], written(value), mean, f"{low} to {high}")
    out.print(table)
    out.print(
        f"refits: the same policies, played in {len(refits)} refits of the game on resampled matches: mean, and\n"
        "95 % interval for one more refit. Exploitability uses the best response in the refit."
    )


def matrix(title: str, names: Sequence[str], probabilities: F64) -> Table:
    """Table of ``[N, N]`` probabilities of the row player against the column player."""
    table = _table(title, "")
    table.columns[0].no_wrap = True
    for name in names:
        table.add_column(_name(name), justify="right", no_wrap=True)
    for i, name in enumerate(names):
        table.add_row(_name(name), *("" if i == j else percent(probabilities[i, j]) for j in range(len(names))))
    return table


def player_rows(rows: "Sequence[PlayerRow]") -> Table:
    """Table of players by their mean predicted results."""
    right = ("skill as of", "strokes in the data", "rallies won", "matches won")
    table = _table("Predicted against all others", "player", right=right)
    for row in rows:
        table.add_row(_name(row.name), row.since, f"{row.strokes:,}", percent(row.rally_win), percent(row.match_win))
    return table


def pair_rows(rows: "Sequence[Prediction]") -> Table:
    """Table of predictions of pairs, with real results where there are any."""
    met = any(row.matches for row in rows)
    right = ("rallies won", "95 % interval", "matches won", "95 % interval")
    table = _table(
        "Predicted, first player against second", "players", right=(*right, "real rallies", "real matches")[: 6 if met else 4]
    )
    for row in rows:
        real = (f"{row.rallies_won} of {row.rallies}", f"{row.matches_won} of {row.matches}") if met else ()
        table.add_row(
            Text(printable(" against ".join(row.players))),
            percent(row.rally_win),
            f"{100 * row.rally_low:.1f} to {100 * row.rally_high:.1f}",
            percent(row.match_win),
            f"{100 * row.match_low:.0f} to {100 * row.match_high:.0f}",
            *real,
        )
    return table


def scouted_rows(players: Sequence["ListedPlayer"]) -> Table:
    """Table of the players who can be scouted."""
    table = _table("Players", "player", "discipline", right=("strokes", "matches", "last match", "own choices"))
    for each in players:
        choices = "yes" if each.imitated else "no"
        counts = (f"{each.strokes:,}", f"{each.matches:,}", str(each.last), choices)
        table.add_row(Text(printable(each.name)), each.discipline, *counts)
    return table


def reason_rows(prediction: "Prediction") -> Table:
    """Table of the offsets with the largest effects."""
    table = _table(f"Points of 100 rallies for {printable(prediction.players[0])}", "offset", right=("points",))
    for reason, points in prediction.reasons.items():
        table.add_row(Text(printable(reason)), f"{points:+.2f}")
    return table


def percent(share: float) -> str:
    """A fraction in percent."""
    return f"{100 * share:.1f} %"


def _check_encoding(args: Sequence[str]) -> None:
    """Refuse arguments that are not valid UTF-8."""
    for arg in args:
        try:
            arg.encode()
        except UnicodeEncodeError as error:
            raise ShuttleError(f"argument {arg!a}: expected text in UTF-8") from error


def _fail(prog: str, message: str) -> int:
    text = Text.assemble(("error:", "bold red"), f" {prog}: {printable(message, keep=chr(10))}")
    console(stderr=True).print(text, soft_wrap=True)
    return 1


def _file(error: OSError, default: str) -> str:
    return os.fsdecode(error.filename) if isinstance(error.filename, str | bytes) else default


def _reader_is_gone() -> bool:
    if not hasattr(select, "poll"):
        return True
    pipe = select.poll()
    pipe.register(sys.stdout.fileno(), select.POLLOUT)
    return any(state & select.POLLERR for _, state in pipe.poll(0))


def _drop_output() -> None:
    """Discard buffered output, which the interpreter would otherwise write at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _name(name: str) -> Text:
    return Text(printable(name))


def _with_interval(share: float, interval: tuple[float, float] | None) -> str:
    return percent(share) if interval is None else f"{percent(share)} ({percent(interval[0])} to {percent(interval[1])})"


def _number(value: float | None) -> str:
    # Adding 0 turns a rounded -0.0 into 0.0.
    return "-" if value is None else f"{round(value, 4) + 0:.4f}"
