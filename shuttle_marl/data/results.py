"""Who won each rally of a file, and how: from endings, winners, scores, and who serves next."""

import itertools
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import I64, Bools
from shuttle_marl.data import inference
from shuttle_marl.data.column_map import FAULTS, WINNERS, WORDS
from shuttle_marl.data.columns import Columns
from shuttle_marl.data.ends import end_of
from shuttle_marl.data.people import People
from shuttle_marl.data.rallies import Rallies
from shuttle_marl.data.schema import REASONS, Outcome
from shuttle_marl.data.strict_csv import Problem, shown

_ENDINGS: Final = WORDS["ending"]
_FAULTS, _WINNERS = ([_ENDINGS.index(word) for word in words] for words in (FAULTS, WINNERS))


class Results:
    """Results of the n rows.

    Attributes:
        outcome, reason: ``[n]`` codes of the schema.
        forced: ``[n]`` whether the opponent forced a fault: 1, 0, -1 not known.
        points: ``[n]`` points of the striker and of the opponent after the rally, by column of the schema.
        inferred: ``[n]`` whether who serves next told the outcome.
    """

    def __init__(self, columns: Columns, rallies: Rallies, people: People, ending: I64) -> None:
        self._columns, self._rallies, self._ending = columns, rallies, ending
        self.points = {name: columns.whole(name, name) for name in ("points", "points_opponent")}
        self.inferred = np.zeros(len(columns), dtype=bool)
        scored = self._by_score(people)
        won = people.winners(rallies.group)
        self.outcome, self.reason = self._outcomes(np.where(won < 0, scored, won))
        self.forced = columns.codes("forced", -1)
        for word, code in (("unforced-error", 0), ("forced-error", 1)):
            self.forced = np.where(ending == _ENDINGS.index(word), code, self.forced)

    def _by_score(self, people: People) -> I64:
        """``[n]`` 1 if the striker won the rally by the score, or by who serves next, 0 if not, -1 unknown."""
        columns, rallies = self._columns, self._rallies
        first, last = np.flatnonzero(rallies.first), np.flatnonzero(rallies.last)
        fresh, start = rallies.fresh[first], rallies.start
        of_match = np.flatnonzero(inference.changes(rallies.match))[np.cumsum(inference.changes(rallies.match)) - 1]
        side = (people.player != people.player[start]).astype(np.int64)
        server = np.where(rallies.stroke[first] % 2 == 1, side[first], 1 - side[first])
        followed = np.r_[~fresh[1:] & (np.diff(rallies.rally[first]) == 1), False]
        following = np.where(followed, np.r_[server[1:], -1], -1)  # who won serves next
        winner = np.full(len(first), -1)
        if "score" in columns:
            fault, won_by = (np.isin(self._ending[last], group) for group in (_FAULTS, _WINNERS))
            told = np.select([fault, won_by], [1 - side[last], side[last]], following)
            known = people.winners(rallies.group)[last]
            told = np.select([known == 1, known == 0], [side[last], 1 - side[last]], told)
            began = (people.player[of_match] != people.player[start])[first].astype(np.int64)
            if all(end_of(name) for name in np.unique(people.player)):  # another person in the next game
                began = (began + rallies.game[first] - rallies.game[of_match][first]) % 2
            match = np.unique(rallies.match[first], return_inverse=True)[1]
            scores = self._scores()
            points, winner, reading = inference.winners_by_score(scores, fresh, server, told, began, match)
            if reading:
                columns.notes.append(reading)
            else:
                text = "the score does not tell whose points are first, or whether it is that before the rally; add a winner"
                columns.sheet.problems.append(Problem(columns.sheet.path, text))
            totals = [(rallies.start[first[r]], sum(score)) for r, score in enumerate(scores) if score is not None]
            if "game" not in columns and any(a == b and later < now for (a, now), (b, later) in itertools.pairwise(totals)):
                text = "the score falls, so there are several games: number them in a column"
                columns.sheet.problems.append(Problem(columns.sheet.path, text))
            both = np.array([(np.nan, np.nan) if pair is None else pair for pair in points])[rallies.group]
            rows = np.arange(len(columns))
            self.points = {"points": both[rows, side], "points_opponent": both[rows, 1 - side]}
        elif not ("ending" in columns or "winner" in columns):
            winner = following
            self.inferred = np.isin(np.arange(len(columns)), last[winner >= 0])
        of_row = winner[rallies.group]
        return np.where(of_row < 0, -1, of_row == side)

    def _scores(self) -> list[inference.Points | None]:
        """The score of each rally as it stands there."""
        columns, group = self._columns, self._rallies.group
        scores: list[inference.Points | None] = [None] * len(self._rallies)
        for row, text in enumerate(columns.text("score")):
            if text.strip() and (score := inference.read_score(text)) is None:
                columns.sheet.mark(row, f"score {shown(text)}; expected points such as 5-3 (did a spreadsheet make it a date?)")
            elif text.strip():
                if scores[group[row]] not in (None, score):
                    columns.sheet.warn([row], inference.OTHER_SCORE)
                scores[group[row]] = score
        return scores

    def _outcomes(self, won: I64) -> tuple[I64, I64]:
        """Outcome and reason of each stroke, from the endings and winners of rallies."""
        columns, last, ending = self._columns, self._rallies.last, self._ending
        for row in np.flatnonzero(~last & (ending > 0)):
            columns.sheet.mark(row, f"ending {_ENDINGS[ending[row]]!r} of a stroke that is not the last of its rally")
        fault, winner = np.isin(ending, _FAULTS), np.isin(ending, _WINNERS)
        for row in np.flatnonzero(last & ((fault & (won == 1)) | (winner & (won == 0)))):
            columns.sheet.mark(row, f"ending {_ENDINGS[ending[row]]!r} contradicts who won the rally")
        undecided = last & ~fault & ~winner
        by_winner = np.select([won == 1, won == 0], [Outcome.WINNER, Outcome.FAULT], Outcome.UNKNOWN)
        outcome = np.select([undecided, fault, winner], [by_winner, Outcome.FAULT, Outcome.WINNER], Outcome.RETURNED)
        self._check_ends(undecided & (ending != _ENDINGS.index("unknown")), won)
        reason = np.array([REASONS.index(word if word in REASONS else "unknown") for word in _ENDINGS])[ending]
        return outcome, np.where(undecided, REASONS.index("unknown"), reason)

    def _check_ends(self, unsaid: Bools, won: I64) -> None:
        """Compare ends of rallies without an ending with what the file has; in files of programs they may be missing."""
        columns = self._columns
        if columns.strict and "ending" in columns:
            rows = np.flatnonzero(unsaid & (won >= 0))
            columns.sheet.warn(rows, "the last stroke of its rally has no ending, only a winner")
        if columns.strict and ("ending" in columns or "winner" in columns):
            rows = np.flatnonzero(unsaid & (won < 0) & ~self._rallies.wrong())
            text = "the last stroke of its rally has neither an ending nor a winner; use unknown if neither is known"
            columns.sheet.mark(rows, text)
