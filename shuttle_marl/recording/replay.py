"""Replay the strokes of rally logs, and check their bytes, numbers and scores."""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from shuttle_marl.base.arrays import I64, Bools
from shuttle_marl.game import draws
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.rally import Rallies
from shuttle_marl.game.rules import WINNER
from shuttle_marl.game.scoring import Rules, count_rally, is_over
from shuttle_marl.game.tables import Game
from shuttle_marl.recording.header import LogHeader, Sampling
from shuttle_marl.recording.log_file import LogFile
from shuttle_marl.recording.reader import RallyLog, require_game


@dataclasses.dataclass(frozen=True, kw_only=True)
class Replay:
    """Result of :func:`replay`.

    Attributes:
        wrong: numbers of the rallies with an illegal stroke, or another outcome, winner or choice than the replay.
    """

    rallies: int
    strokes: int
    wrong: tuple[int, ...]


def replay(log: RallyLog, game: Game, policies: Mapping[str, TabulatedPolicy] | None = None) -> Replay:
    """Replay every rally of a log from its draws.

    If the draws are unknown, only the legality of the strokes and the winners are checked.

    Args:
        policies: tabulated policies by name, whose choices are compared too.

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
            # The last striker wins by a winner and loses by a fault.
            last = (batch.server + batch.length - 1) & 1
            lost = np.flatnonzero(batch.winner != np.where(batch.reason == WINNER, last, 1 - last))
            wrong.extend((offset + first + np.unique(np.r_[batch.row_of_stroke[bad], lost])).tolist())
    return Replay(rallies=rallies, strokes=strokes, wrong=tuple(wrong))


def _wrong_strokes(header: LogHeader, game: Game, rallies: Rallies, policies: Mapping[int, TabulatedPolicy]) -> Bools:
    """``[N]`` whether a stroke is illegal, or differs in its outcome or its policy's choice from the replay."""
    if header.draws == "unknown":
        return rallies.legal(game)[0] < 0
    from shuttle_marl.kernel import wrong_outcomes  # noqa: PLC0415  numba is slow to import

    key = header.rally_key(rallies)
    wrong = wrong_outcomes(rallies, game, key)
    if not policies:
        return wrong
    state, k = rallies.legal(game)
    row, striker = rallies.row_of_stroke, rallies.striker
    for i, table in policies.items():
        mine = np.flatnonzero((rallies.policy[row, striker] == i) & (state >= 0))
        u = draws.choice_draw(draws.draw(key[row[mine]], rallies.position[mine]))
        wrong[mine] |= table.choose(state[mine], u) != k[mine]
        if rallies.waited is not None and game.recovery is not None:
            theirs = np.flatnonzero((rallies.policy[row, 1 - striker] == i) & (state >= 0))
            u = draws.position_draw(draws.draw(key[row[theirs]], rallies.position[theirs]))
            wrong[theirs] |= table.choose_position(state[theirs], u) != rallies.waited[theirs]
    return wrong


@dataclasses.dataclass(frozen=True, kw_only=True)
class Checked:
    """Result of :func:`check`.

    Attributes:
        problems: descriptions of the problems; empty for a correct log.
    """

    rallies: int
    strokes: int
    replayed: bool
    problems: tuple[str, ...]


def check(path: Path, game: Game | None = None) -> Checked:
    """Check a log.

    Args:
        game: the game of the log, to replay every stroke; None: no replay.

    Raises:
        RecordingError: not a rally log, a damaged one, or one of another game.
    """
    with RallyLog(path) as log:
        problems: list[str] = []
        for offset, files in log.logs:
            for file in files:
                file.check_data()
            for file, after in itertools.pairwise(files):
                if after.header.first_rally != file.end:
                    missing = f"{offset + file.end} to {offset + after.header.first_rally - 1}"
                    problems.append(f"rallies {missing}, between {file.path.name} and {after.path.name}, are missing")
            problems += _check_matches(files, offset)
        if game is not None:
            wrong = replay(log, game).wrong
            if wrong:
                problems.append(f"{len(wrong)} rallies do not follow from the seed and the rules, first: {wrong[0]}")
        return Checked(rallies=log.n_rallies, strokes=log.n_strokes, replayed=game is not None, problems=tuple(problems))


def _check_matches(files: Sequence[LogFile], offset: int) -> list[str]:
    """Check that every rally follows from the previous rally of its match, and that it belongs to the sample."""
    header = files[0].header
    sampling, matches = Sampling.parse(header.record), _Matches(header.rules)
    problems: list[str] = []
    number = 0
    for file in files:
        for i in range(len(file.rallies)):
            first, rallies = file.batch(i)
            if first != number:
                # Rallies are missing: later ones may belong to matches whose start was not seen.
                matches.open_, matches.all_known = matches.open_[:0], False
            number = first + len(rallies)
            bad = np.flatnonzero(matches.breaks(rallies))
            if len(bad):
                problems.append(f"rally {offset + first + int(bad[0])} does not follow from the score of the rally before it")
            strange = np.flatnonzero(~sampling.keeps(header, rallies.pairing, rallies.match))
            if len(strange):
                problems.append(f"rally {offset + first + int(strange[0])} does not belong to {header.record}")
    if matches.in_order and len(matches.open_) > 1:
        pairing, match = matches.open_[0, :2]
        problems.append(f"match {match} of pairing {pairing} breaks off")
    return problems


class _Matches:
    """Scores of the matches of a log; matches may be interleaved.

    Attributes:
        open_: ``[M, 9]`` last rally so far of every unfinished match, see :func:`_rows`.
        in_order: whether each match ended before the next one started.
    """

    def __init__(self, rules: Rules) -> None:
        self._rules = rules
        self.all_known = True
        self._last = np.full(2, -1, dtype=np.int64)
        self.open_ = np.empty((0, 9), dtype=np.int64)
        self.in_order = True

    def breaks(self, rallies: Rallies) -> Bools:
        """``[R]`` whether a rally contradicts the rallies before it."""
        new = _rows(rallies)
        rows = np.concatenate([self.open_, new])
        order = np.lexsort((rows[:, 1], rows[:, 0]))  # stable, so the rallies of a match stay in their order
        rows, is_new = rows[order], (order >= len(self.open_))
        over, after, server = self._after(rows)
        same = (rows[1:, :2] == rows[:-1, :2]).all(axis=1)
        continues = (rows[1:, 2] == rows[:-1, 2] + 1) & (rows[1:, 3] == server[:-1]) & (rows[1:, 5:] == after[:-1]).all(axis=1)
        starts = (rows[:, 2] == 0) & (rows[:, 5:] == 0).all(axis=1)
        good = starts | (not self.all_known)
        good[1:] = np.where(same, continues & ~over[:-1], good[1:])
        in_order = np.r_[[self._last], new[:, :2]]
        step = np.diff(in_order, axis=0)
        self.in_order &= bool(((step[:, 0] > 0) | ((step[:, 0] == 0) & (step[:, 1] >= 0))).all())
        self._last = in_order[-1]
        self.open_ = rows[np.r_[~same, True] & ~over]
        breaks = np.zeros(len(order), dtype=np.bool_)
        breaks[order] = ~good & is_new
        return breaks[len(breaks) - len(new) :]

    def _after(self, rows: I64) -> tuple[Bools, I64, I64]:
        """After each rally: whether the match is over, the score, and the next server."""
        row, winner = np.arange(len(rows)), rows[:, 4]
        after = rows[:, 5:].copy()
        counted = count_rally(after[row, winner], after[row, winner ^ 1], after[row, 2 + winner], self._rules)
        after[row, winner], after[row, 2 + winner] = counted.points, counted.games
        after[counted.game_won, :2] = 0
        return is_over(after[:, 2:], self._rules), after, winner


def _rows(rallies: Rallies) -> I64:
    """``[R, 9]`` pairing, match, rally, server, winner, score before the rally."""
    columns = (rallies.pairing, rallies.match, rallies.rally, rallies.server, rallies.winner)
    return np.concatenate([np.stack(columns, axis=1, dtype=np.int64), rallies.score.astype(np.int64)], axis=1)
