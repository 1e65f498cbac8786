"""Solvers: minimax, robust and human-like play, and best responses.

Human-like play is the KL-regularised equilibrium (piKL: Jacob et al., ICML 2022; arXiv 2112.07544). Each player i has a prior
b_i, a model of human play, and pays tau KL(pi_i(. | s) || b_i(. | s)) to the other player in every state, so the game stays
zero-sum. With Q(s, a) the value of a stroke as in :mod:`shuttle_marl.exact.fixed_point`, the value of a state to its striker and
the policy are

    V(s) = tau log sum_a b(a | s) exp(Q(s, a) / tau),        pi(a | s) = b(a | s) exp((Q(s, a) - V(s)) / tau).

The limits are minimax over the support of the prior for tau = 0, and the prior for infinite tau. A soft maximum changes by at
most the largest change of its terms, so its operator contracts as the maximum does, values lie between -1 and 1, the equilibrium
is unique, and the error bound of the other solvers holds. The error of a log-probability of the policy is at most 2 / tau times
the bound.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from shuttle_marl.base.arrays import F64, I32
from shuttle_marl.exact.fixed_point import (
    TOLERANCE,
    BlockLinear,
    ExactError,
    Free,
    ProfileValue,
    Striker,
    largest_continuation,
    solve_players,
    successors,
)
from shuttle_marl.exact.profile import (
    PairPolicy,
    StatePolicy,
    block_chances,
    check_opponents,
    check_same_layout,
    facing,
    induced,
    met,
    moved,
)
from shuttle_marl.exact.saddles import Saddle
from shuttle_marl.exact.sweeps import after_block_choices, block_choices, block_mean, block_soft_values, lists_of
from shuttle_marl.game.draws import CHOICE_ONE, ONE
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.shipped import supported
from shuttle_marl.game.tables import ROOT, Game

P_co = TypeVar("P_co", TabulatedPolicy, PairPolicy, covariant=True)


class _Player(Striker, Protocol):
    """A player with a policy."""

    def policy(self, following: F64) -> tuple[Any, F64 | None]:
        """The strokes, and ``[S, 9]`` positions of the receiver, from the ``[S]`` values of the next states to the receiver."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Equilibrium(ProfileValue, Generic[P_co]):
    """Values and policies of an equilibrium.

    Attributes:
        games: the tables with which player 0 and player 1 strike; the same object in the symmetric game.
        policy: of each player; the same object in the symmetric game.
        sweeps: number of sweeps over all legal pairs of a game.
    """

    games: tuple[Game, Game]
    policy: tuple[P_co, P_co]
    sweeps: int

    @property
    def value(self) -> tuple[F64, F64]:
        """``[S]`` each: value of the states to the player who strikes there, player 0 and player 1."""
        return self.striking

    @property
    def value_at_serve(self) -> float:
        """Value of a rally to player 0, who serves it."""
        return float(self.striking[0][ROOT])


Solution = Equilibrium[TabulatedPolicy]
"""A solved game: the best stroke in every state; with recovery strokes and positions are mixed, rounded to 1/65535."""


def solve(game: Game, other: Game | None = None, *, tolerance: float = TOLERANCE) -> Solution:
    """Minimax value and policies.

    Args:
        game: the tables with which player 0 strikes, or the game of a pair, which has those of player 1 too.
        other: the tables with which player 1 strikes, of the same layout; None: the symmetric game, or that of the pair.

    Raises:
        ExactError: the layouts differ, or some stroke never ends a rally.
    """
    if other is None:
        game, other = game.seats if game.people is not None else (game, game.opposite)
    elif game.people is not None:
        raise ExactError(f"the game of {game.people.title} has the tables of both players; solve it alone")
    check_opponents(game, other)
    theirs = None if other is game else _player((other,))
    return _equilibrium(_player((game,)), theirs, tolerance)


def _equilibrium(own: _Player, other: _Player | None, tolerance: float, start: F64 | None = None) -> Equilibrium[Any]:
    """The equilibrium of two players; ``other`` None: the symmetric game; ``start`` as for :func:`solve_players`."""
    solved, sweeps = solve_players(own, other, tolerance, start=start)
    # Each strikes in its states, and waits in those of the other one.
    first, waited = own.policy(solved.striking[1])
    if other is None:
        first = second = first.waiting_at(waited)
    else:
        second, waits = other.policy(solved.striking[0])
        first, second = first.waiting_at(waits), second.waiting_at(waited)
    games, count = (own.game, (other or own).game), sweeps if other is None else 2 * sweeps
    return Equilibrium(**vars(solved), games=games, policy=(first, second), sweeps=count)


def solve_robust(games: Sequence[Game], *, tolerance: float = TOLERANCE) -> Solution:
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

    Returns:
        The robust player as player 0, in the first of the games, and a perfect opponent with nature on their side. The odds of
        player 0 are guaranteed in every one of the games, against every opponent.

    Raises:
        ExactError: there is no game, the layouts differ, or some stroke never ends a rally.
    """
    if not games:
        raise ExactError("robust play over no games: give one or more")
    for game in games[1:]:
        check_same_layout(games[0], game)
    several = tuple(games)
    return _equilibrium(_player(several, against=True), _player(several), tolerance)


class _BestStrokes(Free):
    def block_sweep(self, block: int, plain: F64, after_attack: F64) -> tuple[F64, BlockLinear]:
        chosen = block_choices(self.games, block, plain, after_attack, against=self.against)
        return chosen.value, functools.partial(after_block_choices, self.game, chosen)

    def policy(self, following: F64) -> tuple[TabulatedPolicy, None]:
        """The best strokes as a table, from the ``[S]`` values of the next states to the receiver, who chooses no positions."""
        blocks = (
            block_choices(self.games, block, *successors(self.game, following, block), against=self.against)
            for block in range(self.game.n_blocks)
        )
        return pure_policy(self.game, np.concatenate([chosen.rank for chosen in blocks])), None


def _player(games: tuple[Game, ...], *, against: bool = False, priors: Sequence[StatePolicy] = (), tau: float = 0.0) -> _Player:
    """A player who chooses best, with arguments as of :class:`_BestStrokes`, or human-like.

    Args:
        priors: of the own strokes and of the receiver's positions; empty: the player chooses best.
        tau: cost of a nat of divergence from them.
    """
    if not games[0].hides:
        return _SoftPlayer(priors[0], tau) if priors else _BestStrokes(games, against)
    strokes, positions = None, None
    if priors:
        strokes = tuple(priors[0].block_probabilities(block) for block in range(games[0].n_blocks))
        positions = priors[1].position_probabilities()
    return Saddle(games, against, strokes=strokes, positions=positions, tau=tau)


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
        player: the responder, whose strokes may be limited.
        opponent: who follows the policy.
        value: of the response as player 0 against the policy as player 1.
        sweeps: number of sweeps over all legal pairs of the responder.
    """

    game: Game
    player: "_BestStrokes | Saddle"
    opponent: Striker
    value: ProfileValue
    sweeps: int

    @functools.cached_property
    def policy(self) -> TabulatedPolicy:
        """The response as a table."""
        mine, theirs = self.value.striking
        found = moved(self.player.policy(theirs)[0], self.game)
        return found.waiting_at(self.opponent.all_strategies(mine)[1]) if isinstance(self.opponent, Saddle) else found


@dataclasses.dataclass(frozen=True, kw_only=True)
class Exploitability:
    """Gains of best responses on a profile, on the scale from -1 to 1, both players serving equally often.

    Attributes:
        exploitability: NashConv divided by the number of players, the unit of all other figures. For one policy in both seats of
            the symmetric game, its best response wins ``(1 + exploitability) / 2`` of the rallies.
        error_bound: absolute error bound of NashConv.
    """

    exploitability: float
    error_bound: float

    @property
    def nash_conv(self) -> float:
        """Sum of the gains of both players' best responses; 0 for a Nash equilibrium (Lanctot et al., NeurIPS 2017)."""
        return 2 * self.exploitability


def best_response(
    policy: StatePolicy, *, game: Game | None = None, at_least: float = 0, tolerance: float = TOLERANCE
) -> Response:
    """The best response to a policy.

    Args:
        policy: of the opponent, player 1.
        game: the tables with which the responder, player 0, strikes; None: the symmetric game, or those of the other player of
            the pair.
        at_least: real strokes in the data behind every stroke of the response; in a state without such a stroke it plays the one
            with the most (:func:`shuttle_marl.game.shipped.supported`).

    Raises:
        ExactError: the layouts differ, or play may never end.
        GameError: ``at_least`` is above 0, and the model has no counts of real strokes.
    """
    tables = game or policy.game.opposite
    check_opponents(tables, policy.game)
    return _response(tables, policy, 1.0, at_least, tolerance)


def _response(tables: Game, policy: StatePolicy, p: float, at_least: float, tolerance: float) -> Response:
    """The best response to an opponent who follows a policy with probability ``p`` at each choice, and else chooses best."""
    own: _BestStrokes | Saddle
    opponent: Striker
    game = limited(tables, at_least)
    if game.hides:
        positions = policy.position_probabilities()
        own = _BestStrokes((met(game, positions),)) if p == 1 else Saddle((game,), positions=positions, share=p)
        opponent = _striking_by(policy, p)
    else:
        own, opponent = _BestStrokes((game,)), induced(policy)
        opponent = opponent if p == 1 else _Restricted(opponent, own if game is policy.game else _BestStrokes((policy.game,)), p)
    value, sweeps = solve_players(own, opponent, tolerance)
    return Response(game=tables, player=own, opponent=opponent, value=value, sweeps=sweeps)


def restricted_response(policy: StatePolicy, p: float, *, tolerance: float = TOLERANCE) -> Response:
    """The best response to an opponent who plays a policy with probability ``p`` at each stroke, and else the best stroke.

    The restricted Nash response (Johanson, Zinkevich & Bowling, NeurIPS 2007), with the restriction drawn for each stroke rather
    than for a whole rally: 1 is the best response to the policy, 0 is minimax.

    Args:
        policy: of the opponent, player 1.
        p: from 0 to 1.

    Returns:
        The response; its value is against the restricted opponent.

    Raises:
        ExactError: ``p`` is not from 0 to 1, or play may never end.
    """
    if not 0 <= p <= 1:
        raise ExactError(f"restricted response with p = {p}: expected a number from 0 to 1")
    return _response(policy.game, policy, p, 0, tolerance)


def restricted_value(policy: StatePolicy, opponent: StatePolicy, p: float, *, tolerance: float = TOLERANCE) -> ProfileValue:
    """The value of a policy against the opponent of :func:`restricted_response`.

    No policy, not even one that remembers, is worth more than that response, because the restricted game is a zero-sum game whose
    state both players know, of which the response is an equilibrium strategy.

    Args:
        opponent: policy that player 1 plays with probability ``p`` at each stroke; else the stroke that is worst for player 0.
        p: from 0 to 1.

    Raises:
        ExactError: play may never end.
    """
    played, other = facing(policy, opponent)
    restricted = _Restricted(induced(other), _BestStrokes((other.game,)), p)
    own: Striker = induced(played)
    if policy.game.hides:
        own = _Restricted(own, _striking_by(policy), p)
    return solve_players(own, restricted, tolerance)[0]


def _striking_by(policy: StatePolicy, share: float = 1.0) -> Saddle:
    """Who follows the strokes of a policy with a probability at each, and else strikes best, against the best positions."""
    strokes = tuple(block_chances(policy, block) for block in range(policy.game.n_blocks))
    return Saddle((policy.game,), strokes=strokes, share=share)


@dataclasses.dataclass(frozen=True, eq=False)
class _Restricted:
    """A player who follows a policy with probability ``p`` at each stroke, and else plays the best stroke."""

    chain: Striker
    free: "_BestStrokes | Saddle"
    p: float

    @property
    def game(self) -> Game:
        return self.chain.game

    @property
    def contraction(self) -> float:
        return self.p * self.chain.contraction + (1 - self.p) * self.free.contraction

    def block_sweep(self, block: int, plain: F64, after_attack: F64) -> tuple[F64, BlockLinear]:
        bound, of_bound = self.chain.block_sweep(block, plain, after_attack)
        free, of_free = self.free.block_sweep(block, plain, after_attack)

        def linear(plain: F64, after_attack: F64) -> F64:
            return self.p * of_bound(plain, after_attack) + (1 - self.p) * of_free(plain, after_attack)

        return self.p * bound + (1 - self.p) * free, linear


def limited(game: Game, at_least: float) -> Game:
    """The game in which strokes with too few real strokes behind them are faults, so that perfect play does without them."""
    if at_least <= 0:
        return game
    allowed = supported(game, at_least)
    return dataclasses.replace(game, threshold=np.where(allowed[:, None], game.threshold, np.uint16(ONE - 1)))


def nash_conv(policy: StatePolicy, opponent: StatePolicy | None = None, *, tolerance: float = TOLERANCE) -> Exploitability:
    """NashConv and exploitability of a profile.

    Args:
        opponent: of player 1; None: the same strokes as ``policy``, with the tables of the other player in the game of a pair.

    Raises:
        ExactError: the layouts differ, or play may never end.
    """
    if opponent is None and policy.game.opposite is not policy.game:
        opponent = PairPolicy(
            game=policy.game.opposite, probability=policy.pair_probabilities(), positions=policy.position_probabilities()
        )
    answer = best_response(policy, game=opponent.game if opponent else None, tolerance=tolerance)
    other = answer if opponent is None else best_response(opponent, game=policy.game, tolerance=tolerance)
    # The game is zero-sum, so the values of the profile itself cancel.
    gain = answer.value.odds().value + other.value.odds().value
    return Exploitability(exploitability=gain / 2, error_bound=answer.value.error_bound + other.value.error_bound)


def solve_soft(
    prior: StatePolicy, opponent: StatePolicy | None = None, *, tau: float, tolerance: float = TOLERANCE
) -> Equilibrium[PairPolicy]:
    """The KL-regularised equilibrium; its values are those of the regularised game.

    Args:
        prior: of player 0; strokes with probability 0 keep it.
        opponent: prior of player 1; None: the same.
        tau: cost of a nat; finite and positive.

    Raises:
        ExactError: ``tau`` is not finite and positive, the layouts differ, or some stroke never ends a rally.
    """
    if not 0 < tau < float("inf"):
        raise ExactError(f"tau {tau!r}: expected a finite number above 0; towards 0 is minimax, towards infinity the prior")
    opponent = prior if opponent is None else opponent
    check_same_layout(prior.game, opponent.game)

    own, theirs = _player((prior.game,), priors=(prior, opponent), tau=tau), None
    if opponent is not prior:
        theirs = _player((opponent.game,), priors=(opponent, prior), tau=tau)
    return _equilibrium(own, theirs, tolerance, np.zeros(prior.game.n_states))


class _SoftPlayer:
    """A player of the regularised game."""

    def __init__(self, prior: StatePolicy, tau: float) -> None:
        self.game, self._tau, self.contraction = prior.game, tau, largest_continuation(prior.game)
        self._prior: list[F64] = []
        for block in range(self.game.n_blocks):
            # Most priors ignore the efforts, so equal blocks share an array.
            probability = prior.block_probabilities(block)[lists_of(self.game).order]
            self._prior.append(next((seen for seen in self._prior if np.array_equal(seen, probability)), probability))

    def block_sweep(self, block: int, plain: F64, after_attack: F64) -> tuple[F64, BlockLinear]:
        values, policy = block_soft_values(self.game, block, self._prior[block], self._tau, plain, after_attack)

        def linear(plain: F64, after_attack: F64) -> F64:
            return -block_mean(self.game, block, policy, plain, after_attack)

        return values, linear

    def policy(self, following: F64) -> tuple[PairPolicy, None]:
        game, probability = self.game, np.empty(self.game.n_pairs)
        for block, prior in enumerate(self._prior):
            found = block_soft_values(game, block, prior, self._tau, *successors(game, following, block))[1]
            probability[game.block_pairs(block)][lists_of(game).order] = found
        return PairPolicy(game=game, probability=probability), None
