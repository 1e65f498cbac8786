"""Robust play: the policy with the best worst case over several games of one layout, such as refits on resampled matches.

After every stroke, of either player, nature picks from the games the one whose probabilities decide it, and picks against the
robust player. Let X be the value to the robust player where they strike, and Y the value to the opponent where the opponent
does. With Q_g the value of a stroke in the game g,

    X(s) = max_a min_g Q_g(s, a; Y),        Y(s) = max_a max_g Q_g(s, a; X):

the opponent plays perfectly and has nature on their side. So the policy's worst case, X at the serve, is met or exceeded in every
one of the games, against every opponent, even if the game changes from stroke to stroke.

That nature picks for each stroke by itself is called rectangular uncertainty (Iyengar, Math. Oper. Res. 30, 2005; Nilim &
El Ghaoui, Oper. Res. 53, 2005). Each of the two operators contracts with the largest continuation of all the games, so values
are as exact as those of :mod:`shuttle_marl.exact.optimal`, with the same bound. The other notion, one game drawn by nature for
the whole rally, is less cautious, but finding its best policy is NP-hard (Wiesemann, Kuhn & Rustem, Math. Oper. Res. 38, 2013).
"""

import dataclasses
from collections.abc import Sequence

from shuttle_marl.arrays import F64
from shuttle_marl.exact.blocks import by_blocks
from shuttle_marl.exact.fixed_point import TOLERANCE, ExactError, Linear, largest_continuation, newton
from shuttle_marl.exact.match import Odds
from shuttle_marl.exact.optimal import best_sweep, pure_policy
from shuttle_marl.exact.profile import ProfileValue, check_same_layout
from shuttle_marl.exact.sweeps import after_choices, choices
from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.game.tabulated import TabulatedPolicy


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class RobustSolution:
    """The best worst case over several games.

    Attributes:
        games: from which nature picks.
        policy: of the robust player, for the first of the games.
        value: of the robust player, player 0, against a perfect opponent with nature on their side.
        sweeps: how often all legal pairs were swept.
    """

    games: tuple[Game, ...]
    policy: TabulatedPolicy
    value: ProfileValue
    sweeps: int

    def odds(self) -> Odds:
        """Probabilities of winning a rally that are guaranteed in every one of the games, against every opponent."""
        return self.value.odds()


def solve_robust(games: Sequence[Game], *, tolerance: float = TOLERANCE) -> RobustSolution:
    """The policy with the best worst case.

    Args:
        games: of one layout, from which nature picks after every stroke; one: the minimax policy.
        tolerance: largest error bound of a value that is good enough.

    Raises:
        ExactError: there is no game, the layouts differ, or some stroke never ends a rally.
    """
    if not games:
        raise ExactError("robust play over no games: give one or more")
    for game in games[1:]:
        check_same_layout(games[0], game)
    contraction = max(map(largest_continuation, games)) ** 2

    def operator(x: F64) -> tuple[F64, Linear]:
        theirs = choices(games, x)
        own = choices(games, theirs.value, against=True)
        first, second = after_choices(games, own), after_choices(games, theirs)
        return own.value, lambda change: first(second(change))

    start, swept = by_blocks(games[0], best_sweep(games, against=True), best_sweep(games), contraction, tolerance)
    z, sweeps, residual, bound = newton(operator, start, contraction, tolerance)
    theirs = choices(games, z)
    own = choices(games, theirs.value, against=True)
    z[ROOT] = own.value[ROOT]
    value = ProfileValue(striking=(z, theirs.value), residual=residual, contraction=contraction, error_bound=bound)
    return RobustSolution(
        games=tuple(games), policy=pure_policy(games[0], own.rank), value=value, sweeps=2 * (swept + sweeps) + 2
    )
