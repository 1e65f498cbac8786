"""A fixed policy turns a player's strokes into a Markov chain."""

import dataclasses

import numpy as np
import numpy.typing as npt

from shuttle_marl.exact.contraction import FIRST_RALLY_STATE
from shuttle_marl.exact.errors import ExactError
from shuttle_marl.exact.sweeps import mean_following, pushed
from shuttle_marl.game.rally import ONE, Game
from shuttle_marl.game.table import TabulatedPolicy

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class InducedChain:
    """What happens when one player strikes by a policy.

    Attributes:
        game: the tables with which the player strikes.
        reward: ``[S]`` expected reward to the striker of the stroke played: chance of a winner minus chance of a fault.
        weight: ``[2 P]`` chance that a legal pair is played and the receiver strikes next, from below and from above in turn.
        contraction: the largest chance to go on in a rally state.
    """

    game: Game
    reward: Floats
    weight: Floats
    contraction: float

    def go_on(self, following: Floats) -> Floats:
        """``[S]`` C following: the mean of what follows each state, the end of the rally counting as 0."""
        return mean_following(self.game, self.weight, following)

    def lead_to(self, visits: Floats) -> Floats:
        """``[S]`` C' visits: how often each state follows, given how often the striker is in each state."""
        return pushed(self.game, self.weight, visits)

    def values(self, following: Floats) -> Floats:
        """``[S]`` value of every state to the striker, ``following`` the value of the next states to the receiver."""
        return self.reward - self.go_on(following)


def induced(policy: TabulatedPolicy) -> InducedChain:
    """The chain of a policy, with the chances exactly as they are played from its table.

    Raises:
        ExactError: the policy may go on for ever.
    """
    game = policy.game
    chance = policy.pair_probabilities()
    fault, winner, below = game.threshold.astype(np.float64).T / ONE
    reward = np.asarray(np.bincount(game.pair_state, chance * (winner - 2 * fault), game.n_states), dtype=np.float64)
    continuation = np.bincount(game.pair_state, chance * (1 - winner), game.n_states)[FIRST_RALLY_STATE:]
    if continuation.max(initial=0.0) >= 1:
        state = FIRST_RALLY_STATE + int(continuation.argmax())
        raise ExactError(f"no stroke of the policy ever ends the rally in state: {game.describe(state)}")
    weight = np.stack([chance * (below - winner), chance * (1 - below)], axis=1).ravel()
    return InducedChain(game=game, reward=reward, weight=weight, contraction=float(continuation.max(initial=0.0)))


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
