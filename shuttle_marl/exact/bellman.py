"""The sweep that maximises over all legal strokes, compiled; it reads the 16-bit tables of the game as they are."""

from collections.abc import Callable
from typing import Any, Final, TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt

from shuttle_marl.rally import Game

Floats = npt.NDArray[np.float64]
F = TypeVar("F", bound=Callable[..., Any])

TIE: Final = 1e-12
"""Of strokes whose values differ by less, the first one in the catalogue is played, so that rounding decides nothing."""


def _compiled(function: F) -> F:
    """Compile once, without the interpreter's lock, and keep the machine code on disk."""
    return cast(F, numba.njit(cache=True, nogil=True)(function))


@_compiled
def _sweep(
    threshold: npt.NDArray[np.uint16],
    pair_start: npt.NDArray[np.int32],
    first_reply: npt.NDArray[np.int32],
    following: Floats,
    out: Floats,
) -> None:
    # In units of 1/65536 the cumulative chances are whole numbers, and so are the coefficients: exact in floating point.
    for s in range(len(out)):
        after = 2 * first_reply[s]
        best = -np.inf
        for pair in range(pair_start[s], pair_start[s + 1]):
            fault, winner, below = float(threshold[pair, 0]), float(threshold[pair, 1]), float(threshold[pair, 2])
            gain = winner - 2.0 * fault - (below - winner) * following[after] - (65536.0 - below) * following[after + 1]
            best = max(best, gain)
            after += 2
        out[s] = best / 65536.0 if pair_start[s + 1] > pair_start[s] else 0.0


def best_values(game: Game, following: Floats, out: Floats | None = None) -> Floats:
    """``[S]`` value of the best stroke in every state; 0 in a state without legal strokes.

    Args:
        game: the tables of the striker.
        following: ``[S]`` value of the next states to the receiver, who strikes there.
        out: where to write the values; may not be ``following``.
    """
    out = np.empty(game.n_states) if out is None else out
    _sweep(game.threshold, game.pair_start, game.first_reply, following, out)
    return out


def stroke_values(game: Game, following: Floats) -> Floats:
    """``[P]`` value of every legal stroke to the striker, given ``following`` as in :func:`best_values`."""
    fault, winner, below = game.threshold.astype(np.float64).T
    after = 2 * game.pair_edge
    gain = winner - 2 * fault - (below - winner) * following[after] - (65536.0 - below) * following[after + 1]
    return np.asarray(gain / 65536.0)


def greedy_strokes(game: Game, following: Floats) -> npt.NDArray[np.bool_]:
    """``[P]`` marks the one stroke of each state whose value is highest, the first one of a tie."""
    values = stroke_values(game, following)
    best = best_values(game, following)
    candidates = np.flatnonzero(values >= best[game.pair_state] - TIE)
    states = game.pair_state[candidates]
    chosen = np.zeros(game.n_pairs, dtype=bool)
    chosen[candidates[np.r_[True, states[1:] != states[:-1]]]] = True
    return chosen


def warm_up(game: Game) -> None:
    """Compile, or load the compiled sweep, by sweeping the serve alone."""
    one = slice(0, 1)
    value = np.zeros(game.n_states)
    _sweep(game.threshold, game.pair_start, game.first_reply, value, np.empty_like(value)[one])
