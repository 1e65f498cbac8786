"""Options of runs, without the solvers: the command reads them before anything is imported that needs numba."""

import dataclasses
from typing import Annotated, Final, Literal, get_args

import msgspec
import tyro

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import Count
from shuttle_marl.base.runs import RunOptions

Split = Literal["dev", "test", "round"]
"""Part of a task: for tuning, for scores that are reported, and drawn from a seed that no method knows."""
Access = Literal["samples", "tables", "opponent"]
"""What a method says that it reads: what it plays and logs alone; or tables of the game; or those of its opponent too."""
SPLITS: Final[tuple[Split, ...]] = get_args(Split)
ACCESS: Final[tuple[Access, ...]] = get_args(Access)  # from little to much
Kind = Literal["method", "reference"]  # what a row of a board is: a method, or a reference, which is computed or does not learn


class SuiteError(ShuttleError):
    """A task, a method or a submission that cannot be used."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class SuiteRun(RunOptions):
    """Options of a run of a method on a task."""

    error = SuiteError

    task: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TASK")]
    """Name of the task."""
    method: str
    """Baseline of the task, or MODULE:ATTRIBUTE."""
    split: Split = "dev"
    """Part of the task: dev for tuning, test for scores that are reported, round for games drawn from --seed."""
    seed: str | None = None
    """Seed of the split round, which draws games, opponents and luck; secret until all methods were run."""
    budget: int | None = None
    """Budget, in strokes; default: the smallest one of the task."""
    seeds: Count | None = None
    """Number of seeds, from 0; default: that of the task."""
    quick: bool = False
    """The smallest cases and budgets only, to test a method; not a score."""
    workers: Annotated[int, msgspec.Meta(ge=1, le=512)] = 1
    """Parallel processes; results do not depend on it."""
    ray: str | None = None
    """Ray cluster that plays the units: local, auto, HOST:PORT of its head, or ray://HOST:PORT; replaces --workers."""
