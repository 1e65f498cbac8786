"""What is counted in real strokes: habits and endings beside those of others, options that won or lost more, and page 1.

Differences of the counts of two tallies (:mod:`shuttle_marl.dynamics.habits`) are tested together, with the false discovery rate
of Benjamini & Hochberg (J. R. Stat. Soc. B 57, 1995). An **option** is a kind of stroke beside others; those that stand out most
are what a player does and leaves. The best of many differences is larger than the next match will show, so page 1 also says how
many of them are more than chance.
"""

import dataclasses
import datetime
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from scipy import special, stats

from shuttle_marl.base.arrays import F64, I64, Bools, Ints
from shuttle_marl.dynamics.habits import NONE, QUESTIONS, Plays, Tally, tally
from shuttle_marl.game.court import AREAS, BACK, N_AREAS, third_of
from shuttle_marl.game.shipped import RELIABLE
from shuttle_marl.game.stroke import N_SERVES, N_SHOTS, SHOTS, TECHNIQUES
from shuttle_marl.reports.value import NORMAL

FALSE_DISCOVERIES: Final = 0.05
LEAST_DIFFERENCE: Final = 0.03  # smaller differences of shares are of no use on court and are not reported


@dataclasses.dataclass(frozen=True, kw_only=True)
class Habit:
    """A share of strokes beside that of others.

    Attributes:
        kind, about, answer: the question and the answer.
        strokes: number of strokes of the player that the question asks about.
        share, low, high: share of the answer among them, with its 90 % interval.
        usual: share of the others.
        p: p-value of the difference.
        clear: whether the difference is more than chance, with a correction for the number of differences, and large enough.
    """

    kind: str
    about: tuple[str, ...]
    answer: str
    strokes: float
    share: float
    low: float
    high: float
    usual: float
    p: float
    clear: bool = False


def habits(mine: Tally, others: Tally, *, dispersed: bool = True) -> list[Habit]:
    """Shares of a player beside those of others, for all questions with enough strokes.

    Args:
        mine, others: counted strokes.
        dispersed: whether counts vary by their dispersion; else they are independent, as within one match.
    """
    found: list[Habit] = []
    for number, question in enumerate(QUESTIONS):
        counts = [each.answers(number) for each in (mine, others)]
        n, m = (float(count.sum()) for count in counts)
        if n < RELIABLE or m < RELIABLE:
            continue
        scale = float(max(mine.dispersion[number], others.dispersion[number])) if dispersed else 1.0
        for k, name in enumerate(question.answers):
            share, usual = counts[0][k] / n, counts[1][k] / m
            if max(counts[0][k], usual * n) < 1 or (question.kind == "serve" and k > 0):
                continue
            error = float(difference_error(counts[0][k], n, counts[1][k], m, scale))
            p = float(2 * stats.norm.sf(abs(share - usual) / error)) if error > 0 else 1.0
            low, high = interval(share, n / scale)
            about = question.about
            found.append(
                Habit(kind=question.kind, about=about, answer=name, strokes=n, share=share, low=low, high=high, usual=usual, p=p)
            )
    return sorted(
        with_discoveries(found), key=lambda habit: (not habit.clear, -abs(habit.share - habit.usual) * np.sqrt(habit.strokes))
    )


def with_discoveries(found: Sequence[Habit]) -> list[Habit]:
    """The habits, with those marked whose difference from the others is more than chance."""
    clear = discoveries([habit.p for habit in found])
    return [
        dataclasses.replace(habit, clear=bool(mark) and abs(habit.share - habit.usual) >= LEAST_DIFFERENCE)
        for habit, mark in zip(found, clear, strict=True)
    ]


def discoveries(p: Sequence[float]) -> Bools:
    """``[N]`` which of N hypotheses are rejected, with a false discovery rate of 5 %."""
    if not len(p):
        return np.zeros(0, np.bool_)
    return np.asarray(stats.false_discovery_control(np.asarray(p)) <= FALSE_DISCOVERIES)


def difference_error(won: Any, n: Any, others_won: Any, m: Any, scale: float = 1.0) -> F64:
    """Standard error of the difference of two shares, won of n and of m, if both are the same one; any shape.

    Args:
        scale: dispersion of the counts.
    """
    pooled = (won + others_won) / (n + m)
    return np.asarray(np.sqrt(scale * pooled * (1 - pooled) * (1 / n + 1 / m)))


def interval(share: float, n: float, z: float = NORMAL) -> tuple[float, float]:
    """Wilson's 90 % interval of a share of n independent strokes; n may be fractional."""
    centre, width = share + z * z / (2 * n), z * np.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    scale = 1 + z * z / n
    return max(0.0, float((centre - width) / scale)), min(1.0, float((centre + width) / scale))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Ending:
    """Shares of faults and winners among the strokes of one shot type.

    Attributes:
        shot, technique: shot type, and technique; None: all of them.
        fault, winner: shares, each with the 90 % interval and the share of the others.
        clear: whether the share of faults, and that of winners, differs by more than chance.
    """

    shot: str
    technique: str | None
    strokes: float
    fault: tuple[float, float, float, float]
    winner: tuple[float, float, float, float]
    clear: tuple[bool, bool]


def endings(mine: Tally, others: Tally) -> list[Ending]:
    """Faults and winners of a player beside others, by shot type, and by shot type and technique, for enough strokes."""
    kinds: list[tuple[str, str | None]] = [(shot, None) for shot in SHOTS]
    kinds += [(shot, technique) for shot in SHOTS for technique in TECHNIQUES]
    counts = [
        np.concatenate([each.ends.sum(axis=1), each.ends[:, :-1].reshape(-1, 3)]).astype(np.float64) for each in (mine, others)
    ]
    n, m = (count[:, :1] for count in counts)
    enough = np.flatnonzero((n[:, 0] >= RELIABLE) & (m[:, 0] >= RELIABLE))
    if not len(enough):
        return []
    n, m = n[enough], m[enough]
    shares, usual = (count[enough, 1:] / size for count, size in zip(counts, (n, m), strict=True))
    error = difference_error(shares * n, n, usual * m, m)
    with np.errstate(invalid="ignore"):
        p = np.where(error > 0, 2 * stats.norm.sf(np.abs(shares - usual) / error), 1.0)
    clear = discoveries(p.ravel().tolist()).reshape(-1, 2)
    found = []
    for i, kind in enumerate(enough.tolist()):
        size = float(n[i, 0])
        fault, winner = ((s, *interval(s, size), u) for s, u in zip(shares[i].tolist(), usual[i].tolist(), strict=True))
        shot, technique = kinds[kind]
        mark = bool(clear[i, 0]), bool(clear[i, 1])
        found.append(Ending(shot=shot, technique=technique, strokes=size, fault=fault, winner=winner, clear=mark))
    return found


DOS: Final = 3
DONTS: Final = 2
MAIN: Final = 3
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
    own: Tally, player: Tally | None, plays: Plays, won: F64, towards: Bools, answering: Bools, others: Bools | None = None
) -> Brief:
    """Page 1 against an opponent.

    Args:
        own: strokes of the opponent.
        player: strokes of the player; None: of nobody in particular, whose main strokes are those that the opponent meets.
        plays, won: ``[N]`` annotated strokes and their results; of none there are no options.
        towards: ``[N]`` strokes that are played to the opponent: those of the player, or of all of the opponent's opponents.
        answering: ``[N]`` strokes of the opponent.
        others: ``[N]`` strokes that options are compared with, as in :func:`options`.
    """
    found = options(plays, won, towards, others)
    dos = _chosen([each for each in found if each.gain > 0 and not is_short(each.shot, each.area)], DOS)
    donts = _chosen([each for each in found[::-1] if each.gain < 0], DONTS, dos)
    served = towards & (plays.incoming < N_SERVES)
    returns = next((each for each in options(plays, won, served) if each.area < 0 < each.gain), None)
    mix = np.bincount(plays.shot[towards], minlength=N_SHOTS).astype(np.float64)
    if player is not None:
        mix = player.answers(next(i for i, each in enumerate(QUESTIONS) if each.kind == "shots"))
    mix[:N_SERVES] = 0
    answers = []
    for shot in np.argsort(-mix, kind="stable").tolist()[: min(MAIN, np.count_nonzero(mix))]:
        landed = plays.area[answering & (plays.incoming == shot) & (plays.area >= 0)]
        areas = np.bincount(landed, minlength=N_AREAS) / max(1, len(landed)) if len(plays) else np.zeros(0)
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


@dataclasses.dataclass(frozen=True, kw_only=True)
class Heat:
    """Targets of a player in won and in lost rallies: ``[9]`` counts, and areas that differ by more than chance."""

    player: int
    won: tuple[float, ...]
    lost: tuple[float, ...]
    clear: tuple[int, ...]


def heat(plays: Plays, mine: Bools, won: F64, player: int) -> Heat:
    """Targets in won and lost rallies; ``mine``: ``[N]`` strokes of the player, ``won``: ``[N]`` their results."""
    aimed = mine & (plays.incoming < NONE) & (plays.shot >= N_SERVES) & (plays.area >= 0)
    counts = [np.bincount(plays.area[aimed & (won == result)], minlength=N_AREAS).astype(np.float64) for result in (1.0, 0.0)]
    n = [max(1.0, float(count.sum())) for count in counts]
    error = difference_error(counts[0], n[0], counts[1], n[1])
    with np.errstate(invalid="ignore", divide="ignore"):
        z = np.nan_to_num((counts[0] / n[0] - counts[1] / n[1]) / error)
    clear = np.flatnonzero(discoveries((2 * stats.norm.sf(np.abs(z))).tolist()))
    return Heat(player=player, won=tuple(counts[0].tolist()), lost=tuple(counts[1].tolist()), clear=tuple(clear.tolist()))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Change:
    """A habit of a player in one game that differs from the same player's other games."""

    player: int
    game: int
    habit: Habit


def changes(plays: Plays, seat: I64, game: I64) -> list[Change]:
    """Habits that differ between the games of a player by more than chance, each in the game where it differs most."""
    found: list[tuple[int, int, Habit]] = []
    for player in (0, 1):
        for number in np.unique(game).tolist():
            mine = seat == player
            one, others = plays.take(mine & (game == number)), plays.take(mine & (game != number))
            if len(one) and len(others):
                found += [(player, number, habit) for habit in habits(tally(one), tally(others), dispersed=False)]
    marked = with_discoveries([habit for *_, habit in found])
    clear = [Change(player=p, game=n, habit=habit) for (p, n, _), habit in zip(found, marked, strict=True) if habit.clear]
    clear.sort(key=lambda each: -each.habit.p)
    most = {(each.player, each.habit.kind, each.habit.about, each.habit.answer): each for each in clear}
    return sorted(most.values(), key=lambda each: each.habit.p)


def plain(value: Any) -> Any:
    """Dataclasses, tuples and arrays as values of JSON; NaN as None. Options name their shot type and area; None: any."""
    if isinstance(value, Option):
        named = {"shot": SHOTS[value.shot] if value.shot >= 0 else None, "area": AREAS[value.area] if value.area >= 0 else None}
        return {**value._asdict(), **named}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return {name: plain(part) for name, part in value._asdict().items()}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(part) for key, part in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(part) for part in value]
    if isinstance(value, datetime.date):
        return value.isoformat()
    return None if isinstance(value, float) and math.isnan(value) else value
