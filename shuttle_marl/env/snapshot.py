"""A moment of an environment, as text and pictures show it."""

import dataclasses

from shuttle_marl.env.tables import Stroke
from shuttle_marl.game.rally import Game


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Snapshot:
    """The rally so far, or the last rally until the next serve is struck.

    Attributes:
        game: the game that is played.
        names: names of players 0 and 1.
        title: what is played, such as ``rally 3``.
        strokes: strokes of the rally.
        server: who served it, or is to serve.
        striker: who is to hit; None where the rally is over.
        winner: who won the rally; None while it goes on or where it was cut off.
        reason: why the rally ended: ``fault``, ``winner``, ``illegal stroke`` or ``too many strokes``; None before.
        by_game: points of players 0 and 1 in each game so far; empty where there is no match around the rally.
        match_winner: who won the match; None while it goes on.
    """

    game: Game
    names: tuple[str, str]
    title: str
    strokes: tuple[Stroke, ...]
    server: int
    striker: int | None
    winner: int | None
    reason: str | None
    by_game: tuple[tuple[int, int], ...] = ()
    match_winner: int | None = None
