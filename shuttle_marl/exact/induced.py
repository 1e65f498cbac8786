"""A fixed policy turns a player's strokes into a Markov chain."""

import dataclasses
import functools

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix

from shuttle_marl.exact.contraction import FIRST_RALLY_STATE
from shuttle_marl.exact.errors import ExactError
from shuttle_marl.policy.table import TabulatedPolicy
from shuttle_marl.rally import ONE, Game

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class InducedChain:
    """What happens when one player strikes by a policy.

    Attributes:
        reward: ``[S]`` expected reward to the striker of the stroke played: chance of a winner minus chance of a fault.
        go_on: ``[S, S]`` sparse, chance that the receiver strikes next, in each state.
        contraction: the largest chance to go on in a rally state.
    """

    reward: Floats
    go_on: csr_matrix
    contraction: float

    def values(self, following: Floats) -> Floats:
        """``[S]`` value of every state to the striker, ``following`` the value of the next states to the receiver."""
        return np.asarray(self.reward - self.go_on @ following)


def induced(policy: TabulatedPolicy) -> InducedChain:
    """The chain of a policy, with the chances exactly as they are played from its table.

    Raises:
        ExactError: the policy may go on for ever.
    """
    game = policy.game
    chance = policy.pair_probabilities()
    threshold = game.threshold.astype(np.float64) / ONE
    fault, winner, below = threshold.T
    reward = np.asarray(np.bincount(game.pair_state, chance * (winner - 2 * fault), game.n_states), dtype=np.float64)
    continuation = np.bincount(game.pair_state, chance * (1 - winner), game.n_states)[FIRST_RALLY_STATE:]
    if continuation.max(initial=0.0) >= 1:
        state = FIRST_RALLY_STATE + int(continuation.argmax())
        raise ExactError(f"no stroke of the policy ever ends the rally in state: {game.describe(state)}")
    weight = np.stack([chance * (below - winner), chance * (1 - below)], axis=1).ravel()
    successor, row_start = _successors(game)
    go_on = csr_matrix((weight, successor, row_start), shape=(game.n_states, game.n_states))
    # Policies that play few strokes get matrices of their own; the others share the indices, half of the memory.
    if np.count_nonzero(weight) < len(weight) // 2:
        go_on = go_on.copy()
        go_on.eliminate_zeros()
    return InducedChain(reward=reward, go_on=go_on, contraction=float(continuation.max(initial=0.0)))


@functools.lru_cache(maxsize=2)
def _successors(game: Game) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """``[2 P]`` next states of the legal pairs, contact below and above, and ``[S + 1]`` where those of a state begin."""
    successor = np.repeat(2 * game.pair_edge, 2)
    successor[1::2] += 1
    return successor, 2 * game.pair_start


def check_same_layout(first: Game, second: Game) -> None:
    """Two players' tables must name the same states and strokes; only the chances may differ.

    Raises:
        ExactError: they do not.
    """
    if first is second:
        return
    if first.catalogue.names != second.catalogue.names:
        raise ExactError(
            f"the two players' games have different catalogues ({first.catalogue.version} and {second.catalogue.version}); "
            "compile both from the same catalogue and the same rule of legality"
        )
    for table in ("edge_own", "edge_incoming", "reply_start", "reply_count", "pair_start"):
        if not np.array_equal(getattr(first, table), getattr(second, table)):
            raise ExactError(
                f"the two players' games differ in {table}, so their states are not the same; "
                "compile both from the same catalogue and the same rule of legality"
            )
