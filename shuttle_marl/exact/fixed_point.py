"""Values of two players who strike in turn, each with a policy or with optimal strokes: fixed points with error bounds.

Let player i strike in state s. With W(s') the value of the next state, seen by the receiver who strikes there, the value of
s to player i is

    (T_i W)(s) = opt_a [now(s, a) - sum_j next_j(s, a) W(4 e + j)],      e the edge that follows (s, a), j from 0 to 3,

where *opt* is the maximum over the legal strokes, or their mean under a policy pi_i, j the receiver's contact and whether they
are hurried, and sum_j next_j = p r the probability that the rally continues. (Shapley 1953 and Condon 1992 for such games; Patek
& Bertsekas 1999 for games without discount that end with probability 1.)

**T_i is a contraction in the sup norm over the rally states**, those other than the serve. Rally states only follow each
other, and |max_a f - max_a g| <= max_a |f - g|, so |T_i W - T_i U| <= c_i |W - U| with

- c_i = d, the supremum of p r over all legal pairs but the serves, for the maximum;
- c_i = max_s sum_a pi_i(a | s) p r, the largest mean continuation, for the mean under pi_i: at most d.

**The bound.** From x, an approximation of V_0 however found, let y = T_1 x, z = T_0 y and rho = |z - x|. T_0 T_1 contracts
with D = c_0 c_1 and has the fixed point V_0, so |x - V_0| <= |x - z| + |z - V_0| <= rho + D |x - V_0|, so
|x - V_0| <= rho / (1 - D), |z - V_0| <= D |x - V_0|, and for y' = T_1 z, |y' - V_1| <= c_1 |z - V_0|. All rally values
returned, z and y', are within D rho / (1 - D). In the symmetric game V = T V, one operator does: from x, z = T x and
rho = |z - x|, |z - V| <= d rho / (1 - d).

**The serve** follows no state, so its value is one application of T_i to rally values. A serve continues with probability at
most 1, so its error is at most that of the rally values it is computed from, whatever its own p r. It is therefore always
computed last, from rally values for which the bound holds already.

**Rounding.** One application of T_0 T_1 in double precision is off by less than :data:`ROUNDING`; that is added to rho, once
more to the bound because z itself is rounded, and once more for y' and the serve.

**Blocks.** Efforts never decrease, so the values of a block of states depend only on itself and on blocks of more effort, which
are solved first (:func:`by_blocks`). A block fits into the L2 cache, and starts from the values of a neighbour. The result is
only the initial guess of Newton's method over all states, from which the error bound comes.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable
from typing import Final, Protocol

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.game.draws import ONE
from shuttle_marl.game.scoring import BWF, Rules, match_win_probability
from shuttle_marl.game.tables import ROOT, Game

ROUNDING: Final = 2.0**-40
"""Bound of the rounding of two applications: a term passes through K + 8 roundings at most, as a product of three numbers, in the
sum, and scaled by a unit, and the absolute values of the terms add up to 2 at most. So each application loses at most
2 (K + 8) 2^-53 in double precision: both less than 2^-41 for states of K <= 1000 legal strokes."""

TOLERANCE: Final = 1e-9  # default of ``tolerance``: the largest acceptable error bound of values, on the scale from -1 to 1
FIRST_RALLY_STATE: Final = 4  # base states 0 to 3 are the start of the rally; no state leads there

_DIRECTIONS: Final = 60
_SOLVED: Final = 1e-3  # relative residual at which the linear system of a Newton step counts as solved

Linear = Callable[[F64], F64]
Operator = Callable[[F64], tuple[F64, Linear]]  # x to T x and the linear part of T at x
BlockLinear = Callable[[F64, F64], F64]
"""``[base states]`` change of the values of a block, from those of the blocks after a plain stroke and after an attack."""


class ExactError(ShuttleError):
    """Games with different layouts, or values without an error bound."""


def largest_continuation(game: Game) -> float:
    """The supremum d of p r, the probability that the rally continues, over all legal pairs but the serves, and all positions.

    Raises:
        ExactError: it is 1, so some stroke never ends a rally and values have no bound.
    """
    # The second threshold is the probability, in fixed point, that the stroke ends the rally.
    waiting = game.waiting
    first = int(waiting.start[FIRST_RALLY_STATE])
    ends = waiting.limits[:, first:, 1]
    if not ends.size or ends.min() > 0:
        return float(1 - ends.min(initial=ONE - 1) / ONE)
    level, row = np.unravel_index(int(ends.argmin()), ends.shape)
    base = int(np.searchsorted(waiting.start, first + row, side="right")) - 1
    stroke = game.base_pair_stroke[game.base_pair_start[base] + (first + row - waiting.start[base]) // waiting.choices[base]]
    where = game.describe(int(level) * game.levels * game.n_base_states + base)
    advice = "exact values need a probability above 0 for every stroke to end it"
    raise ExactError(f"{game.catalogue.names[stroke]} never ends the rally in state: {where}; {advice}")


def error_bound(residual: float, contraction: float) -> float:
    """``|z - V|`` for ``z = T x``, ``residual = |z - x|`` and an operator T that contracts with ``contraction`` (see above)."""
    return (residual + ROUNDING) * contraction / (1 - contraction) + 2 * ROUNDING


def newton(
    operator: Operator, start: F64, contraction: float, tolerance: float, *, affine: bool
) -> tuple[F64, int, float, float]:
    """The fixed point of an operator that is not linear, by Newton's method: policy iteration, where it takes a maximum.

    Each step solves the operator's linear part at x. If that does not reduce the residual by ``contraction``, as may happen far
    from the fixed point when both players maximise, a plain sweep replaces the step. The error bound is that of a final plain
    sweep.

    Args:
        contraction: factor by which T contracts the rally states.
        affine: whether T is affine, so that one Newton step solves it.

    Returns:
        ``[S]`` T x, the number of applications, the residual ``|T x - x|``, and the error bound of T x. Residual and bound
        are over the rally states; the value of the serve is one application behind.
    """
    x = start
    z, linear = operator(x)
    applications, residual = 1, _largest(z - x)
    while True:
        bound = error_bound(residual, contraction)
        # Rounding prevents further progress.
        if bound <= tolerance or residual <= ROUNDING:
            return z, applications, residual, bound
        # At most half of the residual that satisfies the tolerance.
        close_enough = max(0.0 if affine else _SOLVED * residual, tolerance * (1 - contraction) / (2 * contraction))
        there = x + accelerated(linear, z - x, functools.partial(_within, close_enough))
        image, slope = operator(there)
        applications += 1
        left = _largest(image - there)
        if not left <= contraction * residual:
            there, (image, slope) = z, operator(z)
            applications += 1
            left = _largest(image - there)
        x, z, linear, residual = there, image, slope, left


def accelerated(linear: Linear, constant: F64, done: Callable[[F64], bool]) -> F64:
    """An approximate solution of x = constant + linear(x), by generalised conjugate residuals.

    (Eisenstat, Elman & Schultz, SIAM J. Numer. Anal. 1983.) Values of rallies have one slow mode, the continuation of the rally,
    which a few directions remove; plain sweeps need one per stroke of a long rally. Inner products are sums of numpy, because the
    rounding of BLAS depends on the number of threads.

    Args:
        constant: also the initial guess.
        done: whether a residual ``constant + linear(x) - x`` is acceptable.
    """
    x, residual = constant.copy(), linear(constant)
    directions: list[tuple[F64, F64]] = []
    while not done(residual) and len(directions) < _DIRECTIONS:
        p, q = residual.copy(), residual - linear(residual)
        for before, image in directions:
            along = (q * image).sum()
            q -= along * image
            p -= along * before
        length = np.sqrt((q * q).sum())
        if not length > 0:
            break
        p /= length
        q /= length
        directions.append((p, q))
        step = (residual * q).sum()
        x += step * p
        residual -= step * q
    return x


def _within(bound: float, difference: F64) -> bool:
    return _largest(difference) <= bound


def _largest(difference: F64) -> float:
    """Largest absolute value over the rally states."""
    return float(np.abs(difference[FIRST_RALLY_STATE:]).max(initial=0.0))


class Striker(Protocol):
    """A player in the states in which it strikes."""

    @property
    def game(self) -> Game:
        """The tables with which the player strikes."""

    @property
    def contraction(self) -> float:
        """Factor by which a sweep reduces an error of the rally states."""

    def block_sweep(self, block: int, plain: F64, after_attack: F64) -> tuple[F64, BlockLinear]:
        """Values of one block and their linear part.

        Args:
            plain, after_attack: ``[base states]`` values of the blocks after a stroke that is no attack and after an attack.
        """


@dataclasses.dataclass(eq=False)
class Free:
    """A player who chooses best; a base class of strikers."""

    games: tuple[Game, ...]  # tables of the player; of several, nature picks one after each stroke
    against: bool = False  # whether nature picks against this player; else in favour

    @property
    def game(self) -> Game:
        """The first of the games."""
        return self.games[0]

    @functools.cached_property
    def contraction(self) -> float:
        """Factor by which a sweep reduces an error of the rally states."""
        return max(map(largest_continuation, self.games))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Odds:
    """Odds of one player against another.

    Attributes:
        serving: probability of winning a rally that the player serves.
        receiving: probability of winning a rally that the opponent serves.
        error_bound: absolute error bound of both.
    """

    serving: float
    receiving: float
    error_bound: float

    @property
    def rally(self) -> float:
        """Probability of winning a rally when both serve equally often."""
        return (self.serving + self.receiving) / 2

    @property
    def value(self) -> float:
        """Expected reward, from -1 to 1."""
        return self.serving + self.receiving - 1

    def match(self, rules: Rules = BWF, first_server: int | None = None) -> float:
        """Probability of winning a match; ``first_server`` 0 is the player, 1 the opponent, None drawn at random."""
        return float(match_win_probability(self.serving, self.receiving, first_server=first_server, rules=rules))

    def match_error_bound(self) -> float:
        """Absolute error bound of :meth:`match`, which increases with both probabilities of a rally."""
        low, high = (
            match_win_probability(*(min(1.0, max(0.0, p + e)) for p in (self.serving, self.receiving)))
            for e in (-self.error_bound, self.error_bound)
        )
        middle = self.match()
        return float(max(high - middle, middle - low))


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ProfileValue:
    """Values of all states when player 0 and player 1 play given policies.

    Attributes:
        striking: ``[S]`` each: value to player 0 of the states in which player 0 strikes, and to player 1 of those in which
            player 1 strikes. A value is the probability of winning the rally minus that of losing it, so the probability of
            winning is ``(1 + value) / 2``.
        residual: largest change of a value in the last sweep.
        contraction: factor by which a pair of sweeps reduces an error.
        error_bound: absolute error bound of all values (:mod:`shuttle_marl.exact.fixed_point`).
    """

    striking: tuple[F64, F64]
    residual: float
    contraction: float
    error_bound: float

    def odds(self, player: int = 0) -> Odds:
        """Odds of a player against the opponent."""
        serving, receiving = self.striking[player][ROOT], -self.striking[1 - player][ROOT]
        # Rounding may carry the value of a certain win past 1.
        probabilities = (min(1.0, max(0.0, (1 + float(value)) / 2)) for value in (serving, receiving))
        return Odds(serving=next(probabilities), receiving=next(probabilities), error_bound=self.error_bound / 2)


def successors(game: Game, values: F64, block: int) -> tuple[F64, F64]:
    """``[base states]`` of ``[S]`` values: of the block after a stroke of a block that is no attack, and after an attack."""
    plain, attack = (values[game.block_states(after)] for after in game.block_following(block))
    return plain, attack


def sweep(player: Striker, following: F64) -> tuple[F64, Linear]:
    """``[S]`` values of all states to the striker, from those of the next states to the receiver, and the linear part."""
    game = player.game
    blocks = [player.block_sweep(block, *successors(game, following, block)) for block in range(game.n_blocks)]

    def linear(change: F64) -> F64:
        return np.concatenate([of_block(*successors(game, change, block)) for block, (_, of_block) in enumerate(blocks)])

    return np.concatenate([values for values, _ in blocks]), linear


def solve_players(
    first: Striker, second: Striker | None, tolerance: float, *, start: F64 | None = None, affine: bool = False
) -> tuple[ProfileValue, int]:
    """Values of player 0 and player 1, and the number of sweeps over all legal pairs of one of them.

    Args:
        first, second: the players; second None: the symmetric equilibrium, in which both have the same values.
        start: ``[S]`` initial guess; None: :func:`by_blocks`.
        affine: whether sweeps are affine, so that one step of Newton's method solves a block.
    """
    contraction = first.contraction * (second.contraction if second else 1.0)

    def operator(x: F64) -> tuple[F64, Linear]:
        if second is None:
            return sweep(first, x)
        y, of_second = sweep(second, x)
        z, of_first = sweep(first, y)
        return z, lambda change: of_first(of_second(change))

    swept = 0
    if start is None:
        start, swept = by_blocks(first, second, tolerance, affine=affine)
    z, sweeps, residual, bound = newton(operator, start, contraction, tolerance, affine=affine)
    y = sweep(second, z)[0] if second else z
    z[ROOT] = first.block_sweep(0, *successors(first.game, y, 0))[0][ROOT]
    # With recovery, matrix games are solved up to a gap.
    bound += 2 * max(getattr(player, "gap", 0.0) for player in (first, second)) / (1 - contraction)
    value = ProfileValue(striking=(z, y), residual=residual, contraction=contraction, error_bound=bound)
    return value, swept + sweeps + 1


def by_blocks(first: Striker, second: Striker | None, tolerance: float, *, affine: bool = False) -> tuple[F64, int]:
    """Approximate values of the states in which the first player strikes; arguments as for :func:`solve_players`.

    Returns:
        ``[S]`` values, and the number of sweeps over all legal pairs, rounded up.
    """
    game, symmetric, second = first.game, second is None, second or first
    # Sweeps alternate between the players, so each pair contracts twice.
    contraction = first.contraction * second.contraction
    levels = range(game.levels)
    striking: tuple[dict[tuple[int, int], F64], dict[tuple[int, int], F64]] = {}, {}
    x, swept = np.zeros(game.n_base_states), 0
    for own, other in sorted(itertools.product(levels, repeat=2), key=lambda efforts: -sum(efforts)):
        if symmetric and (own, other) in striking[1]:
            striking[0][own, other], striking[1][other, own] = striking[1][own, other], striking[0][other, own]
            continue
        # Blocks in which the first and the second player strike with these efforts.
        here, there = own * game.levels + other, other * game.levels + own
        spent = striking[0].get((own, other + 1)), striking[1].get((other, own + 1))
        operator = _within_block(first, here, second, there, spent)
        x, applications, *_ = newton(operator, x, contraction, tolerance / 4, affine=affine)
        swept += applications * (2 if symmetric else 1)
        striking[0][own, other] = x
        striking[1][other, own] = second.block_sweep(there, x, x if spent[0] is None else spent[0])[0]
    values = np.concatenate([striking[0][own, other] for own, other in itertools.product(levels, repeat=2)])
    return values, -(-swept // game.n_blocks)


def _within_block(first: Striker, here: int, second: Striker, there: int, spent: tuple[F64 | None, F64 | None]) -> Operator:
    """T_0 T_1 in a block of the first player and one of the second.

    Args:
        spent: values of the first and of the second player in the blocks after an attack; None: the same blocks.
    """

    def operator(x: F64) -> tuple[F64, Linear]:
        y, of_reply = second.block_sweep(there, x, x if spent[0] is None else spent[0])
        z, of_stroke = first.block_sweep(here, y, y if spent[1] is None else spent[1])

        def linear(change: F64) -> F64:
            between = of_reply(change, change if spent[0] is None else np.zeros_like(change))
            return of_stroke(between, between if spent[1] is None else np.zeros_like(between))

        return z, linear

    return operator
