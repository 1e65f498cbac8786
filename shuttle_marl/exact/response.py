"""Best responses and exploitability."""

import dataclasses

import numpy as np

from shuttle_marl.exact.fixed_point import TOLERANCE, iterate, largest_continuation
from shuttle_marl.exact.minimax import greedy_policy
from shuttle_marl.exact.profile import ProfileValue, StatePolicy, check_same_layout, induced
from shuttle_marl.exact.sweeps import best_values
from shuttle_marl.game.rally import ROOT, Game
from shuttle_marl.game.table import TabulatedPolicy


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Response:
    """The best response to a policy.

    Attributes:
        policy: the response, one stroke in every state.
        value: of the response as player 0 against the policy as player 1.
        sweeps: how often all legal pairs of the responder were swept.
    """

    policy: TabulatedPolicy
    value: ProfileValue
    sweeps: int


@dataclasses.dataclass(frozen=True, kw_only=True)
class Exploitability:
    """Gains of best responses on a profile, on the scale from -1 to 1, both players serving equally often.

    Attributes:
        nash_conv: the sum of what each player gains by answering the other one best, instead of playing the profile; 0 for a
            Nash equilibrium (Lanctot et al., NeurIPS 2017).
        error_bound: it is within this of the true one.
    """

    nash_conv: float
    error_bound: float

    @property
    def exploitability(self) -> float:
        """NashConv divided by the number of players.

        For one policy in both seats of the symmetric game this is what its best response gains, as a value: the best
        response wins ``(1 + exploitability) / 2`` of the rallies.
        """
        return self.nash_conv / 2


def best_response(policy: StatePolicy, *, game: Game | None = None, tolerance: float = TOLERANCE) -> Response:
    """The best response to a policy.

    Args:
        policy: of the opponent, player 1.
        game: the tables with which the responder, player 0, strikes; None: those of the policy, the symmetric game.
        tolerance: largest error bound that is good enough.

    Raises:
        ExactError: the layouts differ, or play may never end.
    """
    own = game or policy.game
    check_same_layout(own, policy.game)
    opponent = induced(policy)
    contraction = largest_continuation(own) * opponent.contraction
    z, sweeps, residual, bound = iterate(
        lambda x, out: best_values(own, opponent.values(x), out), np.zeros(own.n_states), contraction, tolerance
    )
    y = opponent.values(z)
    z[ROOT] = best_values(own, y)[ROOT]
    value = ProfileValue(striking=(z, y), residual=residual, contraction=contraction, error_bound=bound)
    return Response(policy=greedy_policy(own, y), value=value, sweeps=sweeps + 1)


def nash_conv(policy: StatePolicy, opponent: StatePolicy | None = None, *, tolerance: float = TOLERANCE) -> Exploitability:
    """NashConv and exploitability of a profile.

    Args:
        policy: of player 0.
        opponent: of player 1; None: ``policy`` in both seats.
        tolerance: largest error bound of a best response that is good enough.

    Raises:
        ExactError: the layouts differ, or play may never end.
    """
    answer = best_response(policy, game=opponent.game if opponent else None, tolerance=tolerance)
    other = answer if opponent is None else best_response(opponent, game=policy.game, tolerance=tolerance)
    # The game is zero-sum, so what both players get from the profile itself adds up to 0.
    gain = answer.value.odds().value + other.value.odds().value
    return Exploitability(nash_conv=gain, error_bound=answer.value.error_bound + other.value.error_bound)
