"""Rallies as motion, staged once for all who watch them."""

import threading
from collections.abc import Callable
from typing import Final

import numpy as np

from shuttle_marl.game.rules import RETURNED_BELOW
from shuttle_marl.game.tables import Game
from shuttle_marl.rally import record
from shuttle_marl.staging import Motion, stage
from shuttle_marl.watch.match import Person, Rally
from shuttle_marl.watch.tables import Kept

FPS: Final = 50
_MOST_MOTIONS: Final = 16


class Stager:
    """Stages rallies of one game; keeps the last ones.

    Args:
        game: the tables.
        athletes: of seats 0 and 1.
        hands: with which seats 0 and 1 play.
    """

    def __init__(self, game: Game, athletes: tuple[str, str], hands: tuple[str, str]) -> None:
        self._game, self._athletes, self._hands = game, athletes, hands
        self._motions = Kept(_MOST_MOTIONS)
        # Staging takes one core; two at a time would only make both late.
        self._one = threading.Lock()

    def kept(self, rally: Rally, person: Person | None, make: Callable[[], Motion]) -> Motion:
        """The motion of a rally, made by ``make`` if it is not there.

        Where strokes were chosen by a person, it depends on when they did, because frames that were seen stay as they are.
        """
        since = person.stroke if person is not None and person.rally == rally.number else 0
        key = (rally.key, rally.server, rally.stroke, rally.ending, rally.turn, rally.chosen, person is not None, since)
        return self._motions.get(key, make)

    def stage(self, rally: Rally, continuing: Motion | None = None, from_stroke: int | None = None) -> Motion:
        """Stage a rally; one that waits for a person up to where they are expected to strike.

        Args:
            rally: as it was played.
            continuing: a motion with the same strokes before ``from_stroke``, whose frames stay as they are.
            from_stroke: number of the first stroke that is another one.

        Raises:
            StagingError: it cannot be staged.
        """
        ending = rally.ending
        if ending is None:
            assert rally.turn is not None
            ending = RETURNED_BELOW + int(self._game.contact(rally.turn))
        played = record.Rally(
            catalogue=self._game.catalogue,
            server=rally.server,
            stroke=np.array(rally.stroke, dtype=np.int64),
            ending=ending,
        )
        with self._one:
            if continuing is not None:
                return stage(played, seed=rally.key, continuing=continuing, from_stroke=from_stroke)
            return stage(played, seed=rally.key, handedness=self._hands, athletes=self._athletes, fps=FPS)
