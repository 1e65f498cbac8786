"""Constant lists: one order of preference of the strokes for all states, or one for each incoming shot type and contact.

The player plays the first legal stroke of the list. The list is improved by exact policy iteration in this class: strokes are
ordered by their mean loss, the value of the best stroke minus their own, over the states that the player visits. It is a
reference: it uses the tables, and shows how little of the state an opponent's weaknesses need.
"""

import numpy as np

from shuttle_marl.arrays import F64, I64, Ints
from shuttle_marl.exact import evaluate, visits
from shuttle_marl.exact.optimal import pure_policy
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.suite.players import PlayerSetting, Trained

_ROUNDS = 6
_TOLERANCE = 1e-6


def constant(setting: PlayerSetting) -> Trained:
    """One list for all states."""
    return Trained(player=best_list(setting, np.zeros(setting.game.n_base_states, dtype=np.int64)), strokes=0)


def by_incoming(setting: PlayerSetting) -> Trained:
    """One list for each incoming shot type and contact."""
    return Trained(player=best_list(setting, incoming_cells(setting.game)), strokes=0)


def incoming_cells(game: Game) -> I64:
    """``[base states]`` number of the incoming shot type and contact."""
    state = np.arange(game.n_base_states)
    shot = np.append(game.catalogue.shot, game.catalogue.shot.max() + 1).astype(np.int64)
    return np.asarray(2 * shot[game.incoming(state)] + game.contact(state))


def best_list(setting: PlayerSetting, cell: Ints) -> TabulatedPolicy:
    """The best list found for each cell ``[base states]`` of states."""
    game = setting.game
    opponent = tabulate(resolve(setting.opponent or "bc", game), game)
    player, best, won = opponent, opponent, -1.0
    for _ in range(_ROUNDS):
        value = evaluate(player, opponent, tolerance=_TOLERANCE)
        if value.odds().rally <= won:
            break
        best, won = player, value.odds().rally
        weight = visits(player, opponent, tolerance=_TOLERANCE).states[0]
        player = list_policy(game, cell, mean_losses(game, cell, value.striking[1], weight))
    return best


def mean_losses(game: Game, cell: Ints, following: F64, weight: F64) -> F64:
    """``[cells, n]`` mean loss of each stroke where it is legal; infinity where it never is.

    Args:
        game: the tables.
        cell: ``[base states]`` cell of each state.
        following: ``[S]`` values of the next states to the receiver.
        weight: ``[S]`` weights of the states.
    """
    n = game.n_strokes
    key = cell[game.base_pair_state] * n + game.base_pair_stroke
    size = (int(cell.max()) + 1) * n
    first = game.base_pair_start[:-1][game.playable[: game.n_base_states]]
    loss, total = np.zeros(size), np.zeros(size)
    for block in range(game.n_blocks):
        q = game.stroke_values(following, game.block_pairs(block))
        best = np.zeros(game.n_base_states)
        best[game.playable[: game.n_base_states]] = np.maximum.reduceat(q, first)
        # Every state counts a little, so that rare ones have an order too.
        share = weight[game.block_states(block)][game.base_pair_state] + 1e-12
        loss += np.bincount(key, share * (best[game.base_pair_state] - q), size)
        total += np.bincount(key, share, size)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(total > 0, loss / total, np.inf).reshape(-1, n)


def list_policy(game: Game, cell: Ints, losses: F64) -> TabulatedPolicy:
    """The policy that plays the legal stroke of the smallest loss of its cell."""
    worth = losses[cell[game.base_pair_state], game.base_pair_stroke]
    # The last entry in this order is the best stroke of its state.
    order = np.lexsort((-worth, game.base_pair_state))
    rank = np.full(game.n_base_states, -1, dtype=np.int32)
    rank[game.base_pair_state[order]] = game.base_pair_rank[order]
    return pure_policy(game, np.tile(rank, game.n_blocks))
