"""``history=K``: the last K strokes of each player in an observation."""

import numpy as np

from shuttle_marl.base.arrays import F32, I32, Bools, Intp
from shuttle_marl.game.layout import stroke_features
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel import RallyBatch


class BatchHistory:
    """The last K strokes in every row of a batch.

    Args:
        length: number of strokes K of each player.

    Attributes:
        strokes: ``[B, 2, K]`` int32 catalogue indices, latest first, n where there are none: those of the learner, or without
            opponents of the striker, then those of the other player.
    """

    def __init__(self, batch: RallyBatch, length: int) -> None:
        self._batch = batch
        self.strokes: I32 = np.full((len(batch), 2, length), batch.game.n_strokes, np.int32)
        self.note()

    def note(self) -> None:
        """Note where the rows are, before they strike."""
        rows = self._batch.rows
        self._key, self._count, self._waited = rows.key.copy(), rows.stroke.copy(), self._batch.waits

    def step(self, struck: Bools | None = None) -> None:
        """Take the strokes since :meth:`note`, and note again; ``struck``: ``[B]`` whether the action was legal; None: all."""
        rows, alone = self._batch.rows, not self._batch.n_opponents
        began = rows.key != self._key
        goes_on = ~began if struck is None else ~began & struck
        latest, before = self._latest()
        if alone:
            self.strokes = self.strokes[:, ::-1].copy()
            self._push(np.flatnonzero(~began), 1, latest)
        else:
            own = goes_on & ~self._waited
            mine = rows.striker == self._batch.opponents.seat  # the opponent has struck last
            self._push(np.flatnonzero(own), 0, np.where(mine, before, latest))
            self._push(np.flatnonzero(goes_on & (rows.stroke - self._count > own)), 1, np.where(mine, latest, before))
        self.begin(began)

    def begin(self, rows: Bools) -> None:
        """Start the rallies of some rows, in which at most the opponent has served, and note where all rows are."""
        self.strokes[rows] = self._batch.game.n_strokes
        self._push(np.flatnonzero(rows & (self._batch.rows.stroke > 0)), 1, self._latest()[0])
        self.note()

    def _latest(self) -> tuple[I32, I32]:
        """``[B]`` each: the last stroke and the one before it; n where there is none."""
        game, state = self._batch.game, self._batch.rows.state
        return game.incoming(state), game.own(state)

    def _push(self, rows: Intp, player: int, stroke: I32) -> None:
        self.strokes[rows, player, 1:] = self.strokes[rows, player, :-1]
        self.strokes[rows, player, 0] = stroke[rows]


def features_of(game: Game, strokes: I32) -> F32:
    """``[B, 54 K]`` features of ``[B, 2, K]`` strokes: 27 numbers for each, as of the last ones, zero where there are none."""
    return stroke_features(game)[strokes].reshape(len(strokes), -1)
