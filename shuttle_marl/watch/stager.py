"""Motion of rallies."""

import threading
from typing import Final

from shuttle_marl.staging import Motion, continue_motion, stage
from shuttle_marl.watch.match import CourtRally

FPS: Final = 50


class Stager:
    """Stages rallies with players of one appearance."""

    def __init__(self, athletes: tuple[str, str], hands: tuple[str, str]) -> None:
        self.athletes, self.hands = athletes, hands
        # Staging uses one core; two at a time would delay both.
        self._one = threading.Lock()

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
            return stage(rally, seed=rally.key, handedness=self.hands, athletes=self.athletes, fps=FPS)
