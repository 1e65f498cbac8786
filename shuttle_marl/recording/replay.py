"""Everything that follows from a log, its game and its policies: states, probabilities, and the rallies played again."""

import dataclasses
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from shuttle_marl.arrays import I32, Bools
from shuttle_marl.game import draws
from shuttle_marl.game.rules import WINNER, strike
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.rally.record import Rallies
from shuttle_marl.recording.header import LogHeader
from shuttle_marl.recording.reader import RallyLog
from shuttle_marl.recording.schema import RecordingError


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
        chosen = policies or {}
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
        known = self._game.stroke_probabilities(pair)
        columns = {name: np.where(state < 0, np.nan, p) for name, p in zip(names, known, strict=True)}
        found: dict[str, npt.NDArray[np.generic]] = {"state": state, **columns}
        if self._policies:
            striker = rallies.policy[rallies.row_of_stroke, rallies.striker]
            probability = np.full(len(state), np.nan)
            for i, policy in self._policies.items():
                mine = (striker == i) & (state >= 0)
                probability[mine] = policy.probability_of(pair[mine])
            found["probability"] = probability
        return found


def require_game(log: RallyLog, game: Game) -> None:
    """Refuse another game than that of a log.

    Raises:
        RecordingError: it is another.
    """
    played = log.files[0].header.game
    if played != game.hash:
        raise RecordingError(
            f"{log.path}: played on game {played[:12]}, not on {game.hash[:12]}; name its model with --game (and --profile)"
        )


def states(game: Game, rallies: Rallies) -> tuple[I32, I32]:
    """``[N]`` each: the state in which every stroke was struck, and which of its legal strokes it is.

    Both are -1 where the stroke, or the one it answers, is not legal.
    """
    state = rallies.states(game)
    k = np.where(state < 0, -1, game.rank(np.maximum(state, 0), rallies.stroke.astype(np.int64)))
    return np.where(k < 0, -1, state), k


@dataclasses.dataclass(frozen=True, kw_only=True)
class Replay:
    """Result of playing rallies again.

    Attributes:
        rallies: number played again.
        strokes: number of their strokes.
        wrong: numbers of the rallies of which a stroke is illegal, an outcome, the winner or a choice differs.
    """

    rallies: int
    strokes: int
    wrong: tuple[int, ...]


def replay(log: RallyLog, game: Game, policies: Mapping[str, TabulatedPolicy] | None = None) -> Replay:
    """Play every rally of a log again.

    Where a log says that its draws are unknown, only the legality of strokes and the winners are checked.

    Args:
        log: the log.
        game: the game it was played on.
        policies: tables of policies by name; strokes of those are chosen again from the draws as well.

    Raises:
        RecordingError: the log was played on another game; or it is damaged.
    """
    require_game(log, game)
    rallies = strokes = 0
    wrong: list[int] = []
    for file, offset in ((file, offset) for offset, files in log.logs for file in files):
        names = [player.name for player in file.header.policies]
        chosen = {i: policies[name] for i, name in enumerate(names) if policies and name in policies}
        for i in range(len(file.rallies)):
            first, batch = file.batch(i)
            rallies, strokes = rallies + len(batch), strokes + len(batch.stroke)
            bad = _wrong_strokes(file.header, game, batch, chosen)
            row = batch.row_of_stroke
            wrong.extend((offset + first + np.unique(np.r_[row[bad], np.flatnonzero(_wrong_winner(batch))])).tolist())
    return Replay(rallies=rallies, strokes=strokes, wrong=tuple(wrong))


def _wrong_strokes(header: LogHeader, game: Game, rallies: Rallies, policies: Mapping[int, TabulatedPolicy]) -> Bools:
    """``[N]`` strokes that are illegal, have another outcome than the draw gives, or are not what their policy chooses."""
    state, k = states(game, rallies)
    wrong = state < 0
    if header.draws == "unknown":
        return wrong
    legal = np.flatnonzero(~wrong)
    key = header.rally_key(rallies)
    bits = draws.draw(key[rallies.row_of_stroke[legal]], rallies.position[legal])
    outcome, _ = strike(game, state[legal], k[legal], draws.outcome_draw(bits))
    wrong[legal] = outcome != rallies.outcome(game.catalogue)[legal]
    policy = rallies.policy[rallies.row_of_stroke[legal], rallies.striker[legal]]
    for i, played in policies.items():
        mine = np.flatnonzero(policy == i)
        wrong[legal[mine]] |= played.choose(state[legal[mine]], draws.choice_draw(bits[mine])) != k[legal[mine]]
    return wrong


def _wrong_winner(rallies: Rallies) -> Bools:
    """``[R]`` rallies that the log gives to the wrong player: the last striker wins by a winner and loses by a fault."""
    last = (rallies.server + rallies.length - 1) & 1
    wrong: Bools = rallies.winner != np.where(rallies.reason == WINNER, last, 1 - last)
    return wrong
