"""Lists how every table of the documentation is made, and makes one again: ``python -m docs.tools.reproduce [TABLE] [--save]``.

A table is made from a result file by :mod:`docs.tools.tables`; the result file is made by a command. The result of a second run
of that command is compared with the saved one, number by number, within a tolerance: 0 where a seed determines the result, a
relative difference where versions of PyTorch or the machine change it. Speeds are compared within a factor of two, and differ by
more between machines. ``--save`` keeps the time, the greatest difference and the game in ``reproduced.json``, and a result that
differs. A time in words is an estimate.
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
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, Final, Literal

from rich.console import Console

from docs.tools import league_tables, suite_tables, tables
from docs.tools.markdown import ROOT, saved
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands import cli
from shuttle_marl.game import default_game

_PROVENANCE: Final = frozenset(
    {"command", "commit", "cpu", "cpu_seconds", "git", "machine", "packages", "platform", "python", "printed", "seconds"}
    | {"shuttle_marl"}
)
"""Keys of result files that differ between two runs."""
_DATA: Final = "{data}"
_OUT: Final = "{out}"
_SPEED: Final = 1.0
"""Relative tolerance of measured speeds: a factor of two."""
_AGAIN: Final = Path(__file__).with_name("reproduced.json")
"""Seconds, greatest relative difference and game of reproduced tables, by name."""


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
        tolerance: greatest relative difference of a number.
        estimate: how long it takes on two cores, where no second run was measured.
        speeds: names of numbers that are speeds, if others are not.
    """

    folder: Literal["benchmarks", "experiments"]
    tables: tuple[str, ...]
    command: str
    tolerance: float
    estimate: str = ""
    speeds: tuple[str, ...] = ()


RESULTS: Final[dict[str, Result]] = (
    {
        name: Result(folder="experiments", tables=shown, command=f"experiments.{command}", tolerance=tolerance, estimate=estimate)
        for name, shown, command, tolerance, estimate in (
            ("advice", ("advice_results",), "advice --data {data} --split validation --out {out}", 0.02, ""),
            ("human", ("human", "human_players"), "human --data {data} --json", 0.0, ""),
            ("league_training", ("league_training",), "league_training --out runs/again --json {out}", 0.5, "hours"),
            ("next_stroke", ("next_stroke",), "next_stroke --data {data} --out {out}", 0.02, ""),
            ("pairs_cross", ("pair_results", "pair_strokes"), "pairs --data {data} --cross 4 --out {out}", 0.02, "half an hour"),
            (
                "self_play",
                ("self_play",),
                "self_play --seeds 3 --strokes 40000000 200000000 --jobs 2 --out runs/again --json",
                0.5,
                "8 minutes",
            ),
            (
                "self_play_recovery",
                ("self_play_recovery",),
                "self_play --game default:recovery --variants magnet plain pool nash --seeds 2 --strokes 40000000 "
                "--out runs/again --json",
                0.5,
                "5 minutes",
            ),
            ("stroke_value", ("stroke_value",), "stroke_value --data {data} --json", 0.0, ""),
            ("styles", ("styles",), "styles --seeds 10 --out runs/again --json {out}", 0.2, "an hour"),
            (
                "truth_cross",
                (
                    "recovery_truth",
                    *(
                        f"truth_{name}"
                        for name in ("calibration", "figures", "forecasts", "memory", "shots", "slopes", "told_apart")
                    ),
                ),
                "truth --data {data} --cross 4 --out {out}",
                0.02,
                "half an hour",
            ),
            ("truth_shares", ("truth_shares",), "truth.shares --data {data} --out {out}", 0.02, "half an hour"),
            ("truth_limits", ("truth_limits", "truth_legality"), "truth.limits --data {data} --out {out}", 0.02, "half an hour"),
            ("suite", tuple(suite_tables.BLOCKS), "suite --data {data} --out runs/again --json {out}", 0.2, "hours"),
            ("truth_profiles", (), "truth --data {data} --cross 4 --profiles --halvings 0 --out {out}", 0.02, "half an hour"),
            (
                "truth_validation",
                (),
                "truth --data {data} --split validation --profiles --halvings 0 --out {out}",
                0.02,
                "half an hour",
            ),
            ("win_rates", ("win_rates", "win_rates_matrix"), "win_rates --out runs/again --json {out}", 0.1, "15 minutes"),
        )
    }
    | {
        name: Result(folder="benchmarks", tables=shown, command=f"benchmarks.{name} --json", tolerance=_SPEED, estimate=estimate)
        for name, shown, estimate in (
            ("aec", ("aec",), ""),
            ("exact_values", ("exact_values",), ""),
            ("league", ("league",), "4 minutes"),
            ("recording", ("recording",), ""),
            ("startup", ("startup",), ""),
            ("throughput", ("speed", "throughput", "throughput_bound", "throughput_sizes", "cluster"), "4 minutes"),
            ("time_to_win", ("time_to_win",), "minutes"),
            ("training", ("training_speed",), ""),
            ("viewer", ("viewer",), ""),
        )
    }
    | {
        "depth": Result(
            folder="experiments",
            tables=("depth_play", "depth_lists"),
            command="shuttle_marl.exact depth --json",
            tolerance=0.02,
            estimate="2 minutes",
        ),
        "depth_recovery": Result(
            folder="experiments",
            tables=("recovery_depth",),
            command="shuttle_marl.exact depth --game default:recovery --json",
            tolerance=0.02,
            estimate="2 minutes",
        ),
        "staging": Result(
            folder="benchmarks",
            tables=("staging",),
            command="benchmarks.staging --json",
            tolerance=0.02,
            speeds=("continue_ms", "realtime"),
        ),
        "tagging": Result(
            folder="benchmarks",
            tables=("tagging",),
            command="benchmarks.tagging --json",
            tolerance=0.0,
            speeds=("autosave_ms", "autosave_ms_95", "film_s", "tag_s"),
            estimate="20 minutes",
        ),
    }
)
"""Result files by name."""
COMPUTED: Final = ("layer_diagram", "layers", "paths", "ranking", "ranking_short")
"""Tables without a result file: of the code and of the default tournament, the same on every machine."""
PROGRAMS: Final = {"recipes": "docs.tools.recipes --save"}
"""Tables of programs that need other libraries, whose results are only replaced, not compared."""


def listed() -> Iterator[tuple[str, str, str, str, str, str]]:
    """Every table: name, command, time (in seconds if it was measured), tolerance, greatest difference, and game of that run.

    Results that are shown beside others stand under their own name.
    """
    known = measured()

    def times(name: str, estimate: str = "") -> tuple[str, str, str]:
        if name not in known:
            return estimate, "", ""
        found = known[name]["difference"]
        return f"{known[name]['seconds']} s", "" if found is None else f"{found:.2g}", known[name]["game"]

    for name, result in RESULTS.items():
        duration, found, game = times(name, result.estimate)
        for table in result.tables or (name,):
            yield table, f"python -m {result.command}", duration, f"{result.tolerance:g}", found, game
    for table in COMPUTED:
        duration, found, game = times(table)
        yield table, f"python -m docs.tools.reproduce {table}", duration, "0", found, game
    for table, command in PROGRAMS.items():
        seconds = sum(kept["cpu_seconds"] for kept in saved("experiments", table)[table].values())
        yield table, f"python -m {command}", f"{seconds:.0f} CPU s", "not compared", "", ""


def measured() -> dict[str, dict[str, Any]]:
    """Seconds, greatest relative difference and game of reproduced tables, by name."""
    found: dict[str, dict[str, Any]] = json.loads(_AGAIN.read_text(encoding="utf-8"))
    return found


def deviations(before: Any, after: Any, path: str = "") -> Iterator[tuple[float, str, str]]:
    """Differences between two results: how great they are, where, and what they are.

    Numbers differ by a fraction of the greater one. Differences of keys, texts and lengths are infinite.
    """
    if isinstance(before, dict) and isinstance(after, dict):
        for key in sorted((before.keys() | after.keys()) - _PROVENANCE):
            if key not in before or key not in after:
                yield math.inf, f"{path}.{key}", f"only in the {'new' if key in after else 'saved'} result"
            else:
                yield from deviations(before[key], after[key], f"{path}.{key}")
    elif isinstance(before, list) and isinstance(after, list):
        if len(before) != len(after):
            yield math.inf, path, f"{len(before)} entries, now {len(after)}"
        for i, (first, second) in enumerate(zip(before, after, strict=False)):
            yield from deviations(first, second, f"{path}[{i}]")
    elif _is_number(before) and _is_number(after):
        if not math.isclose(before, after, rel_tol=1e-12, abs_tol=1e-12):
            finite = math.isfinite(before) and math.isfinite(after)
            size = abs(before - after) / max(abs(before), abs(after)) if finite else math.inf
            yield size, path, f"{before:g}, now {after:g}"
    elif before != after:
        yield math.inf, path, f"{before!r}, now {after!r}"


def differences(before: Any, after: Any, tolerance: float, speeds: Collection[str] = ()) -> tuple[list[str], float]:
    """Compare two results.

    Args:
        before: saved result.
        after: new result.
        tolerance: greatest relative difference of a number.
        speeds: names of numbers that may differ by a factor of two.

    Returns:
        The differences beyond the tolerance, and the greatest difference of a number that is no speed.
    """
    beyond, greatest = [], 0.0
    for size, path, what in deviations(before, after):
        speed = path.rpartition(".")[2] in speeds
        greatest = greatest if speed else max(greatest, size)
        if size > (_SPEED if speed else tolerance):
            beyond.append(f"{path}: {what}")
    return beyond, greatest


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


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
        places = {_OUT: str(out), "runs/again": str(run), _DATA: data}
        command = result.command
        for place, path in places.items():
            command = command.replace(place, shlex.quote(path))
        words = shlex.split(command)
        done = subprocess.run([sys.executable, "-m", *words], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
        if done.returncode != 0:
            raise ReproduceError(f"python -m {command}: exit status {done.returncode}")
        text = out.read_text(encoding="utf-8") if _OUT in result.command else done.stdout
    names = {_OUT: f"{result.folder}/results/{name}.json", _DATA: "shuttleset"}
    for place, path in places.items():
        text = text.replace(path, names.get(place, place)) if path else text
    return text


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


def check(table: str, *, save: bool = False) -> list[str]:
    """Make a table again; returns the differences.

    Args:
        table: name of the table or of its result file.
        save: keep the time and the greatest difference, and a result that differs.

    Raises:
        ReproduceError: there is no such table, it is only replaced, or its command fails.
    """
    begun = time.perf_counter()
    name = next((name for name, result in RESULTS.items() if table in (name, *result.tables)), table)
    greatest = 0.0
    if name in RESULTS:
        result = RESULTS[name]
        new = remake(name, result)
        found, greatest = differences(saved(result.folder, name), json.loads(new), result.tolerance, result.speeds)
        if save and (found or greatest):
            replace_file(ROOT / result.folder / "results" / f"{name}.json", f"{new.rstrip()}\n".encode())
    elif name in COMPUTED:
        found = [] if _computed(name) == _shown(name) else [f"{name}: another table than the page shows"]
    elif name in PROGRAMS:
        raise ReproduceError(f"{name} is not compared; run python -m {PROGRAMS[name]}")
    else:
        raise ReproduceError(f"no table {name!r}; python -m docs.tools.reproduce lists them")
    if save:
        row = {
            "seconds": round(time.perf_counter() - begun),
            "difference": None if found else greatest,
            "game": default_game().hash[:12],
        }
        whole = json.dumps(dict(sorted({**measured(), name: row}.items())), indent=1)
        replace_file(_AGAIN, f"{whole}\n".encode())
    return found


def main(table: str = "", /, *, save: bool = False) -> None:
    """List the tables, or make one again and compare it.

    Args:
        table: Name of the table or of its result file.
        save: Keep the time, the greatest difference, and the new result if it differs.
    """
    console = Console(soft_wrap=True, markup=False, highlight=False)
    if not table:
        rows = [("table", "command", "time", "tolerance", "found", "game"), *listed()]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        for row in rows:
            console.print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
        return
    begun = time.perf_counter()
    found = check(table, save=save)
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
