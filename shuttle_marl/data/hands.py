"""Hands of the players of a stroke table: told by the user, given in the file, or inferred.

Players strike around the head on their backhand side, right-handers on the left and left-handers on the right: in the published
matches at most 12 % of these strokes of a right-hander are struck on the right, and at least 97 % of those of a left-hander.
"""

import contextlib
import contextvars
import dataclasses
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from shuttle_marl.base.arrays import I8, I64, Bools
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.data import schema
from shuttle_marl.data.schema import DataError, shown
from shuttle_marl.data.upstream import player_id
from shuttle_marl.data.words import Words
from shuttle_marl.game import court
from shuttle_marl.game.court import HANDS
from shuttle_marl.game.stroke import HEIGHTS, TECHNIQUES

_LEAST: Final = 10  # strokes around the head that tell the hand of a player; of fewer it is unknown
_LEFT_HANDED, _RIGHT_HANDED = 0.7, 0.3  # least share of them on the right of a left-hander, and largest of a right-hander
_RIGHT, _LEFT = range(len(HANDS))
_CENTRE: Final = 1  # side of an area that tells nothing


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlayerHand:
    """The hand of a player, a number in :data:`shuttle_marl.game.court.HANDS` or None, and the strokes that show it."""

    hand: int | None
    n: int  # overhead strokes around the head on a known side
    share: float | None  # fraction of them on the striker's right, None without any

    @property
    def name(self) -> str:
        """``right``, ``left`` or ``unknown``."""
        return "unknown" if self.hand is None else HANDS[self.hand]

    @property
    def shown(self) -> int | None:
        """The hand that the strokes show; None if they are few or of both sides."""
        if self.share is None or self.n < _LEAST:
            return None
        return _LEFT if self.share >= _LEFT_HANDED else _RIGHT if self.share <= _RIGHT_HANDED else None


def hands_of(strokes: pa.Table) -> dict[str, PlayerHand]:
    """Hands of the players who strike, by name in alphabetical order. The side of a stroke is that of its contact point; without
    one, that of the area of the stroke before, if it was not inferred."""
    player, names = _encoded(strokes, "player")
    given = strokes["hand"].fill_null(-1).to_numpy()
    hand, known = np.full(len(names), -1), np.flatnonzero((given >= 0) & (given < len(HANDS)))[::-1]
    hand[player[known]] = given[known]  # the first one, if they differ
    replied = np.diff(strokes["stroke"].to_numpy(), prepend=0) == 1
    replied[schema.rally_starts(strokes)[:-1]] = False
    area = np.where(area_inferred(strokes), _CENTRE, strokes["area"].fill_null(_CENTRE).to_numpy())
    met = np.where(replied, np.roll(area, 1) % court.N_SIDES, _CENTRE)
    x = strokes["contact_x"].to_numpy()
    on_right = np.where(np.isnan(x), met < _CENTRE, x > 0)
    counted = (strokes["technique"].to_numpy() == TECHNIQUES.index("around-the-head")) & ~(np.isnan(x) & (met == _CENTRE))
    counted &= strokes["height"].to_numpy() == HEIGHTS.index("above")
    n, right = (np.bincount(player[rows], minlength=len(names)) for rows in (counted, counted & on_right))
    rows = sorted(zip(names, hand.tolist(), n.tolist(), right.tolist(), strict=True))
    return {
        name: PlayerHand(hand=None if number < 0 else number, n=count, share=of_them / count if count else None)
        for name, number, count, of_them in rows
    }


def with_hands(strokes: pa.Table, path: Path) -> tuple[pa.Table, list[str]]:
    """Fill the column ``hand``: what :func:`telling_hands` tells, else what the table holds, else what the strokes show.

    Returns:
        The table, and sentences on what was told and inferred.
    """
    players, (words, said) = hands_of(strokes), _TELLING.get() or ((), [])
    told = _told(words, players, path)
    inferred = {name: p.shown for name, p in players.items() if p.hand is None and name not in told and p.shown is not None}
    hands = {name: p.hand for name, p in players.items()} | inferred | told
    player, names = _encoded(strokes, "player")
    of_player = pa.array([hands[name] for name in names], pa.int8()).take(pa.array(player))
    replaced = pc.or_(pc.is_null(strokes["hand"]), pc.is_in(strokes["player"], pa.array(list(told), pa.string())))
    filled = pc.if_else(replaced.combine_chunks(), of_player, strokes["hand"].combine_chunks())
    strokes = schema.changed(strokes, "hand", filled)
    said.append(unknown_hands(strokes))
    sources = (("told by --hand", told), ("from the side of strokes around the head", inferred))
    counts = {source: [list(found.values()).count(hand) for hand in (_RIGHT, _LEFT)] for source, found in sources if found}
    return strokes, [
        f"hands of players, {source}: {right:,} right-handed, {left:,} left-handed" for source, (right, left) in counts.items()
    ]


def unknown_hands(strokes: pa.Table) -> list[str]:
    """One sentence on the players of unknown hand, none if there are none."""
    players = hands_of(strokes)
    unknown = [name for name, player in players.items() if player.hand is None]
    text = f"hand unknown, played as right-handed: {', '.join(unknown)} ({len(unknown):,} of {len(players):,} players)"
    return [text] if unknown else []


@contextlib.contextmanager
def telling_hands(words: Sequence[str]) -> Iterator[list[list[str]]]:
    """Tell the hands of players of the strokes that are read within the block.

    Args:
        words: such as ``kento-momota=left``, with the words for hands of any language of :mod:`shuttle_marl.data.words`.

    Yields:
        :func:`unknown_hands` of each table that was read.
    """
    unknown: list[list[str]] = []
    token = _TELLING.set((words, unknown))
    try:
        yield unknown
    finally:
        _TELLING.reset(token)
    if words and not unknown:
        raise ShuttleError(f"--hand {words[0]}: no annotated strokes were read; name a file or a folder with some")


_TELLING: Final = contextvars.ContextVar[tuple[Sequence[str], list[list[str]]] | None]("telling", default=None)


def _told(words: Sequence[str], players: Collection[str], path: Path) -> dict[str, int]:
    """Map players to the hands that the words of ``--hand`` give, as numbers in :data:`shuttle_marl.game.court.HANDS`."""
    told: dict[str, int] = {}
    for word in words:
        name, _, text = word.rpartition("=")
        player = name if name in players else player_id(name)
        meant = Words("hand", (text,)).meaning(text)
        if player not in players:
            wrong = f"no player {shown(name)}"
        elif meant is None:
            wrong = f"{shown(text)} is no hand"
        elif told.setdefault(player, HANDS.index(meant)) != HANDS.index(meant):
            wrong = f"{player} has two hands"
        else:
            continue
        raise DataError(path, f"--hand {shown(word)}: {wrong}; expected NAME=right or NAME=left, players: {', '.join(players)}")
    return told


def receiver_hands(strokes: pa.Table) -> I8:
    """``[n]`` hand of the receiver of each stroke, as the match has it for the strokes of that player; -1: unknown."""
    match, player, opponent = (strokes[name].to_pylist() for name in ("match", "player", "opponent"))
    hand_of = dict(zip(zip(match, player, strict=True), strokes["hand"].fill_null(-1).to_pylist(), strict=True))
    return np.array([hand_of.get(receiver, -1) for receiver in zip(match, opponent, strict=True)], dtype=np.int8)


def area_inferred(strokes: pa.Table) -> Bools:
    """``[n]`` whether the area of a stroke was inferred."""
    return np.asarray(pc.fill_null(pc.match_substring_regex(strokes["inferred"], r"\barea\b"), fill_value=False).to_numpy())


def _encoded(strokes: pa.Table, name: str) -> tuple[I64, list[Any]]:
    encoded = strokes[name].combine_chunks().dictionary_encode()
    return encoded.indices.to_numpy().astype(np.int64), encoded.dictionary.to_pylist()
