"""One stroke at a time, in plain Python numbers: its observation, its draw, and the table read that decides it.

The rule is that of :func:`shuttle_marl.game.rules.strike` and the draws are those of :mod:`shuttle_marl.game.draws`, without
the cost of numpy calls on single numbers; tests hold both equal.
"""

import functools
from array import array
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shuttle_marl.arrays import F32, U64
from shuttle_marl.game.draws import choice_draw, draw, outcome_draw, stream
from shuttle_marl.game.observation import EFFORT, SWAP, features
from shuttle_marl.game.rules import RETURNED_BELOW
from shuttle_marl.game.tables import Game
from shuttle_marl.game.thresholds import ONE

Observation = dict[str, npt.NDArray[Any]]
"""Observation of an agent: ``observation`` and ``action_mask``."""


class Stroke(NamedTuple):
    """A stroke that was played.

    Attributes:
        player: who played it, 0 or 1.
        stroke: catalogue index.
        outcome: index into :data:`shuttle_marl.game.rules.OUTCOMES`.
        p_succ: probability that the stroke was good.
        p_ret: probability that a good one was returned.
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
        rows: ``[base states, 59]`` float32 observation of the striker in each state without efforts.
        masks: ``[2 (n + 1), n]`` int8 legal strokes by ``reply(state)``.
        swap: ``[59]`` permutation that turns the striker's observation into the receiver's.
    """

    swap = SWAP

    def __init__(self, game: Game) -> None:
        self.game = game
        self.rows = features(game)
        self.masks = np.ascontiguousarray(game.reply_mask.reshape(-1, game.n_strokes).astype(np.int8))
        self._n = game.n_strokes
        # A memoryview yields Python integers four times as fast as an array, without the memory of a list.
        self._rank = _view(game.reply_rank)
        self._limits = [_view(limits) for limits in game.limits]
        self._pair_start = _view(game.base_pair_start)
        self._first_reply = _view(game.first_reply)
        self._arrival = _view(2 * game.reply_edge + game.edge_attack[game.reply_edge])
        self._incoming = _view(game.edge_incoming)
        self._size, self._levels = game.n_base_states, game.levels
        self._after = [tuple(b * self._size for b in game.block_following(block)) for block in range(game.n_blocks)]
        highest = max(1, game.levels - 1)
        self._efforts = slice(EFFORT, EFFORT + 2)
        self._shares = [(own / highest, other / highest) for own in range(game.levels) for other in range(game.levels)]

    def __deepcopy__(self, memo: dict[int, Any]) -> "StrokeTables":
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return tables_of, (self.game,)

    def row(self, state: int) -> F32:
        """``[59]`` observation of the striker in a state, a new array."""
        block, base = divmod(state, self._size)
        row: F32 = self.rows[base].copy()
        if block:
            row[self._efforts] = self._shares[block]
        return row

    def reply(self, state: int) -> int:
        """Row of :attr:`masks`: twice the incoming stroke plus the contact."""
        return 2 * self._incoming[state % self._size >> 1] + (state & 1)

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
            Outcome, the receiver's state (where the rally is over, that after its last stroke, contact below), the
            probability that the stroke is good, and the probability that a good one is returned.
        """
        block, base = divmod(state, self._size)
        k = self._rank[(2 * self._incoming[base >> 1] + (base & 1)) * self._n + stroke]
        entry = 3 * (self._pair_start[base] + k)
        limits = self._limits[block // self._levels]
        fault, winner = limits[entry], limits[entry + 1]
        outcome = (draw >= fault) + (draw >= winner) + (draw >= limits[entry + 2])
        arrival = self._arrival[self._first_reply[base] + k]
        following = self._after[block][arrival & 1] + (arrival & ~1) + max(outcome - RETURNED_BELOW, 0)
        return outcome, following, (ONE - fault) / ONE, (ONE - winner) / (ONE - fault)


def _view(table: npt.NDArray[Any]) -> memoryview:
    return np.ascontiguousarray(table).ravel().data


@functools.lru_cache(maxsize=8)
def tables_of(game: Game) -> StrokeTables:
    """The prepared tables of a game, made once."""
    return StrokeTables(game)


_RALLIES: Final = 32
_STROKES: Final = 32


class EpisodeDraws:
    """Draws of rallies 0, 1, 2, … of one stream, made many at a time.

    Stroke k of rally r is decided by ``outcome_draw(draw(stream(seed, *numbers, r), k))``, and chosen by the ``choice_draw`` of
    the same number where a policy plays; bit 16 at k = 0 says who serves where that is drawn at random.
    """

    def __init__(self, seed: int, *numbers: int) -> None:
        self._name = (seed, *numbers)
        self._block = -1
        self._bits: U64 = np.empty(0, np.uint64)
        self._outcomes = array("H")
        self._choices = array("H")
        self._first_servers = b""

    def __reduce__(self) -> tuple[Any, ...]:
        return EpisodeDraws, self._name  # the draws follow from that

    def first_server(self, rally: int) -> int:
        """Seat that serves first in a rally, drawn at random: 0 or 1."""
        self._prepare(rally)
        return self._first_servers[rally % _RALLIES]

    def rally(self, rally: int) -> "array[int]":
        """The first draws of a rally, uniform in [0, 65536); :meth:`more` has the next ones."""
        self._prepare(rally)
        start = rally % _RALLIES * _STROKES
        return self._outcomes[start : start + _STROKES]

    def more(self, rally: int, known: int) -> "array[int]":
        """Draws ``known`` and following of a rally."""
        bits = draw(stream(*self._name, rally), np.arange(known, known + _STROKES))
        return array("H", outcome_draw(bits).astype(np.uint16).tobytes())

    def choice(self, rally: int, stroke: int) -> int:
        """The number in [0, 65535) by which a policy chooses a stroke."""
        if stroke >= _STROKES:
            return int(choice_draw(draw(stream(*self._name, rally), stroke))[0])
        self._prepare(rally)
        if not self._choices:
            self._choices = array("H", choice_draw(self._bits).astype(np.uint16).tobytes())
        return self._choices[rally % _RALLIES * _STROKES + stroke]

    def _prepare(self, rally: int) -> None:
        block = rally // _RALLIES
        if block != self._block:
            rallies = np.arange(block * _RALLIES, (block + 1) * _RALLIES)
            bits = draw(stream(*self._name, rallies)[:, None], np.arange(_STROKES))
            self._outcomes = array("H", outcome_draw(bits).astype(np.uint16).tobytes())
            self._bits, self._choices = bits, array("H")
            self._first_servers = ((bits[:, 0] >> np.uint64(16)) & np.uint64(1)).astype(np.uint8).tobytes()
            self._block = block
