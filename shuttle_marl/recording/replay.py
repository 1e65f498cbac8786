"""Plays recorded rallies again: the draws from the recorded seed, the outcomes from the rules, compared bit for bit."""

import dataclasses
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from shuttle_marl.game import draws
from shuttle_marl.game.rally import WINNER, Game, strike
from shuttle_marl.game.table import TabulatedPolicy
from shuttle_marl.recording.derived import require_game, states
from shuttle_marl.recording.header import LogHeader
from shuttle_marl.recording.reader import RallyLog
from shuttle_marl.recording.schema import Rallies
from shuttle_marl.recording.tables import outcomes, rows_of_strokes


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
            row = rows_of_strokes(batch)[0]
            wrong.extend((offset + first + np.unique(np.r_[row[bad], np.flatnonzero(_wrong_winner(batch))])).tolist())
    return Replay(rallies=rallies, strokes=strokes, wrong=tuple(wrong))


def _wrong_strokes(
    header: LogHeader, game: Game, rallies: Rallies, policies: Mapping[int, TabulatedPolicy]
) -> npt.NDArray[np.bool_]:
    """``[N]`` strokes that are illegal, have another outcome than the draw gives, or are not what their policy chooses."""
    row, position, seat = rows_of_strokes(rallies)
    state, k = states(game, rallies)
    wrong = state < 0
    if header.draws == "unknown":
        return wrong
    legal = np.flatnonzero(~wrong)
    key = header.rally_key(rallies)
    bits = draws.draw(key[row[legal]], position[legal])
    outcome, _ = strike(game, state[legal], k[legal], draws.outcome_draw(bits))
    wrong[legal] = outcome != outcomes(rallies, game.catalogue)[legal]
    policy = rallies.policy[row[legal], seat[legal]]
    for i, played in policies.items():
        mine = np.flatnonzero(policy == i)
        wrong[legal[mine]] |= played.choose(state[legal[mine]], draws.choice_draw(bits[mine])) != k[legal[mine]]
    return wrong


def _wrong_winner(rallies: Rallies) -> npt.NDArray[np.bool_]:
    """``[R]`` rallies that the log gives to the wrong player: the last striker wins by a winner and loses by a fault."""
    last = (rallies.server + rallies.length - 1) & 1
    wrong: npt.NDArray[np.bool_] = rallies.winner != np.where(rallies.reason == WINNER, last, 1 - last)
    return wrong
