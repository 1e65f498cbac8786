"""Matches played out, for policies that read the score: they have no table, so nothing about them is exact."""

import dataclasses
import math
from collections.abc import Callable
from statistics import NormalDist
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.stats import binomtest

from shuttle_marl.game import draws
from shuttle_marl.game.policy import Policy
from shuttle_marl.game.table import TabulatedPolicy
from shuttle_marl.kernel.lockstep import Ints, ask, play
from shuttle_marl.kernel.played import Matches, Played

Watch = Callable[[int, Matches, Played], None]
"""``(first, matches, played)``: shown a batch of matches, those from number ``first`` on; entrant 0 is the policy that is
sampled, entrant 1 its opponent."""

_Z: Final = NormalDist().inv_cdf(0.975)
_BATCH: Final = 1 << 12
"""So many matches are played side by side."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class SampledOdds:
    """What came of a number of matches, with 95 % intervals.

    Attributes:
        matches: number of matches.
        rallies: number of rallies.
        strokes: number of strokes.
        rally: share of the rallies won.
        rally_interval: its interval, matches taken as independent and the rallies of one not.
        match: share of the matches won.
        match_interval: its interval (Wilson, J. Am. Stat. Assoc. 1927).
    """

    matches: int
    rallies: int
    strokes: int
    rally: float
    rally_interval: tuple[float, float]
    match: float
    match_interval: tuple[float, float]


def sample(
    policy: Policy,
    opponent: TabulatedPolicy,
    *,
    matches: int,
    seed: int = 0,
    key: int = 0,
    name: str = "policy",
    watch: Watch | None = None,
) -> SampledOdds:
    """Play matches of a policy against a tabulated one; seats and the first serve are balanced over four matches.

    The draws of match m are those of ``draws.stream(seed, key, m)`` in :func:`shuttle_marl.kernel.lockstep.play`.

    Args:
        policy: may read the score.
        opponent: a table.
        matches: how many.
        seed: names every draw, with ``key``.
        key: of the pairing, see :func:`shuttle_marl.game.draws.pairing_key`.
        name: of the policy, for errors.
        watch: is shown what was played, see :data:`Watch`.

    Raises:
        PolicyError: the policy raised, or returned no distribution over the legal strokes.
    """
    choose = _Choose(policy, opponent, name)
    rallies, won, strokes, wins = np.zeros(matches, dtype=np.int64), np.zeros(matches, dtype=np.int64), 0, 0
    for first in range(0, matches, _BATCH):
        number = np.arange(first, min(first + _BATCH, matches))
        seat = number & 1
        seated = Matches(
            entrant=np.stack([seat, 1 - seat], axis=1).astype(np.int32),
            first_server=((number >> 1) & 1).astype(np.int8),
            key=draws.stream(seed, key, number),
        )
        played = play(opponent.game, seated, choose, keep_strokes=watch is not None)
        if watch is not None:
            watch(first, seated, played)
        match = first + played.match
        rallies += np.bincount(match, minlength=matches)
        won += np.bincount(match, played.winner == (match & 1), minlength=matches).astype(np.int64)
        strokes += int(played.length.sum())
        wins += int((played.games.argmax(axis=1) == seat).sum())
    share = float(won.sum() / rallies.sum())
    # Ratio of sums over matches: the variance of its numerator's deviations, matches being independent.
    interval = binomtest(wins, matches).proportion_ci(method="wilson")
    spread = _Z * math.sqrt(float(((won - share * rallies) ** 2).sum())) / float(rallies.sum())
    return SampledOdds(
        matches=matches,
        rallies=int(rallies.sum()),
        strokes=strokes,
        rally=share,
        rally_interval=(max(0.0, share - spread), min(1.0, share + spread)),
        match=wins / matches,
        match_interval=(float(interval.low), float(interval.high)),
    )


class _Choose:
    """The strokes of both; entrant 0 is the policy, entrant 1 the table. See :data:`shuttle_marl.kernel.lockstep.Choose`."""

    def __init__(self, policy: Policy, opponent: TabulatedPolicy, name: str) -> None:
        self._policy, self._name = policy, name
        self._game, self._table = opponent.game, opponent.padded()

    def __call__(self, entrant: Ints, state: Ints, draw: Ints, striker: Ints, score: Ints) -> npt.NDArray[np.intp]:
        k = (self._table[state] <= draw[:, None]).sum(axis=1)
        asked = np.flatnonzero(entrant == 0)
        if len(asked):
            mine = state[asked], draw[asked], striker[asked], score[:, asked]
            k[asked] = ask(self._policy, self._name, self._game, *mine)
        return k
