"""Where to wait: what the positions of a receiver are worth in one state of the game with recovery.

Both players choose at the same time, so perfect play mixes, and several positions may be as good as the best one. A position is
judged by its **loss**: how many more rallies the striker wins, if they strike and both go on as perfect play does.
"""

import dataclasses
from typing import Final

import numpy as np

from shuttle_marl.analysis.decisions import USUAL
from shuttle_marl.base.arrays import F64, I64
from shuttle_marl.exact import Solution
from shuttle_marl.game.recovery import CENTRE
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import position_shares

GOOD: Final = 0.005
"""Loss up to which a position counts as good as the best one, in rallies."""
MATTERS: Final = 0.02
"""Loss of the position chosen from which it is asked where to wait."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Places:
    """The M feasible positions of a receiver, against the K legal strokes of the striker.

    Attributes:
        position: ``[M]`` positions, rising.
        people, perfect: ``[M]`` probabilities of people's choices and of perfect play.
        win: ``[K, M]`` probability that the striker wins the rally with a stroke, under perfect play from then on.
        struck: ``[K]`` probabilities of the strokes under perfect play.
    """

    position: I64
    people: F64
    perfect: F64
    win: F64
    struck: F64

    @property
    def loss(self) -> F64:
        """``[M]`` rallies that a position loses to the best one, against perfect strokes."""
        lost = self.struck @ self.win
        return np.asarray(lost - lost.min())

    @property
    def gain(self) -> F64:
        """``[K, M]`` rallies that a stroke wins more than against a receiver who waits as people do."""
        return np.asarray(self.win - (self.win @ self.people)[:, None])

    def question(self, waited: int) -> int | None:
        """How usual the answer is to the question where to wait for a receiver who waits somewhere; None: it is not asked.

        It is asked where the position loses clearly and at least one more does. The middle of the court is the usual answer,
        the last rank, all others have rank 0, as in :func:`shuttle_marl.analysis.decisions.usual_of`.
        """
        loss = dict(zip(self.position.tolist(), self.loss.tolist(), strict=True))
        wrong = sum(lost > GOOD for lost in loss.values())
        if loss.get(waited, 0.0) < MATTERS or wrong < 2:  # the receiver of a recorded rally may wait where few do
            return None
        return 0 if loss.get(CENTRE, 1.0) > GOOD else len(USUAL)


def places_of(game: Game, state: int, seat: int, solution: Solution) -> Places | None:
    """The positions between which the receiver chooses while a seat strikes in a state; None: they have no choice."""
    tables = game.seats[seat]
    people = tables.people_positions(state) if tables.recovery is not None else np.ones(1)
    position = np.flatnonzero(people)
    if len(position) < 2:
        return None
    pairs = tables.pair_at(state, np.arange(len(tables.legal_strokes(state))))
    after = solution.value[1 - seat][tables.arrivals(pairs)]
    outcome = np.stack([tables.outcome_probabilities(pairs, int(one)) for one in position], axis=1)
    value = outcome[..., 1] - outcome[..., 0] - (outcome[..., 2:] * after[:, None]).sum(axis=-1)
    return Places(
        position=position,
        people=people[position],
        perfect=position_shares(solution.policy[1 - seat].waiting_table[state])[position],
        win=(1 + value) / 2,
        struck=solution.policy[seat].probability_of(pairs),
    )
