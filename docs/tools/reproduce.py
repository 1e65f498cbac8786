"""Lists how every table of the documentation is made, and makes one again: ``python -m docs.tools.reproduce [TABLE]``.

A table is made from a result file by :mod:`docs.tools.tables`; the result file is made by a command. The result of a second run
of that command is compared with the saved one, number by number, within a tolerance: 0 where a seed determines the result, a
relative difference where versions of PyTorch or the machine change it. Speeds are compared within a factor of two, and differ by
more between machines.
"""

import dataclasses
import json
import math
import os
import re
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, Literal

from rich.console import Console

from docs.tools import league_tables, suite_tables, tables
from docs.tools.markdown import ROOT, saved
from shuttle_marl.commands import cli
from shuttle_marl.errors import ShuttleError

_PROVENANCE: Final = frozenset(
    {"command", "commit", "cpu", "cpu_s", "cpu_seconds", "git", "machine", "packages", "platform", "python", "printed", "seconds"}
)
"""Keys of result files that differ between two runs."""
_DATA: Final = "{data}"
_OUT: Final = "{out}"
_SPEED: Final = 1.0
"""Relative tolerance of measured speeds: a factor of two."""


class ReproduceError(ShuttleError):
    """An unknown table, a command that fails, or another result."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Result:
    """A result file and the tables that show it.

    Attributes:
        folder: the folder whose subfolder ``results`` holds it.
        tables: names of the tables in :data:`docs.tools.tables.BLOCKS`.
        command: arguments of ``python -m``. ``{out}`` is the file that it writes; without it, it prints JSON. ``{data}`` is
            the folder of the annotated matches, ``$SHUTTLESET``.
        time: how long it takes on two cores; in seconds if it was measured to be less than three minutes.
        tolerance: greatest relative difference of a number.
    """

    folder: Literal["benchmarks", "experiments"]
    tables: tuple[str, ...]
    command: str
    time: str
    tolerance: float


RESULTS: Final[dict[str, Result]] = {
    name: Result(folder="experiments", tables=shown, command=command, time=duration, tolerance=tolerance)
    for name, shown, command, duration, tolerance in (
        ("advice", ("advice_results",), "experiments.advice --data {data} --split validation --json", "minutes", 0.02),
        ("human", ("human", "human_players"), "experiments.human --data {data} --json", "163 s", 0.0),
        ("league_training", ("league_training",), "experiments.league_training --out runs/again --json {out}", "hours", 0.5),
        ("next_stroke", ("next_stroke",), "experiments.next_stroke --data {data} --out {out}", "minutes", 0.02),
        (
            "pairs_cross",
            ("pair_results", "pair_strokes"),
            "experiments.pairs --data {data} --cross 4 --out {out}",
            "an hour",
            0.02,
        ),
        ("self_play", ("self_play",), "experiments.self_play --out runs/again --json", "hours", 0.5),
        ("stroke_value", ("stroke_value",), "experiments.stroke_value --data {data} --json", "14 s", 0.0),
        ("styles", ("styles",), "experiments.styles --seeds 10 --out runs/again --json {out}", "an hour", 0.2),
        (
            "truth_cross",
            ("truth_calibration", "truth_figures", "truth_memory", "truth_shots", "truth_slopes", "truth_told_apart"),
            "experiments.truth --data {data} --cross 4 --out {out}",
            "half an hour",
            0.02,
        ),
        (
            "truth_limits",
            ("truth_limits", "truth_legality"),
            "experiments.truth.limits --data {data} --out {out}",
            "half an hour",
            0.02,
        ),
        ("suite", tuple(suite_tables.BLOCKS), "experiments.suite --data {data} --out runs/again --json {out}", "hours", 0.2),
        (
            "truth_profiles",
            (),
            "experiments.truth --data {data} --cross 4 --profiles --halvings 0 --out {out}",
            "half an hour",
            0.02,
        ),
        (
            "truth_validation",
            (),
            "experiments.truth --data {data} --split validation --profiles --halvings 0 --out {out}",
            "half an hour",
            0.02,
        ),
        (
            "win_rates",
            ("win_rates", "win_rates_matrix"),
            "experiments.win_rates --out runs/again --json {out}",
            "15 minutes",
            0.1,
        ),
    )
} | {
    name: Result(folder="benchmarks", tables=shown, command=f"benchmarks.{name} --json", time=duration, tolerance=_SPEED)
    for name, shown, duration in (
        ("aec", ("aec",), "27 s"),
        ("exact_values", ("exact_values",), "115 s"),
        ("league", ("league",), "4 minutes"),
        ("recording", ("recording",), "63 s"),
        ("staging", ("staging",), "3 minutes"),
        ("startup", ("startup",), "52 s"),
        ("throughput", ("speed", "throughput", "throughput_bound", "throughput_sizes"), "4 minutes"),
        ("time_to_win", ("time_to_win",), "minutes"),
        ("training", ("training_speed",), "113 s"),
        ("viewer", ("viewer",), "81 s"),
    )
}
"""Result files by name."""
COMPUTED: Final = {
    "layer_diagram": "seconds",
    "layers": "seconds",
    "paths": "32 s",
    "ranking": "a minute",
    "ranking_short": "a minute",
}
"""Tables without a result file, and their time: of the code and of the default tournament, the same on every machine."""
PROGRAMS: Final = {"recipes": ("docs.tools.recipes --save", "10 minutes")}
"""Tables of programs that need other libraries, whose results are only replaced, not compared."""


def listed() -> Iterator[tuple[str, str, str, str]]:
    """Every table: name, command, time, and tolerance; results that are shown beside others by their own name."""
    for name, result in RESULTS.items():
        for table in result.tables or (name,):
            yield table, f"python -m {result.command}", result.time, f"{result.tolerance:.0%}"
    for table, duration in COMPUTED.items():
        yield table, f"python -m docs.tools.reproduce {table}", duration, "0%"
    for table, (command, duration) in PROGRAMS.items():
        yield table, f"python -m {command}", duration, "not compared"


def differences(before: Any, after: Any, tolerance: float, path: str = "") -> Iterator[str]:
    """Differences between two results: keys, texts, and numbers beyond a relative tolerance."""
    if isinstance(before, dict) and isinstance(after, dict):
        for key in sorted((before.keys() | after.keys()) - _PROVENANCE):
            if key not in before or key not in after:
                yield f"{path}.{key}: only in the {'new' if key in after else 'saved'} result"
            else:
                yield from differences(before[key], after[key], tolerance, f"{path}.{key}")
    elif isinstance(before, list) and isinstance(after, list):
        if len(before) != len(after):
            yield f"{path}: {len(before)} entries, now {len(after)}"
        for i, (first, second) in enumerate(zip(before, after, strict=False)):
            yield from differences(first, second, tolerance, f"{path}[{i}]")
    elif _is_number(before) and _is_number(after):
        if not math.isclose(before, after, rel_tol=tolerance or 1e-12, abs_tol=1e-12):
            yield f"{path}: {before:g}, now {after:g}"
    elif before != after:
        yield f"{path}: {before!r}, now {after!r}"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def remake(name: str, result: Result) -> Any:
    """Run the command of a result.

    Raises:
        ReproduceError: it needs the annotated matches, or failed.
    """
    data = os.environ.get("SHUTTLESET")
    if _DATA in result.command and not data:
        raise ReproduceError(f"{name} needs the annotated matches; set SHUTTLESET to their folder (shuttle-marl data download)")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "result.json"
        words = [word.replace(_DATA, data or "").replace(_OUT, str(out)) for word in shlex.split(result.command)]
        words = [str(Path(folder) / "run") if word == "runs/again" else word for word in words]
        done = subprocess.run([sys.executable, "-m", *words], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
        if done.returncode != 0:
            raise ReproduceError(f"python -m {shlex.join(words)}: exit status {done.returncode}")
        return json.loads(out.read_text(encoding="utf-8") if _OUT in result.command else done.stdout)


def _shown(table: str) -> str:
    """A table as a page shows it."""
    for path in (ROOT / "README.md", *sorted(ROOT.glob("docs/*.md"))):
        found = re.search(rf"<!-- begin: {table} -->\n(.*?)\n<!-- end: {table} -->", path.read_text(encoding="utf-8"), re.DOTALL)
        if found:
            return found[1]
    raise ReproduceError(f"no page shows {table}")


def _computed(table: str) -> str:
    if table not in tables.LEAGUE_BLOCKS:
        return tables.BLOCKS[table]()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        league = [sys.executable, "-m", "shuttle_marl.league", "--record", "none", "--out", str(out)]
        subprocess.run(league, cwd=ROOT, stdout=subprocess.DEVNULL, check=True)
        return getattr(league_tables, table)(out)


def check(table: str) -> list[str]:
    """Make a table again; returns the differences.

    Raises:
        ReproduceError: there is no such table, it is only replaced, or its command fails.
    """
    if table in COMPUTED:
        return [] if _computed(table) == _shown(table) else [f"{table}: another table than the page shows"]
    for name, result in RESULTS.items():
        if table in (name, *result.tables):
            return list(differences(saved(result.folder, name), remake(name, result), result.tolerance))
    if table in PROGRAMS:
        raise ReproduceError(f"{table} is not compared; run python -m {PROGRAMS[table][0]}")
    raise ReproduceError(f"no table {table!r}; python -m docs.tools.reproduce lists them")


def main(table: str = "", /) -> None:
    """List the tables, or make one again and compare it.

    Args:
        table: Name of the table or of its result file.
    """
    console = Console(soft_wrap=True, markup=False, highlight=False)
    if not table:
        widths = [max(map(len, column)) for column in zip(*listed(), strict=True)]
        for row in listed():
            console.print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
        return
    begun = time.perf_counter()
    found = check(table)
    if found:
        shown = "\n".join(found[:20])
        raise ReproduceError(f"{table}: {len(found)} differences\n{shown}")
    console.print(f"{table}: reproduced in {time.perf_counter() - begun:.0f} s")


if __name__ == "__main__":
    sys.exit(
        cli.run(
            main, prog="python -m docs.tools.reproduce", description="List the tables of the documentation, or make one again."
        )
    )
