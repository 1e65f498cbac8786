"""Options of runs, without the solvers: the command reads them before anything is imported that needs numba."""

import dataclasses
from pathlib import Path
from typing import Annotated, Final, Literal, get_args

import tyro

from shuttle_marl.base.bounds import Count, Within, check_bounds
from shuttle_marl.base.errors import ShuttleError

Split = Literal["dev", "test", "round"]
"""Part of a task: for tuning, for scores that are reported, and drawn for one round after methods were committed to."""
Access = Literal["samples", "tables", "opponent"]
"""What a method says that it reads: what it plays, logs or texts alone; or tables of the game; or those of its opponent too."""
ACCESS: Final[tuple[Access, ...]] = get_args(Access)
"""From little to much."""
Kind = Literal["method", "ablation", "reference"]
"""What a row of a board is: a method, one without a part of it, or a reference, which is computed or does not learn."""
Beacon = Annotated[str | None, tyro.conf.arg(metavar="HEX")]
_MOST_WORKERS: Final = 512


class SuiteError(ShuttleError):
    """A task, a method or a submission that cannot be used."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Resources:
    """How much a run plays, and where it is written."""

    budget: int | None = None
    """Budget, in strokes; default: the smallest one of the task."""
    seeds: Count | None = None
    """Number of seeds, from 0; default: that of the task."""
    quick: bool = False
    """The smallest cases and budgets only, to test a method; not a score."""
    workers: Annotated[int, Within(low=1, high=_MOST_WORKERS, text=f"1 to {_MOST_WORKERS}")] = 1
    """Parallel processes; results do not depend on it."""
    game: str = "default"
    """Model of the game: a shipped one or a folder."""
    out: Path | None = None
    """Run folder; default runs/TASK-METHOD-SPLIT, with a number appended if that exists."""
    resume: bool = False
    """Continue the run in --out (or the default folder)."""
    overwrite: bool = False
    """Replace the run in --out."""

    def __post_init__(self) -> None:
        check_bounds(self, SuiteError)
        if self.resume and self.overwrite:
            raise SuiteError("--resume continues a run and --overwrite replaces it; give one of them")


@dataclasses.dataclass(frozen=True, kw_only=True)
class SuiteRun(Resources):
    """Options of a run of a method on a task."""

    task: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TASK")]
    """Name of the task."""
    method: str
    """Baseline of the task, program:COMMAND, or MODULE:ATTRIBUTE."""
    split: Split = "dev"
    """Part of the task: dev for tuning, test for scores that are reported, round for one round (`suite rerun`)."""
    ray: str | None = None
    """Ray cluster that plays the units: local, auto, HOST:PORT of its head, or ray://HOST:PORT; replaces --workers."""
    beacon: Beacon = None
    """Randomness of the beacon of a round, for the split round."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class RerunOptions:
    """Whose entry of a round is rerun, by whom and in what."""

    task: str
    """Name of the task."""
    author: str
    """Author of the entry."""
    randomness: str
    """Randomness of the beacon, as you have read it there."""
    by: str
    """Your name."""
    image: str | None = None
    """Image of a container with Python and NumPy, for podman or docker; default: namespaces of Linux."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class VerifyOptions:
    """What the verification of a run reads beside its folder."""

    game: str | None = None
    """Model of the game; default: the shipped one that the run names. Folders that a run names are not opened."""
    beacon: Beacon = None
    """Randomness of the beacon of a round, for the split round."""


NOTHING_GIVEN: Final = VerifyOptions()
