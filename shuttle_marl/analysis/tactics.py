"""What if a player used a tactic more: effects on winning.

A tactic is a set of strokes within a set of alternatives, such as straight smashes within all smashes to a side. *Ten more of
a hundred* moves the probability of the set within its alternatives by 0.1 in every state, up to 0 or 1, and leaves the
proportions within both sets, and all other strokes, as they are. The effect is its first derivative in the refits: the sum over
pairs of (changed minus usual probability) times advantage times visits.
"""

import dataclasses
from typing import Final

import numpy as np

from shuttle_marl.analysis.advice import LEAST_STEADY, Refitted, calibrated
from shuttle_marl.base.arrays import F64, Bools
from shuttle_marl.dynamics.habits import straight
from shuttle_marl.game.pairs import people_of
from shuttle_marl.game.shipped import Estimate
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import Game

TACTICS: Final = ("short_serve", "straight_smash", "net_shot", "attack", "risk")
"""Keys of the tactics."""
STEP: Final = 0.1
"""Change of the probability of a tactic within its alternatives."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Effect:
    """Effect of using a tactic more or less.

    Attributes:
        tactic: one of :data:`TACTICS`.
        share: share of the tactic within its alternatives, as the player plays now.
        often: strokes among the alternatives in a rally.
        more: expected effect on rallies won of one :data:`STEP`, calibrated, with its 90 % interval.
        steady: share of the refits in which the effect has the sign of the mean.
    """

    tactic: str
    share: float
    often: float
    more: Estimate
    steady: float

    @property
    def clear(self) -> bool:
        """Whether the direction of the effect is known."""
        return self.steady >= LEAST_STEADY and self.more.low * self.more.high > 0


def _sets(game: Game, usual: F64, *, opposite: bool) -> dict[str, tuple[Bools, Bools]]:
    """Strokes of each tactic, and its alternatives with them, ``[base pairs]`` each.

    Args:
        opposite: whether the receiver has the other hand.
    """
    catalogue, stroke, state = game.catalogue, game.base_pair_stroke, game.base_pair_state
    shot, area, above = catalogue.shot[stroke], catalogue.area[stroke].astype(np.int64), game.contact(state) == 1
    met = np.append(catalogue.area, -1)[game.incoming(state)].astype(np.int64)

    def one_of(*names: str) -> Bools:
        return np.isin(shot, [SHOTS.index(name) for name in names])

    serving = one_of("short-serve", "long-serve")
    wide = (met >= 0) & (met % 3 != 1) & (area % 3 != 1)
    smash = one_of("smash", "half-smash") & wide
    net = one_of("net-shot", "cross-court-net-shot")
    low_at_net = (met >= 0) & (met // 3 == 0) & ~above
    fault = game.outcome_probabilities(np.arange(game.n_base_pairs))[:, 0]
    mean = np.bincount(state, usual * fault, game.n_base_states)[state]
    return {
        "short_serve": (one_of("short-serve"), serving),
        "straight_smash": (smash & straight(met, area, opposite=opposite), smash),
        "net_shot": (net & low_at_net, (net | one_of("lift")) & low_at_net),
        "attack": (one_of("smash", "half-smash", "net-kill") & above, above & ~serving),
        "risk": ((fault > mean) & ~serving, ~serving),
    }  # fmt: skip


def changed(game: Game, usual: F64, tactic: Bools, among: Bools, change: float) -> F64:
    """``[base pairs]`` probabilities with a tactic used more or less.

    Args:
        usual: ``[base pairs]`` probabilities before.
        tactic, among: ``[base pairs]`` strokes of the tactic, and its alternatives with them.
        change: of the probability of the tactic within its alternatives.
    """
    state, n = game.base_pair_state, game.n_base_states
    all_of = np.bincount(state[among], usual[among], n)
    part = np.bincount(state[tactic], usual[tactic], n)
    both = (part > 0) & (part < all_of)
    now = np.divide(part, all_of, out=np.zeros(n), where=both)
    then = np.clip(now + change, 0, 1)
    up = np.where(both, then / np.where(both, now, 1), 1)
    down = np.where(both, (1 - then) / np.where(both, 1 - now, 1), 1)
    return np.where(tactic, usual * up[state], np.where(among, usual * down[state], usual))


def effects(found: Refitted) -> list[Effect]:
    """Effects of all tactics of the player at seat 0."""
    policy = found.home.policies[0]
    game, usual = policy.game, policy.block_probabilities(0)
    hands = people_of(found.pair).hands
    sets = _sets(game, usual, opposite=hands[0] != hands[1])
    weight = (found.home.visits(0)[game.base_pair_state] * usual).astype(np.float64)
    advantages = [each.advantages(0) for each in found.refits or (found.home,)]
    out = []
    for name in TACTICS:
        tactic, among = sets[name]
        slope = changed(game, usual, tactic, among, STEP) - usual
        more = np.array([float(slope @ each) for each in advantages])
        often = float(weight[among].sum())
        out.append(
            Effect(
                tactic=name,
                share=float(weight[tactic].sum()) / often if often else float("nan"),
                often=often,
                more=calibrated(more, found.factor),
                steady=float((np.sign(more) == np.sign(more.mean())).mean()) if found.refits else 0.0,
            )
        )
    return out
