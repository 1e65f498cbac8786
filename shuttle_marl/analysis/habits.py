"""Habits: how a player plays in common situations, compared with other players, and which differences are more than chance.

A **question** is a situation (a serve, the reply to a drop from below, …); its answers are shot types, directions or
outcomes. The same questions are asked of annotated strokes, which are counted, and of an imitated player, whose expected
frequencies are exact and count as the player's strokes in the data of the model. Strokes of a match are alike, so counts vary
more than independent ones: their variance is multiplied by the **dispersion** (McCullagh & Nelder, Generalized Linear Models,
section 4.5), estimated over all players and matches, or :data:`DISPERSION`. Differences are tested together, with the false
discovery rate of Benjamini & Hochberg (J. R. Stat. Soc. B 57, 1995).
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import pyarrow as pa
from scipy import stats

from shuttle_marl.analysis.advice import NORMAL, Meeting
from shuttle_marl.arrays import F64, I64, Bools
from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.features import rows_from_strokes
from shuttle_marl.game.court import AREAS, N_AREAS
from shuttle_marl.game.shipped import RELIABLE
from shuttle_marl.game.stroke import HEIGHTS, N_SERVES, N_SHOTS, SHOTS
from shuttle_marl.game.thresholds import ONE

NONE: Final = N_SHOTS
"""Code of a previous stroke that does not exist; larger codes are unknown."""
DISPERSION: Final = 2.0
"""Dispersion of counts where it cannot be estimated."""
FALSE_DISCOVERIES: Final = 0.05
LEAST_DIFFERENCE: Final = 0.03
"""Smaller differences of shares are of no use on court and are not reported."""
_LEAST_DEGREES: Final = 10
DIRECTIONS: Final = ("straight", "middle", "cross")
ENDS: Final = ("fault", "winner", "returned")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Plays:
    """N strokes, or N kinds of strokes with their expected numbers.

    Attributes:
        own, incoming: ``[N]`` shot type of the striker's own last and of the incoming stroke; :data:`NONE`, or larger if unknown.
        met: ``[N]`` area in which the striker strikes; -1 if unknown or serving.
        contact, shot, area: ``[N]`` of the stroke; area -1 if unknown.
        weight: ``[N]`` number of strokes.
        fault, winner: ``[N]`` number of them that were faults and winners.
        group: ``[N]`` cluster of alike strokes: number of the match.
    """

    own: I64
    incoming: I64
    met: I64
    contact: I64
    shot: I64
    area: I64
    weight: F64
    fault: F64
    winner: F64
    group: I64

    def __len__(self) -> int:
        return len(self.shot)

    def take(self, which: Bools) -> "Plays":
        """Some of the strokes."""
        return Plays(**{field.name: getattr(self, field.name)[which] for field in dataclasses.fields(self)})


def plays_of_strokes(strokes: pa.Table) -> Plays:
    """Strokes of a table of schema :data:`shuttle_marl.data.schema.STROKES`, in its order."""
    rows = rows_from_strokes(strokes)
    code = {name: rows.codes[name].astype(np.int64) for name in ("own_shot", "incoming_shot", "incoming_area", "contact", "shot")}
    # Where the shuttle came down, not the target as the models estimate it: what a coach sees.
    area = strokes["area"].fill_null(-1).to_numpy().astype(np.int64)
    met = code["incoming_area"]
    return Plays(
        own=code["own_shot"],
        incoming=code["incoming_shot"],
        met=np.where(met < N_AREAS, met, -1),
        contact=code["contact"],
        shot=code["shot"],
        area=np.where(rows.outcome == Outcome.FAULT, -1, area),
        weight=np.ones(len(rows)),
        fault=(rows.outcome == Outcome.FAULT).astype(np.float64),
        winner=(rows.outcome == Outcome.WINNER).astype(np.float64),
        group=rows.match.astype(np.int64),
    )


def plays_of_meeting(meeting: Meeting, seat: int, strokes: float) -> Plays:
    """Expected strokes of one player of two policies.

    Args:
        meeting: the policies.
        seat: of the player.
        strokes: number of strokes in all.
    """
    game = meeting.policies[seat].game
    state, stroke = game.base_pair_state, game.base_pair_stroke
    played = meeting.seen.base_pairs(seat)
    played *= strokes / played.sum()
    limit = np.moveaxis(game.limits[..., :2].astype(np.float64), -1, 0) / ONE
    shot = np.append(game.catalogue.shot, NONE).astype(np.int64)
    return Plays(
        own=shot[game.own(state)],
        incoming=shot[game.incoming(state)],
        met=np.append(game.catalogue.area, -1).astype(np.int64)[game.incoming(state)],
        contact=game.contact(state).astype(np.int64),
        shot=game.catalogue.shot[stroke].astype(np.int64),
        area=game.catalogue.area[stroke].astype(np.int64),
        weight=played.sum(axis=0),
        fault=(played * limit[0]).sum(axis=0),
        winner=(played * (limit[1] - limit[0])).sum(axis=0),
        group=np.zeros(len(stroke), np.int64),
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Question:
    """A question, and what each stroke answers.

    Attributes:
        kind: type of the question, a key of the catalogue of texts.
        about: values of the question: names of shot types and contact heights.
        answers: names of the answers.
    """

    kind: str
    about: tuple[str, ...]
    answers: tuple[str, ...]


def questions(plays: Plays) -> Iterator[tuple[Question, I64]]:
    """All questions, each with the answer of every stroke, -1 where it is not asked."""

    def asked(which: Bools, answer: I64) -> I64:
        return np.where(which & (answer >= 0), answer, -1)

    rally, serve = plays.incoming < NONE, plays.shot < N_SERVES
    yield Question(kind="shots", about=(), answers=SHOTS), asked(rally & ~serve, plays.shot)
    yield Question(kind="targets", about=(), answers=AREAS), asked(rally & ~serve, plays.area)
    yield Question(kind="serve", about=(), answers=SHOTS), asked(serve, plays.shot)
    sides = tuple(area.split("-")[1] for area in AREAS[:3])
    side = np.where(plays.area >= 0, plays.area % 3, -1)
    yield Question(kind="serve_side", about=("short-serve",), answers=sides), asked(plays.shot == 0, side)
    for name in SHOTS[:N_SERVES]:
        yield Question(kind="return", about=(name,), answers=SHOTS), asked(plays.incoming == SHOTS.index(name), plays.shot)
    yield Question(kind="third", about=(), answers=SHOTS), asked((plays.own < N_SERVES) & rally, plays.shot)
    for shot in range(N_SERVES, N_SHOTS):
        for contact, height in enumerate(HEIGHTS):
            which = (plays.incoming == shot) & (plays.contact == contact)
            yield Question(kind="reply", about=(SHOTS[shot], height), answers=SHOTS), asked(which, plays.shot)
    # Left and right of a target are the receiver's, those of where the striker stands the striker's: straight is 2 - side.
    wide = (plays.met >= 0) & (plays.met % 3 != 1)
    direction = np.where(side == 1, 1, np.where(side == 2 - plays.met % 3, 0, 2))
    for name in ("smash", "half-smash", "drop", "clear", "lift", "drive", "push"):
        which = (plays.shot == SHOTS.index(name)) & wide & (side >= 0)
        yield Question(kind="direction", about=(name,), answers=DIRECTIONS), asked(which, direction)


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


def habits(mine: Plays, others: Plays, *, dispersion: float | None = None, exact_others: bool = False) -> list[Habit]:
    """Shares of a player beside those of others, for all questions with enough strokes.

    Args:
        mine, others: the strokes.
        dispersion: of the counts; None: estimated from the groups of both.
        exact_others: whether the shares of the others are known, not counted.
    """
    found: list[Habit] = []
    for (question, answer), (_, other) in zip(questions(mine), questions(others), strict=True):
        size = len(question.answers)
        counts = [np.bincount(a[a >= 0], plays.weight[a >= 0], size) for a, plays in ((answer, mine), (other, others))]
        n, m = (float(count.sum()) for count in counts)
        if n < RELIABLE or m < RELIABLE:
            continue
        scale = dispersion or max(1.0, *(_dispersion(a, plays, size) for a, plays in ((answer, mine), (other, others))))
        for k, name in enumerate(question.answers):
            share, usual = counts[0][k] / n, counts[1][k] / m
            if max(counts[0][k], usual * n) < 1 or (question.kind == "serve" and k > 0):
                continue
            pooled = usual if exact_others else (counts[0][k] + counts[1][k]) / (n + m)
            error = np.sqrt(scale * pooled * (1 - pooled) * (1 / n + (0 if exact_others else 1 / m)))
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


def interval(share: float, n: float, z: float = NORMAL) -> tuple[float, float]:
    """Wilson's 90 % interval of a share of n independent strokes; n may be fractional."""
    centre, width = share + z * z / (2 * n), z * np.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    scale = 1 + z * z / n
    return max(0.0, float((centre - width) / scale)), min(1.0, float((centre + width) / scale))


def _dispersion(answer: I64, plays: Plays, size: int) -> float:
    """Pearson's chi-squared of the shares in each group, by its degrees of freedom; 1 for too few groups."""
    asked = answer >= 0
    groups, group = np.unique(plays.group[asked], return_inverse=True)
    count = np.bincount(group * size + answer[asked], plays.weight[asked], len(groups) * size).reshape(-1, size)
    count = count[:, count.sum(axis=0) >= 5]
    expected = count.sum(axis=1, keepdims=True) * count.sum(axis=0) / max(1.0, count.sum())
    degrees = (count.shape[0] - 1) * (count.shape[1] - 1)
    if degrees < _LEAST_DEGREES or (expected <= 0).any():
        return 1.0
    return float(((count - expected) ** 2 / expected).sum() / degrees)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Ending:
    """Shares of faults and winners among the strokes of one shot type.

    Attributes:
        shot: shot type.
        strokes: number of strokes.
        fault, winner: shares, each with the 90 % interval and the share of the others.
        clear: whether the share of faults, and that of winners, differs by more than chance.
    """

    shot: str
    strokes: float
    fault: tuple[float, float, float, float]
    winner: tuple[float, float, float, float]
    clear: tuple[bool, bool]


def endings(mine: Plays, others: Plays, *, dispersion: float = 1.0) -> list[Ending]:
    """Faults and winners by shot type, of a player beside others, for shot types with enough strokes."""
    rows: list[tuple[str, float, list[tuple[float, float, float, float]]]] = []
    p: list[float] = []
    for shot, name in enumerate(SHOTS):
        own, other = mine.shot == shot, others.shot == shot
        n, m = float(mine.weight[own].sum()), float(others.weight[other].sum())
        if n < RELIABLE or m < RELIABLE:
            continue
        shares = []
        for mine_of, others_of in ((mine.fault, others.fault), (mine.winner, others.winner)):
            share, usual = float(mine_of[own].sum() / n), float(others_of[other].sum() / m)
            pooled = (share * n + usual * m) / (n + m)
            error = np.sqrt(dispersion * pooled * (1 - pooled) * (1 / n + 1 / m))
            p.append(float(2 * stats.norm.sf(abs(share - usual) / error)) if error > 0 else 1.0)
            shares.append((share, *interval(share, n / dispersion), usual))
        rows.append((name, n, shares))
    clear = discoveries(p).reshape(-1, 2).tolist()
    return [
        Ending(shot=name, strokes=n, fault=shares[0], winner=shares[1], clear=(mark[0], mark[1]))
        for (name, n, shares), mark in zip(rows, clear, strict=True)
    ]


def area_shares(plays: Plays, which: Bools | None = None) -> tuple[F64, F64]:
    """``[9]`` number of strokes in the rally (without serves) towards each area, and their shares."""
    used = (plays.area >= 0) & (plays.shot >= N_SERVES)
    if which is not None:
        used &= which
    count = np.bincount(plays.area[used], plays.weight[used], N_AREAS)
    return count.astype(np.float64), np.asarray(count / max(1.0, count.sum()))
