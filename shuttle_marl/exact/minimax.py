"""Perfect play by both: value iteration on the whole game (Shapley 1953)."""

import dataclasses

import numpy as np
import numpy.typing as npt

from shuttle_marl.exact.fixed_point import TOLERANCE, iterate, largest_continuation
from shuttle_marl.exact.profile import check_same_layout
from shuttle_marl.exact.sweeps import best_values, greedy_strokes
from shuttle_marl.game.draws import CHOICE_ONE
from shuttle_marl.game.rally import ROOT, Game
from shuttle_marl.game.table import TabulatedPolicy

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Solution:
    """The solved game.

    Attributes:
        games: the tables with which player 0 and player 1 strike; one and the same in the symmetric game.
        value: ``[S]`` each: minimax value of the states in which player 0 strikes, to player 0, and of those in which player
            1 strikes, to player 1; from -1 to 1.
        policy: of each player, the best stroke in every state.
        sweeps: how often all legal pairs of a game were swept.
        residual: by how much the last sweep before the bound was met changed a value.
        contraction: factor by which a sweep (a pair of sweeps, where the games differ) shrinks an error.
        error_bound: every value is within this of the true one (:mod:`shuttle_marl.exact.fixed_point`).
    """

    games: tuple[Game, Game]
    value: tuple[Floats, Floats]
    policy: tuple[TabulatedPolicy, TabulatedPolicy]
    sweeps: int
    residual: float
    contraction: float
    error_bound: float

    @property
    def value_at_serve(self) -> float:
        """Value of a rally to player 0, who serves it."""
        return float(self.value[0][ROOT])


def solve(game: Game, other: Game | None = None, *, tolerance: float = TOLERANCE) -> Solution:
    """Minimax value and policies.

    Args:
        game: the tables with which player 0 strikes.
        other: those with which player 1 strikes, of the same layout; None: the same, the symmetric game.
        tolerance: largest error bound that is good enough.

    Raises:
        ExactError: the layouts differ, or some stroke never ends a rally.
    """
    if other is None or other is game:
        return _solve_symmetric(game, tolerance)
    check_same_layout(game, other)
    contraction = largest_continuation(game) * largest_continuation(other)
    between = np.empty(game.n_states)

    def operator(x: Floats, out: Floats) -> None:
        best_values(game, best_values(other, x, between), out)

    z, sweeps, residual, bound = iterate(operator, np.zeros(game.n_states), contraction, tolerance)
    y = best_values(other, z)
    z[ROOT] = best_values(game, y)[ROOT]
    policies = (greedy_policy(game, y), greedy_policy(other, z))
    return Solution(
        games=(game, other),
        value=(z, y),
        policy=policies,
        sweeps=2 * sweeps + 2,
        residual=residual,
        contraction=contraction,
        error_bound=bound,
    )


def _solve_symmetric(game: Game, tolerance: float) -> Solution:
    contraction = largest_continuation(game)
    value, sweeps, residual, bound = iterate(
        lambda x, out: best_values(game, x, out), np.zeros(game.n_states), contraction, tolerance
    )
    value[ROOT] = best_values(game, value)[ROOT]
    policy = greedy_policy(game, value)
    return Solution(
        games=(game, game),
        value=(value, value),
        policy=(policy, policy),
        sweeps=sweeps + 1,
        residual=residual,
        contraction=contraction,
        error_bound=bound,
    )


def greedy_policy(game: Game, following: Floats) -> TabulatedPolicy:
    """The policy that plays the best stroke in every state, ``following`` being the value of the next states to the receiver."""
    cumulative = np.zeros(game.n_pairs, dtype=np.uint16)
    best = np.flatnonzero(greedy_strokes(game, following))
    # From the chosen stroke on, the cumulative probability of its state is 1.
    chosen = np.full(game.n_states, game.n_pairs)
    chosen[game.pair_state[best]] = best
    cumulative[np.arange(game.n_pairs) >= chosen[game.pair_state]] = CHOICE_ONE
    return TabulatedPolicy(game=game, cumulative=cumulative)
