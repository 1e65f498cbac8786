"""Plays recorded rallies again: the draws from the recorded seed, the outcomes from the rules, compared bit for bit."""

import dataclasses
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from shuttle_marl import draws
from shuttle_marl.policy.table import TabulatedPolicy
from shuttle_marl.rally import WINNER, Game, strike
from shuttle_marl.recording.reader import RallyLog
from shuttle_marl.recording.schema import Rallies, RecordingError
from shuttle_marl.recording.tables import outcomes, rows_of_strokes


@dataclasses.dataclass(frozen=True, kw_only=True)
class Replay:
    """What came of playing rallies again.

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

    Args:
        log: the log.
        game: the game it was played on.
        policies: tables of policies by name; strokes of those are chosen again from the draws as well.

    Raises:
        RecordingError: the log was played on another game; or it is damaged.
    """
    if log.header.game != game.hash:
        raise RecordingError(
            f"{log.path}: played on game {log.header.game[:12]}, not on {game.hash[:12]}; name its model with --game"
        )
    names = [player.name for player in log.header.policies]
    tables = {names.index(name): policy.padded() for name, policy in (policies or {}).items() if name in names}
    rallies = strokes = 0
    wrong: list[int] = []
    for first, batch in log.batches():
        rallies, strokes = rallies + len(batch), strokes + len(batch.stroke)
        bad = _wrong_strokes(log, game, batch, tables)
        row = rows_of_strokes(batch)[0]
        wrong.extend((first + np.unique(np.r_[row[bad], np.flatnonzero(_wrong_winner(batch))])).tolist())
    return Replay(rallies=rallies, strokes=strokes, wrong=tuple(wrong))


def states(game: Game, rallies: Rallies) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """``[N]`` each: the state in which every stroke was struck, and which of its legal strokes it is.

    Both are -1 where the stroke, or the one it answers, is not legal.
    """
    n = game.n_strokes
    _, position, _ = rows_of_strokes(rallies)
    stroke = rallies.stroke.astype(np.int64)
    own = np.where(position >= 2, np.r_[n, n, stroke[:-2]][: len(stroke)], n)
    incoming = np.where(position >= 1, np.r_[n, stroke[:-1]], n)
    height = game.catalogue.height.astype(np.int64)
    contact = height[stroke]
    k = game.reply_rank[incoming, contact, stroke].astype(np.int64)
    # The edge own -> incoming: the start of a rally is edge 0; the serve is a reply to no stroke.
    serve = position == 0
    struck = np.where(serve, 0, incoming)
    before = np.where(serve, 0, game.reply_rank[own, height[struck], struck])
    edge = np.where(serve, 0, game.reply_start[own, height[struck]] + before)
    legal = (k >= 0) & (before >= 0)
    return np.where(legal, 2 * edge + contact, -1), np.where(legal, k, -1)


def _wrong_strokes(
    log: RallyLog, game: Game, rallies: Rallies, tables: Mapping[int, npt.NDArray[np.uint16]]
) -> npt.NDArray[np.bool_]:
    """``[N]`` strokes that are illegal, have another outcome than the draw gives, or are not what their policy chooses."""
    row, position, seat = rows_of_strokes(rallies)
    state, k = states(game, rallies)
    wrong = state < 0
    legal = np.flatnonzero(~wrong)
    key = log.header.rally_key(rallies)
    bits = draws.draw(key[row[legal]], position[legal])
    outcome, _ = strike(game, state[legal], k[legal], draws.outcome_draw(bits))
    wrong[legal] = outcome != outcomes(rallies, log.catalogue)[legal]
    policy = rallies.policy[row[legal], seat[legal]]
    for i, table in tables.items():
        mine = np.flatnonzero(policy == i)
        chosen = (table[state[legal[mine]]] <= draws.choice_draw(bits[mine])[:, None]).sum(axis=1)
        wrong[legal[mine]] |= chosen != k[legal[mine]]
    return wrong


def _wrong_winner(rallies: Rallies) -> npt.NDArray[np.bool_]:
    """``[R]`` rallies that the log gives to the wrong player: the last striker wins by a winner and loses by a fault."""
    last = (rallies.server + rallies.length - 1) & 1
    wrong: npt.NDArray[np.bool_] = rallies.winner != np.where(rallies.reason == WINNER, last, 1 - last)
    return wrong
