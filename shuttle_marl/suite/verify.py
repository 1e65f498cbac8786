"""Verification of a run: every score is recomputed from the stored policies and answers, and nothing else is proved."""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from shuttle_marl.base.errors import ShuttleError, printable
from shuttle_marl.suite import store
from shuttle_marl.suite.options import NOTHING_GIVEN, SuiteError, VerifyOptions
from shuttle_marl.suite.registry import task_of_run
from shuttle_marl.suite.results import Row, summarise

TOLERANCE: Final = 1e-7
"""Largest difference between a recomputed score and the stored one, in the unit of the score."""
NOT_VERIFIED: Final = ("strokes used", "curves", "tuning", "seconds", "access", "that the method produced these policies")
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
        summary: of the run; None if a unit is refused.
    """

    units: int
    refused: list[Refusal]
    summary: Row | None


def verify_run(
    folder: Path,
    given: VerifyOptions = NOTHING_GIVEN,
    *,
    progress: Callable[[Any], Any] = lambda units: units,
) -> Verification:
    """Recompute all scores of a run from its policies and answers.

    Nothing is recomputed if a unit can be refused without it.

    Raises:
        SuiteError: the folder holds no run.
    """
    config = store.read_config(folder)
    task, arena, cases = task_of_run(config, given.game, given.beacon)
    units = [(number, seed) for number in range(len(cases)) for seed in range(config.seeds)]
    summary, refused = None, []

    def read(number: int, seed: int) -> store.Entry:
        if config.game.hash != arena.game.hash:
            raise SuiteError(f"played on game {config.game.hash[:12]}; this is {arena.game.hash[:12]}")
        entry = store.read_unit(folder, number, cases[number], seed)
        if other := sorted({*entry.policies} - {*task.roles} | {*entry.answers} - {*task.answers}):
            what = "policies or answers that the task does not have, such as"
            raise SuiteError(f"the entry has {len(other)} {what} {printable(other[0][:40])}")
        return entry

    def recompute(number: int, seed: int) -> None:
        entry, case = read(number, seed), cases[number]
        fingerprint = task.fingerprint(arena, case, seed)
        if entry.fingerprint != fingerprint:
            raise SuiteError(f"the case has fingerprint {entry.fingerprint[:12]}; expected {fingerprint[:12]}")
        outcome = store.read_outcome(folder, entry, arena.game)
        _compare(entry.scores, task.score(arena, case, seed, outcome))
        _compare(entry.parts, task.parts(arena, case, outcome))

    for check in (read, recompute):
        for number, seed in progress(units):
            try:
                check(number, seed)
            except ShuttleError as error:
                refused.append(Refusal(case=cases[number].name, seed=seed, reason=str(error)))
        if refused:
            break
    else:
        summary = summarise(folder, given.beacon, given.game)
    return Verification(units=len(units), refused=refused, summary=None if refused else summary)


def _compare(stored: Mapping[str, float], found: Mapping[str, float]) -> None:
    if other := stored.keys() - found.keys():
        raise SuiteError(f"the entry has scores that the task does not have: {', '.join(sorted(map(printable, other)))}")
    for name, value in found.items():
        if not abs(value - stored.get(name, float("nan"))) <= TOLERANCE:
            raise SuiteError(f"{name} is {value:.9f}, not {stored.get(name)}")
