"""Sweeps over all legal pairs of a game, compiled: the best stroke of every state, the mean under a policy, and its transpose.

The effort after a stroke depends on the effort before it and on the stroke alone (:mod:`shuttle_marl.game.rally`). So a sweep
takes one block of states after the other, and first arranges the values of the states that can follow in the order of the
replies, contact below and above in turn: those of a state with K legal strokes are 2 K neighbours. It then reads weights and
values in order and needs no index of its own. Sums run in four lanes whose order is fixed: they have the same bits on every
machine.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from shuttle_marl.game.rally import ONE, Game
from shuttle_marl.kernel.compiling import cached

Floats = npt.NDArray[np.float64]
Singles = npt.NDArray[np.float32]
Ints = npt.NDArray[np.int32]
Bools = npt.NDArray[np.bool_]
F = TypeVar("F", bound=Callable[..., Any])

TIE: Final = 1e-12
"""Of strokes whose values differ by less, the first one in the catalogue is played, so that rounding decides nothing."""


def _compiled(function: F) -> F:
    """Compile once, without the interpreter's lock, and keep the machine code on disk."""
    return cached(function, nogil=True)


def _compiled_without_nan(function: F) -> F:
    """The same where no value is NaN and the sign of zero is of no account, so that maxima are taken side by side."""
    return cached(function, nogil=True, fastmath={"nnan", "nsz"})


@_compiled
def _arrange(values: Floats, after_attack: Floats, reply_edge: Ints, attack: Bools, out: Floats) -> None:
    """Values of the states that follow each reply, from those of the block after a stroke that is no attack and after one."""
    for v in range(reply_edge.size):
        edge = reply_edge[v]
        source = after_attack if attack[edge] else values
        out[2 * v] = source[2 * edge]
        out[2 * v + 1] = source[2 * edge + 1]


@_compiled
def _hand_back(arranged: Floats, reply_edge: Ints, attack: Bools, plain: Floats, after_attack: Floats) -> None:
    """The transpose of :func:`_arrange`: adds what came to each reply to the states that follow it."""
    for v in range(reply_edge.size):
        edge = reply_edge[v]
        target = after_attack if attack[edge] else plain
        target[2 * edge] += arranged[2 * v]
        target[2 * edge + 1] += arranged[2 * v + 1]


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
def _first_best(
    rewards: Singles, continuation: Singles, pair_start: Ints, first_reply: Ints, following: Floats, tie: float, out: Ints
) -> None:
    for s in range(out.size):
        reward = rewards[pair_start[s] : pair_start[s + 1]]
        weight = continuation[2 * pair_start[s] : 2 * pair_start[s + 1]]
        value = following[2 * first_reply[s] : 2 * first_reply[s] + weight.size]
        best = -1e300
        for i in range(reward.size):
            best = max(best, reward[i] - weight[2 * i] * value[2 * i] - weight[2 * i + 1] * value[2 * i + 1])
        out[s] = -1
        for i in range(reward.size):
            if reward[i] - weight[2 * i] * value[2 * i] - weight[2 * i + 1] * value[2 * i + 1] >= best - tie:
                out[s] = i
                break


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
    for s in range(visits.size):
        if visits[s] == 0.0:
            continue
        weight = weights[2 * pair_start[s] : 2 * pair_start[s + 1]]
        reached = out[2 * first_reply[s] : 2 * first_reply[s] + weight.size]
        for i in range(weight.size):
            reached[i] += weight[i] * visits[s]


class _Probabilities(NamedTuple):
    """The probabilities of a game in units of 1/65536: whole numbers, so exact in single precision."""

    reward: Singles
    """``[L, base pairs]`` winner minus fault."""
    continuation: Singles
    """``[L, 2 base pairs]`` returned from below, from above, in turn."""


@functools.lru_cache(maxsize=16)
def _probabilities(game: Game) -> _Probabilities:
    fault, winner, below = np.moveaxis(game.limits.astype(np.int64), -1, 0)
    continuation = np.stack([below - winner, ONE - below], axis=-1).reshape(game.levels, -1)
    return _Probabilities(reward=(winner - 2 * fault).astype(np.float32), continuation=continuation.astype(np.float32))


def arranged(game: Game, following: Floats, block: int, out: Floats | None = None) -> Floats:
    """``[2 V]`` values of the states that follow each reply in a block, contact below and above in turn, from ``[S]`` values."""
    out = np.empty(2 * len(game.reply_edge)) if out is None else out
    plain, attack = (following[game.block_states(after)] for after in game.block_following(block))
    _arrange(plain, attack, game.reply_edge, game.edge_attack, out)
    return out


def best_values(game: Game, following: Floats, out: Floats | None = None) -> Floats:
    """``[S]`` value of the best stroke in every state; 0 in a state without legal strokes.

    Args:
        game: the tables of the striker.
        following: ``[S]`` value of the next states to the receiver, who strikes there.
        out: where to write the values; may not be ``following``.
    """
    out = np.empty(game.n_states) if out is None else out
    table, room = _probabilities(game), np.empty(2 * len(game.reply_edge))
    for block in range(game.n_blocks):
        level, value = block // game.levels, arranged(game, following, block, room)
        part = out[game.block_states(block)]
        _best(table.reward[level], table.continuation[level], game.base_pair_start, game.first_reply, value, part)
    return out


def best_ranks(game: Game, following: Floats) -> Ints:
    """``[S]`` which legal stroke of each state has the highest value, the first one of a tie; -1 where there is none."""
    out = np.empty(game.n_states, np.int32)
    table = _probabilities(game)
    for block in range(game.n_blocks):
        level, value = block // game.levels, arranged(game, following, block)
        part = out[game.block_states(block)]
        tables = table.reward[level], table.continuation[level], game.base_pair_start, game.first_reply
        _first_best(*tables, value, TIE * ONE, part)
    return out


def mean_following(game: Game, weights: Sequence[Floats], following: Floats) -> Floats:
    """``[S]`` what follows a state on average.

    Args:
        game: the layout.
        weights: for each block ``[2 base pairs]`` weight of the next states of each legal pair, contact below and above in turn.
        following: ``[S]`` values of the next states.
    """
    out, room = np.empty(game.n_states), np.empty(2 * len(game.reply_edge))
    for block, weight in enumerate(weights):
        value = arranged(game, following, block, room)
        _mean(weight, game.base_pair_start, game.first_reply, value, out[game.block_states(block)])
    return out


def propagate(game: Game, weights: Sequence[Floats], visits: Floats) -> Floats:
    """``[S]`` how often each state follows ``[S]`` visits: the transpose of :func:`mean_following`."""
    out, room = np.zeros(game.n_states), np.empty(2 * len(game.reply_edge))
    for block, weight in enumerate(weights):
        here = visits[game.block_states(block)]
        if not here.any():
            continue
        room[:] = 0.0
        _propagate(weight, game.base_pair_start, game.first_reply, here, room)
        plain, attack = (out[game.block_states(after)] for after in game.block_following(block))
        _hand_back(room, game.reply_edge, game.edge_attack, plain, attack)
    return out


def warm_up(game: Game) -> None:
    """Compile all sweeps, or load them from the disk, by sweeping the first state alone."""
    room, state, one = np.zeros(2 * len(game.reply_edge)), np.zeros(game.n_base_states), np.empty(1)
    table, where = _probabilities(game), (game.base_pair_start, game.first_reply)
    _arrange(state, state, game.reply_edge[:1], game.edge_attack, room)
    _hand_back(room, game.reply_edge[:1], game.edge_attack, state, state)
    _best(table.reward[0], table.continuation[0], *where, room, one)
    _first_best(table.reward[0], table.continuation[0], *where, room, TIE, np.empty(1, np.int32))
    _mean(np.zeros(2 * game.n_base_pairs), *where, room, one)
    _propagate(np.zeros(2 * game.n_base_pairs), *where, one, room)
