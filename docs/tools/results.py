"""Saved results, listed in ``results.toml``, and the tables that show them, each a template in ``templates/``.

Experiments and benchmarks print their results with the same templates (:func:`show`).
"""

import dataclasses
import functools
import json
import os
import platform
import sys
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_args

import jinja2
import tyro

from docs.tools.markdown import saved
from shuttle_marl.base.runs import write_json

Folder = Literal["benchmarks", "experiments"]
Json = Annotated[bool, tyro.conf.arg(name="json")]  # option of a command: print JSON instead of tables


@dataclasses.dataclass(frozen=True, kw_only=True)
class Result:
    """A result file and the tables that show it; ``results.toml`` explains the other fields."""

    folder: Folder  # the folder whose subfolder `results` holds it
    tables: tuple[str, ...]  # names of the templates that show it
    command: str  # arguments of `python -m`
    tolerance: float = 1.0
    estimate: str = ""
    speeds: tuple[str, ...] = ()
    compared: bool = True
    at: str = ""  # commit that has the program; empty: this one
    earlier: bool = False  # whether an earlier game gave it


_HERE: Final = Path(__file__).parent
_LISTED: Final = tomllib.loads((_HERE / "results.toml").read_text(encoding="utf-8"))
RESULTS: Final = {
    name: Result(**{**about, "folder": folder, "tables": tuple(about["tables"])})
    for folder in get_args(Folder)
    for name, about in _LISTED[folder].items()
}
"""Result files by name."""
_UNITS: Final = {"s": ((3600, "h"), (60, "min"), (1, "s")), "B": ((1e12, "TB"), (1e9, "GB"), (1e6, "MB"))}


def render(table: str, result: Any) -> str:
    """A table as Markdown.

    Args:
        table: name of a template.
        result: JSON value that it shows.
    """
    return _environment().get_template(f"{table}.jinja").render(result=result).strip("\n")


def saved_table(table: str, name: str) -> str:
    """A table of a saved result."""
    return render(table, saved(RESULTS[name].folder, name))


def show(result: Any, *tables: str, as_json: bool = False, out: Path | None = None) -> None:
    """Print a result.

    Args:
        result: JSON value.
        tables: names of the templates that show it.
        as_json: print JSON instead.
        out: write it to this file first.
    """
    if out is not None:
        write_json(out, result)
    text = json.dumps(result, indent=2) if as_json else "\n\n".join(render(table, result) for table in tables)
    sys.stdout.write(f"{text}\n")


@functools.cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_HERE / "templates"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        autoescape=False,  # Markdown of our own results
    )
    environment.globals |= {"saved": saved, "made_by": _made_by, "machine": machine}
    environment.tests["contains"] = lambda text, part: part in text
    environment.filters |= {
        "as": format,
        "percent": lambda share, digits=1: f"{100 * share:.{digits}f}",
        "millions": lambda speed: f"{speed / 1e6:.{1 if speed >= 1e6 else 3}f}",
        "spread": lambda of, digits=1: f"{100 * of['mean']:.{digits}f} ± {100 * of['deviation']:.{digits}f}",
        "ci": _with_interval,
        "unit": _with_unit,
        "of": _grouped,
        "falling": lambda rows, key: sorted(rows.items(), key=lambda item: -item[1][key]["value"]),
    }
    return environment


def _made_by(result: Mapping[str, Any]) -> str:
    commit = result["git"]["commit"][:7] if result["git"] else "no checkout"
    return f"`{' '.join(result['command'])}`, commit {commit}"


def this_machine() -> dict[str, Any]:
    """Python version, architecture and number of cores available to this process."""
    return {"python": platform.python_version(), "machine": platform.machine(), "cores": os.cpu_count()}


def machine(result: Mapping[str, Any]) -> str:
    """Description of the machine of a result."""
    return "Python {python}, {machine}, {cores} cores.".format(**result)


def _with_interval(
    of: Mapping[str, float], form: str, scale: float = 1, value: str = "value", low: str = "low", high: str = "high"
) -> str:
    middle, lower, upper = (format(scale * of[name], form) for name in (value, low, high))
    return f"{middle} ({lower} to {upper})"


def _with_unit(value: float, unit: Literal["s", "B"]) -> str:
    size, name = next((each for each in _UNITS[unit] if value >= each[0]), _UNITS[unit][-1])
    return f"{value / size:.{1 if value / size < 10 else 0}f} {name}"


def _grouped(rows: Iterable[Mapping[str, Any]], *keys: str) -> list[tuple[Any, list[Mapping[str, Any]]]]:
    """Rows by the values of some keys, in the order in which these first occur."""
    groups: dict[Any, list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault(row[keys[0]] if len(keys) == 1 else tuple(row[key] for key in keys), []).append(row)
    return list(groups.items())
