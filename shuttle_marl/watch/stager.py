"""Rallies as motion, staged once for all who watch them."""

import threading
from typing import Final

import numpy as np

from shuttle_marl.game.rally import Game
from shuttle_marl.staging import Motion, PlayedRally, stage
from shuttle_marl.watch.match import Rally
from shuttle_marl.watch.tables import Kept

FPS: Final = 50
_MOST_MOTIONS: Final = 96


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

    def motion(self, rally: Rally) -> Motion | None:
        """The motion of a rally; None if no stroke was played.

        Raises:
            StagingError: it cannot be staged.
        """
        if not rally.stroke or rally.ending is None:
            return None
        key = (rally.key, rally.server, rally.stroke, rally.ending)
        return self._motions.get(key, lambda: self._staged(rally))

    def _staged(self, rally: Rally) -> Motion:
        assert rally.ending is not None
        played = PlayedRally(
            catalogue=self._game.catalogue,
            server=rally.server,
            stroke=np.array(rally.stroke, dtype=np.int64),
            ending=rally.ending,
        )
        with self._one:
            return stage(played, seed=rally.key, handedness=self._hands, athletes=self._athletes, fps=FPS)
