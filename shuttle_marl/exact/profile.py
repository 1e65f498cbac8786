"""The value of a profile: two tabulated policies, one for each player, against each other."""

import dataclasses

import numpy as np
import numpy.typing as npt

from shuttle_marl.exact.contraction import FIRST_RALLY_STATE, TOLERANCE, error_bound
from shuttle_marl.exact.induced import InducedChain, check_same_layout, induced
from shuttle_marl.exact.linear import solve_linear
from shuttle_marl.exact.odds import Odds
from shuttle_marl.game.rally import ROOT
from shuttle_marl.game.table import TabulatedPolicy

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ProfileValue:
    """What every state is worth when player 0 and player 1 play given policies.

    Attributes:
        striking: ``[S]`` each: value of the states in which player 0 strikes, to player 0, and of those in which player 1
            strikes, to player 1. Values lie between -1 and 1: the chance to win the rally minus the chance to lose it, so
            the chance to win is ``(1 + value) / 2``.
        residual: by how much the last sweep changed a value.
        contraction: factor by which a pair of sweeps shrinks an error.
        error_bound: every value is within this of the true one (:mod:`shuttle_marl.exact.contraction`).
    """

    striking: tuple[Floats, Floats]
    residual: float
    contraction: float
    error_bound: float

    def odds(self, player: int = 0) -> Odds:
        """How a player fares against the other."""
        serving, receiving = self.striking[player][ROOT], -self.striking[1 - player][ROOT]
        # Rounding may carry a value of a certain rally past 1.
        chances = (min(1.0, max(0.0, (1 + float(value)) / 2)) for value in (serving, receiving))
        return Odds(serving=next(chances), receiving=next(chances), error_bound=self.error_bound / 2)


def evaluate(policy: TabulatedPolicy, opponent: TabulatedPolicy, *, tolerance: float = TOLERANCE) -> ProfileValue:
    """The exact value of player 0 playing ``policy`` against player 1 playing ``opponent``.

    Player i strikes with the tables of the game that its policy was tabulated for. In the symmetric game that is the same
    game; where the players have profiles of their own, it is the game with the striker's success and the receiver's return.

    Args:
        policy: of player 0.
        opponent: of player 1.
        tolerance: largest error bound that is good enough.

    Raises:
        ExactError: the two games have different layouts, or play may go on for ever.
    """
    check_same_layout(policy.game, opponent.game)
    first = induced(policy)
    return evaluate_chains(first, first if opponent is policy else induced(opponent), tolerance=tolerance)


def evaluate_chains(first: InducedChain, second: InducedChain, *, tolerance: float = TOLERANCE) -> ProfileValue:
    """:func:`evaluate` for policies whose chains are there already; both must be of games with the same layout."""
    contraction = first.contraction * second.contraction
    # Eliminating the second player: V_0 = r_0 - C_0 (r_1 - C_1 V_0).
    z, residual, bound = solve_linear(
        first.values(second.reward),
        lambda x: first.go_on(second.go_on(x)),
        norm=lambda r: float(np.abs(r[FIRST_RALLY_STATE:]).max(initial=0.0)),
        bound=lambda residual, _: error_bound(residual, contraction),
        tolerance=tolerance,
    )
    y = second.values(z)
    z[ROOT] = first.values(y)[ROOT]
    return ProfileValue(striking=(z, y), residual=residual, contraction=contraction, error_bound=bound)
