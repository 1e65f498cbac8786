"""Writes the tables of the documentation from results, so that nobody types a number by hand.

    python -m benchmarks.tables [--run FOLDER] [--check]

A table stands between ``<!-- begin: NAME -->`` and ``<!-- end: NAME -->``. The ranking comes from a run folder of the
league; without ``--run`` the default tournament is played, which is the same on every machine. Speeds come from
``benchmarks/results/``, where the benchmarks' own ``--json`` output was saved. The model card is a page of its own.
``--check`` changes nothing and fails if a page does not show what the results say.
"""

import difflib
import json
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import pyarrow.csv
from rich.console import Console

from benchmarks import training_tables
from benchmarks.markdown import ROOT, machine, markdown, saved
from shuttle_marl.commands import cli
from shuttle_marl.dynamics.card import as_markdown, read_card
from shuttle_marl.errors import ShuttleError
from shuttle_marl.files import replace_file
from shuttle_marl.game.shipped import model_folder
from shuttle_marl.league.config import LeagueConfig
from shuttle_marl.league.ranking import Standing
from shuttle_marl.league.report import HEADINGS, cells
from shuttle_marl.league.run import run_league


class TableError(ShuttleError):
    """A table that cannot be written, or that is not what the results say."""


def ranking(folder: Path) -> str:
    """The ranked table of a finished run, and what was played.

    Raises:
        TableError: the folder holds no finished run.
    """
    try:
        config, manifest = (json.loads((folder / f"{name}.json").read_text(encoding="utf-8")) for name in ("config", "manifest"))
        rows: list[dict[str, Any]] = pyarrow.csv.read_csv(folder / "ranking.csv").to_pylist()
    except (OSError, ValueError) as error:
        raise TableError(f"{folder}: no finished run of the league ({error})") from error
    nothing: Any = float("nan")
    standings = [Standing(**{name: nothing if value is None else value for name, value in row.items()}) for row in rows]
    played = (
        f"{len(standings)} players, {config['matches']:,} matches a pair, seed {config['seed']}, "
        f"game `{manifest['game']['hash'][:12]}`."
    )
    return f"{markdown(HEADINGS, [cells(s) for s in standings], left=('player',))}\n\n{played}"


def model_card(_: Path) -> str:
    """The card of the shipped model."""
    return as_markdown(read_card(model_folder()))


def aec(_: Path) -> str:
    """Speed of PettingZoo's loop, from ``benchmarks/results/aec.json``."""
    result = saved("aec")
    rows = [
        (
            f"`{e['environment']}`",
            f"{e['steps_per_second']:,.0f}",
            f"{e['slowest']:,.0f} to {e['fastest']:,.0f}",
            f"{e['ratio']:.1f}",
        )
        for e in result["environments"]
    ]
    headings = ("environment", "steps/s", "slowest to fastest turn", "times `connect_four_v3`")
    return f"{markdown(headings, rows, left=('environment',))}\n\n{machine(result)}"


def startup(_: Path) -> str:
    """CPU time of commands that do nothing yet, from ``benchmarks/results/startup.json``."""
    result = saved("startup")
    rows = [(f"`{c['command']}`", f"{c['cpu_s']:.2f}") for c in result["commands"]]
    return f"{markdown(('command', 'CPU s'), rows, left=('command',))}\n\n{machine(result)}"


def recording(_: Path) -> str:
    """Cost of the rally log, from ``benchmarks/results/recording.json``."""
    result = saved("recording")
    rows = [
        ("CPU time to write a stroke", f"{result['cpu_us_per_stroke']:.3f} µs"),
        ("bytes a stroke of a tournament", f"{result['bytes_per_stroke']:.2f}"),
        ("strokes of a tournament played and recorded a second", f"{result['recorded_strokes_per_s'] / 1e6:.1f} million"),
        ("CPU time that recording adds to training with PPO", f"{100 * result['training_overhead']:.1f} %"),
        ("bytes a stroke of training, with chances and values", f"{result['training_bytes_per_stroke']:.2f}"),
        ("strokes read a second", f"{result['read_strokes_per_s'] / 1e6:.0f} million"),
        ("strokes played again a second", f"{result['replay_strokes_per_s'] / 1e6:.1f} million"),
        (f"to open the log of {result['rallies']:,} rallies and read one of them", f"{result['find_rally_ms']:.1f} ms"),
    ]
    played = f"{result['strokes']:,} strokes of a tournament. {machine(result)}"
    return f"{markdown(('', 'measured'), rows, left=('',))}\n\n{played}"


def stroke_value(_: Path) -> str:
    """Players ranked by value added, from ``benchmarks/results/stroke_value.json``."""
    result = saved("stroke_value")
    groups = []
    for kind, title in (("MS", "men"), ("WS", "women")):
        rows = [
            (
                p["player"],
                str(p["matches"]),
                f"{p['strokes']:,}",
                *(
                    f"{100 * p[name]:+.2f} ({100 * p[low]:+.2f} to {100 * p[high]:+.2f})"
                    for name, low, high in (("value", "low", "high"), ("decision", "decision_low", "decision_high"))
                ),
            )
            for p in result["players"]
            if p["discipline"] == kind
        ]
        groups.append(markdown((title, "matches", "strokes", "points by 100 strokes", "by decisions"), rows, left=(title,)))
    played = f"{result['valued']:,} of {result['strokes']:,} strokes have a value; in brackets 95 % intervals."
    return "\n\n".join([*groups, played])


def exact_values(_: Path) -> str:
    """Time of the exact solvers, from ``benchmarks/results/exact_values.json``."""
    result = saved("exact_values")
    rows = [(row["what"], f"{row['seconds']:.2f}", f"{row['cpu_s']:.2f}") for row in result["solvers"]]
    return f"{markdown(('solver', 'seconds', 'CPU seconds'), rows, left=('solver',))}\n\n{machine(result)}"


def throughput(_: Path) -> str:
    """Million strokes a second by batch, from ``benchmarks/results/throughput.json``."""
    rows = [row for row in saved("throughput") if "states" not in row]
    batches = sorted({row["batch"] for row in rows})
    lines = []
    for what, threads in dict.fromkeys((row["what"], row["threads"]) for row in rows):
        mine = {row["batch"]: row for row in rows if (row["what"], row["threads"]) == (what, threads)}
        cells = [_millions(mine[batch]["strokes_per_s"]) if batch in mine else "" for batch in batches]
        lines.append((f"`{what}`", str(threads), *cells, f"{mine[max(mine)]['peak_mb']:.0f}"))
    headings = ("", "threads", *(f"{batch:,}" for batch in batches), "peak MB")
    least, most = (f"{edge(row['load'] for row in rows):.0f}" for edge in (min, max))
    load = least if least == most else f"{least} to {most}"
    return f"{markdown(headings, lines, left=('',))}\n\n{rows[0]['machine']}; processes that wanted a core meanwhile: {load}."


def speed(_: Path) -> str:
    """The figures of the README, from ``benchmarks/results/throughput.json`` and ``exact_values.json``."""
    best: dict[str, float] = {}
    for row in saved("throughput"):
        if "states" not in row and row["threads"] == 1 and row["batch"] in (1, 8192):
            best[row["what"]] = row["strokes_per_s"]
    solvers = {row["what"].partition(",")[0]: row["cpu_s"] for row in saved("exact_values")["solvers"]}
    strokes = (
        ("the kernel alone", "kernel"),
        ("the kernel with observations and masks", "kernel_observed"),
        ("`RallyEnv` in TorchRL's loop", "torchrl"),
        ("a tournament, every stroke kept", "tournament"),
    )
    lines = [(name, f"{best[what] / 1e6:.0f} million strokes a second") for name, what in strokes]
    times = best["aec"] / best["connect_four_v3"]
    lines.append(("`rally_v0` in PettingZoo's loop", f"{times:.1f} times the speed of PettingZoo's `connect_four_v3`"))
    lines.append(("perfect play of the whole game", f"{solvers['minimax']:.2f} s"))
    lines.append(("a best response", f"{solvers['best response']:.2f} s"))
    return f"{markdown(('', 'speed'), lines, left=('', 'speed'))}\n\nOne thread, 8,192 rallies or matches at once."


def throughput_floor(_: Path) -> str:
    """The kernel beside what its reads alone allow, from ``benchmarks/results/throughput.json``."""
    lines = [
        (
            f"`{row['what']}`",
            str(row["threads"]),
            str(row["bytes_per_stroke"]),
            f"{1e9 / row['floor_per_s']:.1f}",
            f"{1e9 / row['strokes_per_s']:.1f}",
        )
        for row in saved("throughput")
        if "floor_per_s" in row
    ]
    return markdown(("", "threads", "bytes a stroke", "floor, ns", "measured, ns"), lines, left=("",))


def throughput_sizes(_: Path) -> str:
    """The kernel in games of other sizes, from ``benchmarks/results/throughput.json``."""
    by_game: dict[tuple[Any, ...], dict[str, float]] = {}
    for row in saved("throughput"):
        if "states" in row:
            game = (row["synthetic"], row["strokes"], row["states"], row["legal_pairs"])
            by_game.setdefault(game, {})[row["what"]] = 1e9 / row["strokes_per_s"]
    lines = [
        (
            "synthetic" if synthetic else "shipped",
            f"{strokes:,}",
            f"{states:,}",
            f"{pairs:,}",
            f"{cost['kernel']:.1f}",
            f"{cost['kernel_observed']:.1f}",
        )
        for (synthetic, strokes, states, pairs), cost in by_game.items()
    ]
    headings = ("game", "catalogue", "states", "legal pairs", "`kernel`, ns", "`kernel_observed`, ns")
    return markdown(headings, lines, left=("game",))


def _millions(speed: float) -> str:
    return f"{speed / 1e6:.1f}" if speed >= 1e6 else f"{speed / 1e6:.3f}"


def staging(_: Path) -> str:
    """How believable staged rallies are, from ``benchmarks/results/staging.json``."""
    result = saved("staging")
    rows = [
        ("racket to shuttle at a contact, worst", f"{1000 * result['contact_max']:.1f} mm", "10 mm"),
        ("slide of a planted foot, worst", f"{1000 * result['slide_max']:.1f} mm", "20 mm"),
        ("speed of a player, greatest", f"{result['speed_max']:.2f} m/s", "6.5 m/s"),
        ("acceleration of a player, greatest", f"{result['acceleration_max']:.2f} m/s²", "12 m/s²"),
        ("joint beyond its limit, worst", f"{result['joint_excess_deg']:.1f}°", "0°"),
        ("shuttle over the net, least", f"{1000 * result['net_clearance_min']:.0f} mm", "10 mm"),
        ("end of a flight to the chosen point, worst", f"{1000 * result['landing_error_max']:.1f} mm", "50 mm"),
        ("strokes that end as they must: in their area, out, in the net", f"{100 * result['ends_as_it_must']:.1f} %", "100 %"),
        ("flight times within the quartiles of their shot type", f"{100 * result['flight_times_in_quartiles']:.1f} %", "90 %"),
        ("faster than real time, one core", f"{result['times_real_time']:.0f} times", "20 times"),
    ]
    staged = (
        f"{result['rallies']:,} rallies between imitated players, {result['strokes']:,} strokes, {result['plants']:,} plants of "
        f"a foot, {result['seconds'] / 60:,.0f} minutes. {machine(result)}"
    )
    return f"{markdown(('', 'measured', 'asked for'), rows, left=('',))}\n\n{staged}"


def replaced(text: str, name: str, table: str) -> str:
    """A page with one of its tables written anew.

    Raises:
        TableError: the page has no such place, or more than one.
    """
    begin, end = f"<!-- begin: {name} -->", f"<!-- end: {name} -->"
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise TableError(f"expected one {begin} with {end} behind it")
    return f"{text[: text.index(begin)]}{begin}\n{table}\n{text[text.index(end) :]}"


TABLES: Final[dict[tuple[str, str], Callable[[Path], str]]] = {
    ("README.md", "ranking"): ranking,
    ("README.md", "speed"): speed,
    ("benchmarks/README.md", "aec"): aec,
    ("benchmarks/README.md", "startup"): startup,
    ("benchmarks/README.md", "throughput"): throughput,
    ("benchmarks/README.md", "throughput_floor"): throughput_floor,
    ("benchmarks/README.md", "throughput_sizes"): throughput_sizes,
    ("docs/analysis.md", "stroke_value"): stroke_value,
    ("docs/exact.md", "exact_values"): exact_values,
    ("docs/rally_log.md", "recording"): recording,
    ("README.md", "win_rates"): training_tables.main_result,
    ("docs/training.md", "win_rates"): training_tables.agents,
    ("docs/training.md", "win_rates_matrix"): training_tables.matrix,
    ("docs/training.md", "styles"): training_tables.style_figures,
    ("docs/training.md", "time_to_win"): training_tables.time_to_win,
    ("docs/staging.md", "staging"): staging,
}
"""Page and name of every table, and what makes it from the run folder of the ranking."""
WHOLE_PAGES: Final[dict[str, Callable[[Path], str]]] = {"docs/model_card.md": model_card}
"""Pages that are made as a whole."""


def main(*, run: Path | None = None, check: bool = False) -> None:
    """Write all tables, or check them.

    Args:
        run: Folder of the finished run whose ranking is shown; by default the default tournament is played now.
        check: Change nothing; fail if a table differs.
    """
    with tempfile.TemporaryDirectory() as temporary:
        folder = run or run_league(LeagueConfig(out=Path(temporary) / "run", record="none"), Console(stderr=True)).folder
        changed: dict[str, str] = {name: render(folder) for name, render in WHOLE_PAGES.items()}
        for (name, block), render in TABLES.items():
            text = changed.get(name) or (ROOT / name).read_text(encoding="utf-8")
            changed[name] = replaced(text, block, render(folder))
    for name, after in changed.items():
        before = (ROOT / name).read_text(encoding="utf-8")
        if check and after != before:
            changes = "\n".join(difflib.unified_diff(before.splitlines(), after.splitlines(), name, "results", lineterm=""))
            raise TableError(f"{name} does not show what the results say; run this without --check\n{changes}")
        if not check:
            replace_file(ROOT / name, after.encode())
    Console().print(f"{len(TABLES)} tables and {len(WHOLE_PAGES)} pages {'checked' if check else 'written'}")


if __name__ == "__main__":
    sys.exit(cli.run(main, prog="python -m benchmarks.tables", description="Write or check the tables of the documentation."))
