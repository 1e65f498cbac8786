"""Values of two players who strike in turn, each under a fixed policy or with optimal strokes.

Efforts never decrease, so the values of a block depend only on itself and on blocks of more effort, which are solved first
(:func:`by_blocks`). A block fits into the L2 cache, and starts from the values of a neighbour. The result is only the initial
guess of Newton's method over all states, from which the error bound comes.
"""

import dataclasses
import itertools
from collections.abc import Callable
from typing import Protocol

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.exact.fixed_point import Linear, newton
from shuttle_marl.exact.match import Odds
from shuttle_marl.game.tables import ROOT, Game

BlockLinear = Callable[[F64, F64], F64]
"""``[base states]`` change of the values of a block, from those of the block after a stroke that is no attack and after an
attack."""


class Striker(Protocol):
    """A player in the states in which it strikes."""

    @property
    def game(self) -> Game:
        """The tables with which the player strikes."""
        ...

    @property
    def contraction(self) -> float:
        """Factor by which a sweep reduces an error of the rally states."""
        ...

    def block_sweep(self, block: int, plain: F64, after_attack: F64) -> tuple[F64, BlockLinear]:
        """Values of one block and their linear part.

        Args:
            plain, after_attack: ``[base states]`` values of the blocks after a stroke that is no attack and after an attack.
        """
        ...


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
    x, none, swept = np.zeros(game.n_base_states), np.zeros(game.n_base_states), 0
    for own, other in sorted(itertools.product(levels, repeat=2), key=lambda efforts: -sum(efforts)):
        if symmetric and (own, other) in striking[1]:
            striking[0][own, other], striking[1][other, own] = striking[1][own, other], striking[0][other, own]
            continue
        # Blocks in which the first and the second player strike with these efforts.
        here, there = own * game.levels + other, other * game.levels + own
        spent = striking[0].get((own, other + 1)), striking[1].get((other, own + 1))

        def reply(x: F64, there: int = there, spent: F64 | None = spent[0]) -> tuple[F64, BlockLinear]:
            return second.block_sweep(there, x, x if spent is None else spent)

        def operator(
            x: F64, here: int = here, reply: Callable[[F64], tuple[F64, BlockLinear]] = reply,
            spent: tuple[F64 | None, F64 | None] = spent,
        ) -> tuple[F64, Linear]:  # fmt: skip
            y, of_reply = reply(x)
            z, of_stroke = first.block_sweep(here, y, y if spent[1] is None else spent[1])

            def linear(change: F64) -> F64:
                between = of_reply(change, change if spent[0] is None else none)
                return of_stroke(between, between if spent[1] is None else none)

            return z, linear

        x, applications, *_ = newton(operator, x, contraction, tolerance / 4, affine=affine)
        swept += applications * (2 if symmetric else 1)
        striking[0][own, other], striking[1][other, own] = x, reply(x)[0]
    values = np.concatenate([striking[0][own, other] for own, other in itertools.product(levels, repeat=2)])
    return values, -(-swept // game.n_blocks)
