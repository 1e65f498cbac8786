"""The frozen settings of the suite: hash of the game and fingerprints of the cases of every task.

``frozen.json`` is written by ``python -m shuttle_marl.suite freeze``, for maintainers. As long as it names no game, tasks take
the installed one, and scores are preliminary.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from shuttle_marl.suite import store
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.task import Task

FROZEN: Final = Path(__file__).parent / "frozen.json"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Frozen:
    """Content of ``frozen.json``.

    Attributes:
        game: hash of the game; None: not frozen.
        variants: hashes of its variants, such as the game of one discipline.
        cases: fingerprint of each case, by ``TASK/SPLIT/CASE/SEED``.
    """

    game: str | None = None
    variants: Sequence[str] = ()
    cases: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def official(self, digest: str) -> bool:
        """Whether the hash is that of the frozen game or of a variant of it."""
        return digest in (self.game, *self.variants)

    def check(self, task: Task, split: str, case: str, fingerprint: str, base: str) -> None:
        """Check that a case is the frozen one; cases of other games are not checked.

        Raises:
            SuiteError: the case was changed, or depends on another version of a library.
        """
        known = self.cases.get(f"{task.name}/{split}/{case}")
        if self.official(base) and known is not None and known != fingerprint:
            raise SuiteError(
                f"{task.name} {case} ({split}): its fingerprint is {fingerprint[:12]}, the frozen one {known[:12]}; "
                "install the version of the package that the task was frozen with"
            )


def load(path: Path = FROZEN) -> Frozen:
    """Read the frozen settings.

    Raises:
        SuiteError: the file is damaged.
    """
    return store.read(path, Frozen, "; install the package again", sealed=True) if path.is_file() else Frozen()
