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
from shuttle_marl.suite.results import Row, cases_of, summarise
from shuttle_marl.suite.store import RunConfig
from shuttle_marl.suite.task import Arena, Case, Task

TOLERANCE: Final = 1e-9
"""Largest difference between a recomputed score and the stored one."""
NOT_VERIFIED: Final = ("strokes used", "tuning", "seconds", "that the method produced these policies")
"""What no recomputation can show."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Refusal:
    """A unit that is refused, and the reason."""

    case: str
    seed: int
    reason: str


@dataclasses.dataclass(frozen=True, kw_only=True)
class Verification:
    """Verification of a run.

    Attributes:
        units: number of units.
        refused: units that are refused.
        summary: of the run; None if a unit is refused. Its remarks say why results are not official.
    """

    units: int
    refused: list[Refusal]
    summary: Row | None


def verify_run(
    folder: Path,
    *,
    game: str | None = None,
    beacon: str | None = None,
    data: Path | None = None,
    progress: Callable[[Any], Any] = lambda units: units,
) -> Verification:
    """Recompute all scores of a run from its policies and answers.

    Nothing is recomputed if a unit can be refused without it.

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
    cases = cases_of(task, arena, config)
    units = [(number, seed) for number in range(len(cases)) for seed in range(config.seeds)]
    summary, refused = None, []
    for check in (_read, _recomputed):
        for number, seed in progress(units):
            try:
                check(folder, config, task, arena, number, cases[number], seed)
            except ShuttleError as error:
                refused.append(Refusal(case=cases[number].name, seed=seed, reason=str(error)))
        if refused:
            break
    else:
        summary = summarise(folder, beacon, game)
        if not _aggregated(folder, summary):
            reason = f"{store.RESULTS} holds other aggregates than those of the units; `suite score` writes them again"
            refused = [Refusal(case=cases[number].name, seed=seed, reason=reason) for number, seed in units]
    return Verification(units=len(units), refused=refused, summary=None if refused else summary)


def _aggregated(folder: Path, summary: Row) -> bool:
    """Whether the stored aggregates, if there are any, are those of the units."""
    path = folder / store.RESULTS
    if not path.exists():
        return True
    try:
        stored = read_json(path, dict[str, Any])
    except FileReadError:
        return False
    expected = json.loads(json.dumps(summary))
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


def _read(folder: Path, config: RunConfig, task: Task, arena: Arena, number: int, case: Case, seed: int) -> None:  # noqa: ARG001
    """Check what needs no computing."""
    if config.game.hash != arena.game.hash:
        raise SuiteError(f"played on game {config.game.hash[:12]}; this is {arena.game.hash[:12]}")
    store.read_unit(folder, number, case, seed)


def _recomputed(folder: Path, config: RunConfig, task: Task, arena: Arena, number: int, case: Case, seed: int) -> None:
    """Check the fingerprint and the scores."""
    entry = store.read_unit(folder, number, case, seed)
    fingerprint = task.fingerprint(arena, case, seed)
    if entry.fingerprint != fingerprint:
        raise SuiteError(f"the case has fingerprint {entry.fingerprint[:12]}; expected {fingerprint[:12]}")
    frozen.load().check(task, config.split, f"{case.name}/{seed}", fingerprint, arena.base)
    outcome = store.read_outcome(folder, entry, arena.game, task.roles)
    for stored, found in (
        (entry.scores, task.score(arena, case, seed, outcome)),
        (entry.parts, task.parts(arena, case, outcome)),
    ):
        if other := stored.keys() - found.keys():
            raise SuiteError(f"the entry has scores that the task does not have: {', '.join(sorted(map(printable, other)))}")
        for name, value in found.items():
            if not abs(value - stored.get(name, float("nan"))) <= TOLERANCE:
                raise SuiteError(f"{name} is {value:.9f}, not {stored.get(name)}")
