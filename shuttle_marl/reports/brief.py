"""The figures of the page that a coach gives to a player: what won and lost rallies, what to expect, and where answers go.

All of them are counted in real strokes, and describe. An **option** is a kind of stroke beside others; the ones that stand out
most, by the difference of the shares of rallies won and its standard error, are what a player does and leaves. The best of many
differences is larger than the next match will show, so the page also says how many of them are more than chance.
"""

import dataclasses
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa
from scipy import special, stats

from shuttle_marl.base.arrays import F64, Bools, Ints
from shuttle_marl.dynamics.habits import QUESTIONS, Plays, Tally
from shuttle_marl.game.court import BACK, N_AREAS, third_of
from shuttle_marl.game.shipped import RELIABLE
from shuttle_marl.game.stroke import N_SERVES, N_SHOTS, SHOTS
from shuttle_marl.reports.habits import difference_error, discoveries
from shuttle_marl.reports.summary import rally_table

DOS: Final = 3
DONTS: Final = 2
MAIN: Final = 3
"""Number of main strokes, serves apart."""
_HIGH: Final = (SHOTS.index("clear"), SHOTS.index("lift"))


class Option(NamedTuple):
    """Strokes of a shot type to a target area, and how many of their rallies the striker won.

    Attributes:
        shot, area: indices; -1: any. With an area, only strokes that landed in count, because faults have none.
        strokes, won: real strokes, and rallies won with them.
        others, others_won: the same of the strokes that they are compared with.
        usual: share of rallies that they would win here: that of the others, at the strength of the opponent.
        clear: whether the difference is more than chance, with a correction for the number of options.
    """

    shot: int
    area: int
    strokes: int
    won: int
    others: int
    others_won: int
    usual: float
    clear: bool

    @property
    def gain(self) -> float:
        """Difference of the shares of rallies won."""
        return self.won / self.strokes - self.others_won / self.others

    def covers(self, shot: int, area: int) -> bool:
        """Whether a stroke is one of the kind."""
        return self.shot in (-1, shot) and self.area in (-1, area)


def is_short(shot: Ints | int, area: Ints | int) -> Bools:
    """Whether strokes are clears or lifts that land short of the rear court, where no player aims.

    Args:
        shot: index of the shot type, any shape.
        area: index of the area; -1: any area, which is not short.
    """
    return np.isin(shot, _HIGH) & (np.asarray(area) >= 0) & (third_of(np.asarray(area)) < BACK)


class Expected(NamedTuple):
    """Most frequent answers to a question, as names and shares, among a number of strokes."""

    kind: str
    about: str
    most: tuple[tuple[str, float], ...]
    strokes: int


class Answers(NamedTuple):
    """How an opponent answers a stroke.

    Attributes:
        expected: shot types of the answers.
        areas: ``[9]`` shares of the areas to which they go, as the player who waits sees them; empty: not known.
    """

    expected: Expected
    areas: tuple[float, ...]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Brief:
    """Page 1 for a player against an opponent.

    Attributes:
        dos, donts: options of the player that won and lost more than others, the most striking first.
        expected: serves, returns and third strokes of the opponent.
        returns: the return of the opponent's serves that won most, beside the other returns; None: too few.
        answers: of the opponent to the main strokes of the player.
    """

    dos: tuple[Option, ...]
    donts: tuple[Option, ...]
    expected: tuple[Expected, ...]
    returns: Option | None
    answers: tuple[Answers, ...]


def won_or_lost(strokes: pa.Table) -> F64:
    """``[N]`` whether the striker won the rally of each stroke, 1 or 0; NaN where that is not known."""
    rallies = rally_table(strokes)
    first = rallies["first"].to_numpy()
    rally = np.repeat(np.arange(len(first)), np.diff([*first, strokes.num_rows]))
    winner = rallies["winner"].to_numpy(zero_copy_only=False).astype(object)[rally]
    player = strokes["player"].to_numpy(zero_copy_only=False).astype(object)
    return np.where(winner == None, np.nan, (winner == player).astype(np.float64))  # noqa: E711  an array of objects


def options(plays: Plays, won: F64, mine: Bools, others: Bools | None = None) -> list[Option]:
    """All options with enough strokes, those that stand out for winning first.

    Args:
        won: ``[N]`` :func:`won_or_lost`.
        mine: ``[N]`` strokes that count.
        others: ``[N]`` strokes of others, compared where they are of the same kind, at the strength that the difference of all
            strokes with a landing area shows: against a strong opponent every kind wins less. None: all other ones of ``mine``.
    """
    rally = np.isfinite(won) & (plays.shot >= N_SERVES)

    def counted(which: Bools) -> F64:
        """``[kinds, areas, 2]`` strokes and rallies won; the last kind and the last area stand for all."""
        total = np.zeros((N_SHOTS + 1, N_AREAS + 1, 2))
        which = which & rally
        result = np.stack([np.ones(len(won)), won], axis=1)[which]
        shot, area = plays.shot[which], plays.area[which]
        landed = area >= 0
        np.add.at(total, (shot[landed], area[landed]), result[landed])
        total[-1] = total[:-1].sum(axis=0)
        total[-1, -1] = total[-1].sum(axis=0)
        np.add.at(total, (shot, np.full(len(shot), N_AREAS)), result)
        return total

    total = counted(mine)
    if others is None:
        # What landed in is compared with what landed in, and all strokes of a shot type with all strokes.
        beside = np.broadcast_to(total[-1, -1], total.shape).copy()
        beside[:, -1] = total[:-1, -1].sum(axis=0)
        beside -= total
    else:
        beside = counted(others)
    with np.errstate(invalid="ignore", divide="ignore"):
        ((n, w), (m, v)) = (np.moveaxis(each, -1, 0) for each in (total, beside))
        level = 0.0 if others is None else float(special.logit(w[-1, -1] / n[-1, -1]) - special.logit(v[-1, -1] / m[-1, -1]))
        usual = special.expit(special.logit(v / m) + level)
        z = (w / n - usual) / difference_error(w, n, usual * m, m)
        alike = (n >= RELIABLE) & (m >= RELIABLE) & (z * (w / n - v / m) >= 0)
    alike[-1, -1] = False
    kinds = np.argwhere(alike & np.isfinite(z))
    clear = discoveries((2 * stats.norm.sf(np.abs(z[tuple(kinds.T)]))).tolist())
    found = []
    for (s, a), mark in zip(kinds.tolist(), clear, strict=True):
        counts = int(n[s, a]), int(w[s, a]), int(m[s, a]), int(v[s, a])
        option = Option(s if s < N_SHOTS else -1, a if a < N_AREAS else -1, *counts, float(usual[s, a]), bool(mark))
        found.append((float(z[s, a]), option))
    return [option for _, option in sorted(found, key=lambda each: -each[0])]


def _chosen(ordered: Sequence[Option], most: int, before: Sequence[Option] = ()) -> tuple[Option, ...]:
    """The first ones that say something else than those before them."""
    taken = [*before]
    for option in ordered:
        if len(taken) < len(before) + most and not any(a.covers(*b[:2]) or b.covers(*a[:2]) for a in taken for b in [option]):
            taken.append(option)
    return tuple(taken[len(before) :])


def expected_of(own: Tally, kind: str, *about: str) -> Expected:
    """Answers of a player to all questions of a kind that begin with ``about``, most frequent first."""
    asked = [number for number, each in enumerate(QUESTIONS) if each.kind == kind and each.about[: len(about)] == about]
    counts = np.sum([own.answers(number) for number in asked], axis=0)
    question, total = QUESTIONS[asked[0]], counts.sum()
    order = [k for k in np.argsort(-counts, kind="stable").tolist()[:MAIN] if counts[k]]
    shares = tuple((question.answers[k], float(counts[k] / total)) for k in order)
    return Expected(kind, "".join(question.about[:1]), shares, int(total))


def brief(
    own: Tally, player: Tally | None, plays: Plays | None, won: F64, towards: Bools, answering: Bools, others: Bools | None = None
) -> Brief:
    """Page 1 against an opponent.

    Args:
        own: strokes of the opponent.
        player: strokes of the player; None: of nobody in particular, whose main strokes are those that the opponent meets.
        plays, won: ``[N]`` annotated strokes and their results; None: no matches, so no options.
        towards: ``[N]`` strokes that are played to the opponent: those of the player, or of all of the opponent's opponents.
        answering: ``[N]`` strokes of the opponent.
        others: ``[N]`` strokes that options are compared with, as in :func:`options`.
    """
    dos: tuple[Option, ...] = ()
    donts, returns, mix = dos, None, np.zeros(N_SHOTS)
    if plays is not None:
        found = options(plays, won, towards, others)
        better = [each for each in found if each.gain > 0 and not is_short(each.shot, each.area)]
        worse = [each for each in found[::-1] if each.gain < 0]
        dos = _chosen(better, DOS)
        donts = _chosen(worse, DONTS, dos)
        served = towards & (plays.incoming < N_SERVES)
        answered = (each for each in options(plays, won, served) if each.area < 0)
        returns = next((each for each in answered if each.gain > 0), None)
        mix = np.bincount(plays.shot[towards], minlength=N_SHOTS).astype(np.float64)
    if player is not None:
        mix = player.answers(next(i for i, each in enumerate(QUESTIONS) if each.kind == "shots"))
    mix[:N_SERVES] = 0
    answers = []
    for shot in np.argsort(-mix, kind="stable").tolist()[: min(MAIN, np.count_nonzero(mix))]:
        areas = np.zeros(0)
        if plays is not None:
            landed = plays.area[answering & (plays.incoming == shot) & (plays.area >= 0)]
            areas = np.bincount(landed, minlength=N_AREAS) / max(1, len(landed))
        answers.append(Answers(expected_of(own, "reply", SHOTS[shot]), tuple(areas.tolist())))
    asked = (("serve",), ("serve_side",), ("return", "short-serve"), ("return", "long-serve"), ("third",), ("direction", "smash"))
    expected = (expected_of(own, *each) for each in asked)
    return Brief(
        dos=dos,
        donts=donts,
        expected=tuple(each for each in expected if each.strokes >= RELIABLE or (each.strokes and each.kind == "serve")),
        returns=returns,
        answers=tuple(answers),
    )
