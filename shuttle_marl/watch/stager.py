"""Motion of rallies, staged once for all pages."""

import threading
from collections.abc import Callable
from typing import Final

from shuttle_marl.staging import Motion, continue_motion, stage
from shuttle_marl.watch.match import CourtRally
from shuttle_marl.watch.plan import Person
from shuttle_marl.watch.policies import OnceCache

FPS: Final = 50
_MAX_MOTIONS: Final = 16


class Stager:
    """Stages rallies and caches their motion."""

    def __init__(self, athletes: tuple[str, str], hands: tuple[str, str]) -> None:
        self.athletes, self.hands = athletes, hands
        self._motions = OnceCache(_MAX_MOTIONS)
        # Staging uses one core; two at a time would delay both.
        self._one = threading.Lock()

    def cached(self, rally: CourtRally, person: Person | None, compute: Callable[[], Motion]) -> Motion:
        """The motion of a rally, computed if it is not cached.

        Where a person chose strokes, the motion depends on when they did, because frames that were shown do not change.
        """
        since = person.stroke if person is not None and person.rally == rally.number else 0
        strokes = rally.stroke.tobytes(), rally.hurried.tobytes()
        court = rally.server, rally.from_right, rally.ends_changed
        key = (rally.key, court, strokes, rally.ending, rally.turn, rally.chosen, person is not None, since)
        return self._motions.get(key, compute)

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
