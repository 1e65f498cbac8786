"""Lists: policies that play the first legal stroke of an order of preference, one order for each cell of states.

The cells say what such a policy reads. A list is improved by exact policy iteration in its class: strokes are ordered by their
mean loss, the value of the best stroke minus their own, over the states of the cell that the policy visits.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np

from shuttle_marl.base.arrays import F64, I64, U16, Ints
from shuttle_marl.exact.occupancy import visits
from shuttle_marl.exact.optimal import pure_policy
from shuttle_marl.exact.profile import StatePolicy, evaluate, met_by
from shuttle_marl.game.layout import Layout
from shuttle_marl.game.policy import TabulatedPolicy, from_pair_probabilities
from shuttle_marl.game.tables import Game

_ROUNDS = 6
_TOLERANCE = 1e-6
_LITTLE = 1e-12
"""Weight of states that are never visited, so that the strokes of rare cells have an order too."""


def cells_of(game: Layout, *parts: str) -> I64:
    """``[S]`` cell of each state for policies that read some parts of it.

    Args:
        parts: methods of the game that take states: ``own``, ``incoming``, ``incoming_shot``, ``contact``, ``duel``, ``effort``,
            ``opponent_effort``, ``hurried``.
    """
    state = np.arange(game.n_states)
    cell = np.zeros(game.n_states, dtype=np.int64)
    for part in parts:
        value = getattr(game, part)(state)
        cell = cell * (int(value.max()) + 1) + value
    return np.unique(cell, return_inverse=True)[1]


def lists(opponent: StatePolicy, cell: Ints, waits: U16 | None = None) -> Iterator[TabulatedPolicy]:
    """Improving lists against an opponent, the best one last.

    Args:
        opponent: on the game that is played.
        cell: ``[S]`` cell of each state, see :func:`cells_of`.
        waits: positions of the lists with recovery, see :class:`~shuttle_marl.game.policy.TabulatedPolicy`.
    """
    game, won = opponent.game.opposite, -1.0
    tables = met_by(game, opponent)
    player: StatePolicy = opponent if opponent.game is game else from_pair_probabilities(game, opponent.pair_probabilities())
    for turn in range(_ROUNDS):
        value = evaluate(player, opponent, tolerance=_TOLERANCE)
        if turn and value.odds().rally <= won:
            return
        if turn:
            won = value.odds().rally
            assert isinstance(player, TabulatedPolicy)
            yield player
        weight = visits(player, opponent, tolerance=_TOLERANCE).states[0]
        player = dataclasses.replace(list_policy(game, cell, mean_losses(tables, cell, value.striking[1], weight)), waits=waits)


def averaged(policy: TabulatedPolicy, opponent: StatePolicy, cell: Ints) -> TabulatedPolicy:
    """The policy that plays each stroke as often as another one does on average in the states of its cell that it visits."""
    game = policy.game
    weight = visits(policy, opponent, tolerance=_TOLERANCE).states[0] + _LITTLE
    n = game.n_strokes
    played, met = (np.zeros((int(cell.max()) + 1) * n) for _ in range(2))
    for block, key in _keys(game, cell):
        here = weight[game.block_states(block)][game.base_pair_state]
        played += np.bincount(key, here * policy.block_probabilities(block), len(played))
        met += np.bincount(key, here, len(met))
    share = np.concatenate([(played / np.maximum(met, _LITTLE))[key] + _LITTLE for _, key in _keys(game, cell)])
    return dataclasses.replace(from_pair_probabilities(game, game.normalized(share)), waits=policy.waits)


def _keys(game: Game, cell: Ints) -> Iterator[tuple[int, I64]]:
    """Each block, and ``[base pairs]`` number of the cell and the stroke of its pairs."""
    for block in range(game.n_blocks):
        yield block, cell[game.block_states(block)][game.base_pair_state] * game.n_strokes + game.base_pair_stroke


def mean_losses(game: Game, cell: Ints, following: F64, weight: F64) -> F64:
    """``[cells * n]`` mean loss of each stroke where it is legal; infinity where it never is.

    Args:
        cell: ``[S]`` cell of each state.
        following: ``[S]`` values of the next states to the receiver.
        weight: ``[S]`` weights of the states.
    """
    size = (int(cell.max()) + 1) * game.n_strokes
    playable = game.playable[: game.n_base_states]
    first = game.base_pair_start[:-1][playable]
    loss, total = np.zeros(size), np.zeros(size)
    for block, key in _keys(game, cell):
        q = game.stroke_values(following, game.block_pairs(block))
        best = np.zeros(game.n_base_states)
        best[playable] = np.maximum.reduceat(q, first)
        share = weight[game.block_states(block)][game.base_pair_state] + _LITTLE
        loss += np.bincount(key, share * (best[game.base_pair_state] - q), size)
        total += np.bincount(key, share, size)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(total > 0, loss / total, np.inf)


def list_policy(game: Game, cell: Ints, losses: F64) -> TabulatedPolicy:
    """The policy that plays the legal stroke of the smallest loss of its cell."""
    rank = np.full(game.n_states, -1, dtype=np.int32)
    for block, key in _keys(game, cell):
        # The last entry in this order is the best stroke of its state.
        order = np.lexsort((-losses[key], game.base_pair_state))
        rank[game.block_states(block)][game.base_pair_state[order]] = game.base_pair_rank[order]
    return pure_policy(game, rank)
