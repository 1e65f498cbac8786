"""Costly decisions of a match, each compared with the best stroke that is known well enough."""

import dataclasses
import os
from concurrent.futures import ThreadPoolExecutor
from typing import Final

import numpy as np
import pyarrow as pa

from shuttle_marl.analysis.advice import LEAST_REFITS, LEAST_STEADY, TOLERANCE, calibrated
from shuttle_marl.analysis.course import rally_numbers
from shuttle_marl.analysis.values import nearest_strokes
from shuttle_marl.base.arrays import I64
from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.features import rows_from_strokes, states_of, strokes_before
from shuttle_marl.dynamics.hurried import hurry_of
from shuttle_marl.exact import evaluate, moved
from shuttle_marl.game.shipped import RELIABLE, Estimate, factor_of, real_strokes, refits_of
from shuttle_marl.game.tabulated import TabulatedPolicy

MOST: Final = 5
"""Number of decisions."""
_CANDIDATES: Final = 60
_LEAST_COST: Final = 0.02


@dataclasses.dataclass(frozen=True, kw_only=True)
class Choice:
    """A costly decision.

    Attributes:
        player: who decided; ``rally``: index of the rally; ``stroke``: number of the stroke in it, from 1.
        incoming: catalogue index of the incoming stroke, the number of strokes for a serve; ``contact``: 0 below, 1 above.
        played, better: catalogue indices of the stroke and of a better one.
        cost: rallies won less by this choice, per time, calibrated.
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


def costly_choices(strokes: pa.Table, average: TabulatedPolicy, seat: I64) -> tuple[list[Choice], int]:
    """Decisions that cost most if both go on like average players, compared with the best stroke that is known well enough."""
    game = average.game
    real = real_strokes(game)
    values = [evaluate(average, average, tolerance=TOLERANCE).striking[0]]
    games = [game]
    if real is not None:
        games += refits_of(game)
    refits = len(games) - 1
    if real is None or refits < LEAST_REFITS:
        return [], refits
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        policies = [moved(average, each) for each in games[1:]]
        values += [each.striking[0] for each in threads.map(lambda p: evaluate(p, p, tolerance=TOLERANCE), policies)]
    rows = rows_from_strokes(strokes, hurry_of(game))
    nearest = nearest_strokes(game.catalogue)
    own, incoming = (strokes_before(rows, name, nearest, game.n_strokes) for name in ("own", "incoming"))
    state = states_of(game, rows, own, incoming)
    shot, area, technique = (rows.codes[part].astype(np.int64) for part in ("shot", "area", "technique"))
    stroke = np.where((area >= 0) & (state >= 0), nearest[shot, area, rows.codes["contact"], technique], -1)
    # Where a fault was aimed at is not recorded.
    known = np.flatnonzero((stroke >= 0) & (rows.outcome != Outcome.FAULT))
    known = known[game.rank(state[known], stroke[known]) >= 0]
    pair = game.pair(state[known], stroke[known]).astype(np.int64)
    row, pairs = game.pairs(state[known])
    behind = real[game.base_pair_edge[pairs % game.n_base_pairs]]
    worth = np.where(behind >= RELIABLE, game.stroke_values(values[0], pairs), -np.inf)
    starts = np.flatnonzero(np.r_[True, np.diff(row) != 0])
    best = np.array([start + int(part.argmax()) for start, part in zip(starts, np.split(worth, starts[1:]), strict=True)])
    cost = (worth[best] - game.stroke_values(values[0], pair)) / 2
    played_behind = real[game.base_pair_edge[pair % game.n_base_pairs]]
    cost = np.where((played_behind >= RELIABLE) & np.isfinite(cost), cost, 0.0)
    rally, number = rally_numbers(strokes), rows.stroke.astype(np.int64)
    factor, out = factor_of(game), []
    seen: set[tuple[int, int]] = set()
    # Who won the rally by a stroke is not told that it was costly.
    cost[rows.outcome[known] == Outcome.WINNER] = 0
    for k in [k for k in np.argsort(-cost, kind="stable")[:_CANDIDATES].tolist() if cost[k] > 0]:
        place = int(known[k])
        better = int(pairs[best[k]])
        costs = np.array(
            [
                float(each.stroke_values(v, np.array([better, pair[k]])) @ np.array([0.5, -0.5]))
                for each, v in zip(games[1:], values[1:], strict=True)
            ]
        )
        what = (int(seat[place]), int(incoming[place]), int(game.contact(state[place])), int(stroke[place]))
        alternative = (what[0], int(game.base_pair_stroke[better % game.n_base_pairs]))
        expected = calibrated(costs, factor)
        if alternative in seen or (costs > 0).mean() < LEAST_STEADY or expected.value < _LEAST_COST:
            continue
        seen.add(alternative)
        alike = (seat[known] == what[0]) & (incoming[known] == what[1]) & (stroke[known] == what[3])
        out.append(
            Choice(
                player=what[0],
                rally=int(rally[place]),
                stroke=int(number[place]),
                incoming=what[1],
                contact=what[2],
                played=what[3],
                better=int(game.base_pair_stroke[better % game.n_base_pairs]),
                cost=expected,
                played_behind=float(played_behind[k]),
                better_behind=float(behind[best[k]]),
                times=int((alike & (rows.codes["contact"][known] == what[2])).sum()),
            )
        )
    return sorted(out, key=lambda choice: -choice.cost.value)[:MOST], refits
