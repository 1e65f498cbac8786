"""Regret: the value a policy loses to perfect play, stroke by stroke.

In a state s the policy loses regret(s) = V*(s) - sum_a pi(a | s) Q*(s, a) by not playing the best stroke, Q* the minimax value
of a stroke. Weighted by how often the policy strikes in s, the regrets add up exactly to what it loses against a perfect
opponent (the performance difference lemma: Kakade & Langford, ICML 2002):

    V* - V^pi = sum_s visits(s) regret(s),        visits: of the policy against the minimax policy.
"""

import dataclasses

import numpy as np
import numpy.typing as npt

from shuttle_marl.exact.fixed_point import TOLERANCE
from shuttle_marl.exact.minimax import Solution, solve
from shuttle_marl.exact.occupancy import visits
from shuttle_marl.exact.profile import StatePolicy

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Regret:
    """Value lost by a policy, on the scale of values from -1 to 1.

    Attributes:
        state: ``[S]`` loss of the stroke played in each state, on average over the policy.
        weight: ``[S]`` how often the policy strikes there in a rally, both players serving equally often.
        per_rally: loss in a rally: the sum over both.
        error_bound: ``per_rally`` is within this of the true one.
    """

    state: Floats
    weight: Floats
    per_rally: float
    error_bound: float

    @property
    def per_stroke(self) -> float:
        """Loss of a stroke of the policy, on average."""
        return self.per_rally / float(self.weight.sum())

    def largest(self, count: int) -> npt.NDArray[np.intp]:
        """The states in which the policy gives away most in a rally, most first."""
        return np.argsort(-self.state * self.weight, kind="stable")[:count]


def policy_regret(
    policy: StatePolicy,
    opponent: StatePolicy | None = None,
    *,
    solution: Solution | None = None,
    tolerance: float = TOLERANCE,
) -> Regret:
    """The regret of a policy in seat 0, weighted by its visits.

    Args:
        policy: whose regret.
        opponent: against whom the visits are counted; None: the minimax policy, where the sum is V* - V^pi at the serve.
        solution: the solved game, if it is there already; it must be of the policy's game.
        tolerance: error bound of the values and of the visits.

    Raises:
        ExactError: the layouts differ, or play may never end.
    """
    solution = solution or solve(policy.game, tolerance=tolerance)
    value, following = solution.value
    game = policy.game
    state = value - game.sum_by_state(policy.pair_probabilities() * game.stroke_values(following))
    counted = visits(policy, opponent or solution.policy[1], tolerance=tolerance)
    weight = counted.states[0]
    # A state's regret is at most 2 and off by two values at most.
    bound = 2 * solution.error_bound * float(weight.sum()) + 2 * counted.error_bound
    return Regret(state=state, weight=weight, per_rally=float(weight @ state), error_bound=bound)
