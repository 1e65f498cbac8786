"""Three scripted styles of play: preferences in points, played through a softmax.

Every rule adds or subtracts points; a stroke with one more point is played e (2.7) times as often. Rules depend on shot types,
target areas, the contact, the incoming shot, and the position of the opponent, who struck where one's own last stroke landed.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from shuttle_marl.arrays import F64, I64
from shuttle_marl.game.court import area_centre
from shuttle_marl.game.policy import States
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.thresholds import ONE
from shuttle_marl.policy.plain_network import legal_softmax

Rules = Callable[[States], F64]
"""Function from a batch of states to ``[B, n]`` points of every stroke; illegal strokes are masked afterwards."""

SERVE: Final = {"short-serve": 2.0, "long-serve": 0.0}
"""Serves: short, because a long serve can be smashed."""

ATTACK_ABOVE: Final = {
    "smash": 4.0,
    "net-kill": 4.0,
    "half-smash": 3.0,
    "drop": 2.0,
    "push": 2.0,
    "drive": 1.5,
    "net-shot": 1.0,
    "cross-court-net-shot": 1.0,
    "block": 0.5,
    "clear": -1.0,
}
"""Attacking, contact above the net: hit down and hard; a clear loses the attack."""
ATTACK_BELOW: Final = {
    "net-shot": 2.5,
    "cross-court-net-shot": 2.5,
    "push": 2.0,
    "drive": 2.0,
    "block": 1.5,
    "drop": 1.0,
    "clear": -1.0,
    "lift": -1.0,
}
"""Attacking, contact below the net: keep the shuttle flat or tight, so that the opponent has to lift."""

DEFEND: Final = {
    "short-serve": 2.0,
    "long-serve": 0.0,
    "net-kill": 4.0,
    "lift": 3.5,
    "drop": 1.5,
    "net-shot": 2.0,
    "half-smash": 2.0,
    "clear": 1.0,
    "block": 1.0,
    "push": 0.5,
    "drive": 0.0,
    "cross-court-net-shot": 0.0,
    "smash": 0.0,
}
"""Defensive: lift high and deep from below; soft strokes from above, except net kills; no risky angles at the net."""
DEFEND_AGAINST_SMASH: Final = {"lift": 2.0, "block": 1.0, "drive": -1.0}
"""Defensive, in addition, against a smash, half smash or net kill: lift to gain time, or absorb the pace."""
POWER: Final = ("smash", "half-smash", "net-kill")


@dataclasses.dataclass(frozen=True, eq=False)
class ScriptedPolicy:
    """Softmax over the points of each stroke.

    Attributes:
        points: the rules.
    """

    points: Rules

    def probabilities(self, states: States) -> F64:
        """``[B, n]`` softmax of the points over the legal strokes."""
        return legal_softmax(self.points(states), states.mask)


def attacking(states: States) -> F64:
    """Hit down from above, stay flat or tight from below, serve short, and send the opponent running.

    Each metre between the opponent and the target gives 0.5 points.
    """
    shot = states.game.catalogue.shot
    above = states.contact[:, None] == 1
    preference = np.where(above, _by_shot(ATTACK_ABOVE)[shot], _by_shot({**ATTACK_BELOW, **SERVE})[shot])
    return preference + 0.5 * distance_from_opponent(states)


def defensive(states: States) -> F64:
    """Play high and deep, absorb the smash, and aim at the centre so that the opponent gets no angle.

    A target off the centre line costs a point, and a lift, clear or long serve that is not deep costs 2 points.
    """
    catalogue = states.game.catalogue
    points = _by_shot(DEFEND)[catalogue.shot]
    points = points - (catalogue.area % 3 != 1)
    high = np.isin(catalogue.shot, [SHOTS.index(name) for name in ("lift", "clear", "long-serve")])
    points = points - 2.0 * (high & (catalogue.area // 3 != 2))
    smashed = np.isin(_incoming_shot(states), [SHOTS.index(name) for name in POWER])
    return points + smashed[:, None] * _by_shot(DEFEND_AGAINST_SMASH)[catalogue.shot]


def safe(states: States) -> F64:
    """Keep the shuttle in play, and the opponent from hitting down.

    Each percentage point less of the probability of a fault gives 1 point, each one less of the probability that the opponent
    returns the shuttle from above the net 0.1, and each one of the probability that it is not returned at all 0.05. The
    probabilities are read from the game itself.
    """
    game = states.game
    row, pair = game.pairs(states.state)
    fault, winner, below = game.limits_of(pair).T.astype(np.float64) / ONE  # cumulative
    points = np.zeros((len(states), game.n_strokes))
    points[row, game.base_pair_stroke[pair % game.n_base_pairs]] = (
        100.0 * (1 - fault) - 10.0 * (1 - below) + 5.0 * (winner - fault)
    )
    return points


STYLES: Final[Mapping[str, Rules]] = {"attacking": attacking, "defensive": defensive, "safe": safe}
"""The rule sets by the name of the policy."""


def distance_from_opponent(states: States) -> F64:
    """``[B, n]`` metres between the opponent and the centre of each stroke's target area; 0 where no one has moved yet.

    The opponent is taken to stand at the centre of the area to which the striker's own last stroke went.
    """
    catalogue = states.game.catalogue
    target = area_centre(catalogue.area)
    between = np.linalg.norm(target[:, None] - target[None], axis=-1)
    return np.vstack([between, np.zeros(len(catalogue))])[states.own]


def _by_shot(points: Mapping[str, float]) -> F64:
    """``[13]`` points of every shot type, 0 for those that are not named."""
    return np.array([points.get(name, 0.0) for name in SHOTS])


def _incoming_shot(states: States) -> I64:
    """``[B]`` shot type of the incoming stroke, -1 when serving."""
    return np.r_[states.game.catalogue.shot.astype(np.int64), -1][states.incoming]
