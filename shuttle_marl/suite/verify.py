"""Verification of a run: every score is recomputed from the stored policies and answers."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from shuttle_marl.base.errors import ShuttleError, printable
from shuttle_marl.base.files import FileReadError, read_json
from shuttle_marl.suite import frozen, store
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.registry import arena_of_run, find_task
from shuttle_marl.suite.results import summarise
from shuttle_marl.suite.store import RunConfig
from shuttle_marl.suite.task import Arena, Task

TOLERANCE: Final = 1e-9
"""Largest difference between a recomputed score and the stored one."""
NOT_VERIFIED: Final = ("strokes used", "tuning", "seconds", "that the method produced these policies")
"""What no recomputation can show."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Finding:
    """Verification of a unit: recomputed, or the reason why it is refused."""

    case: str
    seed: int
    reason: str | None


def verify_run(
    folder: Path,
    *,
    game: str | None = None,
    beacon: str | None = None,
    data: Path | None = None,
    progress: Callable[[Any], Any] = lambda units: units,
) -> list[Finding]:
    """Recompute all scores of a run from its policies and answers.

    Args:
        folder: of the run.
        game: model of the game; None: the shipped model that the run names.
        beacon: randomness of the beacon round of the hidden split.
        data: annotated matches, for ``imitate``.
        progress: wraps the units, to show progress.

    Raises:
        SuiteError: the folder holds no run.
    """
    config = store.read_config(folder)
    task = find_task(config.task)
    arena = arena_of_run(task, config, game, beacon=beacon, data=data)
    cases = task.cases(arena)
    units = [(number, seed) for number in range(len(cases)) for seed in range(config.seeds)]
    found = [
        Finding(case=cases[number].name, seed=seed, reason=_refused(folder, config, task, arena, number, seed))
        for number, seed in progress(units)
    ]
    if all(finding.reason is None for finding in found) and not _aggregated(folder, beacon, game):
        reason = f"{store.RESULTS} holds other aggregates than those of the units; `suite score` writes them again"
        found = [dataclasses.replace(finding, reason=reason) for finding in found]
    return found


def _aggregated(folder: Path, beacon: str | None, game: str | None) -> bool:
    """Whether the stored aggregates, if there are any, are those of the units."""
    path = folder / store.RESULTS
    if not path.exists():
        return True
    try:
        stored = read_json(path, dict[str, Any])
    except FileReadError:
        return False
    expected = json.loads(json.dumps(summarise(folder, beacon, game)))
    return all(_close(stored.get(name), value) for name, value in expected.items())


def _close(stored: Any, expected: Any) -> bool:
    if isinstance(expected, dict):
        return (
            isinstance(stored, dict)
            and stored.keys() == expected.keys()
            and all(_close(stored[k], expected[k]) for k in expected)
        )
    if isinstance(expected, list):
        return isinstance(stored, list) and len(stored) == len(expected) and all(map(_close, stored, expected))
    if isinstance(expected, float):
        return isinstance(stored, int | float) and abs(stored - expected) <= TOLERANCE * max(1.0, abs(expected))
    return bool(stored == expected)


def _refused(folder: Path, config: RunConfig, task: Task, arena: Arena, number: int, seed: int) -> str | None:
    """Why a unit is refused; None if its scores are reproduced."""
    case = task.cases(arena)[number]
    try:
        if config.game.hash != arena.game.hash:
            raise SuiteError(f"played on game {config.game.hash[:12]}; this is {arena.game.hash[:12]}")
        entry = store.read_entry(store.entry_path(folder, number, seed))
        if (entry.case, entry.seed) != (case.name, seed):
            raise SuiteError(f"the entry is of case {entry.case!r} and seed {entry.seed}")
        fingerprint = task.fingerprint(arena, case, seed)
        if entry.fingerprint != fingerprint:
            raise SuiteError(f"the case has fingerprint {entry.fingerprint[:12]}; expected {fingerprint[:12]}")
        frozen.load().check(task, config.split, f"{case.name}/{seed}", fingerprint, arena.game)
        scores = task.score(arena, case, seed, store.read_outcome(folder, entry, arena.game, task.roles))
        if other := entry.scores.keys() - scores.keys():
            raise SuiteError(f"the entry has scores that the task does not have: {', '.join(sorted(map(printable, other)))}")
        for name, value in scores.items():
            if not abs(value - entry.scores.get(name, float("nan"))) <= TOLERANCE:
                raise SuiteError(f"{name} is {value:.9f}, not {entry.scores.get(name)}")
    except ShuttleError as error:
        return str(error)
    return None
