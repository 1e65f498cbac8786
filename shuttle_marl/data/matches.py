"""Whole rallies of annotated matches, with the score before them and the nearest strokes of the game."""

import dataclasses
from collections.abc import Iterator
from typing import Final

import numpy as np
import pyarrow as pa

from shuttle_marl.base.arrays import I64
from shuttle_marl.data.schema import Outcome
from shuttle_marl.game.court import seen_by, steps_between
from shuttle_marl.game.scoring import Score
from shuttle_marl.game.stroke import N_SERVES
from shuttle_marl.game.tables import Game

_FAR: Final = 1000
"""Distance of a stroke of another shot type; larger than any of area and technique."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class WholeRally:
    """A rally from its serve to the stroke that ended it, none missing.

    Attributes:
        number: of the rally in the data, with its game.
        players: identifiers at seats 0 and 1; seat 0 strikes first in the match.
        score: before the rally.
        rows: of its strokes in the table.
        ended: by a fault or a winner.
    """

    match: str
    number: tuple[int, int]
    players: tuple[str, str]
    score: Score
    rows: I64
    ended: Outcome


def whole_rallies(strokes: pa.Table) -> Iterator[WholeRally]:
    """The whole rallies of a table of schema :data:`~shuttle_marl.data.schema.STROKES`, in its order."""
    names = ("match", "game", "rally", "stroke", "player", "opponent", "shot", "outcome")
    match, game, rally, stroke, player, opponent, shot, outcome = (strokes[n].to_numpy(zero_copy_only=False) for n in names)
    after = np.stack([strokes[name].to_numpy() for name in ("points", "points_opponent")], axis=1)
    new = [column[1:] != column[:-1] for column in (match, game, rally)]
    starts = np.flatnonzero(np.r_[True, np.logical_or.reduce(new)][: len(match)])
    last = -1
    for first, end in zip(starts.tolist(), [*starts[1:].tolist(), len(match)], strict=False):
        if last < 0 or match[first] != match[last]:
            seats, finished, points = (str(player[first]), str(opponent[first])), tuple[tuple[int, int], ...](), (0, 0)
        elif game[first] != game[last]:
            finished, points = (*finished, points), (0, 0)
        last, server, rows = first, seats.index(player[first]), np.arange(first, end)
        known = not np.isnan(after[first]).any()
        if known:  # otherwise they are those of the rally before
            points = int(after[first, server]), int(after[first, 1 - server])
        ended, serves = Outcome(outcome[end - 1]), stroke[first] == 1 and shot[first] < N_SERVES
        if serves and (np.diff(stroke[rows]) == 1).all() and ended in (Outcome.FAULT, Outcome.WINNER):
            winner = (server + len(rows) - (ended == Outcome.WINNER)) % 2
            before = [max(0, points[seat] - (known and seat == winner)) for seat in (0, 1)]
            games = [sum(ends[seat] > ends[1 - seat] for ends in finished) for seat in (0, 1)]
            score = Score(points=(before[0], before[1]), games=(games[0], games[1]), finished=finished, server=server)
            number = int(game[first]), int(rally[first])
            yield WholeRally(match=str(match[first]), number=number, players=seats, score=score, rows=rows, ended=ended)


def event(match: str, players: tuple[str, str]) -> str:
    """Name of a match without its players: ``KOREA OPEN 2019 Final`` of ``Kento_MOMOTA_CHOU_Tien_Chen_KOREA_OPEN_2019_Final``."""
    words, (one, other) = match.replace("_", " ").split(), tuple(map(_letters, players))
    ends = [k for k in range(2, len(words)) if _letters("".join(words[:k])) in (one + other, other + one)]
    return " ".join(words[ends[0] if ends else 0 :])


def _letters(text: str) -> str:
    return "".join(filter(str.isalnum, text.casefold()))


def nearest_stroke(game: Game, state: int, shot: int, technique: int, area: int | None, receiver: str = "right") -> int:
    """The legal stroke nearest to an annotated one: by shot type, then technique, then area.

    Args:
        area: as the receiver sees it; None: not known.
        receiver: hand of the receiver.
    """
    legal, catalogue = game.legal_strokes(state), game.catalogue
    distance = _FAR * (catalogue.shot[legal] != shot) + 10.0 * (catalogue.technique[legal] != technique)
    if area is not None:
        distance = distance + steps_between(catalogue.area[legal].astype(int), seen_by(receiver, area))
    return int(legal[int(distance.argmin())])
