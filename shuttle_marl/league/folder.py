"""The folder of a run: what decides it, what was found, and the pairings that are finished, one line each."""

import contextlib
import dataclasses
import json
import os
from pathlib import Path
from typing import Final

from shuttle_marl import runs
from shuttle_marl.files import replace_file
from shuttle_marl.league.config import LeagueConfig, LeagueError
from shuttle_marl.league.results import PairResult

PAIRINGS: Final = "pairings.jsonl"
RALLIES: Final = "rallies.mcap"


def open_run(config: LeagueConfig) -> contextlib.AbstractContextManager[Path]:
    """Hold the folder to play in: made for a new run, found for a resumed one.

    Raises:
        RunError: a run stands in the folder and was not to be resumed or replaced; or the run to resume is not there or
            was played with other flags.
    """
    return runs.open_run(
        config.out,
        f"league-{config.seed}",
        config.fixed(),
        resume=config.resume,
        overwrite=config.overwrite,
        called=f"of seed {config.seed}",
    )


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
