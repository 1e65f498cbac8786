"""Motion of rallies."""

import dataclasses
import threading
from typing import Final

from shuttle_marl.court.match import CourtRally
from shuttle_marl.court.staging import Motion, continue_motion, stage
from shuttle_marl.game.court import Hands
from shuttle_marl.game.pairs import Looks

FPS: Final = 50


class Stager:
    """Stages rallies.

    Args:
        athletes: ``male`` or ``female``, of seats 0 and 1; None: as the players are.
        hands: ``right`` or ``left``, of seats 0 and 1; None: those of the players.
    """

    def __init__(self, athletes: tuple[str, str] | None = None, hands: Hands | None = None) -> None:
        self._athletes, self._hands = athletes, hands
        # Staging uses one core; two at a time would delay both.
        self._one = threading.Lock()

    def looks(self, found: Looks) -> Looks:
        """How players are shown who look in a way."""
        return Looks(hands=self._hands or found.hands, athletes=self._athletes or found.athletes)

    def shown(self, rally: CourtRally) -> CourtRally:
        """A rally with its players as they are shown."""
        looks = self.looks(Looks(hands=rally.hands, athletes=rally.athletes))
        return dataclasses.replace(rally, **looks._asdict())

    def stage(self, rally: CourtRally, continuing: Motion | None = None, from_stroke: int | None = None) -> Motion:
        """Stage a rally; one that waits for a person up to where they are expected to strike.

        Args:
            continuing: a motion with the same strokes before ``from_stroke``, whose frames do not change.
            from_stroke: number of the first stroke that differs.

        Raises:
            StagingError: the rally cannot be staged.
        """
        with self._one:
            if continuing is not None:
                return continue_motion(continuing, rally, seed=rally.key, from_stroke=from_stroke)
            return stage(rally, seed=rally.key, athletes=rally.athletes, fps=FPS)
