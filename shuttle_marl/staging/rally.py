"""Rallies to stage: one that was played, and some that are played for it."""

import dataclasses
import functools
from collections.abc import Iterable

import numpy as np

from shuttle_marl.arrays import I64
from shuttle_marl.errors import ShuttleError
from shuttle_marl.game.policy import Policy
from shuttle_marl.game.rules import OUTCOMES, RETURNED_BELOW
from shuttle_marl.game.stroke import Catalogue
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.rally.record import Rallies
from shuttle_marl.recording.reader import RallyLog


class StagingError(ShuttleError):
    """A rally that cannot be staged, or an unknown option."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PlayedRally:
    """A rally, as the rally log and the environments know it.

    Attributes:
        catalogue: the strokes that can be played.
        server: seat that serves, 0 or 1; strikers alternate.
        stroke: ``[n]`` catalogue index of every stroke, n >= 1; a rally that is still open may have none.
        ending: outcome of the last stroke, of :mod:`shuttle_marl.game.rules`: FAULT or WINNER, or, while the rally is open and
            the next stroke is not chosen yet, RETURNED_BELOW or RETURNED_ABOVE.
    """

    catalogue: Catalogue
    server: int
    stroke: I64
    ending: int

    @classmethod
    def of(cls, catalogue: Catalogue, strokes: Iterable[tuple[int, int, int]]) -> "PlayedRally":
        """From the strokes one by one.

        Args:
            catalogue: the strokes that can be played.
            strokes: seat of the striker, catalogue index, and outcome (index into ``shuttle_marl.game.rules.OUTCOMES``) of each.

        Raises:
            StagingError: seats that do not alternate, outcomes that do not fit, or what :meth:`checked` refuses.
        """
        rows = np.array(list(strokes), dtype=np.int64).reshape(-1, 3)
        if not len(rows):
            raise StagingError("a rally without strokes; expected at least the serve")
        seat, stroke, outcome = rows.T
        if (seat != (seat[0] + np.arange(len(seat))) % 2).any():
            raise StagingError(f"seats {seat.tolist()}: expected two players who take turns")
        rally = cls(catalogue=catalogue, server=int(seat[0]), stroke=stroke, ending=int(outcome[-1])).checked()
        if (outcome != rally.outcome).any():
            raise StagingError(f"outcomes {outcome.tolist()}: the heights of the strokes give {rally.outcome.tolist()}")
        return rally

    def checked(self) -> "PlayedRally":
        """This rally.

        Raises:
            StagingError: no strokes, an unknown seat, stroke or ending, or a serve that does not stand at the start.
        """
        if self.server not in (0, 1):
            raise StagingError(f"server {self.server}: expected seat 0 or 1")
        if self.ending not in range(len(OUTCOMES)):
            raise StagingError(f"ending {self.ending}: expected 0 to {len(OUTCOMES) - 1}, {', '.join(OUTCOMES)}")
        if not len(self.stroke):
            if self.open:
                return self
            raise StagingError("a rally without strokes; expected at least the serve")
        if self.stroke.min() < 0 or self.stroke.max() >= len(self.catalogue):
            raise StagingError(f"strokes {self.stroke.tolist()}: the catalogue has {len(self.catalogue)} strokes, from 0")
        serves = self.catalogue.is_serve[self.stroke]
        if not serves[0] or serves[1:].any():
            raise StagingError("a rally starts with a serve and has no other; check the order of its strokes")
        return self

    def __len__(self) -> int:
        return len(self.stroke)

    @property
    def open(self) -> bool:
        """Whether the rally lasts: its next stroke is not chosen yet."""
        return self.ending >= RETURNED_BELOW

    @functools.cached_property
    def striker(self) -> I64:
        """``[n]`` seat of the striker of each stroke."""
        return (self.server + np.arange(len(self.stroke))) % 2

    @functools.cached_property
    def outcome(self) -> I64:
        """``[n]`` outcome of each stroke, index into ``shuttle_marl.game.rules.OUTCOMES``."""
        following = RETURNED_BELOW + self.catalogue.height[self.stroke[1:]].astype(np.int64)
        return np.r_[following, self.ending][: len(self.stroke)]


def play_rallies(game: Game, policies: tuple[Policy, Policy], n: int, *, seed: int) -> list[PlayedRally]:
    """Play n rallies, to have some to stage: the first n episodes of ``rally_v0`` with the same seed.

    Args:
        game: the tables.
        policies: of seats 0 and 1; they read no score.
        n: how many, at least 1.
        seed: names all draws; who serves is drawn too.

    Raises:
        PolicyError: a policy that reads the score, or returns no distribution over the legal strokes.
        KernelError: fewer than one rally.
    """
    from shuttle_marl.kernel import play_rallies as play  # noqa: PLC0415  numba is slow to import

    tables = tuple(tabulate(policy, game, f"seat {seat}") for seat, policy in enumerate(policies))
    rallies = play(game, (tables[0], tables[1]), n, seed=seed)
    return [_played(game.catalogue, rallies.slice(k, k + 1)) for k in range(n)]


def recorded_rally(log: RallyLog, number: int) -> PlayedRally:
    """One rally of a log by its number.

    Raises:
        RecordingError: there is no such rally, or the log is damaged.
        StagingError: its strokes make no rally.
    """
    return rally_of(log, log.rally(number))


def rally_of(log: RallyLog, rally: Rallies) -> PlayedRally:
    """A rally that was read from a log.

    Args:
        log: where it was read.
        rally: the one rally.

    Raises:
        StagingError: its strokes make no rally.
    """
    return _played(log.catalogue, rally).checked()


def _played(catalogue: Catalogue, rally: Rallies) -> PlayedRally:
    return PlayedRally(
        catalogue=catalogue,
        server=int(rally.server[0]),
        stroke=rally.stroke.astype(np.int64),
        ending=int(rally.reason[0]),
    )
