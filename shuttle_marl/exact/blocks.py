"""Values block by block: a nearly exact initial guess at a fraction of the cost of sweeps over all states.

Efforts never decrease, so the values of a block depend only on itself and on blocks of more effort, which are solved first. A
block fits into the L2 cache, and starts from the values of a neighbour. The result only saves time: the error bound of a solution
comes from a sweep over all states.
"""

import itertools
from collections.abc import Callable

import numpy as np

from shuttle_marl.arrays import F64
from shuttle_marl.exact.fixed_point import Linear, newton
from shuttle_marl.game.tables import Game

BlockLinear = Callable[[F64 | None, F64 | None], F64]
"""``[base states]`` change of the values of a block, from those of the block after a stroke that is no attack and after an
attack; None: no change."""
BlockSweep = Callable[[int, F64, F64], tuple[F64, BlockLinear]]
"""Index of a block, and values of the blocks after a stroke that is no attack and after an attack, to the values of the block
and their linear part."""


def by_blocks(
    game: Game, first: BlockSweep, second: BlockSweep, contraction: float, tolerance: float, *, affine: bool = False
) -> tuple[F64, int]:
    """Approximate values of the states in which the first player strikes.

    Args:
        game: the layout.
        first, second: sweeps of the players; the same object if the players are alike.
        contraction: of a sweep of both.
        tolerance: intended error bound of the values.
        affine: whether sweeps are affine, so that one step of Newton's method solves a block.

    Returns:
        ``[S]`` values, and the number of sweeps over all legal pairs, rounded up.
    """
    levels = range(game.levels)
    striking: tuple[dict[tuple[int, int], F64], dict[tuple[int, int], F64]] = {}, {}
    x, swept = np.zeros(game.n_base_states), 0
    for own, other in sorted(itertools.product(levels, repeat=2), key=lambda efforts: -sum(efforts)):
        if first is second and (own, other) in striking[1]:
            striking[0][own, other], striking[1][other, own] = striking[1][own, other], striking[0][other, own]
            continue
        # Blocks in which the first and the second player strike with these efforts.
        here, there = own * game.levels + other, other * game.levels + own
        spent = striking[0].get((own, other + 1)), striking[1].get((other, own + 1))

        def reply(x: F64, there: int = there, spent: F64 | None = spent[0]) -> tuple[F64, BlockLinear]:
            return second(there, x, x if spent is None else spent)

        def operator(
            x: F64, here: int = here, reply: Callable[[F64], tuple[F64, BlockLinear]] = reply,
            spent: tuple[F64 | None, F64 | None] = spent,
        ) -> tuple[F64, Linear]:  # fmt: skip
            y, of_reply = reply(x)
            z, of_stroke = first(here, y, y if spent[1] is None else spent[1])

            def linear(change: F64) -> F64:
                between = of_reply(change, change if spent[0] is None else None)
                return of_stroke(between, between if spent[1] is None else None)

            return z, linear

        x, applications, *_ = newton(operator, x, contraction, tolerance / 4, affine=affine)
        swept += applications * (2 if first is second else 1)
        striking[0][own, other], striking[1][other, own] = x, reply(x)[0]
    values = np.concatenate([striking[0][own, other] for own, other in itertools.product(levels, repeat=2)])
    return values, -(-swept // game.n_blocks)
