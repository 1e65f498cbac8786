"""Run folder of a tournament: its configuration, its manifest, and one line for each finished pairing."""

import contextlib
import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec

from shuttle_marl.base import runs
from shuttle_marl.game.tables import Game
from shuttle_marl.league.entrants import Entrant, LeagueConfig, LeagueError
from shuttle_marl.league.tournament import Pairing, PairResult
from shuttle_marl.policy.sources import source_hashes

PAIRINGS: Final = "pairings.jsonl"
RALLIES: Final = "rallies.mcap"
REPORT: Final = "report.json"
PAGE: Final = "report.html"
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
        RunError: a line is damaged.
        LeagueError: pairings are missing.
    """
    journal = runs.Journal(folder / PAIRINGS)
    try:
        results = [msgspec.convert(fields, PairResult) for fields in journal.read(finished=finished)]
    except msgspec.ValidationError as error:
        raise LeagueError(f"{folder / PAIRINGS}: is damaged ({error}); play the tournament again with --overwrite") from error
    expected = [(pairing.number, pairing.names) for pairing in schedule(results)]
    found = [(result.pairing, result.names) for result in results]
    if found != expected[: len(found)] or (finished and found != expected):
        raise LeagueError(
            f"{folder / PAIRINGS}: pairings are missing, out of order, or of another run; restore it from a backup, or play the "
            "tournament again with --overwrite"
        )
    if not finished:
        journal.keep(len(results))
    return results


def append_results(folder: Path, results: list[PairResult]) -> None:
    """Append finished pairings, synchronised to the disk.

    Raises:
        RunError: the file cannot be written.
    """
    runs.Journal(folder / PAIRINGS).append([dataclasses.asdict(result) for result in results])
