"""Sweeps over all legal pairs of a game, compiled: the best stroke of every state, the mean under a policy, and its transpose.

The next states of a state's legal strokes lie next to each other (:mod:`shuttle_marl.game.rally`): those of a state s are
``2 * first_reply[s]`` and the 2 K behind it, contact below and above in turn. So a sweep reads weights and values in order and
needs no index of its own. Sums run in four lanes whose order is fixed: they have the same bits on every machine.
"""

import functools
from collections.abc import Callable
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from shuttle_marl.game.rally import ONE, Game
from shuttle_marl.kernel.compiling import cached

Floats = npt.NDArray[np.float64]
Singles = npt.NDArray[np.float32]
Ints = npt.NDArray[np.int32]
F = TypeVar("F", bound=Callable[..., Any])

TIE: Final = 1e-12
"""Of strokes whose values differ by less, the first one in the catalogue is played, so that rounding decides nothing."""


def _compiled(function: F) -> F:
    """Compile once, without the interpreter's lock, and keep the machine code on disk."""
    return cached(function, nogil=True)


def _compiled_without_nan(function: F) -> F:
    """The same where no value is NaN and the sign of zero is of no account, so that maxima are taken side by side."""
    return cached(function, nogil=True, fastmath={"nnan", "nsz"})


@_compiled_without_nan
def _best(rewards: Singles, continuation: Singles, pair_start: Ints, first_reply: Ints, following: Floats, out: Floats) -> None:
    for s in range(out.size):
        reward = rewards[pair_start[s] : pair_start[s + 1]]
        weight = continuation[2 * pair_start[s] : 2 * pair_start[s + 1]]
        value = following[2 * first_reply[s] : 2 * first_reply[s] + weight.size]
        best = -1e300
        for i in range(reward.size):
            best = max(best, reward[i] - weight[2 * i] * value[2 * i] - weight[2 * i + 1] * value[2 * i + 1])
        out[s] = best / 65536.0 if reward.size else 0.0


@_compiled
def _mean(weights: Floats, pair_start: Ints, first_reply: Ints, following: Floats, out: Floats) -> None:
    for s in range(out.size):
        weight = weights[2 * pair_start[s] : 2 * pair_start[s + 1]]
        value = following[2 * first_reply[s] : 2 * first_reply[s] + weight.size]
        a = b = c = d = 0.0
        fours = weight.size // 4
        for i in range(fours):
            a += weight[4 * i] * value[4 * i]
            b += weight[4 * i + 1] * value[4 * i + 1]
            c += weight[4 * i + 2] * value[4 * i + 2]
            d += weight[4 * i + 3] * value[4 * i + 3]
        for i in range(4 * fours, weight.size):
            a += weight[i] * value[i]
        out[s] = (a + b) + (c + d)


@_compiled
def _propagate(weights: Floats, pair_start: Ints, first_reply: Ints, visits: Floats, out: Floats) -> None:
    out[:] = 0.0
    for s in range(visits.size):
        weight = weights[2 * pair_start[s] : 2 * pair_start[s + 1]]
        reached = out[2 * first_reply[s] : 2 * first_reply[s] + weight.size]
        for i in range(weight.size):
            reached[i] += weight[i] * visits[s]


class _Probabilities(NamedTuple):
    """The probabilities of a game in units of 1/65536: whole numbers, so exact in single precision."""

    reward: Singles
    """``[P]`` winner minus fault."""
    continuation: Singles
    """``[2 P]`` returned from below, from above, in turn."""


@functools.lru_cache(maxsize=4)
def _probabilities(game: Game) -> _Probabilities:
    fault, winner, below = game.threshold.astype(np.int64).T
    continuation = np.stack([below - winner, ONE - below], axis=1).ravel()
    return _Probabilities(reward=(winner - 2 * fault).astype(np.float32), continuation=continuation.astype(np.float32))


def best_values(game: Game, following: Floats, out: Floats | None = None) -> Floats:
    """``[S]`` value of the best stroke in every state; 0 in a state without legal strokes.

    Args:
        game: the tables of the striker.
        following: ``[S]`` value of the next states to the receiver, who strikes there.
        out: where to write the values; may not be ``following``.
    """
    out = np.empty(game.n_states) if out is None else out
    _best(*_probabilities(game), game.pair_start, game.first_reply, following, out)
    return out


def mean_following(game: Game, weights: Floats, following: Floats) -> Floats:
    """``[S]`` what follows a state on average.

    Args:
        game: the layout.
        weights: ``[2 P]`` weight of the next states of each legal pair, contact below and above in turn.
        following: ``[S]`` values of the next states.
    """
    out = np.empty(game.n_states)
    _mean(weights, game.pair_start, game.first_reply, following, out)
    return out


def propagate(game: Game, weights: Floats, visits: Floats) -> Floats:
    """``[S]`` how often each state follows ``[S]`` visits: the transpose of :func:`mean_following`."""
    out = np.empty(game.n_states)
    _propagate(weights, game.pair_start, game.first_reply, visits, out)
    return out


def greedy_strokes(game: Game, following: Floats) -> npt.NDArray[np.bool_]:
    """``[P]`` marks the one stroke of each state whose value is highest, the first one of a tie."""
    values = game.stroke_values(following)
    best = best_values(game, following)
    candidates = np.flatnonzero(values >= best[game.pair_state] - TIE)
    states = game.pair_state[candidates]
    chosen = np.zeros(game.n_pairs, dtype=bool)
    chosen[candidates[np.r_[True, states[1:] != states[:-1]]]] = True
    return chosen


def warm_up(game: Game) -> None:
    """Compile all sweeps, or load them from the disk, by sweeping the first state alone."""
    value, one = np.zeros(game.n_states), np.empty(1)
    _best(*_probabilities(game), game.pair_start, game.first_reply, value, one)
    _mean(np.zeros(2 * game.n_pairs), game.pair_start, game.first_reply, value, one)
    _propagate(np.zeros(2 * game.n_pairs), game.pair_start, game.first_reply, one, value)
