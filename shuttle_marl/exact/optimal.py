"""Optimal play: minimax, robust play, best responses, and the loss of a policy relative to them.

The regret of a policy in a state s is regret(s) = V*(s) - sum_a pi(a | s) Q*(s, a), with Q* the minimax value of a stroke.
Weighted by how often the policy strikes in s, the regrets add up exactly to its loss against a perfect opponent (the
performance difference lemma: Kakade & Langford, ICML 2002):

    V* - V^pi = sum_s visits(s) regret(s),        visits: of the policy against the minimax policy.
"""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from shuttle_marl.arrays import F64, I32, Intp
from shuttle_marl.exact.blocks import BlockLinear, BlockSweep, by_blocks
from shuttle_marl.exact.fixed_point import TOLERANCE, ExactError, Linear, largest_continuation, newton
from shuttle_marl.exact.match import Odds
from shuttle_marl.exact.occupancy import visits
from shuttle_marl.exact.profile import InducedChain, ProfileValue, StatePolicy, check_same_layout, induced
from shuttle_marl.exact.sweeps import Choices, after_block_choices, after_choices, block_choices, choices
from shuttle_marl.game.draws import CHOICE_ONE
from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.game.tabulated import TabulatedPolicy


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Solution:
    """The solved game.

    Attributes:
        games: the tables with which player 0 and player 1 strike; the same object in the symmetric game.
        value: ``[S]`` each: minimax value to player 0 of the states in which player 0 strikes, and to player 1 of those in which
            player 1 strikes; from -1 to 1.
        policy: of each player, the best stroke in every state.
        sweeps: number of sweeps over all legal pairs of a game.
        residual: largest change of a value in the last sweep.
        contraction: factor by which a sweep (a pair of sweeps, if the games differ) reduces an error.
        error_bound: absolute error bound of all values (:mod:`shuttle_marl.exact.fixed_point`).
    """

    games: tuple[Game, Game]
    value: tuple[F64, F64]
    policy: tuple[TabulatedPolicy, TabulatedPolicy]
    sweeps: int
    residual: float
    contraction: float
    error_bound: float

    @property
    def value_at_serve(self) -> float:
        """Value of a rally to player 0, who serves it."""
        return float(self.value[0][ROOT])


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


def solve(game: Game, other: Game | None = None, *, tolerance: float = TOLERANCE) -> Solution:
    """Minimax value and policies.

    Args:
        game: the tables with which player 0 strikes.
        other: the tables with which player 1 strikes, of the same layout; None: the symmetric game.
        tolerance: largest acceptable error bound.

    Raises:
        ExactError: the layouts differ, or some stroke never ends a rally.
    """
    if other is None or other is game:
        return _solve_symmetric(game, tolerance)
    check_same_layout(game, other)
    value, (own, theirs), sweeps = _solve_players([game], [other], tolerance)
    return Solution(
        games=(game, other),
        value=value.striking,
        policy=(pure_policy(game, own.rank), pure_policy(other, theirs.rank)),
        sweeps=sweeps,
        residual=value.residual,
        contraction=value.contraction,
        error_bound=value.error_bound,
    )


def solve_robust(games: Sequence[Game], *, tolerance: float = TOLERANCE) -> RobustSolution:
    """The policy with the best worst case over several games, such as refits on resampled matches.

    After every stroke, of either player, nature picks the game whose probabilities apply, against the robust player. With X the
    value to the robust player where they strike, Y the value to the opponent where the opponent strikes, and Q_g the value of a
    stroke in the game g,

        X(s) = max_a min_g Q_g(s, a; Y),        Y(s) = max_a max_g Q_g(s, a; X).

    The worst case of the policy, X at the serve, is a lower bound in every one of the games, against every opponent, even if the
    game changes from stroke to stroke. That nature picks for each stroke separately is called rectangular uncertainty (Iyengar,
    Math. Oper. Res. 30, 2005; Nilim & El Ghaoui, Oper. Res. 53, 2005). Both operators contract with the largest continuation of
    all games, so the error bound is that of :func:`solve`. One game drawn by nature for the whole rally would be less cautious,
    but finding its best policy is NP-hard (Wiesemann, Kuhn & Rustem, Math. Oper. Res. 38, 2013).

    Args:
        games: of one layout, from which nature picks after every stroke; of one game: the minimax policy.
        tolerance: largest acceptable error bound of a value.

    Raises:
        ExactError: there is no game, the layouts differ, or some stroke never ends a rally.
    """
    if not games:
        raise ExactError("robust play over no games: give one or more")
    for game in games[1:]:
        check_same_layout(games[0], game)
    value, (own, _), sweeps = _solve_players(games, games, tolerance, against=True)
    return RobustSolution(games=tuple(games), policy=pure_policy(games[0], own.rank), value=value, sweeps=sweeps)


def _solve_players(
    games: Sequence[Game], others: Sequence[Game], tolerance: float, *, against: bool = False
) -> tuple[ProfileValue, tuple[Choices, Choices], int]:
    """Values and best strokes of two players who are not alike, and the number of sweeps.

    Args:
        games, others: with which player 0 and player 1 strike; of several, nature picks one after each stroke.
        tolerance: largest acceptable error bound of a value.
        against: whether nature picks against player 0.
    """
    contraction = max(map(largest_continuation, games)) * max(map(largest_continuation, others))

    def operator(x: F64) -> tuple[F64, Linear]:
        theirs = choices(others, x)
        own = choices(games, theirs.value, against=against)
        first, second = after_choices(games, own), after_choices(others, theirs)
        return own.value, lambda change: first(second(change))

    start, swept = by_blocks(games[0], best_sweep(games, against=against), best_sweep(others), contraction, tolerance)
    z, sweeps, residual, bound = newton(operator, start, contraction, tolerance)
    theirs = choices(others, z)
    own = choices(games, theirs.value, against=against)
    z[ROOT] = own.value[ROOT]
    value = ProfileValue(striking=(z, theirs.value), residual=residual, contraction=contraction, error_bound=bound)
    return value, (own, theirs), 2 * (swept + sweeps) + 2


def _solve_symmetric(game: Game, tolerance: float) -> Solution:
    contraction = largest_continuation(game)

    def operator(x: F64) -> tuple[F64, Linear]:
        chosen = choices([game], x)
        return chosen.value, after_choices([game], chosen)

    sweep = best_sweep([game])
    # Sweeps by blocks alternate between the players, so each pair contracts twice.
    start, swept = by_blocks(game, sweep, sweep, contraction**2, tolerance)
    value, sweeps, residual, bound = newton(operator, start, contraction, tolerance)
    chosen = choices([game], value)
    value[ROOT] = chosen.value[ROOT]
    policy = pure_policy(game, chosen.rank)
    return Solution(
        games=(game, game),
        value=(value, value),
        policy=(policy, policy),
        sweeps=swept + sweeps + 1,
        residual=residual,
        contraction=contraction,
        error_bound=bound,
    )


def best_sweep(games: Sequence[Game], *, against: bool = False) -> BlockSweep:
    """Sweep of a player who plays the best strokes; see :func:`shuttle_marl.exact.sweeps.choices`."""

    def sweep(block: int, plain: F64, after_attack: F64) -> tuple[F64, BlockLinear]:
        chosen = block_choices(games, block, plain, after_attack, against=against)
        return chosen.value, after_block_choices(games, block, chosen)

    return sweep


def pure_policy(game: Game, rank: I32) -> TabulatedPolicy:
    """The policy that plays the legal stroke of a rank in every state, ``[S]``; -1 in states without strokes."""
    cumulative = np.empty(game.n_pairs, dtype=np.uint16)
    for block in range(game.n_blocks):
        # From the chosen stroke on, the cumulative probability of its state is 1.
        chosen = rank[game.block_states(block)][game.base_pair_state]
        cumulative[game.block_pairs(block)] = np.where(game.base_pair_rank >= chosen, CHOICE_ONE, 0)
    return TabulatedPolicy(game=game, cumulative=cumulative)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Response:
    """The best response to a policy.

    Attributes:
        game: the tables with which the responder strikes.
        rank: ``[S]`` position of the response among the legal strokes; -1 in a state without any.
        value: of the response as player 0 against the policy as player 1.
        sweeps: number of sweeps over all legal pairs of the responder.
    """

    game: Game
    rank: I32
    value: ProfileValue
    sweeps: int

    @functools.cached_property
    def policy(self) -> TabulatedPolicy:
        """The response as a table."""
        return pure_policy(self.game, self.rank)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Exploitability:
    """Gains of best responses on a profile, on the scale from -1 to 1, both players serving equally often.

    Attributes:
        nash_conv: sum of the gains of both players' best responses over the profile; 0 for a Nash equilibrium (Lanctot et al.,
            NeurIPS 2017).
        error_bound: absolute error bound of it.
    """

    nash_conv: float
    error_bound: float

    @property
    def exploitability(self) -> float:
        """NashConv divided by the number of players.

        For one policy in both seats of the symmetric game, its best response wins ``(1 + exploitability) / 2`` of the rallies.
        """
        return self.nash_conv / 2


def best_response(policy: StatePolicy | InducedChain, *, game: Game | None = None, tolerance: float = TOLERANCE) -> Response:
    """The best response to a policy.

    Args:
        policy: of the opponent, player 1, or its chain.
        game: the tables with which the responder, player 0, strikes; None: the symmetric game.
        tolerance: largest acceptable error bound.

    Raises:
        ExactError: the layouts differ, or play may never end.
    """
    own = game or policy.game
    check_same_layout(own, policy.game)
    opponent = policy if isinstance(policy, InducedChain) else induced(policy)
    contraction = largest_continuation(own) * opponent.contraction

    def operator(x: F64) -> tuple[F64, Linear]:
        chosen = choices([own], opponent.values(x))
        follow = after_choices([own], chosen)
        # The linear part of the opponent is minus the continuation.
        return chosen.value, lambda change: -follow(opponent.continuation(change))

    start, swept = by_blocks(own, best_sweep([own]), opponent.block_sweep, contraction, tolerance)
    z, sweeps, residual, bound = newton(operator, start, contraction, tolerance)
    y = opponent.values(z)
    chosen = choices([own], y)
    z[ROOT] = chosen.value[ROOT]
    value = ProfileValue(striking=(z, y), residual=residual, contraction=contraction, error_bound=bound)
    return Response(game=own, rank=chosen.rank, value=value, sweeps=swept + sweeps + 1)


def nash_conv(policy: StatePolicy, opponent: StatePolicy | None = None, *, tolerance: float = TOLERANCE) -> Exploitability:
    """NashConv and exploitability of a profile.

    Args:
        policy: of player 0.
        opponent: of player 1; None: ``policy`` in both seats.
        tolerance: largest acceptable error bound of a best response.

    Raises:
        ExactError: the layouts differ, or play may never end.
    """
    answer = best_response(policy, game=opponent.game if opponent else None, tolerance=tolerance)
    other = answer if opponent is None else best_response(opponent, game=policy.game, tolerance=tolerance)
    # The game is zero-sum, so the values of the profile itself cancel.
    gain = answer.value.odds().value + other.value.odds().value
    return Exploitability(nash_conv=gain, error_bound=answer.value.error_bound + other.value.error_bound)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Regret:
    """Value lost by a policy, on the scale of values from -1 to 1.

    Attributes:
        state: ``[S]`` loss of the stroke played in each state, on average over the policy.
        weight: ``[S]`` how often the policy strikes there in a rally, both players serving equally often.
        per_rally: loss in a rally: the sum over both.
        error_bound: ``per_rally`` is within this of the true one.
    """

    state: F64
    weight: F64
    per_rally: float
    error_bound: float

    @property
    def per_stroke(self) -> float:
        """Loss of a stroke of the policy, on average."""
        return self.per_rally / float(self.weight.sum())

    def largest(self, count: int) -> Intp:
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
        policy: the policy.
        opponent: of the visits; None: the minimax policy, for which the sum is V* - V^pi at the serve.
        solution: the solved game of the policy, if known.
        tolerance: error bound of the values and of the visits.

    Raises:
        ExactError: the layouts differ, or play may never end.
    """
    solution = solution or solve(policy.game, tolerance=tolerance)
    value, following = solution.value
    state = value - induced(policy).values(following)
    counted = visits(policy, opponent or solution.policy[1], tolerance=tolerance)
    weight = counted.states[0]
    # The regret of a state is at most 2, and its error that of two values.
    bound = 2 * solution.error_bound * float(weight.sum()) + 2 * counted.error_bound
    return Regret(state=state, weight=weight, per_rally=float(weight @ state), error_bound=bound)
