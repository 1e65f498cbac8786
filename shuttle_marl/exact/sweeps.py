"""Compiled sweeps over all legal pairs of a game: the best stroke of every state, the mean under a policy, and its transpose.

A sweep processes one block of states after the other: it gathers the values of the successors of each reply, and goes reply by
reply through all states that have it (:class:`Lists`). Sums have a fixed order, and so the same bits on every machine.
"""

import functools
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64, I32, I64, U8, U16, Bools
from shuttle_marl.base.compiling import cached, compiled, inlined
from shuttle_marl.game.draws import CHOICE_ONE, ONE
from shuttle_marl.game.tables import Game

Successors = tuple[float, float, float, float]
Chances = F64 | U16  # ``[base pairs]`` probability of each legal pair of a block given its state; of a table, in units of 1/65535

TIE: Final = 1e-12
"""Strokes whose values differ by less are tied; the first one in the catalogue is played, so that rounding decides nothing."""


class Replies(NamedTuple):
    """Legal strokes of the base states, and the states that follow them."""

    pair_start: I32  # [base states + 1] first legal pair of each state
    first_reply: I32  # [base states] first reply of each state; the replies of a state are contiguous
    edge: I32  # [V] edge of the state graph that each reply follows
    attack: Bools  # [edges] whether the stroke of an edge is an attack, which raises the effort


def replies(game: Game) -> Replies:
    """The replies of a game."""
    return Replies(game.base_pair_start, game.first_reply, game.reply_edge, game.edge_attack)


class Lists(NamedTuple):
    """Base states by their list of replies: those of one list have the same legal strokes and successors.

    In the order of replies, and of states within each, the pairs of a stroke in all states of a list are contiguous, and what
    follows them is the same: loops over them are long, and have neither look-ups nor sums.
    """

    order: I32  # [base pairs] legal pairs in this order
    pair_start: I64  # [V + 1] first pair of each reply
    state: I32  # [base states with strokes] states by list
    start: I64  # [lists + 1] first state of each list
    first_reply: I32  # [lists] first reply
    end_reply: I32  # [lists] end of the replies


def lists_of(game: Game) -> Lists:
    """The lists of a game."""
    return _lists_of(game.tables)


@functools.lru_cache(maxsize=48)
def _lists_of(game: Game) -> Lists:
    reply = game.first_reply[game.base_pair_state] + game.base_pair_rank
    count = np.diff(game.base_pair_start)
    state = np.flatnonzero(count).astype(np.int32)
    state = state[np.argsort(game.first_reply[state], kind="stable")]
    first, start = np.unique(game.first_reply[state], return_index=True)
    return Lists(
        order=np.argsort(reply, kind="stable").astype(np.int32),
        pair_start=np.searchsorted(np.sort(reply), np.arange(len(game.reply_edge) + 1)),
        state=state,
        start=np.append(start, len(state)),
        first_reply=first,
        end_reply=first + count[state[start]],
    )


class Choices(NamedTuple):
    """The best stroke of every state."""

    value: F64  # [S] value to the striker; 0 in a state without legal strokes
    rank: I32  # [S] position of the best stroke among the legal ones, the first one of a tie; -1 in a state without any
    edge: I32  # [S] edge that follows it
    outcome: F64  # [S, 4] probability of each return of it, in units of 1/65536, in the game in which it is played


class Outcomes(NamedTuple):
    """Outcomes of the legal pairs of a block in G games: by column, in the order of :attr:`Lists.order`, for vectorised loops.

    Means over positions (:func:`shuttle_marl.exact.profile.met`) are not rounded.
    """

    limits: U16 | F64  # [G, 3, base pairs] thresholds
    hurry: U8 | F64  # [G, 2, base pairs] chances of a hurried receiver


@compiled
def _gather(plain: F64, after_attack: F64, replies: Replies, out: F64) -> None:
    """``[4, V]`` values of the successors of each reply: from below, from above, and what is added to each if hurried.

    Args:
        plain, after_attack: values of the block after a stroke that is no attack, and of the block after an attack.
        out: the result; what is added is for chances in units of 1/256.
    """
    for v in range(replies.edge.size):
        edge = replies.edge[v]
        source = after_attack if replies.attack[edge] else plain
        for contact in range(2):
            value = source[4 * edge + contact]
            out[contact, v], out[2 + contact, v] = value, (source[4 * edge + 2 + contact] - value) / 256.0


@compiled
def _scatter_add(gathered: F64, replies: Replies, plain: F64, after_attack: F64) -> None:
    """Scatter-adds ``[4, V]`` values to the successors of each reply."""
    for v in range(replies.edge.size):
        edge = replies.edge[v]
        target = after_attack if replies.attack[edge] else plain
        for i in range(4):
            target[4 * edge + i] += gathered[i, v]


@inlined
def worth_of(fault: float, winner: float, below: float, hurry_below: float, hurry_above: float, after: Successors) -> float:
    """Value of a stroke to its striker, in units of 1/65536, from its outcomes and what :func:`_gather` wrote for its reply."""
    lower = (below - winner) * (after[0] + hurry_below * after[2])
    return (winner - 2.0 * fault) - (lower + (65536.0 - below) * (after[1] + hurry_above * after[3]))


# There is no NaN, and the sign of zero does not matter, so maxima are vectorised.
@functools.partial(cached, nogil=True, fastmath={"nnan", "nsz"})
def _choose(outcomes: Outcomes, lists: Lists, edges: I32, following: F64, against: bool, best_of: Choices) -> None:
    """Best strokes of the states of a block; see :func:`block_choices`.

    Args:
        outcomes: in the order of :attr:`Lists.order`.
        edges: ``[V]`` edge that follows each reply.
        following: ``[4, V]`` gathered values.
        against: whether nature picks the worst game for the striker.
    """
    (limits, hurry), size = outcomes, best_of.value.size
    games = len(limits)
    # Values of the strokes of a list, in the game that nature picks, and the best ones; in units of 1/65536.
    worth, best, rank = np.empty(lists.pair_start[-1]), np.empty(size), np.empty(size, np.int32)
    for a in range(lists.first_reply.size):
        states = lists.state[lists.start[a] : lists.start[a + 1]]
        n, first = states.size, lists.first_reply[a]
        count = lists.end_reply[a] - first
        for i in range(n):
            best[i] = -1e300
        for k in range(count):
            v, values = first + k, worth[k * n : k * n + n]
            start, end = lists.pair_start[v], lists.pair_start[v + 1]
            after = following[0, v], following[1, v], following[2, v], following[3, v]
            for g in range(games):
                fault, winner, below = limits[g, 0, start:end], limits[g, 1, start:end], limits[g, 2, start:end]
                hurry_below, hurry_above = hurry[g, 0, start:end], hurry[g, 1, start:end]
                for i in range(n):
                    value = worth_of(float(fault[i]), float(winner[i]), float(below[i]), hurry_below[i], hurry_above[i], after)
                    values[i] = value if g == 0 else (min(values[i], value) if against else max(values[i], value))
            for i in range(n):
                best[i] = max(best[i], values[i])
        for k in range(count - 1, -1, -1):
            values = worth[k * n : k * n + n]
            for i in range(n):
                rank[i] = k if values[i] >= best[i] - TIE * 65536.0 else rank[i]
        for i in range(n):
            s, k = states[i], rank[i]
            v, g = first + k, 0
            pair = lists.pair_start[v] + i
            after = following[0, v], following[1, v], following[2, v], following[3, v]
            while True:
                won, under = float(limits[g, 1, pair]), float(limits[g, 2, pair])
                hurried_below, hurried_above = hurry[g, 0, pair], hurry[g, 1, pair]
                value = worth_of(float(limits[g, 0, pair]), won, under, hurried_below, hurried_above, after)
                if g == games - 1 or abs(value - worth[k * n + i]) <= TIE * 65536.0:
                    break
                g += 1
            low, high = under - won, 65536.0 - under
            hurried_low, hurried_high = low * (hurried_below / 256.0), high * (hurried_above / 256.0)
            best_of.value[s], best_of.rank[s], best_of.edge[s] = best[i] / 65536.0, k, edges[v]
            best_of.outcome[s, 0], best_of.outcome[s, 1] = low - hurried_low, high - hurried_high
            best_of.outcome[s, 2], best_of.outcome[s, 3] = hurried_low, hurried_high


@compiled
def _follow(chosen: Choices, attack: Bools, plain: F64, after_attack: F64, out: F64) -> None:
    """Change in the value of each state's chosen stroke, from the changes of its successors."""
    for s in range(out.size):
        edge, outcome = chosen.edge[s], chosen.outcome[s]
        change = (after_attack if attack[edge] else plain)[4 * edge : 4 * edge + 4]
        below = outcome[0] * change[0] + outcome[2] * change[2]
        out[s] = -(below + (outcome[1] * change[1] + outcome[3] * change[3])) / 65536.0


@compiled
def _mean(chances: Chances, unit: float, outcomes: Outcomes, lists: Lists, following: F64, out: F64) -> None:
    """Mean of what follows the strokes of each state; chances and outcomes in the order of :attr:`Lists.order`."""
    sums = np.empty(out.size)
    for a in range(lists.first_reply.size):
        states = lists.state[lists.start[a] : lists.start[a + 1]]
        total = sums[: states.size]
        total[:] = 0.0
        for v in range(lists.first_reply[a], lists.end_reply[a]):
            first, last = lists.pair_start[v], lists.pair_start[v + 1]
            chance, played = chances[first:last], False
            for i in range(chance.size):
                played |= chance[i] > 0
            if not played:  # as most strokes of a policy that hardly mixes
                continue
            winner, below = outcomes.limits[0, 1, first:last], outcomes.limits[0, 2, first:last]
            hurry_below, hurry_above = outcomes.hurry[0, 0, first:last], outcomes.hurry[0, 1, first:last]
            low, high, low_hurried, high_hurried = following[0, v], following[1, v], following[2, v], following[3, v]
            for i in range(chance.size):
                under = float(below[i])
                lower = (under - float(winner[i])) * (low + hurry_below[i] * low_hurried)
                total[i] += chance[i] * (lower + (65536.0 - under) * (high + hurry_above[i] * high_hurried))
        for i in range(states.size):
            out[states[i]] = total[i] * unit


@compiled
def _soften(outcomes: Outcomes, lists: Lists, prior: F64, tau: float, following: F64, out: F64, policy: F64) -> None:
    """Soft maxima of the states, and their policy; that and the prior in the order of :attr:`Lists.order`."""
    limits, hurry = outcomes.limits[0], outcomes.hurry[0]
    best, total, change = np.empty(out.size), np.empty(out.size), np.empty(out.size)
    for a in range(lists.first_reply.size):
        states = lists.state[lists.start[a] : lists.start[a + 1]]
        n = states.size
        for i in range(n):
            best[i] = -1e300
            total[i] = change[i] = 0.0
        of_list = range(lists.first_reply[a], lists.end_reply[a])
        for v in of_list:
            start = lists.pair_start[v]
            after = following[0, v], following[1, v], following[2, v], following[3, v]
            for i in range(n):
                pair = start + i
                fault, winner, below = float(limits[0, pair]), float(limits[1, pair]), float(limits[2, pair])
                policy[pair] = worth_of(fault, winner, below, hurry[0, pair], hurry[1, pair], after) / 65536.0
                if prior[pair] > 0.0:
                    best[i] = max(best[i], policy[pair])
        for v in of_list:
            start = lists.pair_start[v]
            for i in range(n):
                x = min((policy[start + i] - best[i]) / tau, 0.0)
                # For a large tau all terms are close to 1, so their differences are summed separately.
                if tau > 1.0:
                    change[i] += prior[start + i] * np.expm1(x)
                policy[start + i] = prior[start + i] * np.exp(x)
                total[i] += policy[start + i]
        for v in of_list:
            start = lists.pair_start[v]
            for i in range(n):
                policy[start + i] /= total[i]
        for i in range(n):
            out[states[i]] = best[i] + tau * (np.log1p(change[i]) if tau > 1.0 else np.log(total[i]))


@compiled
def _propagate(chances: Chances, unit: float, outcomes: Outcomes, lists: Lists, visits: F64, out: F64) -> None:
    """Transpose of :func:`_mean`: the visits of each state as visits of its successors, for :func:`_scatter_add`."""
    limits, hurry = outcomes.limits[0], outcomes.hurry[0]
    shares, parts = np.empty(visits.size), np.empty((4, visits.size))
    for a in range(lists.first_reply.size):
        states = lists.state[lists.start[a] : lists.start[a + 1]]
        n, visited = states.size, False
        for i in range(n):
            shares[i] = visits[states[i]] * unit
            visited |= shares[i] != 0.0
        for v in range(lists.first_reply[a], lists.end_reply[a]):
            low, high, low_hurried, high_hurried = 0.0, 0.0, 0.0, 0.0
            first, last = lists.pair_start[v], lists.pair_start[v + 1]
            chance, played = chances[first:last], False
            for i in range(n if visited else 0):
                played |= chance[i] > 0
            if played:
                winner, below = limits[1, first:last], limits[2, first:last]
                hurry_below, hurry_above = hurry[0, first:last], hurry[1, first:last]
                for i in range(n):
                    share, under = chance[i] * shares[i], float(below[i])
                    lower, upper = (under - float(winner[i])) * share, (65536.0 - under) * share
                    parts[2, i], parts[3, i] = lower * (hurry_below[i] / 256.0), upper * (hurry_above[i] / 256.0)
                    parts[0, i], parts[1, i] = lower - parts[2, i], upper - parts[3, i]
                for i in range(n):
                    low += parts[0, i]
                    high += parts[1, i]
                    low_hurried += parts[2, i]
                    high_hurried += parts[3, i]
            out[0, v], out[1, v], out[2, v], out[3, v] = low, high, low_hurried, high_hurried


@compiled
def _expect(chances: Chances, unit: float, outcomes: Outcomes, lists: Lists, reward: F64, continuation: F64) -> None:
    gains, remainders = np.empty(reward.size), np.empty(reward.size)
    for a in range(lists.first_reply.size):
        states = lists.state[lists.start[a] : lists.start[a + 1]]
        gained, continued = gains[: states.size], remainders[: states.size]
        gained[:] = 0.0
        continued[:] = 0.0
        for v in range(lists.first_reply[a], lists.end_reply[a]):
            first, last = lists.pair_start[v], lists.pair_start[v + 1]
            chance, fault, winner = chances[first:last], outcomes.limits[0, 0, first:last], outcomes.limits[0, 1, first:last]
            for i in range(states.size):
                won = float(winner[i])
                gained[i] += chance[i] * (won - 2.0 * float(fault[i]))
                continued[i] += chance[i] * (65536.0 - won)
        for i in range(states.size):
            reward[states[i]], continuation[states[i]] = gained[i] * unit, continued[i] * unit


def _make_outcomes(games: tuple[Game, ...], table: int) -> Outcomes:
    order = lists_of(games[0]).order
    limits = np.stack([game.limits[table].T.take(order, axis=1) for game in games])
    return Outcomes(limits, np.stack([game.hurry_at(table).T.take(order, axis=1) for game in games]))


_kept: Final = functools.lru_cache(maxsize=48)(_make_outcomes)
_kept_met: Final = functools.lru_cache(maxsize=8)(_make_outcomes)
"""Tables against known positions are larger, and each opponent has its own."""


def _outcomes(games: tuple[Game, ...], table: int) -> Outcomes:
    """The outcomes in a row of the limits of games of one layout."""
    return (_kept if games[0].tables is games[0] else _kept_met)(games, table)


def listed(game: Game, chance: Chances) -> Chances:
    """``[base pairs]`` chances of a block in the order of :attr:`Lists.order`."""
    return chance[lists_of(game).order]


def block_choices(games: tuple[Game, ...], block: int, plain: F64, after_attack: F64, *, against: bool = False) -> Choices:
    """The best strokes in the states of one block: ``[base states]`` of :class:`Choices`.

    Args:
        games: tables of the striker, of one layout; nature picks one after each stroke, the first of tied ones.
        plain, after_attack: ``[base states]`` values of the blocks after a stroke that is no attack and after an attack.
        against: whether nature picks the worst game for the striker; else the best one.
    """
    game = games[0]
    size = game.n_base_states
    found = Choices(np.zeros(size), np.full(size, -1, np.int32), np.zeros(size, np.int32), np.zeros((size, 4)))
    outcomes, following = _outcomes(games, game.table_of(block)), gathered(game, plain, after_attack)
    _choose(outcomes, lists_of(game), game.reply_edge, following, against, found)
    return found


def after_block_choices(game: Game, chosen: Choices, plain: F64, after_attack: F64) -> F64:
    """``[base states]`` linear part of :func:`block_choices` at the chosen strokes."""
    out = np.empty(game.n_base_states)
    _follow(chosen, game.edge_attack, plain, after_attack, out)
    return out


def gathered(game: Game, plain: F64, after_attack: F64) -> F64:
    """``[4, V]`` values of the successors of each reply in a block, see :func:`_gather`."""
    out = np.empty((4, len(game.reply_edge)))
    _gather(plain, after_attack, replies(game), out)
    return out


def unit_of(chance: Chances) -> float:
    """Probability that a chance of 1 stands for, by the type of the numbers."""
    return 1 / CHOICE_ONE if chance.dtype.kind == "u" else 1.0


def block_expected(game: Game, block: int, chance: Chances) -> tuple[F64, F64]:
    """``[base states]`` expected reward to the striker and probability that the rally continues, under :func:`listed` chances."""
    reward, continuation = np.zeros(game.n_base_states), np.zeros(game.n_base_states)
    _expect(chance, unit_of(chance) / ONE, _outcomes((game,), game.table_of(block)), lists_of(game), reward, continuation)
    return reward, continuation


def block_mean(game: Game, block: int, chance: Chances, plain: F64, after_attack: F64) -> F64:
    """``[base states]`` mean value of the successors of each state of one block under :func:`listed` chances."""
    out = np.zeros(game.n_base_states)
    outcomes, following = _outcomes((game,), game.table_of(block)), gathered(game, plain, after_attack)
    _mean(chance, unit_of(chance) / ONE, outcomes, lists_of(game), following, out)
    return out


def block_soft_values(game: Game, block: int, prior: F64, tau: float, plain: F64, after_attack: F64) -> tuple[F64, F64]:
    """``[base states]`` soft maxima of one block, and ``[base pairs]`` their :func:`listed` policy; see :func:`.solve_soft`.

    Args:
        prior: :func:`listed` probability of each base pair.
        tau: cost of a nat of divergence from it.
    """
    out, policy = np.zeros(game.n_base_states), np.empty(game.n_base_pairs)
    following = gathered(game, plain, after_attack)
    _soften(_outcomes((game,), game.table_of(block)), lists_of(game), prior, tau, following, out, policy)
    return out, policy


def propagate(game: Game, chances: Sequence[Chances], visits: F64) -> F64:
    """``[S]`` visits of the successors of ``[S]`` visits, under :func:`listed` chances of each block: a sweep transposed."""
    out, values = np.zeros(game.n_states), np.zeros((4, len(game.reply_edge)))
    for block, chance in enumerate(chances):
        here = visits[game.block_states(block)]
        if here.any():
            _propagate(chance, unit_of(chance) / ONE, _outcomes((game,), game.table_of(block)), lists_of(game), here, values)
            plain, attack = (out[game.block_states(after)] for after in game.block_following(block))
            _scatter_add(values, replies(game), plain, attack)
    return out


def warm_up(game: Game) -> None:
    """Compile the sweeps, or load them from the disk, by sweeping one block."""
    zeros, states = np.zeros(game.n_base_states), np.ones(game.n_states)
    after_block_choices(game, block_choices((game,), 0, zeros, zeros), zeros, zeros)
    for chance in (np.zeros(game.n_base_pairs), np.zeros(game.n_base_pairs, np.uint16)):
        block_expected(game, 0, chance)
        block_mean(game, 0, chance, zeros, zeros)
        propagate(game, [chance], states)
