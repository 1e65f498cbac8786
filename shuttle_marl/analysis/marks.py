"""One basis for what page and reports say about choices: marks, changes, better strokes, costly decisions and puzzles.

Both players go on like strong human players (``human:0.05``: perfect play that pays for leaving what people do, see
:func:`shuttle_marl.policy.computed.human_policy`). The **change** of a stroke is its worth (:mod:`shuttle_marl.analysis.worth`)
minus the mean over the strokes that elite players choose there, calibrated.

A stroke is judged only if at least :data:`~shuttle_marl.game.shipped.RELIABLE` real strokes stand behind it and behind the best
one. It is marked if its change is larger than the disagreement of the refits, and if elite players play its shot type there in
less than :data:`RARE` of the cases. Thresholds were chosen on the training matches.
"""

import dataclasses
import functools
import threading
from typing import Final

import numpy as np
import pyarrow as pa

from shuttle_marl.analysis.advice import TOLERANCE
from shuttle_marl.analysis.brief import is_short
from shuttle_marl.analysis.course import rally_numbers
from shuttle_marl.analysis.values import placed
from shuttle_marl.analysis.worth import Worth, agree, calibrated
from shuttle_marl.base.arrays import F64, I64, Bools
from shuttle_marl.base.cluster import in_threads
from shuttle_marl.data.schema import Outcome
from shuttle_marl.exact import evaluate, moved
from shuttle_marl.game.pairs import without_recovery, without_skill
from shuttle_marl.game.shipped import RELIABLE, Estimate, factor_of, real_strokes, refits_of
from shuttle_marl.game.stroke import N_SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.policy import baselines
from shuttle_marl.policy.computed import TYPICAL_TAU, human_policy

MARKS: Final = ("!!", "!", "?!", "?", "??")
RARE: Final = 0.25
"""Share of the shot type among the choices of elite players from which a stroke has no mark."""
_LEAST: Final = {"!!": 0.06, "!": 0.04, "?!": 0.02, "?": 0.04, "??": 0.07}
"""Least change, or loss, of each mark, in rallies won."""
_MASTERED: Final = 0.03
"""Least difference between the right answer of a question and the stroke played."""
_WRONG: Final = 0.02
"""Least difference between the right answer and the other ones."""
_ANSWERS: Final = 4


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Judged:
    """The P legal strokes of N states, one state after the other.

    Attributes:
        row: ``[P]`` number of the state.
        start: ``[N]`` position of the first stroke of each state.
        stroke, shot: ``[P]`` catalogue index and shot type.
        behind: ``[P]`` real strokes behind it; NaN: unknown.
        share: ``[P]`` probability that elite players choose its shot type there.
        refits: ``[R, P]`` change in each refit, not calibrated.
        change: ``[P]`` calibrated change.
        win: ``[P]`` probability that the striker wins the rally.
    """

    row: I64
    start: I64
    stroke: I64
    shot: I64
    behind: F64
    share: F64
    refits: F64
    change: F64
    win: F64

    @functools.cached_property
    def best(self) -> I64:
        """``[N]`` position of the best stroke with enough real strokes behind it; -1: none."""
        worth = np.where(self.behind >= RELIABLE, self.change, -np.inf)
        best = np.array(
            [s + p.argmax() for s, p in zip(self.start, np.split(worth, self.start[1:]), strict=True)], dtype=np.int64
        )
        return np.where(worth[best] > -np.inf, best, -1)

    @property
    def known(self) -> Bools:
        """``[P]`` whether enough real strokes stand behind the stroke and the best one."""
        return np.asarray((self.behind >= RELIABLE) & (self.best[self.row] >= 0))

    @functools.cached_property
    def loss(self) -> F64:
        """``[P]`` what a stroke loses to the best one, in rallies won; 0 where that is not known or the refits disagree."""
        best = self.best[self.row]
        clear = self.known & agree(self.refits[:, best] - self.refits)
        return np.where(clear, np.maximum(0.0, self.change[best] - self.change), 0.0)

    @functools.cached_property
    def marks(self) -> list[str]:
        """``[P]`` marks; empty for most strokes."""
        out = np.full(len(self.row), "", dtype="<U2")
        marked = self.known & agree(self.refits) & (self.share < RARE)
        for mark in ("!", "!!", "?!", "?", "??"):
            bad = "?" in mark
            size = np.where(self.loss > 0, -self.change, 0.0) if bad else self.change
            out[marked & (size >= _LEAST[mark])] = mark
        return [str(mark) for mark in out]

    def question(self, played: int) -> tuple[int, list[int]] | None:
        """A question about the only state: position of the right answer, and of wrong ones, the stroke played first.

        The right answer is as good as what elite players choose, and clearly better than all others. Of several shot types that
        are right one is drawn, by the stroke played, so that no rule of thumb knows it.
        """
        if not self.known[played]:
            return None

        def below(right: int, least: float) -> Bools:
            worse = self.change[right] - self.change >= least
            return np.asarray(self.known & worse & agree(self.refits[:, [right]] - self.refits))

        good = [k for k in np.flatnonzero(self.known & (self.change >= 0)).tolist() if below(k, _MASTERED)[played]]
        order = np.random.default_rng(played).permutation(N_SHOTS)
        for right in sorted(good, key=lambda k: (order[self.shot[k]], -self.change[k])):
            wrong = [k for k in np.argsort(-self.behind, kind="stable").tolist() if k != played and below(right, _WRONG)[k]]
            if len(wrong) >= _ANSWERS - 2:
                return right, [played, *wrong[: _ANSWERS - 2]]
        return None


class Basis:
    """Values of the choices in a game.

    Args:
        game: of one player alone, without the skill of people and without recovery.

    Attributes:
        refits: number of refits.
        factor: share of predicted advantages that real matches realise; None: unknown, taken as 1.
    """

    def __init__(self, game: Game) -> None:
        self.game, self.factor = game, factor_of(game)
        self._usual, self._real = baselines.load(None, game), real_strokes(game)
        strong, refits = human_policy(TYPICAL_TAU, None, game), refits_of(game)
        self.refits = len(refits)

        def worth(world: Game) -> Worth:
            policy = moved(strong, world)
            return Worth(world, evaluate(policy, policy, tolerance=TOLERANCE).striking)

        self._worlds = list(in_threads(worth, (game, *refits)))

    def judged(self, states: I64) -> Judged:
        """The legal strokes of ``[N]`` states."""
        game = self.game
        row, pairs = game.pairs(states)
        behind = np.full(len(pairs), np.nan) if self._real is None else self._real[game.base_pair_edge[pairs % game.n_base_pairs]]
        chance = self._usual.probability_of(pairs)
        reliable = chance * (behind >= RELIABLE)
        weight = np.where((np.bincount(row, reliable, len(states)) > 0)[row], reliable, chance)
        total = np.bincount(row, weight, len(states))
        worth = np.stack([world.win(pairs) for world in self._worlds])
        usual = np.stack([np.bincount(row, weight * each, len(states)) / total for each in worth])
        refits = (worth - usual[:, row])[min(1, self.refits) :]
        change = (Estimate(1.0, 1.0, 1.0) if self.factor is None else self.factor).value * refits.mean(axis=0)
        stroke = game.base_pair_stroke[pairs % game.n_base_pairs].astype(np.int64)
        shot = game.catalogue.shot[stroke].astype(np.int64)
        kind = row * N_SHOTS + shot
        return Judged(
            row=row,
            start=np.searchsorted(row, np.arange(len(states))),
            stroke=stroke,
            shot=shot,
            behind=behind,
            share=np.bincount(kind, chance, len(states) * N_SHOTS)[kind],
            refits=refits,
            change=change,
            win=np.clip(usual[0][row] + change, 0.0, 1.0),
        )


_LOCK: Final = threading.Lock()


def basis_of(game: Game) -> Basis:
    """The basis of a game: that without the skill of people, whose receivers wait as people do; computed once for all threads."""
    with _LOCK:
        return _computed(without_recovery(without_skill(game)))


@functools.lru_cache(maxsize=2)
def _computed(game: Game) -> Basis:
    return Basis(game)


MOST: Final = 5
"""Number of decisions."""
_LATE: Final = 30
"""Number of the stroke in a rally after which players tire."""


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
    found = placed(strokes, game)
    known = np.flatnonzero((found.rank >= 0) & (found.rows.outcome != Outcome.FAULT))
    state = found.state[known]
    judged = basis.judged(state)
    return JudgedStrokes(
        row=known,
        incoming=found.incoming[known],
        contact=game.contact(state).astype(np.int64),
        stroke=found.stroke[known],
        judged=judged,
        position=judged.start + found.rank[known],
    )


def costly_choices(strokes: pa.Table, game: Game, seat: I64, stakes: F64) -> tuple[list[Choice], int]:
    """The strokes of a match that are marked ``?!``, ``?`` or ``??`` and lose most, one of a kind, and the number of refits.

    The better stroke has the technique of the stroke played, which follows from where the striker stands. Strokes late in a rally
    are left out: the game knows no fatigue.

    Args:
        stakes: ``[2, rallies]`` what each rally is worth to each player, by which costs are ordered; 0: not costly.
    """
    basis = basis_of(game)
    found = judged_strokes(strokes, basis)
    judged, position = found.judged, found.position
    bad = np.array(["?" in mark for mark in judged.marks])[position]
    rally, number, who = rally_numbers(strokes), strokes["stroke"].to_numpy().astype(np.int64), seat[found.row]
    stake = stakes[who, rally[found.row]]
    catalogue = game.seats[0].catalogue
    technique = catalogue.technique[judged.stroke]
    fair = (technique == technique[position][judged.row]) & (judged.behind >= RELIABLE)
    fair &= ~is_short(catalogue.shot, catalogue.area)[judged.stroke]
    alike = np.where(fair, judged.change, -np.inf)
    better = np.array([s + part.argmax() for s, part in zip(judged.start, np.split(alike, judged.start[1:]), strict=True)])
    bad &= (stake > 0) & (number[found.row] <= _LATE) & (alike[better] > judged.change[position])
    seen: set[tuple[int, int, int]] = set()
    out: list[Choice] = []
    for k in np.flatnonzero(bad)[np.argsort((judged.change[position] * stake)[bad], kind="stable")].tolist():
        place, best = int(position[k]), int(better[k])
        what = (int(who[k]), int(judged.shot[place]), int(judged.shot[best]))
        if what in seen or len(out) == MOST:
            continue
        seen.add(what)
        same = (who == who[k]) & (found.incoming == found.incoming[k]) & (found.stroke == found.stroke[k])
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
                times=int((same & (found.contact == found.contact[k])).sum()),
            )
        )
    return out, basis.refits
