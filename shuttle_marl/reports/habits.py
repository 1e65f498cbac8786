"""Counts of real strokes, and page 1 of a report: the statements that hold beyond chance.

Differences of the counts of two tallies (:mod:`shuttle_marl.dynamics.habits`) are tested by Fisher's exact test, because many
answers are rare, and together, with the false discovery rate of Benjamini & Hochberg (J. R. Stat. Soc. B 57, 1995), for all
differences of a kind that the report tests. An **option** is a shot type beside the other ones in the same situation: over
several situations the shares of rallies won would compare the situations, because a block answers a smash. A **statement** of
page 1 is about habits, endings and places that differ from those of others, about the first three strokes, or about an option.
"""

import dataclasses
import datetime
import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
from scipy import special

from shuttle_marl.base.arrays import F64, I64, Bools, Ints
from shuttle_marl.dynamics.habits import NONE, QUESTIONS, Plays, Tally, tally
from shuttle_marl.game.court import AREAS, BACK, third_of
from shuttle_marl.game.shipped import RELIABLE
from shuttle_marl.game.stroke import HEIGHTS, N_SERVES, SHOTS, TECHNIQUES
from shuttle_marl.reports.value import NORMAL

if TYPE_CHECKING:
    from shuttle_marl.reports.waits import Difference

RULES: Final = (  # rules that every report follows; ``python -m experiments.reports`` checks them
    "an advised stroke won no smaller share of the rallies in its situation than the one it replaces, where both were played",
    "no stroke is advised and advised against in one situation, and none is advised to two areas there",
    "each drill trains a stroke that the report advises",
    "shares, strokes and places on page 1 are those of the later pages",
    "points, games and numbers of rallies follow from the points in the data",
)
_SURE: Final = 5  # most habits on page 1
_LEAST: Final = 10  # strokes from which answers are told
_FEW: Final = 2  # most endings, most places, and most options that are advised, and that are advised against
_ASKED: Final = (("serve",), ("serve_side",), ("return", "short-serve"), ("return", "long-serve"), ("third",))

ENDS: Final = ("fault", "winner")
FALSE_DISCOVERIES: Final = 0.05
LEAST_DIFFERENCE: Final = 0.03  # smaller differences of shares are of no use on court and are not reported


@dataclasses.dataclass(frozen=True, kw_only=True)
class Habit:
    """A share of strokes beside that of others."""

    kind: str  # question; of an ending, `fault` or `winner`
    about: tuple[str, ...]  # of the question; of an ending a shot type, and a technique
    answer: str  # to the question; of an ending its kind again
    strokes: float  # number of strokes of the player that the question asks about
    share: float  # of the answer among them
    low: float  # 90 % interval of the share
    high: float
    usual: float  # share of the others
    p: float  # p-value of the difference from the others
    q: float = math.nan  # p, corrected for the number of differences
    clear: bool = False  # whether the difference is more than chance, with this correction, and large enough


def habits(mine: Tally, others: Tally, *, dispersed: bool = True) -> list[Habit]:
    """Shares of a player beside those of others, for all questions with enough strokes; ``mine``, ``others``: counted strokes;
    ``dispersed``: whether counts vary by their dispersion; else they are independent, as within one match."""
    asked: list[tuple[str, tuple[str, ...], str, tuple[float, ...], float]] = []
    for number, question in enumerate(QUESTIONS):
        own, usual = (each.answers(number) for each in (mine, others))
        n, m = float(own.sum()), float(usual.sum())
        if n < RELIABLE or m < RELIABLE:
            continue
        scale = float(max(mine.dispersion[number], others.dispersion[number])) if dispersed else 1.0
        for k, name in enumerate(question.answers):
            if max(own[k], usual[k] / m * n) >= 1 and not (question.kind == "serve" and k):
                asked.append((question.kind, question.about, name, (own[k], n, usual[k], m), scale))
    return sorted(_compared(asked), key=lambda habit: (not habit.clear, -abs(habit.share - habit.usual) * np.sqrt(habit.strokes)))


def _compared(asked: Iterable[tuple[str, tuple[str, ...], str, tuple[float, ...], float]]) -> list[Habit]:
    """Kind, question and answer, counts of :func:`chance`, and dispersion of each, as habits."""
    found = []
    for kind, about, answer, counts, scale in asked:
        won, n, others_won, m = map(float, counts)
        share, usual, p = won / n, others_won / m, chance(np.array([counts]) / scale)
        low, high = interval(share, n / scale)
        found.append(Habit(kind=kind, about=about, answer=answer, strokes=n, share=share, low=low, high=high, usual=usual, p=p))
    return with_discoveries(found)


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


def chance(strata: F64) -> float:
    """P-value of Fisher's exact test, two-sided, that two shares are one; of several strata that they are one in each of them;
    ``strata``: ``[S, 4]`` successes and number of both, each number as large as there are independent strokes; rounded."""
    # Probabilities of the successes of the first one, given those of both in each stratum.
    weight, least, found = np.ones(1), 0, 0
    for won, n, others_won, m in np.rint(strata).astype(np.int64).tolist():
        k = np.arange(max(0, won + others_won - m), min(n, won + others_won) + 1)
        rest = won + others_won - k
        log = -special.gammaln(np.stack([k, n - k, rest, m - rest]) + 1.0).sum(axis=0)
        one = np.exp(log - log.max())
        weight, least, found = np.convolve(weight, one / one.sum()), least + int(k[0]), found + won
    return min(1.0, float(weight[weight <= weight[found - least] * (1 + 1e-7)].sum()))


def interval(share: float, n: float, z: float = NORMAL) -> tuple[float, float]:
    """Wilson's 90 % interval of a share of n independent strokes; n may be fractional."""
    centre, width = share + z * z / (2 * n), z * np.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    scale = 1 + z * z / n
    return max(0.0, float((centre - width) / scale)), min(1.0, float((centre + width) / scale))


def endings(mine: Tally, others: Tally) -> list[Habit]:
    """Faults and winners of a player beside others, by shot type, and by shot type and technique, for enough strokes."""
    kinds: list[tuple[str, ...]] = [*itertools.product(SHOTS), *itertools.product(SHOTS, TECHNIQUES)]
    own, usual = (
        np.concatenate([each.ends.sum(axis=1), each.ends[:, :-1].reshape(-1, 3)]).astype(np.float64) for each in (mine, others)
    )
    return _compared(
        (end, kinds[k], end, (own[k, i], own[k, 0], usual[k, i], usual[k, 0]), 1.0)
        for k in np.flatnonzero(np.minimum(own[:, 0], usual[:, 0]) >= RELIABLE).tolist()
        for i, end in enumerate(ENDS, start=1)
    )


MAIN: Final = 3
_HIGH: Final = (SHOTS.index("clear"), SHOTS.index("lift"))


class Situation(NamedTuple):
    """Situation in which a player chooses a stroke."""

    shot: int  # index of the shot type of the incoming stroke; -1: the player serves
    area: int  # where the player strikes; -1 for a serve
    contact: int  # 0 below, 1 above the net
    hurried: bool  # whether the player is late or stretched


SERVING: Final = Situation(-1, -1, 0, False)


class Option(NamedTuple):
    """A shot type in one situation beside the other ones there. A rally counts once, by the last stroke in the situation."""

    situation: Situation
    shot: int  # index
    rallies: int  # in which it was played
    won: int  # rallies of them that its striker won
    low: float  # 90 % interval of the share of rallies won
    high: float
    others: int  # rallies with the other shot types
    others_won: int  # of them
    p: float  # p-value of the difference by Fisher's exact test within each striker
    q: float = math.nan  # p, corrected for the number of options tested

    @property
    def gain(self) -> float:
        """Difference of the shares of rallies won."""
        return self.won / self.rallies - self.others_won / self.others

    @property
    def clear(self) -> bool:
        """Whether the difference is more than chance, and large enough."""
        return self.q <= FALSE_DISCOVERIES and abs(self.gain) >= LEAST_DIFFERENCE


def is_short(shot: Ints | int, area: Ints | int) -> Bools:
    """Whether strokes are clears or lifts that land short of the rear court, where no player aims; ``shot``: index of the shot
    type, any shape; ``area``: index of the area (-1: any area, which is not short)."""
    return np.isin(shot, _HIGH) & (np.asarray(area) >= 0) & (third_of(np.asarray(area)) < BACK)


class Results:
    """Rallies won by the strokes of some, by situation.

    Args:
        won: ``[N]`` :func:`~shuttle_marl.reports.summary.won_or_lost`.
        rally: ``[N]`` number of the rally.
        mine: ``[N]`` strokes that count.
        striker: ``[N]`` number of the player, because some win more than others whatever they play.
    """

    def __init__(self, plays: Plays, won: F64, rally: I64, mine: Bools, striker: I64) -> None:
        serving = (plays.incoming == NONE) & (plays.shot < N_SERVES)
        placed = (plays.incoming < NONE) & (plays.met >= 0) & (plays.contact >= 0) & (plays.hurried >= 0)
        parts = np.stack([plays.incoming, plays.met, plays.contact, plays.hurried])
        counts = np.flatnonzero(mine & np.isfinite(won) & (serving | placed))[::-1]
        where = np.where(serving, np.array(SERVING)[:, None], parts)[:, counts]
        last = np.unique(np.vstack([rally[counts], where]), axis=1, return_index=True)[1]
        rows: dict[Situation, list[list[int]]] = {}
        for incoming, met, contact, late, *row in (
            np.vstack([where, plays.shot[counts], won[counts], striker[counts]])[:, last].astype(int).T.tolist()
        ):
            rows.setdefault(Situation(incoming, met, contact, bool(late)), []).append(row)
        self._rows = {situation: np.array(some).T for situation, some in rows.items()}

    def of(self, situation: Situation, shot: int) -> tuple[int, int]:
        """Rallies with a shot type in a situation, and those of them that were won."""
        played, won, _ = self._rows.get(situation, np.zeros((3, 0), np.int64))
        return int((played == shot).sum()), int(won[played == shot].sum())

    def confirm(self, situation: Situation, better: int, worse: int) -> bool:
        """Whether a shot type won no smaller share of the rallies in a situation than another one, if both were played there."""
        (n, won), (m, lost) = self.of(situation, better), self.of(situation, worse)
        return not n or not m or won * m >= lost * n

    def options(self) -> list[Option]:
        """All options with enough rallies on both sides, not yet corrected."""
        found = []
        for situation, (played, won, striker) in self._rows.items():
            for shot in np.unique(played).tolist():
                sides = [(played == shot) == own for own in (True, False)]
                strata = np.stack([np.bincount(striker, w) for side in sides for w in (side * won, side)], axis=1).astype(
                    np.float64
                )
                won_by, n, others_won, others = strata.sum(axis=0).astype(int).tolist()
                if min(n, others) >= RELIABLE:
                    low, high = interval(won_by / n, n)
                    found.append(Option(situation, shot, n, won_by, low, high, others, others_won, chance(strata)))
        return found


def options_of(results: Sequence[Results]) -> list[list[Option]]:
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
class Change:
    """A habit of a player in one game that differs from the same player's other games."""

    player: int
    game: int
    habit: Habit


def changes(plays: Plays, seat: I64, game: I64) -> list[Change]:
    """Habits that differ between the games of a player by more than chance, each in the game where it differs most."""
    found: list[tuple[int, int, Habit]] = []
    for player, number in itertools.product((0, 1), np.unique(game).tolist()):
        parts = [(seat == player) & (game == number), (seat == player) & (game != number)]
        if all(part.any() for part in parts):
            one, others = (tally(plays.take(part)) for part in parts)
            found += [(player, number, habit) for habit in habits(one, others, dispersed=False)]
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


@dataclasses.dataclass(frozen=True)
class Statement:
    """A statement of page 1."""

    kind: str  # `habit`, `fault`, `winner`, `wait`, `answer`, `do` or `dont`
    player: int  # whom it describes, or whom an option advises
    figure: "Habit | Difference | Expected | Option"  # what it says
    count: int  # of strokes, of rallies for an option
    value: float  # share, or distance [m]; `low`, `high`: its interval
    low: float
    high: float
    usual: float = np.nan  # share of the others, NaN without
    q: float = np.nan  # p-value with the correction for the number of differences tested; NaN of a description


class Page1(NamedTuple):
    """Page 1."""

    statements: tuple[Statement, ...]
    tested: int | None  # number of options that were compared; None: no matches were given
    serves: tuple[tuple[int, int] | None, ...]  # of each player, the serves that the data have, and all; None: not counted

    def of(self, player: int, *kinds: str) -> list[Statement]:
        """Statements of some kinds about a player."""
        return [each for each in self.statements if each.player == player and each.kind in kinds]

    def as_json(self, text: Any) -> list[dict[str, Any]]:
        """The statements as JSON, each with its text."""
        return [{**plain(each), "text": text(each)} for each in self.statements]


def clear_endings(endings: Iterable[Habit]) -> list[Habit]:
    """Faults and winners that differ; what holds of a shot type is not repeated for its techniques."""
    clear = [each for each in endings if each.clear]
    whole = {(each.kind, each.about) for each in clear}
    return [each for each in clear if len(each.about) == 1 or (each.kind, each.about[:1]) not in whole]


def sure(player: int, habits: Iterable[Habit], endings: Iterable[Habit], places: "Iterable[Difference]") -> Iterator[Statement]:
    """What differs from others by more than chance: first the habits, of one question once."""
    first: dict[tuple[str, ...], Habit] = {}
    for each in habits:
        if each.clear:
            first.setdefault((each.kind, *each.about), each)
    for each in (*[*first.values()][:_SURE], *clear_endings(endings)[:_FEW]):
        kind = each.kind if each.kind in ENDS else "habit"
        yield Statement(kind, player, each, round(each.strokes), each.share, each.low, each.high, each.usual, each.q)
    for place in [each for each in places if each.wait.player == player][:_FEW]:
        yield Statement("wait", player, place, place.wait.strokes, place.value, place.low, place.high, q=place.q)


def answers(player: int, own: Tally) -> Iterator[Statement]:
    """Serve, return of serve and third stroke."""
    for found in (expected_of(own, *each) for each in _ASKED):
        if found.strokes >= _LEAST or (found.strokes and found.kind == "serve"):
            share = found.most[0][1]
            low, high = interval(share, found.strokes)
            yield Statement("answer", player, found, found.strokes, share, low, high)


def options(player: int, found: Sequence[Option]) -> Iterator[Statement]:
    """The options that won more than the others in their situation, and those that won less, by more than chance."""
    for kind, sign in (("do", 1), ("dont", -1)):
        for each in [option for option in found if option.clear and sign * option.gain > 0][:_FEW]:
            won, usual = each.won / each.rallies, each.others_won / each.others
            yield Statement(kind, player, each, each.rallies, won, each.low, each.high, usual, each.q)


def serves(strokes: pa.Table, rallies: pa.Table, player: str) -> tuple[int, int]:
    """Serves of a player that are in the data, and rallies that the player served; ``rallies``:
    :func:`~shuttle_marl.reports.summary.rally_table` of the strokes."""
    first = rallies.filter(pa.compute.equal(rallies["server"], player))["first"].to_numpy()
    stroke, shot = (strokes[name].to_numpy()[first] for name in ("stroke", "shot"))
    return int(((stroke == 1) & (shot < N_SERVES)).sum()), len(first)


class Advised(NamedTuple):
    """Advice in a situation: a shot type and area (-1: any) to play, and the ones that it replaces."""

    player: int
    situation: Situation
    better: tuple[int, int]
    worse: tuple[int, int]

    def agrees(self, results: Results, others: Iterable["Advised"]) -> bool:
        """Whether neither the results of the player nor any other advice speak against it."""
        confirmed = results.confirm(self.situation, self.better[0], self.worse[0])
        return confirmed and not any(self._against(other) or other._against(self) for other in others)

    def _against(self, other: "Advised") -> bool:
        if (self.player, *self.situation[:3]) != (other.player, *other.situation[:3]):
            return False
        split = self.better[0] == other.better[0] and -1 not in (self.better[1], other.better[1]) and self.better != other.better
        return split or (self.better[0] == other.worse[0] and (self.better[1] in (-1, other.worse[1]) or other.worse[1] == -1))


def advised(found: Iterable[Statement]) -> list[Advised]:
    """The options among statements, as advice."""
    any_other = (-2, -1)
    told = []
    for each in found:
        if isinstance(each.figure, Option):
            sides = ((each.figure.shot, -1), any_other)
            told.append(Advised(each.player, each.figure.situation, *(sides if each.kind == "do" else sides[::-1])))
    return told
