"""Built-in opponents of environments for one player."""

import bisect
from collections.abc import Sequence

import numpy as np

from shuttle_marl.game.policy import Policy, States, checked_probabilities, drawn_strokes, reads_score
from shuttle_marl.game.rally import Game
from shuttle_marl.game.table import TabulatedPolicy, tabulate
from shuttle_marl.policy.registry import resolve

Opponents = str | Policy | Sequence[str | Policy]
"""Name of a policy, a policy, or several of either."""


def find(opponent: str | Policy, game: Game) -> tuple[Policy, str]:
    """A policy and what to call it.

    Raises:
        PolicyError: there is no policy of that name.
    """
    return (resolve(opponent, game), opponent) if isinstance(opponent, str) else (opponent, type(opponent).__name__)


def tabulated(opponents: Opponents, game: Game) -> list[TabulatedPolicy]:
    """One opponent or several as tables.

    Raises:
        PolicyError: there is no such opponent, it is no distribution over the legal strokes, or it reads the score.
    """
    several = opponents if isinstance(opponents, Sequence) and not isinstance(opponents, str) else [opponents]
    return [tabulate(policy, game, name) for policy, name in (find(opponent, game) for opponent in several)]


class Opponent:
    """Chooses one stroke at a time: from a table, or by asking a policy that reads the score.

    Attributes:
        name: the policy's name.
        policy: the policy.
        reads_score: whether it has to be told the score.

    Raises:
        PolicyError: there is no such policy, or it is no distribution over the legal strokes.
    """

    def __init__(self, opponent: str | Policy, game: Game) -> None:
        self.policy, self.name = find(opponent, game)
        self.reads_score = reads_score(self.policy)
        self._game = game
        self._cumulative = None if self.reads_score else tabulate(self.policy, game, self.name).cumulative

    def choose(self, state: int, draw: int, score: tuple[int, int, int, int] | None) -> int:
        """Catalogue index of the stroke that is played in a state.

        Args:
            state: state of the opponent, who is the striker.
            draw: uniform integer in [0, 65535).
            score: the opponent's points, the other's points, the opponent's games and the other's games.

        Raises:
            PolicyError: a policy that reads the score raised, or returned no distribution.
        """
        game = self._game
        if self._cumulative is not None:
            pairs = game.pairs_of(state)
            return int(game.pair_stroke[bisect.bisect_right(self._cumulative, draw, pairs.start, pairs.stop)])
        states = States(game=game, state=np.array([state], np.int32), score=np.array([score], np.int16))
        return int(drawn_strokes(checked_probabilities(self.policy, states, self.name), np.array([draw]))[0])
