"""Columns that are not recorded because they follow from the game and the policies: states and probabilities."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from shuttle_marl.game.rally import Game
from shuttle_marl.game.table import TabulatedPolicy
from shuttle_marl.recording.reader import RallyLog
from shuttle_marl.recording.schema import Rallies, RecordingError
from shuttle_marl.recording.tables import rows_of_strokes


class Derived:
    """Makes columns of strokes; :meth:`shuttle_marl.recording.RallyLog.stroke_table` takes it as ``derive``.

    Args:
        log: whose rallies they are.
        game: the game that was played on.
        policies: tables of policies by name; the probability with which they chose a stroke is added.

    Raises:
        RecordingError: the log was played on another game.
    """

    def __init__(self, log: RallyLog, game: Game, policies: Mapping[str, TabulatedPolicy] | None = None) -> None:
        require_game(log, game)
        self._game = game
        self._chances = game.chances()
        chosen = {name: policy.pair_probabilities() for name, policy in (policies or {}).items()}
        self._policies = {i: chosen[player.name] for i, player in enumerate(log.policies) if player.name in chosen}

    def __call__(self, rallies: Rallies) -> dict[str, npt.NDArray[np.generic]]:
        """Columns of the strokes of a batch.

        Returns:
            ``[N]`` each: ``state`` (int32), ``p_succ`` that the stroke is good, ``p_ret`` that a good one is returned and
            ``p_above`` that this happens above the net (float64), and with policies ``probability`` (float64) with which
            the striker's policy chooses the stroke, NaN for other policies. A stroke that is not legal has state -1 and
            probabilities NaN.
        """
        state, k = states(self._game, rallies)
        pair = self._game.pair_at(np.maximum(state, 0), np.maximum(k, 0))
        names = ("p_succ", "p_ret", "p_above")
        columns = {name: np.where(state < 0, np.nan, p[pair]) for name, p in zip(names, self._chances, strict=True)}
        found: dict[str, npt.NDArray[np.generic]] = {"state": state, **columns}
        if self._policies:
            row, _, seat = rows_of_strokes(rallies)
            striker = rallies.policy[row, seat]
            probability = np.full(len(state), np.nan)
            for i, p in self._policies.items():
                mine = (striker == i) & (state >= 0)
                probability[mine] = p[pair[mine]]
            found["probability"] = probability
        return found


def require_game(log: RallyLog, game: Game) -> None:
    """Refuse another game than that of a log.

    Raises:
        RecordingError: it is another.
    """
    played = log.files[0].header.game
    if played != game.hash:
        raise RecordingError(f"{log.path}: played on game {played[:12]}, not on {game.hash[:12]}; name its model with --game")


def states(game: Game, rallies: Rallies) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """``[N]`` each: the state in which every stroke was struck, and which of its legal strokes it is.

    Both are -1 where the stroke, or the one it answers, is not legal.
    """
    _, position, _ = rows_of_strokes(rallies)
    n = game.n_strokes
    stroke = rallies.stroke.astype(np.int64)
    own = np.where(position >= 2, np.r_[n, n, stroke[:-2]][: len(stroke)], n)
    incoming = np.where(position >= 1, np.r_[n, stroke[:-1]], n)
    state = game.state_of(own, incoming, game.catalogue.height[stroke])
    k = np.where(state < 0, -1, game.rank(np.maximum(state, 0), stroke))
    return np.where(k < 0, -1, state), k
