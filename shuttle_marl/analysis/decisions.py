"""Costly decisions of a match, each compared with the best stroke that is known well enough."""

import dataclasses
from typing import Final

import numpy as np
import pyarrow as pa

from shuttle_marl.analysis.advice import calibrated
from shuttle_marl.analysis.course import rally_numbers
from shuttle_marl.analysis.marks import Basis, Judged, basis_of
from shuttle_marl.analysis.values import nearest_strokes
from shuttle_marl.base.arrays import I64
from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.features import rows_from_strokes, states_of, strokes_before
from shuttle_marl.dynamics.hurried import hurry_of
from shuttle_marl.game.shipped import Estimate
from shuttle_marl.game.tables import Game

MOST: Final = 5
"""Number of decisions."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Choice:
    """A costly decision.

    Attributes:
        player: who decided; ``rally``: index of the rally; ``stroke``: number of the stroke in it, from 1.
        incoming: catalogue index of the incoming stroke, the number of strokes for a serve; ``contact``: 0 below, 1 above.
        played, better: catalogue indices of the stroke and of a better one.
        cost: rallies won less than with what elite players choose there, per time, calibrated: the change of the live court.
        played_behind, better_behind: real strokes behind both.
        times: number of times that the player chose so in the match.
    """

    player: int
    rally: int
    stroke: int
    incoming: int
    contact: int
    played: int
    better: int
    cost: Estimate
    played_behind: float
    better_behind: float
    times: int


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class JudgedStrokes:
    """The M strokes of a table whose target and context are known; where a fault was aimed at is not recorded.

    Attributes:
        row: ``[M]`` row of the table.
        incoming: ``[M]`` catalogue index of the incoming stroke, the number of strokes for a serve.
        contact, stroke: ``[M]`` contact and catalogue index of the stroke, or of the nearest one to it.
        judged: all legal strokes of their M states.
        position: ``[M]`` of the strokes among them.
    """

    row: I64
    incoming: I64
    contact: I64
    stroke: I64
    judged: Judged
    position: I64


def judged_strokes(strokes: pa.Table, basis: Basis) -> JudgedStrokes:
    """Strokes of schema :data:`~shuttle_marl.data.schema.STROKES` with all that could be played instead."""
    game = basis.game
    rows = rows_from_strokes(strokes, hurry_of(game))
    nearest = nearest_strokes(game.catalogue)
    own, incoming = (strokes_before(rows, name, nearest, game.n_strokes) for name in ("own", "incoming"))
    state = states_of(game, rows, own, incoming)
    shot, area, technique = (rows.codes[part].astype(np.int64) for part in ("shot", "area", "technique"))
    stroke = np.where((area >= 0) & (state >= 0), nearest[shot, area, rows.codes["contact"], technique], -1)
    known = np.flatnonzero((stroke >= 0) & (rows.outcome != Outcome.FAULT))
    rank = game.rank(state[known], stroke[known])
    known, rank = known[rank >= 0], rank[rank >= 0].astype(np.int64)
    judged = basis.judged(state[known])
    return JudgedStrokes(
        row=known,
        incoming=incoming[known].astype(np.int64),
        contact=game.contact(state[known]).astype(np.int64),
        stroke=stroke[known],
        judged=judged,
        position=judged.start + rank,
    )


def costly_choices(strokes: pa.Table, game: Game, seat: I64) -> tuple[list[Choice], int]:
    """The strokes of a match that are marked ``?!``, ``?`` or ``??`` and lose most, one of a kind, and the number of refits."""
    basis = basis_of(game)
    found = judged_strokes(strokes, basis)
    judged, position = found.judged, found.position
    bad = np.array(["?" in mark for mark in judged.marks])[position]
    # Who won the rally by a stroke is not told that it was costly.
    bad &= strokes["outcome"].to_numpy()[found.row] != Outcome.WINNER
    rally, number, who = rally_numbers(strokes), strokes["stroke"].to_numpy().astype(np.int64), seat[found.row]
    seen: set[tuple[int, int, int]] = set()
    out: list[Choice] = []
    for k in np.flatnonzero(bad)[np.argsort(judged.change[position[bad]], kind="stable")].tolist():
        place, best = int(position[k]), int(judged.best[k])
        what = (int(who[k]), int(judged.shot[place]), int(judged.shot[best]))
        if what in seen or len(out) == MOST:
            continue
        seen.add(what)
        alike = (who == who[k]) & (found.incoming == found.incoming[k]) & (found.stroke == found.stroke[k])
        out.append(
            Choice(
                player=what[0],
                rally=int(rally[found.row[k]]),
                stroke=int(number[found.row[k]]),
                incoming=int(found.incoming[k]),
                contact=int(found.contact[k]),
                played=int(found.stroke[k]),
                better=int(judged.stroke[best]),
                cost=calibrated(-judged.refits[:, place], basis.factor),
                played_behind=float(judged.behind[place]),
                better_behind=float(judged.behind[best]),
                times=int((alike & (found.contact == found.contact[k])).sum()),
            )
        )
    return out, basis.refits
