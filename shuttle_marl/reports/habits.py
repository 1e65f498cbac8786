"""What is counted in real strokes: habits and endings beside those of others, and options within one situation.

Differences of the counts of two tallies (:mod:`shuttle_marl.dynamics.habits`) are tested by Fisher's exact test, because many
answers are rare, and together, with the false discovery rate of Benjamini & Hochberg (J. R. Stat. Soc. B 57, 1995). An **option**
is a shot type beside the other ones in the same situation: over several situations the shares of rallies won would compare the
situations, because a block answers a smash.
"""

import dataclasses
import datetime
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from scipy import special

from shuttle_marl.base.arrays import F64, I64, Bools, Ints
from shuttle_marl.dynamics.habits import NONE, QUESTIONS, Plays, Tally, tally
from shuttle_marl.game.court import AREAS, BACK, N_AREAS, third_of
from shuttle_marl.game.shipped import RELIABLE
from shuttle_marl.game.stroke import HEIGHTS, N_SERVES, SHOTS, TECHNIQUES
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
        p, q: p-value of the difference, and the same corrected for the number of differences.
        clear: whether the difference is more than chance, with this correction, and large enough.
    """

    kind: str
    about: tuple[str, ...]
    answer: str
    strokes: float
    share: float
    low: float
    high: float
    usual: float
    p: float = math.nan
    q: float = math.nan
    clear: bool = False


def habits(mine: Tally, others: Tally, *, dispersed: bool = True) -> list[Habit]:
    """Shares of a player beside those of others, for all questions with enough strokes.

    Args:
        mine, others: counted strokes.
        dispersed: whether counts vary by their dispersion; else they are independent, as within one match.
    """
    found: list[Habit] = []
    tested: list[tuple[float, float, float, float]] = []
    for number, question in enumerate(QUESTIONS):
        own, usual = (each.answers(number) for each in (mine, others))
        n, m = float(own.sum()), float(usual.sum())
        if n < RELIABLE or m < RELIABLE:
            continue
        scale = float(max(mine.dispersion[number], others.dispersion[number])) if dispersed else 1.0
        for k, name in enumerate(question.answers):
            share, low, high = own[k] / n, *interval(own[k] / n, n / scale)
            if max(own[k], usual[k] / m * n) < 1 or (question.kind == "serve" and k > 0):
                continue
            tested.append((own[k] / scale, n / scale, usual[k] / scale, m / scale))
            counts = {"strokes": n, "share": share, "low": low, "high": high, "usual": usual[k] / m}
            found.append(Habit(kind=question.kind, about=question.about, answer=name, **counts))
    found = [dataclasses.replace(habit, p=p) for habit, p in zip(found, chances(np.array(tested)).tolist(), strict=True)]
    return sorted(
        with_discoveries(found), key=lambda habit: (not habit.clear, -abs(habit.share - habit.usual) * np.sqrt(habit.strokes))
    )


def with_discoveries(found: Sequence[Habit]) -> list[Habit]:
    """The habits, with those marked whose difference from the others is more than chance."""
    corrected = adjusted([habit.p for habit in found]).tolist()
    return [
        dataclasses.replace(habit, q=q, clear=q <= FALSE_DISCOVERIES and abs(habit.share - habit.usual) >= LEAST_DIFFERENCE)
        for habit, q in zip(found, corrected, strict=True)
    ]


def adjusted(p: Sequence[float] | F64) -> F64:
    """``[N]`` p-values corrected for their number: the least false discovery rates at which the hypotheses are rejected."""
    order, n = np.argsort(p)[::-1], len(p)
    corrected = np.empty(n)
    corrected[order] = np.minimum.accumulate(np.asarray(p)[order] * n / np.arange(n, 0, -1))
    return corrected


def discoveries(p: Sequence[float] | F64) -> Bools:
    """``[N]`` which of N hypotheses are rejected, with a false discovery rate of 5 %."""
    return np.asarray(adjusted(p) <= FALSE_DISCOVERIES)


def chances(counts: F64) -> F64:
    """``[N]`` p-values of Fisher's exact test, two-sided, that two shares are one.

    Args:
        counts: ``[N, 4]`` successes and number of both, each number as large as there are independent strokes; rounded.
    """
    tables = np.rint(np.reshape(counts, (-1, 4))).astype(np.int64)
    logs = special.gammaln(np.arange(tables[:, 1::2].sum(axis=1).max(initial=0) + 1) + 1.0)  # of factorials
    found = []
    for won, n, others_won, m in tables.tolist():
        k = np.arange(max(0, won + others_won - m), min(n, won + others_won) + 1)
        rest = won + others_won - k
        log = -logs[k] - logs[n - k] - logs[rest] - logs[m - rest]
        weight = np.exp(log - log.max())
        found.append(float(weight[weight <= weight[won - k[0]] * (1 + 1e-7)].sum() / weight.sum()))
    return np.array(found)


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
        q: p-values of both differences, corrected for their number.
        clear: whether the share of faults, and that of winners, differs by more than chance, and enough.
    """

    shot: str
    technique: str | None
    strokes: float
    fault: tuple[float, float, float, float]
    winner: tuple[float, float, float, float]
    q: tuple[float, float]
    clear: tuple[bool, bool]


def endings(mine: Tally, others: Tally) -> list[Ending]:
    """Faults and winners of a player beside others, by shot type, and by shot type and technique, for enough strokes."""
    kinds: list[tuple[str, str | None]] = [(shot, None) for shot in SHOTS]
    kinds += [(shot, technique) for shot in SHOTS for technique in TECHNIQUES]
    own, usual = (
        np.concatenate([each.ends.sum(axis=1), each.ends[:, :-1].reshape(-1, 3)]).astype(np.float64) for each in (mine, others)
    )
    enough = np.flatnonzero(np.minimum(own[:, 0], usual[:, 0]) >= RELIABLE).tolist()
    counts = np.array([(own[k, end], own[k, 0], usual[k, end], usual[k, 0]) for k in enough for end in (1, 2)]).reshape(-1, 2, 4)
    q = adjusted(chances(counts)).reshape(-1, 2)
    shares, beside = counts[..., 0] / counts[..., 1], counts[..., 2] / counts[..., 3]
    clear = (q <= FALSE_DISCOVERIES) & (np.abs(shares - beside) >= LEAST_DIFFERENCE)
    found = []
    for i, (shot, technique) in enumerate(kinds[k] for k in enough):
        size = float(counts[i, 0, 1])
        fault, winner = ((s, *interval(s, size), u) for s, u in zip(shares[i].tolist(), beside[i].tolist(), strict=True))
        corrected, mark = (tuple(each[i].tolist()) for each in (q, clear))
        found.append(Ending(shot=shot, technique=technique, strokes=size, fault=fault, winner=winner, q=corrected, clear=mark))
    return found


MAIN: Final = 3
_HIGH: Final = (SHOTS.index("clear"), SHOTS.index("lift"))


class Situation(NamedTuple):
    """Situation in which a player chooses a stroke.

    Attributes:
        shot: index of the shot type of the incoming stroke; -1: the player serves.
        area: where the player strikes; -1 for a serve.
        contact: 0 below, 1 above the net.
        hurried: whether the player is late or stretched.
    """

    shot: int
    area: int
    contact: int
    hurried: bool


SERVING: Final = Situation(-1, -1, 0, False)


class Option(NamedTuple):
    """A shot type in one situation beside the other ones there. A rally counts once, by the last stroke in the situation.

    Attributes:
        shot: index.
        rallies, won: in which it was played, and that its striker won; ``low``, ``high``: 90 % interval of the share.
        others, others_won: the same of the other shot types.
        p, q: p-value of the difference by Fisher's exact test, and the same corrected for the number of options tested.
    """

    situation: Situation
    shot: int
    rallies: int
    won: int
    low: float
    high: float
    others: int
    others_won: int
    p: float
    q: float = math.nan

    @property
    def gain(self) -> float:
        """Difference of the shares of rallies won."""
        return self.won / self.rallies - self.others_won / self.others

    @property
    def clear(self) -> bool:
        """Whether the difference is more than chance, and large enough."""
        return self.q <= FALSE_DISCOVERIES and abs(self.gain) >= LEAST_DIFFERENCE


def is_short(shot: Ints | int, area: Ints | int) -> Bools:
    """Whether strokes are clears or lifts that land short of the rear court, where no player aims.

    Args:
        shot: index of the shot type, any shape.
        area: index of the area; -1: any area, which is not short.
    """
    return np.isin(shot, _HIGH) & (np.asarray(area) >= 0) & (third_of(np.asarray(area)) < BACK)


class Results:
    """Rallies won by the strokes of some, by situation.

    Args:
        won: ``[N]`` :func:`~shuttle_marl.reports.summary.won_or_lost`.
        rally: ``[N]`` number of the rally.
        mine: ``[N]`` strokes that count.
    """

    def __init__(self, plays: Plays, won: F64, rally: I64, mine: Bools) -> None:
        serving = (plays.incoming == NONE) & (plays.shot < N_SERVES)
        placed = (plays.incoming < NONE) & (plays.met >= 0) & (plays.contact >= 0) & (plays.hurried >= 0)
        parts = np.stack([plays.incoming, plays.met, plays.contact, plays.hurried])
        counts = np.flatnonzero(mine & np.isfinite(won) & (serving | placed))[::-1]
        where = np.where(serving, np.array(SERVING)[:, None], parts)[:, counts]
        last = np.unique(np.vstack([rally[counts], where]), axis=1, return_index=True)[1]
        found: dict[Situation, dict[int, list[int]]] = {}
        for shot, result, incoming, met, contact, late in (
            np.vstack([plays.shot[counts], won[counts], where])[:, last].astype(int).T.tolist()
        ):
            at = found.setdefault(Situation(incoming, met, contact, bool(late)), {}).setdefault(shot, [0, 0])
            at[0], at[1] = at[0] + 1, at[1] + result
        self._counts = found

    def of(self, situation: Situation, shot: int) -> tuple[int, int]:
        """Rallies with a shot type in a situation, and those of them that were won."""
        rallies, won = self._counts.get(situation, {}).get(shot, (0, 0))
        return rallies, won

    def confirm(self, situation: Situation, better: int, worse: int) -> bool:
        """Whether a shot type won no smaller share of the rallies in a situation than another one, if both were played there."""
        (n, won), (m, lost) = self.of(situation, better), self.of(situation, worse)
        return not n or not m or won * m >= lost * n

    def options(self) -> list[Option]:
        """All options with enough rallies on both sides, not yet corrected."""
        found = []
        for situation, shots in self._counts.items():
            total = np.sum([*shots.values()], axis=0)
            for shot, (n, won) in shots.items():
                others, others_won = (total - (n, won)).tolist()
                if min(n, others) >= RELIABLE:
                    (p,) = chances(np.array([won, n, others_won, others])).tolist()
                    found.append(Option(situation, shot, n, won, *interval(won / n, n), others, others_won, p))
        return found


def tested(results: Sequence[Results]) -> list[list[Option]]:
    """The options of some players, the surest first; p-values are corrected for the number of options of them all."""
    found = [each.options() for each in results]
    corrected = iter(adjusted([option.p for some in found for option in some]).tolist())
    return [sorted((each._replace(q=next(corrected)) for each in some), key=lambda each: (each.q, each[:2])) for some in found]


class Expected(NamedTuple):
    """Most frequent answers to a question, as names and shares, among a number of strokes."""

    kind: str
    about: str
    most: tuple[tuple[str, float], ...]
    strokes: int


def expected_of(own: Tally, kind: str, *about: str) -> Expected:
    """Answers of a player to all questions of a kind that begin with ``about``, most frequent first."""
    asked = [number for number, each in enumerate(QUESTIONS) if each.kind == kind and each.about[: len(about)] == about]
    counts = np.sum([own.answers(number) for number in asked], axis=0)
    question, total = QUESTIONS[asked[0]], counts.sum()
    order = [k for k in np.argsort(-counts, kind="stable").tolist()[:MAIN] if counts[k]]
    shares = tuple((question.answers[k], float(counts[k] / total)) for k in order)
    return Expected(kind, "".join(question.about[:1]), shares, int(total))


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
    n, m = (np.full(N_AREAS, count.sum()) for count in counts)
    clear = np.flatnonzero(discoveries(chances(np.stack([counts[0], n, counts[1], m], axis=1))))
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
    """Dataclasses, tuples and arrays as values of JSON; NaN as None. Situations and options name shot types and areas."""
    if isinstance(value, Situation):
        shot, area = (SHOTS[value.shot], AREAS[value.area]) if value.shot >= 0 else (None, None)
        return {"shot": shot, "area": area, "contact": HEIGHTS[value.contact], "hurried": value.hurried}
    if isinstance(value, Option):
        own = {name: plain(part) for name, part in value._asdict().items()}
        return {**own, "shot": SHOTS[value.shot], "clear": value.clear}
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
