"""Compiled sweeps over all legal pairs of a game: the best stroke of every state, the mean under a policy, and its transpose.

The effort after a stroke depends on the effort before it and on the stroke alone (:mod:`shuttle_marl.game.tables`). A sweep
processes one block of states after the other. It first gathers the values of the successor states in the order of the replies:
contact below and above, for a receiver who is not hurried, then for one who is. So the successors of a state with K legal strokes
are 4 K contiguous values, and probabilities and values are read in order. Sums are accumulated in four lanes, one for each of
the four, in a fixed order: they have the same bits on every machine.
"""

import functools
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.arrays import F32, F64, I32, U16, Bools
from shuttle_marl.game.draws import CHOICE_ONE
from shuttle_marl.game.tables import HURRY_ONE, Game
from shuttle_marl.game.thresholds import ONE
from shuttle_marl.kernel.compiling import cached, compiled, inlined

Chances = F64 | U16
"""``[base pairs]`` probability of each legal pair of a block given its state; of a table, in units of 1/65535."""
_UNIT: Final = 1.0 / (ONE * HURRY_ONE)
"""Unit of the probabilities of outcomes: those of a contact, and whether the receiver is hurried."""

TIE: Final = 1e-12
"""Strokes whose values differ by less are tied; the first one in the catalogue is played, so that rounding decides nothing."""


class Replies(NamedTuple):
    """Legal strokes of the base states, and the states that follow them."""

    pair_start: I32
    """``[base states + 1]`` first legal pair of each state."""
    first_reply: I32
    """``[base states]`` first reply of each state; the replies of a state are contiguous."""
    edge: I32
    """``[V]`` edge of the state graph that each reply follows."""
    attack: Bools
    """``[edges]`` whether the stroke of an edge is an attack, which raises the effort."""


def replies(game: Game) -> Replies:
    """The replies of a game."""
    return Replies(game.base_pair_start, game.first_reply, game.reply_edge, game.edge_attack)


class Choices(NamedTuple):
    """The best stroke of every state."""

    value: F64
    """``[S]`` value to the striker; 0 in a state without legal strokes."""
    rank: I32
    """``[S]`` position of the best stroke among the legal ones, the first one of a tie; -1 in a state without any."""
    game: I32
    """``[S]`` index of the game in which it is played."""


@compiled
def _gather(plain: F64, after_attack: F64, replies: Replies, out: F64) -> None:
    """``[4 V]`` values of the successors of each reply.

    Args:
        plain, after_attack: values of the block after a stroke that is no attack, and of the block after an attack.
        replies: of the game.
        out: the result.
    """
    for v in range(replies.edge.size):
        edge = replies.edge[v]
        source = after_attack if replies.attack[edge] else plain
        for i in range(4):
            out[4 * v + i] = source[4 * edge + i]


@compiled
def _scatter_add(gathered: F64, replies: Replies, plain: F64, after_attack: F64) -> None:
    """Transpose of :func:`_gather`: scatter-adds the values of each reply to its successors."""
    for v in range(replies.edge.size):
        edge = replies.edge[v]
        target = after_attack if replies.attack[edge] else plain
        for i in range(4):
            target[4 * edge + i] += gathered[4 * v + i]


@inlined
def _later(weight: F32, after: F64, i: int) -> float:
    """What follows the i-th stroke of a state: the values of its four successors, times their probabilities."""
    unhurried = weight[4 * i] * after[4 * i] + weight[4 * i + 1] * after[4 * i + 1]
    return unhurried + (weight[4 * i + 2] * after[4 * i + 2] + weight[4 * i + 3] * after[4 * i + 3])


# There is no NaN, and the sign of zero does not matter, so maxima are vectorised.
@functools.partial(cached, nogil=True, fastmath={"nnan", "nsz"})
def _choose(rewards: F32, continuation: F32, replies: Replies, following: F64, against: bool, best_of: Choices) -> None:
    """Best strokes of the states of a block; see :func:`block_choices`.

    Args:
        rewards, continuation: of the games, see :func:`_stacked`.
        replies: of the games.
        following: ``[4 V]`` gathered values.
        against: whether nature picks the worst game for the striker.
        best_of: the result.
    """
    pair_start, first_reply = replies.pair_start, replies.first_reply
    out, rank, picked = best_of.value, best_of.rank, best_of.game
    longest = 0
    for s in range(out.size):
        longest = max(longest, pair_start[s + 1] - pair_start[s])
    scratch = np.empty(longest)
    for s in range(out.size):
        first, last = pair_start[s], pair_start[s + 1]
        out[s], rank[s], picked[s] = 0.0, -1, 0
        if first == last:
            continue
        values = scratch[: last - first]
        after = following[4 * first_reply[s] : 4 * (first_reply[s] + values.size)]
        for g in range(len(rewards)):
            reward, weight = rewards[g, first:last], continuation[g, 4 * first : 4 * last]
            if g == 0:
                for i in range(values.size):
                    values[i] = reward[i] - _later(weight, after, i)
            elif against:
                for i in range(values.size):
                    value = reward[i] - _later(weight, after, i)
                    values[i] = min(values[i], value)
            else:
                for i in range(values.size):
                    value = reward[i] - _later(weight, after, i)
                    values[i] = max(values[i], value)
        best = values.max()
        i = 0
        while values[i] < best - TIE / _UNIT:
            i += 1
        out[s], rank[s] = best * _UNIT, i
        wanted = -values[i] if against else values[i]
        for g in range(len(rewards)):
            value = rewards[g, first + i] - _later(continuation[g, 4 * first : 4 * last], after, i)
            if (-value if against else value) >= wanted - TIE / _UNIT:
                picked[s] = g
                break


@compiled
def _mean(chances: Chances, unit: float, continuation: F32, replies: Replies, following: F64, out: F64) -> None:
    """Mean of the gathered values of each state's successors."""
    pair_start, first_reply = replies.pair_start, replies.first_reply
    for s in range(out.size):
        first, last = pair_start[s], pair_start[s + 1]
        chance, weight = chances[first:last], continuation[4 * first : 4 * last]
        value = following[4 * first_reply[s] : 4 * first_reply[s] + weight.size]
        a = b = c = d = 0.0
        for i in range(chance.size):
            a += chance[i] * (weight[4 * i] * value[4 * i])
            b += chance[i] * (weight[4 * i + 1] * value[4 * i + 1])
            c += chance[i] * (weight[4 * i + 2] * value[4 * i + 2])
            d += chance[i] * (weight[4 * i + 3] * value[4 * i + 3])
        out[s] = ((a + b) + (c + d)) * unit


@compiled
def _follow(continuation: F32, replies: Replies, chosen: Choices, plain: F64, after_attack: F64, out: F64) -> None:
    """Change in the value of each state's chosen stroke, from the changes of its successors."""
    for s in range(out.size):
        out[s] = 0.0
        if chosen.rank[s] >= 0:
            p = replies.pair_start[s] + chosen.rank[s]
            edge = replies.edge[replies.first_reply[s] + chosen.rank[s]]
            change = after_attack if replies.attack[edge] else plain
            weight = continuation[chosen.game[s], 4 * p : 4 * p + 4]
            out[s] = -_later(weight, change[4 * edge : 4 * edge + 4], 0) * _UNIT


@compiled
def _soften(
    rewards: F32,
    continuation: F32,
    replies: Replies,
    prior: F64,
    tau: float,
    following: F64,
    out: F64,
    policy: F64,
) -> None:
    pair_start, first_reply = replies.pair_start, replies.first_reply
    for s in range(out.size):
        first, count = pair_start[s], pair_start[s + 1] - pair_start[s]
        reward, weight = rewards[first : first + count], continuation[4 * first : 4 * (first + count)]
        after = following[4 * first_reply[s] : 4 * (first_reply[s] + count)]
        before, played = prior[first : first + count], policy[first : first + count]
        best = -1e300
        for i in range(count):
            played[i] = (reward[i] - _later(weight, after, i)) * _UNIT
            if before[i] > 0.0:
                best = max(best, played[i])
        # For a large tau all terms are close to 1, so their differences are summed separately.
        total = change = 0.0
        for i in range(count):
            x = min((played[i] - best) / tau, 0.0)
            if tau > 1.0:
                change += before[i] * np.expm1(x)
            played[i] = before[i] * np.exp(x)
            total += played[i]
        for i in range(count):
            played[i] /= total
        out[s] = 0.0
        if count > 0:
            out[s] = best + tau * (np.log1p(change) if tau > 1.0 else np.log(total))


@compiled
def _propagate(chances: Chances, unit: float, continuation: F32, replies: Replies, visits: F64, out: F64) -> None:
    """Transpose of :func:`_mean`: adds the visits of each state to the gathered values of its successors."""
    pair_start, first_reply = replies.pair_start, replies.first_reply
    for s in range(visits.size):
        if visits[s] == 0.0:
            continue
        first, last = pair_start[s], pair_start[s + 1]
        chance, weight, share = chances[first:last], continuation[4 * first : 4 * last], visits[s] * unit
        reached = out[4 * first_reply[s] : 4 * first_reply[s] + weight.size]
        for i in range(chance.size):
            played = chance[i] * share
            for j in range(4 * i, 4 * i + 4):
                reached[j] += weight[j] * played


@compiled
def _expect(chance: Chances, unit: float, limits: U16, pair_start: I32, reward: F64, continuation: F64) -> None:
    for s in range(reward.size):
        gained = continued = 0.0
        for p in range(pair_start[s], pair_start[s + 1]):
            fault, winner = np.int64(limits[p, 0]), np.int64(limits[p, 1])
            gained += chance[p] * (winner - 2 * fault)
            continued += chance[p] * (65536 - winner)
        reward[s], continuation[s] = gained * unit, continued * unit


class Probabilities(NamedTuple):
    """The probabilities of a game in units of 2^-24, which single precision holds exactly: up to 2^24, or multiples of 256."""

    reward: F32
    """``[L, base pairs]`` winner minus fault."""
    continuation: F32
    """``[L, 4 base pairs]`` returned from below and from above to a receiver who is not hurried, then to one who is, in turn."""


@functools.lru_cache(maxsize=16)
def probabilities(game: Game) -> Probabilities:
    """The probabilities of a game, as sweeps read them."""
    reward = np.empty((game.levels, game.n_base_pairs), np.float32)
    continuation = np.empty((game.levels, game.n_base_pairs, 4), np.float32)
    hurried = game.hurry.astype(np.float32)
    for level, limits in enumerate(game.limits):
        fault, winner, below = limits.T.astype(np.float32)
        reward[level] = (winner - 2 * fault) * HURRY_ONE
        returned = np.stack([below - winner, ONE - below], axis=-1)
        np.multiply(returned, HURRY_ONE - hurried, out=continuation[level, :, :2])
        np.multiply(returned, hurried, out=continuation[level, :, 2:])
    return Probabilities(reward=reward, continuation=continuation.reshape(game.levels, -1))


def block_choices(games: Sequence[Game], block: int, plain: F64, after_attack: F64, *, against: bool = False) -> Choices:
    """The best strokes in the states of one block: ``[base states]`` of :class:`Choices`.

    Args:
        games: tables of the striker, of one layout; nature picks one after each stroke, the first of tied ones.
        block: index of the block.
        plain, after_attack: ``[base states]`` values of the blocks after a stroke that is no attack and after an attack.
        against: whether nature picks the worst game for the striker; else the best one.
    """
    game = games[0]
    size = game.n_base_states
    found = Choices(np.empty(size), np.empty(size, np.int32), np.empty(size, np.int32))
    following = _gathered(game, plain, after_attack)
    _choose(*_stacked(tuple(games), block // game.levels), replies(game), following, against, found)
    return found


def after_block_choices(games: Sequence[Game], block: int, chosen: Choices, plain: F64, after_attack: F64) -> F64:
    """``[base states]`` linear part of :func:`block_choices` at the chosen strokes."""
    game = games[0]
    out = np.empty(game.n_base_states)
    _follow(_stacked(tuple(games), block // game.levels)[1], replies(game), chosen, plain, after_attack, out)
    return out


def _gathered(game: Game, plain: F64, after_attack: F64) -> F64:
    """``[4 V]`` values of the successors of each reply in a block, in the order of ``Game.arrivals``."""
    out = np.empty(4 * len(game.reply_edge))
    _gather(plain, after_attack, replies(game), out)
    return out


@functools.lru_cache(maxsize=12)
def _stacked(games: tuple[Game, ...], level: int) -> tuple[F32, F32]:
    """``[games, base pairs]`` rewards and ``[games, 4 base pairs]`` continuations of the games at one effort."""
    tables = [probabilities(game) for game in games]
    if len(tables) == 1:
        return tables[0].reward[level : level + 1], tables[0].continuation[level : level + 1]
    return np.stack([table.reward[level] for table in tables]), np.stack([table.continuation[level] for table in tables])


class Expected(NamedTuple):
    """What is to be expected in each state of one block under a policy."""

    reward: F64
    """``[base states]`` reward to the striker of the stroke played."""
    continuation: F64
    """``[base states]`` probability that the rally continues."""


def _unit_of(chance: Chances) -> float:
    """Probability that a chance of 1 stands for, by the type of the numbers."""
    return 1 / CHOICE_ONE if chance.dtype.kind == "u" else 1.0


def block_expected(game: Game, level: int, chance: Chances) -> Expected:
    """Rewards and continuations of one block of states under a policy.

    Args:
        game: the tables with which the player strikes.
        level: own effort.
        chance: the policy.
    """
    found = Expected(np.empty(game.n_base_states), np.empty(game.n_base_states))
    _expect(chance, _unit_of(chance) / ONE, game.limits[level], game.base_pair_start, *found)
    return found


def block_mean(game: Game, block: int, chance: Chances, plain: F64, after_attack: F64) -> F64:
    """``[base states]`` mean value of the successors of each state of one block, 0 where the rally ends.

    Args:
        game: the tables with which the player strikes.
        block: index of the block.
        chance: the policy.
        plain, after_attack: as for :func:`block_choices`.
    """
    out = np.empty(game.n_base_states)
    continuation = probabilities(game).continuation[block // game.levels]
    following = _gathered(game, plain, after_attack)
    _mean(chance, _unit_of(chance) * _UNIT, continuation, replies(game), following, out)
    return out


def block_soft_values(game: Game, block: int, prior: F64, tau: float, plain: F64, after_attack: F64) -> tuple[F64, F64]:
    """``[base states]`` soft maxima of one block, and ``[base pairs]`` their policy (:func:`shuttle_marl.exact.solve_soft`).

    Args:
        game: the tables.
        block: index of the block.
        prior: ``[base pairs]`` probability of each base pair.
        tau: cost of a nat of divergence from it.
        plain, after_attack: as for :func:`block_choices`.
    """
    table, level = probabilities(game), block // game.levels
    out, policy = np.empty(game.n_base_states), np.empty(game.n_base_pairs)
    following = _gathered(game, plain, after_attack)
    _soften(table.reward[level], table.continuation[level], replies(game), prior, tau, following, out, policy)
    return out, policy


def propagate(game: Game, chances: Sequence[Chances], visits: F64) -> F64:
    """``[S]`` expected visits of the successors of ``[S]`` visits, for the policy in each block: the transpose of a sweep."""
    out, values = np.zeros(game.n_states), np.empty(4 * len(game.reply_edge))
    for block, chance in enumerate(chances):
        here = visits[game.block_states(block)]
        if not here.any():
            continue
        values[:] = 0.0
        continuation = probabilities(game).continuation[block // game.levels]
        _propagate(chance, _unit_of(chance) * _UNIT, continuation, replies(game), here, values)
        plain, attack = (out[game.block_states(after)] for after in game.block_following(block))
        _scatter_add(values, replies(game), plain, attack)
    return out


def warm_up(game: Game) -> None:
    """Compile the sweeps, or load them from the disk, by sweeping one block."""
    zeros, states = np.zeros(game.n_base_states), np.ones(game.n_states)
    after_block_choices([game], 0, block_choices([game], 0, zeros, zeros), zeros, zeros)
    for chance in (np.zeros(game.n_base_pairs), np.zeros(game.n_base_pairs, np.uint16)):
        block_expected(game, 0, chance)
        block_mean(game, 0, chance, zeros, zeros)
        propagate(game, [chance], states)
