"""The folder of a run: what decides it, what was found, and the pairings that are finished, one line each."""

import contextlib
import dataclasses
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from shuttle_marl.files import replace_file
from shuttle_marl.league.config import LeagueConfig, LeagueError
from shuttle_marl.league.results import PairResult

CONFIG: Final = "config.json"
MANIFEST: Final = "manifest.json"
PAIRINGS: Final = "pairings.jsonl"
RALLIES: Final = "rallies.mcap"


def open_folder(config: LeagueConfig) -> Path:
    """The folder to play in: made for a new run, found for a resumed one.

    Raises:
        LeagueError: a run stands in the folder and was not to be resumed or replaced; or the run to resume is not there or
            was played with other flags.
    """
    folder = _resumed(config) if config.resume else _new(config)
    if config.resume:
        return folder
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LeagueError(f"{folder}: the run folder cannot be made ({error.strerror}); name another with --out") from error
    write_json(folder / CONFIG, config.fixed())
    return folder


def _default(config: LeagueConfig) -> Path:
    return Path("runs") / f"league-{config.seed}"


def _new(config: LeagueConfig) -> Path:
    folder = config.out
    if folder is None:
        folder, number = _default(config), 1
        while folder.exists():
            number += 1
            folder = folder.with_name(f"league-{config.seed}-{number}")
        return folder
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return folder
    if not (folder / CONFIG).is_file():
        raise LeagueError(f"{folder}: holds something that is no run; name another folder with --out")
    if not config.overwrite:
        state = "a finished run" if is_finished(folder) else "an unfinished run"
        raise LeagueError(f"{folder}: holds {state}; --resume goes on with it, --overwrite replaces it, --out names another")
    with locked(folder):
        shutil.rmtree(folder)
    return folder


def _resumed(config: LeagueConfig) -> Path:
    if config.out is not None:
        folders = [config.out]
    else:
        newest = sorted(_default(config).parent.glob(f"league-{config.seed}*/{CONFIG}"), key=lambda p: p.stat().st_mtime)
        folders = [path.parent for path in newest if not is_finished(path.parent)]
    if not folders or not (folders[-1] / CONFIG).is_file():
        where = f"in {config.out}" if config.out else f"of seed {config.seed} in {_default(config).parent}"
        raise LeagueError(f"there is no run to resume {where}; leave --resume out to start one")
    folder = folders[-1]
    before, now = read_json(folder / CONFIG), config.fixed()
    different = [f"{name}: {before.get(name)!r} then, {now[name]!r} now" for name in now if before.get(name) != now[name]]
    if different:
        raise LeagueError(f"{folder}: was started with other flags ({'; '.join(different)}); give the same ones to resume it")
    return folder


def is_finished(folder: Path) -> bool:
    """Whether a run came to its end."""
    with contextlib.suppress(LeagueError):
        return read_json(folder / MANIFEST).get("status") == "finished"
    return False


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a run folder, so that no second process plays in it.

    Raises:
        LeagueError: another process holds it.
    """
    try:
        import fcntl  # noqa: PLC0415  not on Windows
    except ImportError:
        yield
        return
    try:
        file = (folder / CONFIG).open("rb+")
    except OSError as error:
        raise LeagueError(f"{folder}: cannot be written ({error.strerror}); name another folder with --out") from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # ends with the process, however it ends
        except OSError as error:
            raise LeagueError(f"{folder}: another process plays there; wait for it or name another with --out") from error
        yield


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object.

    Raises:
        LeagueError: it is missing or damaged.
    """
    try:
        fields = json.loads(path.read_text(encoding="utf-8"))
        if isinstance(fields, dict):
            return fields
        problem = "no object"
    except (OSError, ValueError) as error:
        problem = str(error)
    raise LeagueError(f"{path}: cannot be read ({problem}); start the run anew with --overwrite")


def write_json(path: Path, fields: dict[str, Any]) -> None:
    """Write a JSON object, whole or not at all."""
    replace_file(path, (json.dumps(fields, indent=2, ensure_ascii=False) + "\n").encode())


def read_results(folder: Path) -> list[PairResult]:
    """The finished pairings of a run; a last line that was cut off is taken away.

    Raises:
        LeagueError: a line is damaged.
    """
    path = folder / PAIRINGS
    if not path.exists():
        return []
    text = path.read_bytes()
    whole = text[: text.rfind(b"\n") + 1]
    if len(whole) < len(text):
        replace_file(path, whole)
    try:
        results = [PairResult.from_json(json.loads(line)) for line in whole.splitlines()]
    except (ValueError, TypeError, KeyError) as error:
        raise LeagueError(f"{path}: damaged ({error}); start the run anew with --overwrite") from error
    if [result.pairing for result in results] != list(range(len(results))):
        raise LeagueError(f"{path}: pairings are missing or stand twice; start the run anew with --overwrite")
    return results


def append_results(folder: Path, results: list[PairResult]) -> None:
    """Add finished pairings; they are on the disk when this returns.

    Raises:
        LeagueError: no space or the like.
    """
    lines = "".join(json.dumps(dataclasses.asdict(result), ensure_ascii=False) + "\n" for result in results)
    path = folder / PAIRINGS
    try:
        with path.open("ab") as file:
            file.write(lines.encode())
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise LeagueError(f"{path}: cannot be written ({error.strerror}); make room and go on with --resume") from error
