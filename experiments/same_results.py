"""Comparison of two checkouts: both run the same seeded commands, and their output files are compared.

    python -m experiments.same_results BEFORE AFTER [--out FOLDER] [--only NAME ...]

Files must be equal byte for byte, with these exceptions: JSON is compared without times and the checksums over them, printed
text without names of folders, times and widths of columns, and a rally log whose bytes differ (its format may have changed)
must contain the same strokes. Manifests and TensorBoard files are excluded, because they contain times and versions. Both
checkouts run with this interpreter, one command after another, which takes some minutes.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import tyro
from rich.console import Console

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.commands.cli import run as run_command

_TRAIN: Final = ("--seed", "4", "--strokes", "60000", "--out", "{out}")
_PAIR: Final = ("--players", "viktor-axelsen", "kento-momota")
_SUITE: Final = ("--split", "dev", "--quick", "--seeds", "1", "--out", "{out}")
COMMANDS: Final[dict[str, tuple[str, ...]]] = {
    "league": ("league", "--matches", "20", "--pool", "bc", "safe", "random", "ppo", "--away", "--seed", "3", "--out", "{out}"),
    "pair": ("league", "--matches", "20", "--pool", "bc", "random", "attacking", *_PAIR, "--seed", "3", "--out", "{out}"),
    "sample": ("league", "--matches", "200", "--pool", "bc", "safe", "--record", "sample:3", "--no-exact", "--out", "{out}"),
    "solve": ("exact", "solve", "--no-away", "--json"),
    "evaluate": ("exact", "evaluate", "bc", "minimax", "attacking", "ppo", "sac", "random", "bc:viktor-axelsen", "--json"),
    "crossplay": ("exact", "crossplay", "bc", "minimax", "ppo", "random", "safe", "--json"),
    "ppo": ("training", "ppo", *_TRAIN),
    "a2c": ("training", "a2c", *_TRAIN),
    "sac": ("training", "sac", *_TRAIN),
    "self-play": ("training", "ppo", "--opponent", "self", *_TRAIN),
    "exploit": ("suite", "run", "exploit-entrance-v0", "--method", "constant", *_SUITE),
    "offline": ("suite", "run", "offline-v0", "--method", "model", *_SUITE),
}
"""Arguments after ``python -m shuttle_marl``, by name; ``{out}`` is a separate folder for each command."""
_LEFT_OUT: Final = ("manifest.json", "tensorboard")
_PRINTED: Final = "printed.txt"
_INTERPRETER: Final = re.compile(r"\S*python -m")
_SECONDS: Final = "seconds "
"""Beginning of a printed line with a time."""
_TIMES: Final = ("second", "time", "per_s", "checksum")


class SameResultsError(ShuttleError):
    """A command failed, or the results differ."""


def run_commands(checkout: Path, out: Path, names: tuple[str, ...]) -> None:
    """Run the commands of these names with the package of a checkout.

    Args:
        checkout: root of the repository.
        out: each command writes to a subfolder with its name, and its printed text to ``printed.txt`` there.
        names: keys of :data:`COMMANDS`.

    Raises:
        SameResultsError: a command failed, or the checkout holds no package.
    """
    if not (checkout / "shuttle_marl" / "__init__.py").exists():
        raise SameResultsError(f"{checkout}: no package shuttle_marl here; give the root of a checkout")
    for name in names:
        folder = out / name
        folder.mkdir(parents=True)
        module, *arguments = (argument.format(out=folder / "run") for argument in COMMANDS[name])
        printed = _call(checkout, module, *arguments)
        printed = _INTERPRETER.sub("python -m", printed.replace(str(folder), "OUT"))
        lines = (" ".join(line.split()) for line in printed.splitlines())  # columns are as wide as the times in them
        kept = [line for line in lines if not line.startswith(_SECONDS)]
        (folder / _PRINTED).write_text("\n".join(kept), encoding="utf-8")


def _call(checkout: Path, module: str, *arguments: str) -> str:
    command = [sys.executable, "-m", "shuttle_marl", module, *arguments]
    environment = {**os.environ, "PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1", "COLUMNS": "160"}
    done = subprocess.run(command, cwd=checkout, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SameResultsError(f"{checkout}: {' '.join(command[1:])} ended with {done.returncode}:\n{done.stderr[-2000:]}")
    return done.stdout


def differences(before: Path, after: Path, checkouts: tuple[Path, Path]) -> Iterator[str]:
    """Differences between two folders that :func:`run_commands` filled, a line each.

    Args:
        before: one folder.
        after: the other.
        checkouts: which read the rally logs of the first and of the second folder.
    """
    names = [_files(before), _files(after)]
    for name in sorted(names[0] ^ names[1]):
        yield f"{name}: only {'before' if name in names[0] else 'after'}"
    for name in sorted(names[0] & names[1]):
        files = before / name, after / name
        if files[0].read_bytes() != files[1].read_bytes() and (problem := _difference(files, checkouts)):
            yield f"{name}: {problem}"


def _files(folder: Path) -> set[str]:
    paths = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return {path.as_posix() for path in paths if not set(path.parts) & set(_LEFT_OUT)}


def _difference(files: tuple[Path, Path], checkouts: tuple[Path, Path]) -> str:
    """The difference of two unequal files; empty if only excluded parts differ."""
    if files[0].suffix == ".mcap":
        return _other_strokes([_strokes(file, checkout) for file, checkout in zip(files, checkouts, strict=True)])
    texts = [_lines_without_times(file) for file in files]
    if None in texts or texts[0] != texts[1]:
        return f"differs ({files[0].stat().st_size:,} and {files[1].stat().st_size:,} bytes)"
    return ""


def _lines_without_times(file: Path) -> list[Any] | None:
    """Content of a JSON or JSON-lines file without times; None for other files."""
    try:
        text = file.read_text(encoding="utf-8")
        return [_without_times(json.loads(part)) for part in (text.splitlines() if file.suffix == ".jsonl" else [text])]
    except ValueError:
        return None


def _without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_times(v) for key, v in value.items() if not any(word in key for word in _TIMES)}
    return [_without_times(v) for v in value] if isinstance(value, list) else value


def _strokes(log: Path, checkout: Path) -> pa.Table:
    """Every stroke of a log, as the checkout exports them."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "strokes.arrow"
        _call(checkout, "recording", "export", str(log), str(path), "--rows", "strokes")
        return pa.ipc.open_file(path.read_bytes()).read_all()


def _other_strokes(tables: list[pa.Table]) -> str:
    """The difference of two tables of strokes in the columns that both have."""
    names = [name for name in tables[0].column_names if name in tables[1].column_names]
    if not {"number", "stroke"} <= set(names) or len(tables[0]) != len(tables[1]):
        return f"{len(tables[0]):,} and {len(tables[1]):,} strokes, with {', '.join(names) or 'no columns'} in common"
    other = [name for name in names if not tables[0][name].equals(tables[1][name])]
    return f"other {', '.join(other)}" if other else ""


def main(
    before: tyro.conf.Positional[Path],
    after: tyro.conf.Positional[Path],
    *,
    out: Path | None = None,
    only: tuple[str, ...] = tuple(COMMANDS),
) -> None:
    """Compare the results of two checkouts.

    Args:
        before: Root of a checkout.
        after: Root of another one.
        out: Keep the output in this new folder, under `before` and `after`.
        only: Names of the commands to run.
    """
    if unknown := [name for name in only if name not in COMMANDS]:
        raise SameResultsError(f"--only {' '.join(unknown)}: expected some of {', '.join(COMMANDS)}")
    if out is not None and out.exists():
        raise SameResultsError(f"--out {out}: exists; name a new folder")
    checkouts = (before.resolve(), after.resolve())
    with tempfile.TemporaryDirectory() as temporary:
        folder = (out or Path(temporary)).resolve()
        for name, checkout in zip(("before", "after"), checkouts, strict=True):
            run_commands(checkout, folder / name, only)
        found = list(differences(folder / "before", folder / "after", checkouts))
        files = len(_files(folder / "before"))
    if found:
        raise SameResultsError("the results differ\n" + "\n".join(found))
    Console().print(f"the same: {len(only)} commands, {files} files")


if __name__ == "__main__":
    sys.exit(run_command(main, prog="python -m experiments.same_results", description="Compare the results of two checkouts."))
