"""Lists how every table of the documentation is made, and makes one again: ``python -m docs.tools.reproduce [TABLE] [--save]``.

A table is made from a result file by :mod:`docs.tools.tables`; the result file is made by a command. The result of a second run
of that command is compared with the saved one, number by number, within a tolerance: 0 where a seed determines the result, a
relative difference where versions of PyTorch or the machine change it. Speeds are compared within a factor of two, and differ
by more between machines. Studies that are finished run at the commit that has their program. ``--save`` keeps the time and the
greatest difference in ``reproduced.json``, and a result that differs. A time in words is an estimate. Tables without a result
file are checked by ``docs.tools.tables --check``.

``--part K/N`` makes every N-th result again, for the jobs of a scheduled workflow, ``--part 1/1`` all of them. ``--seconds S``
makes results again that fit into so much time, other ones every day. Both leave out speeds.
"""

import datetime
import functools
import json
import math
import os
import re
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from docs.tools.markdown import ROOT, saved
from docs.tools.results import Result
from docs.tools.tables import RESULTS
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands import cli
from shuttle_marl.game import default_game, load_game
from shuttle_marl.game.shipped import model_folder

_PROVENANCE: Final = frozenset(
    {"command", "commit", "cpu", "cpu_seconds", "git", "machine", "packages", "platform", "python", "printed", "seconds"}
    | {"shuttle_marl"}
)
"""Keys of result files that differ between two runs."""
_DATA: Final = "{data}"
_OUT: Final = "{out}"
_SPEED: Final = Result.tolerance  # relative tolerance of measured speeds: a factor of two
_AGAIN: Final = Path(__file__).with_name("reproduced.json")
"""Seconds and greatest relative difference of reproduced tables, by name."""


class ReproduceError(ShuttleError):
    """An unknown table, a command that fails, or another result."""


def listed() -> Iterator[tuple[str, ...]]:
    """Every table: name, command, time (in seconds if it was measured), tolerance, greatest difference, game and commit.

    Results that are shown beside others stand under their own name.
    """
    known = measured()
    for name, result in RESULTS.items():
        again = known.get(name, {})
        duration = f"{again['seconds']} s" if again else result.estimate
        found = "" if again.get("difference") is None else f"{again['difference']:.2g}"
        tolerance = f"{result.tolerance:g}" if result.compared else "not compared"
        for table in result.tables or (name,):
            yield table, f"python -m {result.command}", duration, tolerance, found, *origin_of(file_of(name))


def file_of(name: str) -> Path:
    """File of a result."""
    return ROOT / RESULTS[name].folder / "results" / f"{name}.json"


def origin_of(path: Path) -> tuple[str, str]:
    """Game of a result, and the commit that wrote it, empty without git.

    The game is that which the result names, or the shipped one if that is not newer.
    """
    (time_written, commit), (time_shipped, _) = written(path), written(model_folder() / "game.safetensors")
    named = re.search(r'"game(?:_hash)?": "([0-9a-f]{12})', path.read_text("utf-8")) if path.is_file() else None
    return named[1] if named else default_game().hash[:12] if time_written >= time_shipped else "earlier", commit


@functools.cache
def written(path: Path) -> tuple[int, str]:
    """Time of the last commit of a path [s], and its short hash; 0 and empty without git."""
    asked = ["git", "log", "-1", "--format=%ct %h", "--", str(path)]
    found = subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, check=False).stdout.split()
    return (int(found[0]), found[1]) if found else (0, "")


def measured() -> dict[str, dict[str, Any]]:
    """Seconds and greatest relative difference of reproduced tables, by name."""
    return dict(json.loads(_AGAIN.read_text(encoding="utf-8")))


def differences(before: Any, after: Any, tolerance: float, speeds: Collection[str] = ()) -> tuple[list[str], float]:
    """Compare two results.

    Args:
        before: saved result.
        after: new result.
        tolerance: greatest relative difference of a number, a fraction of the greater one. Differences of keys, texts and lengths
            are infinite.
        speeds: names of numbers that may differ by a factor of two.

    Returns:
        The differences beyond the tolerance, and the greatest difference of a number that is no speed.
    """
    beyond, greatest = [], 0.0
    for size, path, what in _deviations(before, after, ""):
        speed = path.rpartition(".")[2] in speeds
        greatest = greatest if speed else max(greatest, size)
        if size > (_SPEED if speed else tolerance):
            beyond.append(f"{path}: {what}")
    return beyond, greatest


def _deviations(before: Any, after: Any, path: str) -> Iterator[tuple[float, str, str]]:
    """Size, place and description of each difference between two results."""
    match before, after:
        case dict(), dict():
            for key in sorted((before.keys() | after.keys()) - _PROVENANCE):
                if key not in before or key not in after:
                    yield math.inf, f"{path}.{key}", f"only in the {'new' if key in after else 'saved'} result"
                else:
                    yield from _deviations(before[key], after[key], f"{path}.{key}")
        case list(), list():
            if len(before) != len(after):
                yield math.inf, path, f"{len(before)} entries, now {len(after)}"
            for i, (first, second) in enumerate(zip(before, after, strict=False)):
                yield from _deviations(first, second, f"{path}[{i}]")
        case (float() | int(), float() | int()) if not isinstance(before, bool) and not isinstance(after, bool):
            if not math.isclose(before, after, rel_tol=1e-12, abs_tol=1e-12):
                finite = math.isfinite(before) and math.isfinite(after)
                yield (
                    abs(before - after) / max(abs(before), abs(after)) if finite else math.inf,
                    path,
                    f"{before:g}, now {after:g}",
                )
        case _ if before != after:
            yield math.inf, path, f"{before!r}, now {after!r}"


def remake(name: str, result: Result) -> str:
    """Run the command of a result.

    Returns:
        The new result as JSON. It names the folders as the list of tables does.

    Raises:
        ReproduceError: it needs the annotated matches, or failed.
    """
    data = os.environ.get("SHUTTLESET", "")
    if _DATA in result.command and not data:
        raise ReproduceError(f"{name} needs the annotated matches; set SHUTTLESET to their folder (shuttle-marl data download)")
    with tempfile.TemporaryDirectory() as folder:
        out, run = Path(folder) / "result.json", Path(folder) / "run"
        places = {_OUT: str(out), "runs/again": str(run), _DATA: data and str(Path(data).absolute())}
        command = result.command
        for place, path in places.items():
            command = command.replace(place, shlex.quote(path))
        words = [sys.executable, "-m", *shlex.split(command)]
        here = checkout(result.at, Path(folder) / "checkout") if result.at else ROOT
        done = subprocess.run(words, cwd=here, stdout=subprocess.PIPE, text=True, check=False)
        if done.returncode != 0:
            raise ReproduceError(f"python -m {command}: exit status {done.returncode}")
        text = out.read_text(encoding="utf-8") if _OUT in result.command else done.stdout
    names = {_OUT: f"{result.folder}/results/{name}.json", _DATA: "shuttleset"}
    for place, path in places.items():
        text = text.replace(path, names.get(place, place)) if path else text
    return text


def checkout(commit: str, folder: Path) -> Path:
    """Write the files of a commit to a new folder, and return it.

    Raises:
        ReproduceError: this clone does not have the commit.
    """
    folder.mkdir()
    try:
        files = subprocess.run(["git", "archive", commit], cwd=ROOT, stdout=subprocess.PIPE, check=True).stdout
    except (OSError, subprocess.CalledProcessError) as error:
        raise ReproduceError(f"no commit {commit} here, which has the program; git fetch --unshallow gets it") from error
    subprocess.run(["tar", "-x", "-C", str(folder)], input=files, check=True)
    return folder


def check(table: str, *, save: bool = False) -> list[str]:
    """Make a table again; returns the differences.

    Args:
        table: name of the table or of its result file.
        save: keep the time and the greatest difference, and a result that differs.

    Raises:
        ReproduceError: there is no such table, it is only replaced, or its command fails.
    """
    begun = time.perf_counter()
    name = next((name for name, result in RESULTS.items() if table in (name, *result.tables)), "")
    if not name:
        raise ReproduceError(f"no table {table!r}; python -m docs.tools.reproduce lists them")
    result = RESULTS[name]
    if not result.compared:
        raise ReproduceError(f"{name} is not compared; run python -m {result.command}")
    new = remake(name, result)
    found, greatest = differences(saved(result.folder, name), json.loads(new), result.tolerance, result.speeds)
    if save:
        if found or greatest:
            replace_file(file_of(name), f"{new.rstrip()}\n".encode())
        about = {"seconds": round(time.perf_counter() - begun), "difference": None if found else greatest}
        whole = json.dumps(dict(sorted({**measured(), name: about}.items())), indent=1)
        replace_file(_AGAIN, f"{whole}\n".encode())
    return found


def part_of(part: str) -> list[str]:
    """Names of the compared results of part K/N, speeds left out.

    Raises:
        ReproduceError: the part is not of this form.
    """
    found = re.fullmatch(r"(\d{1,3})/(\d{1,3})", part)
    if found is None or not 1 <= int(found[1]) <= int(found[2]):
        raise ReproduceError(f"--part {part}: expected K/N with K from 1 to N")
    names = [name for name, result in RESULTS.items() if result.compared and result.tolerance < 1]
    return names[int(found[1]) - 1 :: int(found[2])]


def within(seconds: float, day: int) -> list[str]:
    """Names of the results that take less than so many seconds together, without data; each day the list starts elsewhere.

    Results of earlier games are left out.
    """
    known, present = measured(), {load_game(name).hash[:12] for name in ("default", "default:recovery")}
    quick = [name for name in part_of("1/1") if name in known and _DATA not in RESULTS[name].command]
    quick = [name for name in quick if origin_of(file_of(name))[0] in present]
    first = day % max(1, len(quick))
    chosen = []
    for name in quick[first:] + quick[:first]:
        if known[name]["seconds"] <= seconds:
            seconds -= known[name]["seconds"]
            chosen.append(name)
    return chosen


def main(table: str = "", /, *, save: bool = False, part: str = "", seconds: float = 0.0) -> None:
    """List the tables, or make some again and compare them.

    Args:
        table: Name of the table or of its result file.
        save: Keep the time, the greatest difference, and the new result if it differs.
        part: K/N: make every N-th result again.
        seconds: Make results again that take so long together.
    """
    console = Console(soft_wrap=True, markup=False, highlight=False)
    if part or seconds:
        names = part_of(part) if part else within(seconds, datetime.datetime.now(datetime.UTC).toordinal())
        if failed := [name for name in names if not _made_again(name, console, save=save)]:
            raise ReproduceError(f"{len(failed)} of {len(names)} results differ or cannot be made: {', '.join(failed)}")
        return
    if not table:
        rows = [("table", "command", "time", "tolerance", "found", "game", "commit"), *listed()]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        for row in rows:
            console.print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
        return
    if not _made_again(table, console, save=save):
        raise ReproduceError(f"{table}: another result")


def _made_again(table: str, console: Console, *, save: bool) -> bool:
    """Make a table again, and print whether it is the same."""
    begun = time.perf_counter()
    try:
        found = check(table, save=save)
    except ReproduceError as error:
        if not os.environ.get("SHUTTLESET") and table in RESULTS and _DATA in RESULTS[table].command:
            console.print(f"{error}: skipped")
            return True
        found = [str(error)]
    duration = f"{time.perf_counter() - begun:.0f} s"
    first = f"{table}: {len(found)} differences in {duration}" if found else f"{table}: reproduced in {duration}"
    console.print("\n".join([first, *found[:20]]))
    return not found


if __name__ == "__main__":
    sys.exit(
        cli.run(
            main, prog="python -m docs.tools.reproduce", description="List the tables of the documentation, or make one again."
        )
    )
