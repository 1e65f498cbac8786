"""Run folder of a tournament: its configuration, its manifest, and one line for each finished pairing."""

import contextlib
import dataclasses
import json
import os
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec

from shuttle_marl.base import runs
from shuttle_marl.base.files import problem, read_file, replace_file
from shuttle_marl.game.tables import Game
from shuttle_marl.league.entrants import Entrant, LeagueConfig, LeagueError
from shuttle_marl.league.tournament import Pairing, PairResult
from shuttle_marl.policy.sources import source_hashes

PAIRINGS: Final = "pairings.jsonl"
RALLIES: Final = "rallies.mcap"
REPORT: Final = "report.json"
PAGE: Final = "report.html"
_CHECKSUM: Final = "crc32"
PACKAGES: Final = ("numpy", "scipy", "numba", "pyarrow", "mcap", "zstandard", "matplotlib", "jinja2")
"""Packages whose versions can affect the files of a run."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Entrants:
    """Entrants in the configuration of a run, see :class:`LeagueConfig`."""

    pool: tuple[str, ...] = ()
    grown: tuple[int, ...] = ()


def open_run(config: LeagueConfig) -> contextlib.AbstractContextManager[Path]:
    """Create or resume the run folder, and lock it.

    Raises:
        RunError: the folder contains a run, and neither resuming nor replacing was requested; or the run to resume does not exist
            or was started with other flags.
    """
    return runs.open_run(
        config.out,
        f"league-{config.seed}",
        config.fixed(),
        resume=config.resume,
        overwrite=config.overwrite,
        called=f"of seed {config.seed}",
    )


def continued(config: LeagueConfig) -> LeagueConfig:
    """The configuration of a continued run, with the entrants that were added to it, now or before.

    Raises:
        LeagueError: there is no run to extend, or it was started with other flags, or no entrant is new.
        RunError: another process uses the folder, or its files cannot be read.
    """
    folder = config.out
    if folder is None or not (config.resume or config.extend) or not (folder / runs.CONFIG).is_file():
        if config.extend:
            raise LeagueError(f"{folder}: contains no run to extend")
        return config
    earlier = runs.read_json(folder / runs.CONFIG, _Entrants)
    pool, grown = earlier.pool, earlier.grown
    if sorted(grown) != list(grown) or not all(2 <= number <= len(pool) for number in grown):
        raise LeagueError(f"{folder / runs.CONFIG}: grown {list(grown)}: expected ascending numbers of entrants")
    if not config.extend:
        return dataclasses.replace(config, pool=pool, grown=grown) if grown and set(config.pool) <= set(pool) else config
    added = tuple(name for name in config.pool if name not in pool)
    if not added:
        raise LeagueError(f"{folder}: all entrants of --pool are already in this run; --resume continues it")
    found = dataclasses.replace(config, pool=(*pool, *added), grown=(*grown, len(pool)), resume=True, extend=False)
    before = runs.read_json(folder / runs.CONFIG, dict[str, Any])
    wanted = {**found.fixed(), "pool": before.get("pool"), "grown": before.get("grown")}
    different = [f"{key}: {before.get(key)!r} then, {value!r} now" for key, value in wanted.items() if before.get(key) != value]
    if different:
        raise LeagueError(f"{folder}: was started with other flags ({'; '.join(different)}); give the same ones to add entrants")
    with runs.locked(folder):
        # If the process is killed between the two writes, the old run only has to be finished again.
        about = runs.read_json(folder / runs.MANIFEST, dict[str, Any]) if (folder / runs.MANIFEST).exists() else {}
        runs.write_json(folder / runs.MANIFEST, {**about, "status": "running"})
        runs.write_json(folder / runs.CONFIG, found.fixed())
    return found


def log_name(stage: int) -> str:
    """File name of the rally log of a stage, counted from 0."""
    return f"rallies-{stage + 1}.mcap" if stage else RALLIES


def manifest(config: LeagueConfig, game: Game, entrants: Sequence[Entrant]) -> dict[str, Any]:
    """Manifest of a run that starts now: everything that is needed to reproduce it."""
    return {
        "status": "running",
        "seed": config.seed,
        **runs.describe(PACKAGES),
        "game": {"model": config.game, "hash": game.hash, "catalogue": game.catalogue.version},
        "policies": {entrant.name: entrant.hash for entrant in entrants},
        # What has no table is known by its files alone.
        "sources": {entrant.name: source_hashes(entrant.name) for entrant in entrants if not entrant.hash},
    }


def check_same(folder: Path, about: dict[str, Any]) -> None:
    """Check that a run was started with the same game and policies.

    Raises:
        LeagueError: it was not.
        RunError: the manifest cannot be read.
    """
    path = folder / runs.MANIFEST
    if not path.exists():
        return
    before = runs.read_json(path, dict[str, Any])
    for what in ("game", "policies", "sources"):
        known = before.get(what, {})
        # Entrants may have been added since then.
        if not isinstance(known, dict) or {key: about[what].get(key) for key in known} != known:
            raise LeagueError(f"{folder}: the {what} changed after the run was started; start a new run with another --out")


def read_results(
    folder: Path, schedule: Callable[[Sequence[PairResult]], Sequence[Pairing]], *, finished: bool = False
) -> list[PairResult]:
    """Read the finished pairings of a run; an incomplete last line of an unfinished run is removed.

    Args:
        folder: of the run.
        schedule: the pairings of the tournament that its first results determine.
        finished: whether the run is finished, so that all pairings are required.

    Raises:
        LeagueError: a line is damaged, or pairings are missing.
    """
    path = folder / PAIRINGS
    text = _content(path)
    whole = text[: text.rfind(b"\n") + 1]
    results = [_read_line(path, number, line) for number, line in enumerate(whole.splitlines(), 1)]
    expected = [(pairing.number, pairing.names) for pairing in schedule(results)]
    found = [(result.pairing, result.names) for result in results]
    if found != expected[: len(found)] or (finished and (found != expected or whole != text)):
        raise LeagueError(f"{path}: pairings are missing, out of order, or of another run; {_ADVICE}")
    if len(whole) < len(text):
        replace_file(path, whole)
    return results


def append_results(folder: Path, results: list[PairResult]) -> None:
    """Append finished pairings, synchronised to the disk.

    Raises:
        LeagueError: the file cannot be written.
    """
    path = folder / PAIRINGS
    try:
        with path.open("ab") as file:
            file.write(b"".join(map(_line, results)))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise LeagueError(f"{path}: cannot be written ({error.strerror}); free disk space and continue with --resume") from error


_ADVICE: Final = "restore it from a backup, or play the tournament again with --overwrite"


def _content(path: Path) -> bytes:
    try:
        return read_file(path)
    except FileNotFoundError:
        return b""
    except OSError as error:
        raise LeagueError(f"{path}: cannot be read ({problem(error)}); {_ADVICE}") from error


def _line(result: PairResult) -> bytes:
    """A finished pairing as a line of JSON with a checksum."""
    fields = dataclasses.asdict(result)
    return (json.dumps({**fields, _CHECKSUM: _checksum(fields)}, ensure_ascii=False) + "\n").encode()


def _read_line(path: Path, number: int, line: bytes) -> PairResult:
    """Reverse :func:`_line`."""
    try:
        fields = json.loads(line.decode())
        if not isinstance(fields, dict):
            reason = "not a JSON object"
        elif fields.pop(_CHECKSUM, None) != _checksum(fields):
            reason = f"its {_CHECKSUM} does not match"
        else:
            return msgspec.convert(fields, PairResult)
    except RecursionError:
        reason = "nested too deeply"
    except (ValueError, msgspec.ValidationError) as error:
        reason = str(error)
    raise LeagueError(f"{path}: line {number} is damaged ({reason}); {_ADVICE}")


def _checksum(fields: dict[str, Any]) -> str:
    """CRC-32 of the fields as JSON with sorted keys, in ASCII and without spaces; 8 hexadecimal digits."""
    return f"{zlib.crc32(json.dumps(fields, sort_keys=True, separators=(',', ':')).encode()):08x}"
