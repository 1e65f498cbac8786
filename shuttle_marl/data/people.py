"""Names of matches and of players, their opponents, hands and disciplines."""

import functools
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import I64, Array
from shuttle_marl.data import inference
from shuttle_marl.data.column_map import PLAYERS, nfc, plain, whole
from shuttle_marl.data.problems import shown
from shuttle_marl.data.schema import DISCIPLINES
from shuttle_marl.data.sheet import Sheet
from shuttle_marl.data.upstream import discipline, player_id
from shuttle_marl.data.words import Words, bare
from shuttle_marl.game import court

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
_OTHER_END: Final = {"near": "far", "far": "near", "left": "right", "right": "left"}
_DECIDER: Final = 3
"""Game within which the players change ends."""
_PLACE: Final = re.compile("player|court|side|half|end")
UNKNOWN_END: Final = "the players change ends in the third game, and with one name nobody knows the other; name them in each row"


@functools.lru_cache(maxsize=1 << 12)
def end_of(word: str) -> str:
    """``near``, ``far``, ``left`` or ``right`` for the name of an end, such as *top* or *player_near*; else empty."""
    word = _PLACE.sub("", bare(word))
    found = Words("side", ()).meaning(word) or Words("side_of_area", ()).meaning(word) or ""
    return found if found in _OTHER_END else ""


def ends_in(names: Mapping[str, str]) -> dict[str, str]:
    """Names by end, of a mapping in which some keys are names of ends."""
    return {end: name for word, name in names.items() if (end := end_of(word))}


def at_ends(ends: Mapping[str, str], words: Sequence[str], games: Iterable[int], first: int) -> list[str]:
    """Names of players who are named by the ends of a match, empty where they cannot be known (:data:`UNKNOWN_END`).

    Args:
        ends: names by end in the first game, see :func:`ends_in`.
        words: the end of each player.
        games: its game, from 1.
        first: the first game of the match, or of the part of the file in which the names hold.
    """
    return [
        ends.get(end_of(word) if game == first else _OTHER_END.get(end_of(word), ""), "") if game < _DECIDER else ""
        for word, game in zip(words, games, strict=True)
    ]


def ends_note(games: Iterable[int]) -> str:
    """What is inferred about names of ends in these games."""
    if len(set(games)) > 1:
        return "names of the ends: those of the first game of a match, exchanged in the second, because the players change"
    return "names of the ends: the same in all rallies, because they are of one game by their numbers"


def names_of_matches(sheet: Sheet) -> Array:
    """``[n]`` names of matches; without a column that of the file."""
    if "match" in sheet:
        return np.array(_checked(sheet, "match", spelled(sheet, "match")))
    return np.full(len(sheet), "".join(c if c.isprintable() else "_" for c in sheet.path.stem).strip() or "match")


def players_of(sheet: Sheet, match: Array, game: I64) -> tuple[Array, Array]:
    """``[n]`` identifiers of the players and of their opponents."""
    known: dict[str, str] = {}
    alike: dict[str, str] = {}
    inference.warn_alike(sheet, alike, match.tolist(), "match")

    def identifiers(name: str) -> Array:
        names = _checked(sheet, name, spelled(sheet, name, game, match))
        for row, value in enumerate(names):
            if (other := known.setdefault(player_id(value), value)) != value:
                one = f"{shown(value)} and {shown(other)} would be one player, {player_id(value)}"
                sheet.mark(row, f"{one}; write one name, or map one in [values.player]")
        inference.warn_alike(sheet, alike, names, "player")
        return np.array([player_id(value) for value in names], dtype=object)

    player = identifiers("player")
    return player, identifiers("opponent") if "opponent" in sheet else _others(sheet, match, player)


def spelled(sheet: Sheet, name: str, game: I64 | None = None, match: Array | None = None) -> list[str]:
    """``[n]`` names of a column as ``[values.player]`` spells them.

    Args:
        game, match: ``[n]``, for players who are named by their ends.
    """
    texts, spellings = sheet.text(name), sheet.map.values.get("player", {}) if name in PLAYERS else {}
    values = [nfc(spellings.get(plain(text), whole(text))) for text in texts]
    if game is None or match is None or not (ends := ends_in(spellings)):
        return values
    at_end = np.array([plain(text) in spellings and bool(end_of(text)) for text in texts])
    for of_match in np.unique(match[at_end]):
        rows, games = np.flatnonzero(at_end & (match == of_match)).tolist(), game[match == of_match]
        found = at_ends(ends, [texts[row] for row in rows], game[rows], games.min())
        for row, person in zip(rows, found, strict=True):
            if not person:
                sheet.mark(row, f"{sheet.named(name)} {shown(texts[row])}: {UNKNOWN_END}")
            values[row] = person or values[row]
        told = ends_note(games.tolist())
        sheet.notes += [told] if told not in sheet.notes else []
    return values


def _checked(sheet: Sheet, name: str, values: list[str]) -> list[str]:
    """The names; what is no name of one match or one person is a problem."""
    wrong = {value: told for value in set(values) if (told := _no_name(value, of_player=name in PLAYERS))}
    for row, value in enumerate(values) if wrong else ():
        if value in wrong:
            sheet.mark(row, f"{sheet.named(name)} {shown(value)}; {wrong[value]}")
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


def _others(sheet: Sheet, match: Array, player: Array) -> Array:
    """``[n]`` the other player of the match."""
    opponent = player.copy()
    of_match, begins = np.argsort(match, kind="stable"), np.unique(np.sort(match), return_index=True)[1]
    for rows in np.split(of_match, begins[1:]):
        names, first, count = np.unique(player[rows], return_index=True, return_counts=True)
        if len(names) == 2:
            opponent[rows] = np.where(player[rows] == names[0], names[1], names[0])
            continue
        if not sheet.unreadable[rows].any():  # else reported already
            has = f"match {str(match[rows[0]])!r} has {len(names)} players ({', '.join(names[:5])})"
            rarest = rows[first[np.lexsort((-first, count))[0]]]
            sheet.mark(rarest, f"{has}; expected two, or a column opponent")
        sheet.unreadable[rows] = True
    return opponent


def hands_given(sheet: Sheet, player: Array) -> I64:
    """``[n]`` hands of the column, -1 not given; a player has one."""
    hand, of_player = sheet.words("hand"), dict[str, int]()
    for row in np.flatnonzero(hand >= 0):
        if of_player.setdefault(player[row], hand[row]) != hand[row]:
            sheet.mark(row, f"{player[row]} is {court.HANDS[hand[row]]}-handed here, and not above; expected one hand")
    return np.array([of_player.get(name, -1) for name in player])


def disciplines(sheet: Sheet, player: Array, opponent: Array) -> Array:
    """``[n]`` disciplines: of the column, of the map, or of known players."""
    known = [{discipline(a), discipline(b)} - {None} for a, b in zip(player, opponent, strict=True)]
    first, second = DISCIPLINES
    if "discipline" in sheet:
        given = np.array(DISCIPLINES)[np.maximum(sheet.words("discipline"), 0)]
    elif sheet.map.discipline:
        given = np.full(len(sheet), sheet.map.discipline)
    elif sheet.map.guessed and not any(known):
        sheet.notes.append(f'the discipline: {first}; if it is another, set discipline = "{second}" in a map')
        return np.full(len(sheet), first)
    else:
        told = f'set discipline = "{first}" or "{second}" in the map, or map a column'
        sheet.mark(
            np.flatnonzero([len(kinds) != 1 for kinds in known])[:1],
            f"unknown discipline, or players of different ones; {told}",
        )
        return np.array([min((kind for kind in kinds if kind), default=first) for kinds in known])
    others = np.array([bool(kinds - {told}) for kinds, told in zip(known, given.tolist(), strict=True)])
    sheet.warn(others, "a player of the published matches, who plays another discipline there")
    return given
