"""Matches, games, rallies and strokes that the rows of a file belong to."""

import itertools
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import I64, Bools
from shuttle_marl.data import inference
from shuttle_marl.data.column_map import WORDS
from shuttle_marl.data.columns import Columns
from shuttle_marl.data.people import checked_names
from shuttle_marl.data.strict_csv import DataError, Sheet
from shuttle_marl.game.stroke import N_SERVES

_BARE_SERVE: Final = WORDS["shot"].index("serve")
_SERVES: Final = (*range(N_SERVES), _BARE_SERVE)
_LET: Final = WORDS["ending"].index("let")
_MOST_MATCHES: Final = 10_000


class Rallies:
    """Where each of the n rows belongs.

    Attributes:
        match, game, rally, stroke: ``[n]`` name and numbers.
        fresh, first: ``[n]`` whether a row begins a game, and a rally.
        start: ``[n]`` first row of the game.
        group: ``[n]`` number of the rally in the file, from 0.
        reply: ``[n]`` whether the next row is the next stroke.
        shot: ``[n]`` shot types, -1 not known.
        inferred_serve: ``[n]`` whether the reply told the type of a serve.
    """

    def __init__(self, columns: Columns) -> None:
        self._columns = columns
        sheet, n = columns.sheet, len(columns)
        if "match" in columns:
            self.match = np.array(checked_names(columns, "match"))
        else:
            self.match = np.full(n, "".join(c if c.isprintable() else "_" for c in sheet.path.stem).strip() or "match")
        self.game = columns.integers("game", 1)
        shot = columns.codes("shot", -1)
        known, match = np.unique(self.match, return_inverse=True)
        if len(known) > _MOST_MATCHES:
            raise DataError(sheet.path, f"{len(known):,} matches, more than {_MOST_MATCHES:,}; divide the file")
        self.fresh = inference.changes(match, self.game)
        self.start = np.flatnonzero(self.fresh)[np.cumsum(self.fresh) - 1]
        self.rally = columns.integers("rally", 1) if "rally" in columns else self._numbered(shot)
        self.first = self.fresh | inference.changes(self.rally)
        self.group = np.cumsum(self.first) - 1
        if {"rally", "stroke", "seconds", "frame"} & columns.map.columns.keys():
            rows = zip(*map(sheet.text, columns.map.columns.values()), strict=True)
            sheet.mark(1 + np.flatnonzero([a == b for a, b in itertools.pairwise(rows)]), "duplicate of the row before")
        self.stroke = self._strokes(shot)
        self.reply = np.r_[~self.first[1:] & (np.diff(self.stroke) == 1), False]
        self.inferred_serve = shot == _BARE_SERVE
        self.shot = np.where(self.inferred_serve, np.isin(self.following(shot), inference.LONG_REPLIES), shot)

    def __len__(self) -> int:
        """Number of rallies."""
        return int(self.first.sum())

    @property
    def last(self) -> Bools:
        """``[n]`` whether a row ends its rally."""
        return np.r_[self.first[1:], True]

    def following(self, values: I64) -> I64:
        """``[n]`` values of the next strokes, -1 without one."""
        return np.where(self.reply, np.r_[values[1:], -1], -1)

    def wrong(self) -> Bools:
        """``[n]`` rows of the rallies with problems."""
        return np.isin(self.group, self.group[self._columns.sheet.unreadable])

    def without_lets(self, ending: I64) -> Sheet | None:
        """The sheet without rallies that were replayed, which do not count as rallies of their games; None: there are none."""
        let, header = ending == _LET, self._columns.map.columns.get("rally")
        if not let.any():
            return None
        after_let = np.r_[False, let[:-1]]
        part = np.cumsum(self.first | after_let)  # the replay may have the same number
        kept = ~np.isin(part, part[let])
        counted = np.cumsum(~self.fresh & after_let & (np.diff(self.rally, prepend=0) > 0))
        number = self.rally - counted + counted[self.start]
        sheet = self._columns.sheet.without(~kept)
        if header is not None:
            sheet.columns[header] = tuple(map(str, number[kept].tolist()))
        return sheet

    def _numbered(self, shot: I64) -> I64:
        """Numbers of rallies in their games: each begins with a serve, or after a pause."""
        columns, begins, pause = self._columns, np.isin(shot, _SERVES), ""
        if "seconds" in columns:
            passed = np.diff(columns.numbers("seconds"), prepend=np.nan)
            inference.check_tempo(columns.sheet, passed[~(self.fresh | begins)])
            begins |= passed > inference.PAUSE
            pause = f", or after a pause of {inference.PAUSE:g} s"
        columns.notes.append(f"where rallies begin: with each serve{pause}")
        number = np.cumsum(begins | self.fresh)
        return number - number[self.start] + 1

    def _strokes(self, shot: I64) -> I64:
        """Numbers of strokes in their rallies; in files of programs one is missing where a player strikes twice in a row."""
        columns, n = self._columns, len(shot)
        if "stroke" in columns:
            return columns.integers("stroke", 1)
        start = np.flatnonzero(self.first)[self.group]
        if columns.strict:
            return np.arange(n) - start + 1
        player = np.array(columns.text("player"))
        again = np.r_[False, player[1:] == player[:-1]]
        if twice := int((again & ~self.first).sum()):
            columns.notes.append(f"a stroke is missing where a player strikes twice in a row: {twice:,} times")
        served = np.isin(shot, [-1, WORDS["shot"].index("unknown"), *_SERVES])
        step = np.cumsum(np.where(again, 2, 1))
        return step - step[start] + np.where(served[start], 1, 2)
