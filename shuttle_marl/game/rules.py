"""The rules of a rally as functions of a state, for a batch at a time."""

from typing import Final

import numpy as np

from shuttle_marl.base.arrays import I8, I32, Bools, Ints
from shuttle_marl.base.errors import ActionError
from shuttle_marl.game.layout import LONGEST_DUEL, Layout
from shuttle_marl.game.tables import Game
from shuttle_marl.game.thresholds import ONE

OUTCOMES: Final = (
    "fault",
    "winner",
    "returned from below",
    "returned from above",
    "returned from below, hurried",
    "returned from above, hurried",
)
"""Ends of a stroke. That of a return names the receiver's contact and whether they are hurried."""
FAULT, WINNER, RETURNED_BELOW, RETURNED_ABOVE, HURRIED_BELOW, HURRIED_ABOVE = range(6)


class IllegalStrokeError(ActionError):
    """A stroke of the catalogue that is not legal in the state, or in the kernel a stroke in a rally that is over.

    Attributes:
        stroke: its catalogue index.
        row: row of a batch; None outside of batches.
    """

    def __init__(self, message: str, stroke: int, row: int | None = None) -> None:
        super().__init__(message)
        self.stroke, self.row = stroke, row


def states_of_rallies(game: Layout, stroke: Ints, position: Ints, hurried: Bools | Ints) -> I32:
    """The state in which each stroke of rallies was struck.

    Args:
        stroke: ``[N]`` catalogue indices, rally after rally.
        position: ``[N]`` number of each stroke in its rally, from 0.
        hurried: ``[N]`` whether the striker of each stroke was hurried.

    Returns:
        ``[N]`` state, -1 where the game has no such state. It does not look whether the stroke is legal there.
    """
    n, stroke, position = game.n_strokes, np.asarray(stroke, dtype=np.int64), np.asarray(position, dtype=np.int64)
    row = np.arange(len(stroke))
    own = np.where(position >= 2, stroke[np.maximum(row - 2, 0)], n)
    incoming = np.where(position >= 1, stroke[np.maximum(row - 1, 0)], n)
    even = position % 2 == 0
    attack = game.catalogue.is_attack[stroke]
    # Attacks before each stroke since the beginning of its rally, of those who struck at even and at odd positions.
    so_far = np.stack([np.r_[0, np.cumsum(attack & side)] for side in (even, ~even)])
    counts = np.minimum(so_far[:, row] - so_far[:, row - position], game.levels - 1)
    effort, opponent_effort = np.where(even, counts, counts[::-1])
    duel = np.zeros(len(stroke), dtype=np.int64)
    if game.counts_duels:
        net = game.catalogue.is_net_shot[stroke]
        # The last stroke up to each one that is no net shot; at the latest the one before the rally.
        broken = np.maximum.accumulate(np.where(net, row - position - 1, row))
        in_a_row = np.minimum(row - broken, LONGEST_DUEL)
        duel = np.where(position >= 1, in_a_row[np.maximum(row - 1, 0)], 0)
    hurry = np.asarray(hurried, dtype=np.int64)
    return game.state_of(own, incoming, game.catalogue.height[stroke], duel, effort, opponent_effort, hurry)


def strike(
    game: Game, state: Ints, k: Ints, draw: Ints, striker: Ints | None = None, position: Ints | None = None
) -> tuple[I8, I32]:
    """Play the k-th legal stroke of each state.

    Args:
        state: ``[B]`` state of the striker.
        k: ``[B]`` which of its legal strokes, 0 <= k < legal_count(state); not checked.
        draw: ``[B]`` uniform integers in [0, 2^24), see :func:`shuttle_marl.game.draws.outcome_draw`.
        striker: ``[B]`` seat of the striker, for the game of a pair; None: ``game`` holds the tables of all strikers.
        position: ``[B]`` position of the receiver, feasible in the state, which is not checked; None: ``game`` has no recovery.

    Returns:
        ``[B]`` outcome (index into :data:`OUTCOMES`) and ``[B]`` state of the receiver, who is the next striker;
        -1 where the rally is over.
    """
    if striker is not None and game.people is not None:
        ends, after = np.empty(len(state), np.int8), np.empty(len(state), np.int32)
        for seat, tables in enumerate(game.seats):
            at = striker == seat
            ends[at], after[at] = strike(tables, state[at], k[at], draw[at], None, None if position is None else position[at])
        return ends, after
    block, base = np.divmod(state, game.n_base_states)
    own, other = np.divmod(block, game.levels)
    # Rows by `take` and three comparisons: an index array and a sum over an axis of length three cost several times as much.
    row: Ints = game.base_pair_start[base] + k
    rows, hurry = game.limits, game.hurry
    if position is not None:
        row, rows, hurry = game.waiting.row(base, k, position), game.waiting.limits, game.waiting.hurry
    at = own * rows.shape[1] + row
    limits, low = rows.reshape(-1, 3).take(at, axis=0), draw & (ONE - 1)
    outcome = (low >= limits[..., 0]).view(np.int8) + (low >= limits[..., 1]) + (low >= limits[..., 2])
    above = np.maximum(outcome - RETURNED_BELOW, 0)
    hurried = (draw >> 16) < hurry[row, above]
    outcome += (HURRIED_BELOW - RETURNED_BELOW) * (hurried & (outcome >= RETURNED_BELOW)).view(np.int8)
    edge = game.reply_edge[game.first_reply[base] + k]
    after = other * game.levels + np.minimum(own + game.edge_attack[edge], game.levels - 1)
    following = after * game.n_base_states + 4 * edge + outcome - RETURNED_BELOW
    return outcome, np.where(outcome >= RETURNED_BELOW, following, -1).astype(np.int32)
