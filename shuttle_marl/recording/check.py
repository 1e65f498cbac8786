"""Checks everything in a rally log that can be checked: bytes, numbers, scores, and with the game every stroke."""

import dataclasses
import zlib
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from mcap.opcode import Opcode
from mcap.records import DataEnd, Footer

from shuttle_marl.rally import Game
from shuttle_marl.recording.container import FOOTER_LENGTH, FRAME, MAGIC, damage, stream
from shuttle_marl.recording.reader import RallyLog
from shuttle_marl.recording.replay import replay
from shuttle_marl.recording.schema import DamagedLogError, Rallies
from shuttle_marl.scoring import Rules, wins_game

_BLOCK: Final = 1 << 20


@dataclasses.dataclass(frozen=True, kw_only=True)
class Checked:
    """What :func:`check` found.

    Attributes:
        rallies: number of rallies checked.
        strokes: number of strokes checked.
        replayed: whether the strokes were played again.
        problems: what is wrong, in words; empty for a good log.
    """

    rallies: int
    strokes: int
    replayed: bool
    problems: tuple[str, ...]


def check(path: Path, game: Game | None = None) -> Checked:
    """Check a log.

    Args:
        path: the log.
        game: the game it was played on, to play every stroke again; None leaves that out.

    Raises:
        RecordingError: this is no rally log, or a damaged one, or it was played on another game.
    """
    _check_data(path)
    with RallyLog(path) as log:
        problems = _check_scores(log)
        if game is not None:
            wrong = replay(log, game).wrong
            if wrong:
                problems.append(f"{len(wrong)} rallies do not follow from the seed and the rules, first: {wrong[0]}")
        return Checked(rallies=log.n_rallies, strokes=log.n_strokes, replayed=game is not None, problems=tuple(problems))


def _check_data(path: Path) -> None:
    """Compare the checksum of everything before the summary."""
    tail = FRAME.size + FOOTER_LENGTH + len(MAGIC)
    with damage(path), path.open("rb") as file:
        size = path.stat().st_size
        if size < tail:
            raise DamagedLogError("too short for a rally log")
        file.seek(size - tail + FRAME.size)
        # The record DataEnd, whose body is the checksum, ends where the summary starts.
        end = Footer.read(stream(file.read(FOOTER_LENGTH))).summary_start - FRAME.size - 4
        if not 0 <= end <= size - tail:
            raise DamagedLogError("it was not closed")
        file.seek(0)
        crc, left = 0, end
        while left and (block := file.read(min(_BLOCK, left))):
            crc, left = zlib.crc32(block, crc), left - len(block)
        opcode, _ = FRAME.unpack(file.read(FRAME.size))
        if opcode != Opcode.DATA_END or DataEnd.read(stream(file.read(4))).data_section_crc != crc:
            raise DamagedLogError("the checksum of its data does not fit")


def _check_scores(log: RallyLog) -> list[str]:
    """Compare the score and server of every rally with what the rally before it led to."""
    problems: list[str] = []
    before: tuple[int, Rallies] | None = None
    for first, batch in log.batches():
        rallies = batch
        if before is not None and before[0] == first:
            rallies = Rallies.join([before[1], batch])
        bad = np.flatnonzero(_breaks(rallies, log.header.rules))
        if len(bad):
            number = first + len(batch) - len(rallies) + 1 + int(bad[0])
            problems.append(f"rally {number} does not follow from the score of the rally before it")
        before = first + len(batch), batch.part(len(batch) - 1, len(batch))
    return problems


def _breaks(rallies: Rallies, rules: Rules) -> npt.NDArray[np.bool_]:
    """``[R - 1]`` whether a rally cannot follow the one before it."""
    row = np.arange(len(rallies))
    after = rallies.score.astype(np.int8)
    after[row, rallies.winner] += 1
    own, other = after[row, rallies.winner], after[row, rallies.winner ^ 1]
    game_won = wins_game(own, other, rules)
    after[row, 2 + rallies.winner] += game_won
    after[game_won, :2] = 0
    over = (after[:, 2:].max(axis=1) >= rules.games)[:-1]
    same = (rallies.pairing[1:] == rallies.pairing[:-1]) & (rallies.match[1:] == rallies.match[:-1])
    goes_on = (
        (rallies.rally[1:] == rallies.rally[:-1].astype(np.int32) + 1)
        & (rallies.server[1:] == rallies.winner[:-1])
        & (rallies.score[1:] == after[:-1]).all(axis=1)
    )
    begins = (rallies.rally[1:] == 0) & (rallies.score[1:] == 0).all(axis=1)
    breaks: npt.NDArray[np.bool_] = np.where(same, over | ~goes_on, ~over | ~begins)
    return breaks
