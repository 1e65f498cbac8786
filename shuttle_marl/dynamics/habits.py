"""How players play: strokes as answers to common questions, and the counts of every player of a model.

A **question** is a situation (a serve, the reply to a drop from below, …); its answers are shot types, directions or
outcomes. A :class:`Tally` counts the answers of a player. Strokes of a match are alike, so counts vary more than independent
ones: their variance is multiplied by the **dispersion** (McCullagh & Nelder, Generalized Linear Models, section 4.5), estimated
from the variation between matches. A model contains the tallies of all players of its data, not their strokes.

Areas have the names of a game: as a right-handed player at their place sees them, so *right* is the forehand side.
"""

import dataclasses
import functools
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shuttle_marl.base.arrays import F32, F64, I64, Bools, Ints
from shuttle_marl.base.files import parsed, replace_file
from shuttle_marl.base.tensor_files import checked, tensor_bytes
from shuttle_marl.data.schema import DISCIPLINES, Outcome
from shuttle_marl.dynamics.features import Rows, rows_from_strokes
from shuttle_marl.game.court import AREAS, N_AREAS, N_SIDES
from shuttle_marl.game.layout import GameError
from shuttle_marl.game.recovery import N_POSITIONS, position_of
from shuttle_marl.game.shipped import HABITS, readable
from shuttle_marl.game.stroke import HEIGHTS, N_SERVES, N_SHOTS, N_TECHNIQUES, SHOTS

NONE: Final = N_SHOTS  # code of a previous stroke that does not exist; larger codes are unknown
DIRECTIONS: Final = ("straight", "middle", "cross")
DIRECTED: Final = ("smash", "half-smash", "drop", "clear", "lift", "drive", "push")  # called straight or cross
_LEAST_DEGREES: Final = 10


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Plays:
    """N strokes."""

    own: I64  # [N] shot type of the striker's last stroke; `NONE`, or larger if unknown
    incoming: I64  # [N] that of the incoming stroke, likewise
    met: I64  # [N] area in which the striker strikes; -1 if unknown or serving
    contact: I64  # [N] contact height
    shot: I64  # [N] shot type
    technique: I64  # [N] technique
    area: I64  # [N] where it landed; -1 if unknown
    hurried: I64  # [N] whether the striker is hurried, 1 or 0; -1: not known
    waits: I64  # [N] position (`POSITIONS`) of the striker at the next stroke; -1: not known
    opposite: Bools  # [N] whether the receiver has the other hand
    fault: Bools  # [N] whether it ended the rally as a fault
    winner: Bools  # [N] whether it ended the rally as a winner
    group: I64  # [N] cluster of alike strokes: number of the match

    def __len__(self) -> int:
        return len(self.shot)

    def take(self, which: Bools) -> "Plays":
        """Some of the strokes."""
        return Plays(**{field.name: getattr(self, field.name)[which] for field in dataclasses.fields(self)})


def plays_of_strokes(strokes: pa.Table) -> Plays:
    """Strokes of a table of schema :data:`shuttle_marl.data.schema.STROKES`, in its order."""
    return plays_of(rows_from_strokes(strokes))


def plays_of(rows: Rows) -> Plays:
    """Strokes in context as answers to the questions."""
    code = {name: code.astype(np.int64) for name, code in rows.codes.items()}
    # The receiver of the next stroke is who struck this one.
    waiting = np.concatenate([rows.waiting[1:], np.full((min(1, len(rows)), 2), np.nan)])
    known = (rows.next_contact >= 0) & np.isfinite(waiting).all(axis=1)
    fault = rows.outcome == Outcome.FAULT
    return Plays(
        own=code["own_shot"],
        incoming=code["incoming_shot"],
        met=np.where(code["incoming_area"] < N_AREAS, code["incoming_area"], -1),
        contact=code["contact"],
        shot=code["shot"],
        technique=code["technique"],
        # Where the shuttle came down, not the target as the models estimate it: what a coach sees.
        area=np.where(fault, -1, rows.landed).astype(np.int64),
        hurried=rows.hurried.astype(np.int64),
        waits=np.where(known, position_of(*waiting.T.astype(np.float64)), -1),
        opposite=code["hands"] == 1,
        fault=fault,
        winner=rows.outcome == Outcome.WINNER,
        group=rows.match.astype(np.int64),
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Question:
    """A question, and what each stroke answers."""

    kind: str  # type of the question, a key of the catalogue of texts
    about: tuple[str, ...]  # values of the question: names of shot types and contact heights
    answers: tuple[str, ...]


def straight(met: Ints, area: Ints, *, opposite: Bools | bool) -> Bools:
    """Whether strokes that are met on one side and land on one side go straight, any shape.

    Players face each other: with equal hands a straight stroke goes from one's forehand side to the other's backhand side, with
    different hands from forehand side to forehand side.

    Args:
        met: areas of the striker's half.
        area: areas of the receiver's half.
        opposite: whether the receiver has the other hand.
    """
    return np.asarray((area % N_SIDES == N_SIDES - 1 - met % N_SIDES) != opposite)


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
    wide = (plays.met >= 0) & (plays.met % 3 != 1)
    direction = np.where(side == 1, 1, np.where(straight(plays.met, plays.area, opposite=plays.opposite), 0, 2))
    for name in DIRECTED:
        which = (plays.shot == SHOTS.index(name)) & wide & (side >= 0)
        yield Question(kind="direction", about=(name,), answers=DIRECTIONS), asked(which, direction)


_NOTHING: Final[dict[str, Any]] = {field.name: np.zeros(0, np.int64) for field in dataclasses.fields(Plays)}
QUESTIONS: Final = tuple(question for question, _ in questions(Plays(**_NOTHING)))  # all questions, in the order of a tally
_STARTS: Final = np.cumsum([0, *(len(question.answers) for question in QUESTIONS)])


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Tally:
    """Counted strokes of a player."""

    counts: F32  # [A] number of strokes with each answer, of all `QUESTIONS` in turn
    dispersion: F32  # [Q] dispersion of the counts of each question, 1 or more
    ends: F32  # [13, 4, 3] number of strokes, faults and winners by shot type and technique; unknown techniques last
    positions: F32  # [13, 9] how often the player waited at each position after each shot type

    def answers(self, number: int) -> F64:
        """Counts of the answers to a question."""
        return self.counts[_STARTS[number] : _STARTS[number + 1]].astype(np.float64)

    @property
    def targets(self) -> F64:
        """``[9]`` number of strokes in the rally towards each area."""
        return self.answers(next(i for i, question in enumerate(QUESTIONS) if question.kind == "targets"))


def tally(plays: Plays) -> Tally:
    """Count the answers of strokes."""
    counts, dispersion = [], []
    for question, answer in questions(plays):
        asked, size = answer >= 0, len(question.answers)
        counts.append(np.bincount(answer[asked], minlength=size))
        dispersion.append(max(1.0, _dispersion(answer, plays, size)))
    shape = (N_SHOTS, N_TECHNIQUES + 1)
    kind = np.ravel_multi_index((plays.shot, np.minimum(plays.technique, N_TECHNIQUES)), shape)
    ends = [np.bincount(kind[which], minlength=math.prod(shape)) for which in (plays.shot >= 0, plays.fault, plays.winner)]
    return Tally(
        counts=np.concatenate(counts).astype(np.float32),
        dispersion=np.array(dispersion, np.float32),
        ends=np.stack(ends, axis=1).reshape(*shape, 3).astype(np.float32),
        positions=_positions(plays),
    )


def _positions(plays: Plays) -> F32:
    placed, shape = plays.waits >= 0, (N_SHOTS, N_POSITIONS)
    kind = np.ravel_multi_index((plays.shot[placed], plays.waits[placed]), shape)
    return np.bincount(kind, minlength=math.prod(shape)).reshape(shape).astype(np.float32)


def _dispersion(answer: I64, plays: Plays, size: int) -> float:
    """Pearson's chi-squared of the shares in each group, by its degrees of freedom; 1 for too few groups."""
    asked = answer >= 0
    groups, group = np.unique(plays.group[asked], return_inverse=True)
    count = np.bincount(group * size + answer[asked], minlength=len(groups) * size).reshape(-1, size)
    count = count[:, count.sum(axis=0) >= 5]
    expected = count.sum(axis=1, keepdims=True) * count.sum(axis=0) / max(1.0, count.sum())
    degrees = (count.shape[0] - 1) * (count.shape[1] - 1)
    if degrees < _LEAST_DEGREES or (expected <= 0).any():
        return 1.0
    return float(((count - expected) ** 2 / expected).sum() / degrees)


def save_habits(folder: Path, strokes: pa.Table, players: Sequence[str]) -> None:
    """Write the tallies of all players of a stroke table to a model folder."""
    plays = plays_of_strokes(strokes)
    player = strokes["player"].to_numpy(zero_copy_only=False).astype(str)
    kinds = np.searchsorted(DISCIPLINES, strokes["discipline"].to_numpy(zero_copy_only=False).astype(str))
    disciplines, own, others = [], [], []
    for name in players:
        mine = player == name
        disciplines.append(kinds[mine][0])
        own.append(tally(plays.take(mine)))
        others.append(tally(plays.take((kinds == disciplines[-1]) & ~mine)))
    arrays: dict[str, npt.NDArray[np.generic]] = {
        "discipline": np.array(disciplines, np.int8),
        "counts": np.stack([each.counts for each in own]).astype(np.uint16),
        "ends": np.stack([each.ends for each in own]).astype(np.uint16),
        "positions": np.stack([each.positions for each in own]).astype(np.uint16),
        "dispersion": np.stack([each.dispersion for each in own]).astype(np.float16),
        "dispersion_of_others": np.stack([each.dispersion for each in others]).astype(np.float16),
    }
    replace_file(folder / HABITS, tensor_bytes(arrays, {"habits": json.dumps({"players": list(players)}, sort_keys=True)}))


@functools.cache
def load_habits(folder: Path) -> Mapping[str, tuple[Tally, Tally]]:
    """Read the tallies of a model folder: of each player, and of all others of the discipline. Raises GameError: the model has
    none, or its file is damaged."""
    if not (folder / HABITS).is_file():
        raise GameError(
            f"{folder}: this model has no habits of players ({HABITS}); fit the model again, or name one that has them"
        )
    with readable(folder, HABITS, "habits of players") as tensors:
        (text,) = tensors.metadata.values()
        names = parsed(text)["players"]
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise ValueError("the players are no list of names")
        wanted = {
            "discipline": (np.int8, ()),
            "counts": (np.uint16, (int(_STARTS[-1]),)),
            "ends": (np.uint16, (N_SHOTS, N_TECHNIQUES + 1, 3)),
            "positions": (np.uint16, (N_SHOTS, N_POSITIONS)),
            "dispersion": (np.float16, (len(QUESTIONS),)),
            "dispersion_of_others": (np.float16, (len(QUESTIONS),)),
        }
        arrays = {
            name: checked(tensors.arrays[name], dtype, (len(names), *shape)).astype(np.float32)
            for name, (dtype, shape) in wanted.items()
        }
    counts, ends, places, dispersion = (arrays[name] for name in ("counts", "ends", "positions", "dispersion"))
    found = {}
    for i, name in enumerate(names):
        alike = arrays["discipline"] == arrays["discipline"][i]
        found[name] = (
            Tally(counts=counts[i], dispersion=dispersion[i], ends=ends[i], positions=places[i]),
            Tally(
                counts=counts[alike].sum(axis=0) - counts[i],
                dispersion=arrays["dispersion_of_others"][i],
                ends=ends[alike].sum(axis=0) - ends[i],
                positions=places[alike].sum(axis=0) - places[i],
            ),
        )
    return found
