"""Comparison of the results of two checkouts: seeded commands and programs run in both, and their results are compared.

    python -m experiments.same_results BEFORE AFTER [--only AREA ...] [--json] [--save FILE]

Each area of :data:`AREAS` runs commands of ``shuttle-marl``, and ``seeded_results.py``, which uses the public names of
``shuttle_marl`` alone, so packages and modules may move. They run with the checkout as working directory, one after another, and
with an empty cache of computed values. Results are digests of items: files, keys of JSON, columns of rally logs, and values.
:data:`LEFT_OUT` says what is not compared. The keys of the output are ``different`` (items that are not the same, or only in one
checkout), ``items`` (digests of AFTER by area), ``seconds`` (of the processor, by area) and ``left_out``. BEFORE may be a file
that ``--save`` wrote.
"""

import hashlib
import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_args

import tyro

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands.cli import run as run_command

Area = Literal["game", "play", "league", "exact", "training", "workers", "staging", "reports", "pages", "pictures", "suite"]
_PROGRAM: Final = Path(__file__).with_name("seeded_results.py")
_LEAGUE: Final = "league --seed 3 --pool bc random"
_LEARN: Final = "league train --strokes 2000 --rounds 2 --batch 256 --width 8 --pool bc safe --json"
_PAIR: Final = "--players viktor-axelsen kento-momota"
_SUITE: Final = {
    "exploit-v1": "constant",
    "exploit-entrance-v1": "constant",
    "equilibrium-v1": "bc",
    "adapt-v1": "mixture",
    "offline-v1": "model",
    "evaluate-v1": "behaviour",
}
"""A quick method of each task."""
AREAS: Final[dict[Area, tuple[str, ...]]] = {
    "game": ("seeded game", "policies --json", "dynamics card --json"),
    "play": ("seeded play",),
    "league": (
        f"{_LEAGUE} safe ppo --matches 20 --out {{out}}/cup",
        f"{_LEAGUE} attacking --matches 8 --no-exact {_PAIR} --out {{out}}/pair",
        f"{_LEAGUE} --matches 40 --no-exact --workers 8 --out {{out}}/sample",
    ),
    "exact": ("seeded exact", "exact evaluate bc minimax ppo --no-away --json"),
    "training": ("seeded training",),
    "workers": tuple(f"{_LEARN} --workers {n} --out {{out}}/{n}" for n in (1, 2, 8)),
    "staging": (
        f"{_LEAGUE} --matches 2 --no-exact --out {{out}}/played",
        "recording scene {out}/played/rallies.mcap --out {out}/scene.mcap",
    ),
    "reports": ("seeded reports",),
    "pages": (
        f"{_LEAGUE} --matches 2 --out {{out}}/cup",
        "league report {out}/cup --out {out}/comparison.html",
        "watch --seed 2 --save-site {out}/site",
    ),
    "pictures": ("seeded pictures", "analysis datasets/sample/strokes.parquet --out {out}/analysis --json"),
    "suite": tuple(
        f"suite run {task} --method {method} --quick --seeds 1 --json --out {{out}}/{task}" for task, method in _SUITE.items()
    ),
}
"""Commands of ``shuttle-marl``, and areas of ``seeded_results.py``; ``{out}`` is the folder of the area."""
LEFT_OUT: Final = (
    "seconds, times, speeds, and checksums over them",
    "manifests, TensorBoard files, checkpoints, and report pages of training runs, which contain times and versions",
    "the bytes of rally logs, whose columns are compared",
    "what needs the annotated matches: data, dynamics fit, the experiments",
    "what a browser draws (tests/watch/test_pictures.py), videos, and the pages that a server sends",
    "Ray, GPUs, other numbers of threads than 1, JAX, OpenSpiel, Minari",
)
"""What is not compared."""
_SKIPPED: Final = ("manifest.json", "tensorboard", "checkpoints", ".lock")
_TIMES: Final = ("second", "time", "per_s", "overhead", "checksum")


class SameResultsError(ShuttleError):
    """A command failed, or the results differ."""


def results_of(checkout: Path, area: Area, folder: Path) -> dict[str, str]:
    """Digests of the results of an area by item.

    Args:
        checkout: root of the repository, or of another one with the same commands.
        folder: an empty folder for files, of which a subfolder ``cache`` is kept from area to area.

    Raises:
        SameResultsError: a command failed.
    """
    out = folder / area
    found: dict[str, str] = {}
    out.mkdir()

    def neutral(content: bytes) -> bytes:
        return content.replace(os.fsencode(out), b"OUT").replace(os.fsencode(checkout), b"CHECKOUT")

    for number, step in enumerate((*AREAS[area], "seeded logs")):
        command, *arguments = (word.format(out=out) for word in step.split())
        if command == "seeded":
            found |= json.loads(_run(checkout, folder, "-P", str(_PROGRAM), *arguments, str(out)).splitlines()[-1])
            continue
        printed = _run(checkout, folder, "-m", "shuttle_marl", command, *arguments)
        if "--json" in arguments:
            found |= dict(_of_json(f"{command} {arguments[0]} {number}", json.loads(neutral(printed))))
    for path in sorted(path for path in out.rglob("*") if path.is_file()):
        name = path.relative_to(out).as_posix()
        if not set(path.relative_to(out).parts) & set(_SKIPPED) and not path.match("rallies*.mcap"):
            found |= dict(_of_file(name, neutral(path.read_bytes())))
    return found


def _run(checkout: Path, folder: Path, *arguments: str) -> bytes:
    environment = {**os.environ, "PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1", "COLUMNS": "160"}
    environment["XDG_CACHE_HOME"] = str(folder / "cache")
    done = subprocess.run(
        [sys.executable, *arguments], cwd=checkout, env=environment, stdin=subprocess.DEVNULL, capture_output=True, check=False
    )
    if done.returncode != 0:
        raise SameResultsError(f"{checkout}: {' '.join(arguments)} ended with {done.returncode}:\n{done.stderr[-2000:].decode()}")
    return done.stdout


def _of_file(name: str, content: bytes) -> Iterator[tuple[str, str]]:
    if name.endswith(".jsonl"):
        yield name, _digest([_without_times(json.loads(line)) for line in content.splitlines()])
    elif name.endswith(".json"):
        yield from _of_json(name, json.loads(content))
    else:
        yield name, hashlib.sha256(content).hexdigest()


def _of_json(name: str, value: Any) -> Iterator[tuple[str, str]]:
    if isinstance(value, dict):
        yield from ((f"{name}: {key}", _digest(each)) for key, each in _without_times(value).items())
    else:
        yield name, _digest(_without_times(value))


def _without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_times(v) for key, v in value.items() if not any(word in key for word in _TIMES)}
    return [_without_times(v) for v in value] if isinstance(value, list) else value


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def main(
    before: tyro.conf.Positional[Path],
    after: tyro.conf.Positional[Path],
    *,
    only: tuple[Area, ...] = get_args(Area),
    save: Path | None = None,
    as_json: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> None:
    """Compare the results of two checkouts; the exit status is 1 if they differ.

    Args:
        before: Root of a checkout, or a file of --save.
        after: Root of another checkout.
        only: Areas to compare.
        save: Write the output to this JSON file too.
        as_json: Print JSON.
    """
    seconds: dict[str, float] = {}
    items: list[dict[str, dict[str, str]]] = []
    with tempfile.TemporaryDirectory() as folder:
        for number, checkout in enumerate((before, after)):
            place = Path(folder, str(number)).resolve()
            place.mkdir()
            if checkout.is_file():
                items.append(json.loads(checkout.read_text(encoding="utf-8"))["items"])
                continue
            items.append({})
            for area in only:
                start = _processor_seconds()
                items[-1][area] = results_of(checkout.resolve(), area, place)
                seconds[area] = round(_processor_seconds() - start, 1)
    first, second = ({f"{area}/{name}": value for area in only for name, value in each.get(area, {}).items()} for each in items)
    different = sorted(name for name in first.keys() | second.keys() if first.get(name) != second.get(name))
    result = json.dumps({"different": different, "seconds": seconds, "left_out": LEFT_OUT, "items": items[1]}, indent=1)
    if save:
        replace_file(save, result.encode())
    sys.stdout.write(f"{result}\n" if as_json else f"{len(second):,} items; not compared: {'; '.join(LEFT_OUT)}\n")
    if different:
        raise SameResultsError("\n".join(["the results differ:", *different]))


def _processor_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    sys.exit(run_command(main, prog="python -m experiments.same_results", description="Compare the results of two checkouts."))
