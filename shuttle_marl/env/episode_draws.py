"""The random numbers of one rally after another, named by seed, rally and stroke as in :mod:`shuttle_marl.game.draws`."""

from array import array
from typing import Final

import numpy as np

from shuttle_marl.game.draws import UInt64s, choice_draw, draw, outcome_draw, stream

_RALLIES: Final = 32
_STROKES: Final = 32


class EpisodeDraws:
    """Draws of rallies 0, 1, 2, … of one stream, made many at a time.

    Stroke k of rally r is decided by ``outcome_draw(draw(stream(seed, *numbers, r), k))``, and chosen by the ``choice_draw`` of
    the same number where a policy plays; bit 16 at k = 0 says who serves where that is drawn by lot.
    """

    def __init__(self, seed: int, *numbers: int) -> None:
        self._name = (seed, *numbers)
        self._block = -1
        self._bits: UInt64s = np.empty(0, np.uint64)
        self._outcomes = array("H")
        self._choices = array("H")
        self._lots = b""

    def first_server(self, rally: int) -> int:
        """Who serves first in a rally, by lot: 0 or 1."""
        self._prepare(rally)
        return self._lots[rally % _RALLIES]

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
            self._lots = ((bits[:, 0] >> np.uint64(16)) & np.uint64(1)).astype(np.uint8).tobytes()
            self._block = block
