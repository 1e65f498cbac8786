"""One stroke at a time on the tables of a game, in plain Python numbers.

The same rule as :func:`shuttle_marl.game.rally.strike`, without the cost of numpy calls on single numbers; a test holds the
two equal.
"""

import functools
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from shuttle_marl.env.observation import features
from shuttle_marl.game.rally import ONE, Game


class Stroke(NamedTuple):
    """A stroke that was played.

    Attributes:
        player: who played it, 0 or 1.
        stroke: catalogue index.
        outcome: index into :data:`shuttle_marl.game.rally.OUTCOMES`.
        p_succ: chance that the stroke was good.
        p_ret: chance that a good one was returned.
    """

    player: int
    stroke: int
    outcome: int
    p_succ: float
    p_ret: float


class StrokeTables:
    """A game prepared for playing strokes one at a time; read-only and shared by all environments of the game.

    Attributes:
        game: the tables.
        rows: ``[S, 56]`` float32 observation of the striker in each state.
        masks: ``[2 (n + 1), n]`` int8 legal strokes by ``reply(state)``.
    """

    def __init__(self, game: Game) -> None:
        self.game = game
        self.rows = features(game)
        self.masks = np.ascontiguousarray(game.reply_mask.reshape(-1, game.n_strokes).astype(np.int8))
        self._n = game.n_strokes
        # A memoryview yields Python integers four times as fast as an array, without the memory of a list.
        self._rank = _view(game.reply_rank)
        self._threshold = _view(game.threshold)
        self._pair_start = _view(game.pair_start)
        self._reply_start = _view(game.reply_start)
        self._incoming = _view(game.edge_incoming)

    def __deepcopy__(self, memo: dict[int, Any]) -> "StrokeTables":
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return tables_of, (self.game,)

    def reply(self, state: int) -> int:
        """Row of :attr:`masks`: twice the incoming stroke plus the contact."""
        return 2 * self._incoming[state >> 1] + (state & 1)

    def is_legal(self, state: int, stroke: int) -> bool:
        """Whether a stroke is in the catalogue and legal in a state."""
        return 0 <= stroke < self._n and self._rank[self.reply(state) * self._n + stroke] >= 0

    def strike(self, state: int, stroke: int, draw: int) -> tuple[int, int, float, float]:
        """Play a legal stroke.

        Args:
            state: state of the striker.
            stroke: catalogue index, legal in this state; not checked.
            draw: uniform integer in [0, 65536).

        Returns:
            Outcome, the edge that follows (own last and incoming stroke of the receiver, also where the rally is over),
            the chance that the stroke is good, and the chance that a good one is returned.
        """
        reply = 2 * self._incoming[state >> 1] + (state & 1)
        k = self._rank[reply * self._n + stroke]
        entry = 3 * (self._pair_start[state] + k)
        threshold = self._threshold
        fault, winner = threshold[entry], threshold[entry + 1]
        outcome = (draw >= fault) + (draw >= winner) + (draw >= threshold[entry + 2])
        return outcome, self._reply_start[reply] + k, (ONE - fault) / ONE, (ONE - winner) / (ONE - fault)


def _view(table: npt.NDArray[Any]) -> memoryview:
    return np.ascontiguousarray(table).ravel().data


@functools.lru_cache(maxsize=8)
def tables_of(game: Game) -> StrokeTables:
    """The prepared tables of a game, made once."""
    return StrokeTables(game)
