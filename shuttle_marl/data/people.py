"""Names of matches and of players, their opponents, hands and disciplines."""

import re
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.base.arrays import I64
from shuttle_marl.data import inference
from shuttle_marl.data.column_map import PLAYERS, nfc, plain, whole
from shuttle_marl.data.columns import Columns
from shuttle_marl.data.ends import EXCHANGED, OF_ONE_GAME, UNKNOWN, at_ends, end_of, ends_in
from shuttle_marl.data.schema import DISCIPLINES
from shuttle_marl.data.strict_csv import shown
from shuttle_marl.data.upstream import discipline as discipline_of
from shuttle_marl.data.upstream import player_id
from shuttle_marl.data.words import Words, bare
from shuttle_marl.game import court

Names = npt.NDArray[Any]

_MISSING: Final = frozenset(
    {"nan", "none", "null", "nil", "nat", "na", "<na>", "undefined", "missing", "ref!", "value!", "name?", "div0!", "num!", "inf"}
)
"""What programs write for a missing value, bare."""
_ROLES: Final = frozenset(
    {"server", "receiver", "striker", "hitter", "winner", "loser", "发球方", "接发球方", "发球者", "接发球者"}
)
_IF_ONE: Final = "; map it in [values.player] if it is one"
_TWO: Final = re.compile(r"[/&+;|\u3001\uff06\uff0f]|\s[-\u2013\u2014]\s|\s(and|und|og|et|dan|vs|v|और)\.?\s", re.IGNORECASE)
"""What stands between two names."""


def checked_names(columns: Columns, name: str, game: I64 | None = None, match: Names | None = None) -> list[str]:
    """``[n]`` names of a column; what is no name of one match or one person is a problem.

    Args:
        game, match: ``[n]``, for players who are named by their ends.
    """
    values = spelled(columns, name, game, match)
    wrong = {value: told for value in set(values) if (told := _no_name(value, of_player=name in PLAYERS))}
    for row, value in enumerate(values) if wrong else ():
        if value in wrong:
            columns.sheet.mark(row, f"{columns.header(name)} {shown(value)}; {wrong[value]}")
    return values


def spelled(columns: Columns, name: str, game: I64 | None = None, match: Names | None = None) -> list[str]:
    """``[n]`` names as ``[values.player]`` spells them; arguments as of :func:`checked_names`."""
    texts, spellings = columns.text(name), columns.map.values.get("player", {}) if name in PLAYERS else {}
    values = [nfc(spellings.get(plain(text), whole(text))) for text in texts]
    if game is None or match is None or not (ends := ends_in(spellings)):
        return values
    at_end = np.array([plain(text) in spellings and bool(end_of(text)) for text in texts])
    for of_match in np.unique(match[at_end]):
        rows = np.flatnonzero(at_end & (match == of_match)).tolist()
        games = np.unique(game[match == of_match])
        for row, person in zip(rows, at_ends(ends, [texts[row] for row in rows], game[rows], games.min()), strict=True):
            if not person:
                columns.sheet.mark(row, f"{columns.header(name)} {shown(texts[row])}: {UNKNOWN}")
            values[row] = person or values[row]
        told = EXCHANGED if len(games) > 1 else OF_ONE_GAME
        columns.notes += [told] if told not in columns.notes else []
    return values


def _no_name(value: str, *, of_player: bool) -> str:
    """What is expected instead of a text; empty if it may be a name."""
    if not value or not value.isprintable():
        return "expected a name"
    if of_player and not any(map(str.isalnum, value)):
        return "expected a name with letters or digits"
    if bare(value) in _MISSING or Words("shot", ()).meaning(value) == "unknown":
        return f"expected a name: this stands for a missing one{_IF_ONE if of_player else ''}"
    if of_player and bare(value) in _ROLES:
        return f"expected a name: this is another player in another rally{_IF_ONE}"
    if of_player and _TWO.search(value):
        return f"expected the name of one person, because the game is of singles{_IF_ONE}"
    return ""


class People:
    """Players of the n rows.

    Attributes:
        player, opponent: ``[n]`` identifiers.
    """

    def __init__(self, columns: Columns, match: Names, game: I64) -> None:
        self._columns, self._match, self._game = columns, match, game
        self._names: dict[str, str] = {}
        self._alike: dict[str, str] = {}
        inference.warn_alike(columns.sheet, self._alike, match.tolist(), "match")
        self.player = self._identifiers("player")
        self.opponent = self._identifiers("opponent") if "opponent" in columns else self._others()

    def _identifiers(self, name: str) -> Names:
        sheet, names = self._columns.sheet, checked_names(self._columns, name, self._game, self._match)
        for row, value in enumerate(names):
            if (other := self._names.setdefault(player_id(value), value)) != value:
                sheet.mark(
                    row,
                    f"{shown(value)} and {shown(other)} would be one player, {player_id(value)}; write one name, or map one in "
                    "[values.player]",
                )
        inference.warn_alike(sheet, self._alike, names, "player")
        return np.array([player_id(value) for value in names], dtype=object)

    def _others(self) -> Names:
        """``[n]`` the other player of the match."""
        sheet, player = self._columns.sheet, self.player
        opponent = player.copy()
        of_match, begins = np.argsort(self._match, kind="stable"), np.unique(np.sort(self._match), return_index=True)[1]
        for rows in np.split(of_match, begins[1:]):
            match = self._match[rows[0]]
            names, first, count = np.unique(player[rows], return_index=True, return_counts=True)
            if len(names) != 2:
                if not sheet.unreadable[rows].any():  # else reported already
                    listed = ", ".join(names[:5])
                    rarest = rows[first[np.lexsort((-first, count))[0]]]
                    sheet.mark(
                        rarest, f"match {str(match)!r} has {len(names)} players ({listed}); expected two, or a column opponent"
                    )
                sheet.unreadable[rows] = True
                continue
            opponent[rows] = np.where(player[rows] == names[0], names[1], names[0])
        return opponent

    def winners(self, group: I64) -> I64:
        """``[n]`` 1 if the striker won the rally, 0 if not, -1 unknown; ``group``: ``[n]`` number of the rally."""
        columns, winner_of = self._columns, dict[int, str]()
        if "winner" not in columns:
            return np.full(len(columns), -1)
        sheet = columns.sheet
        for row, name in enumerate(spelled(columns, "winner", self._game, self._match)):
            both = (self.player[row], self.opponent[row])
            if not name or both[0] == both[1]:  # reported already
                continue
            if player_id(name) not in both:
                sheet.mark(row, f"winner {shown(name)}; expected one of the players, {' or '.join(both)}")
            elif winner_of.setdefault(int(group[row]), player_id(name)) != player_id(name):
                sheet.mark(row, f"{shown(name)} contradicts another winner of this rally")
        winners = [winner_of.get(int(number)) for number in group]
        return np.array([-1 if name is None else int(name == who) for name, who in zip(winners, self.player, strict=True)])

    def hands(self) -> I64:
        """``[n]`` hands of the column, -1 not given; a player has one."""
        hand, of_player = self._columns.codes("hand", -1), dict[str, int]()
        for row in np.flatnonzero(hand >= 0):
            who = self.player[row]
            if of_player.setdefault(who, hand[row]) != hand[row]:
                text = f"{who} is {court.HANDS[hand[row]]}-handed here, and not above; expected one hand"
                self._columns.sheet.mark(row, text)
        return np.array([of_player.get(name, -1) for name in self.player])

    def disciplines(self) -> Names:
        """``[n]`` disciplines: of the column, of the map, or of known players."""
        columns, sheet = self._columns, self._columns.sheet
        known = [{discipline_of(a), discipline_of(b)} - {None} for a, b in zip(self.player, self.opponent, strict=True)]
        if "discipline" in columns:
            given = np.array(DISCIPLINES)[np.maximum(columns.codes("discipline", -1), 0)]
        elif columns.map.discipline:
            given = np.full(len(columns), columns.map.discipline)
        elif columns.map.guessed and not any(known):
            columns.notes.append(
                f'the discipline: {DISCIPLINES[0]}; if it is another, set discipline = "{DISCIPLINES[1]}" in a map'
            )
            return np.full(len(columns), DISCIPLINES[0])
        else:
            for row in [row for row, kinds in enumerate(known) if len(kinds) != 1][:1]:
                sheet.mark(
                    row,
                    "unknown discipline, or players of different ones; "
                    f'set discipline = "{DISCIPLINES[0]}" or "{DISCIPLINES[1]}" in the map, or map a column',
                )
            return np.array([min((kind for kind in kinds if kind), default=DISCIPLINES[0]) for kinds in known])
        others = [row for row, kinds in enumerate(known) if kinds - {given[row]}]
        sheet.warn(others, "a player of the published matches, who plays another discipline there")
        return given
