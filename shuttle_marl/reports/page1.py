"""Page 1 of a report: what is sure of a player, in statements with counts, and the check that no two of a report disagree.

A **statement** is about habits, endings and places that differ from those of others by more than chance, about the first three
strokes, or about an option (:class:`~shuttle_marl.reports.habits.Option`) that won more or less than the others in the same
situation, also by more than chance. Each correction is for all differences of its kind that the report tests.
"""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa

from shuttle_marl.dynamics.habits import Tally
from shuttle_marl.game.stroke import N_SERVES
from shuttle_marl.reports.habits import ENDS, Expected, Habit, Option, Results, Situation, expected_of, interval, plain
from shuttle_marl.reports.summary import rally_table
from shuttle_marl.reports.waits import Difference

RULES: Final = (
    "an advised stroke won no smaller share of the rallies in its situation than the one it replaces, where both were played",
    "no stroke is advised and advised against in one situation, and none is advised to two areas there",
    "each drill trains a stroke that the report advises",
    "shares, strokes and places on page 1 are those of the later pages",
    "points, games and numbers of rallies follow from the points in the data",
)
"""What a report keeps; ``python -m experiments.reports`` recounts it."""
_SURE: Final = 5  # most habits on page 1
_LEAST: Final = 10  # strokes from which answers are told
_OTHERS: Final = 2  # most endings, and most places
_OPTIONS: Final = 2  # most options that are advised, and that are advised against
_ASKED: Final = (("serve",), ("serve_side",), ("return", "short-serve"), ("return", "long-serve"), ("third",))


@dataclasses.dataclass(frozen=True)
class Statement:
    """A statement of page 1.

    Attributes:
        kind: ``habit``, ``fault``, ``winner``, ``wait``, ``answer``, ``do`` or ``dont``.
        player: whom it describes, or whom an option advises.
        figure: what it says.
        count: of strokes, of rallies for an option.
        value: share, or distance [m]; ``low``, ``high``: its interval; ``usual``: share of the others, NaN without.
        q: p-value with the correction for the number of differences tested; NaN of a description.
    """

    kind: str
    player: int
    figure: Habit | Difference | Expected | Option
    count: int
    value: float
    low: float
    high: float
    usual: float = np.nan
    q: float = np.nan


class Page1(NamedTuple):
    """Page 1.

    Attributes:
        tested: number of options that were compared; None: no matches were given.
        serves: of each player, the serves that the data have, and all; None: not counted.
    """

    statements: tuple[Statement, ...]
    tested: int | None
    serves: tuple[tuple[int, int] | None, ...]

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


def sure(player: int, habits: Iterable[Habit], endings: Iterable[Habit], places: Iterable[Difference]) -> Iterator[Statement]:
    """What differs from others by more than chance: first the habits, of one question once."""
    first: dict[tuple[str, ...], Habit] = {}
    for each in habits:
        if each.clear:
            first.setdefault((each.kind, *each.about), each)
    for each in (*[*first.values()][:_SURE], *clear_endings(endings)[:_OTHERS]):
        kind = each.kind if each.kind in ENDS else "habit"
        yield Statement(kind, player, each, round(each.strokes), each.share, each.low, each.high, each.usual, each.q)
    for place in [each for each in places if each.wait.player == player][:_OTHERS]:
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
        for each in [option for option in found if option.clear and sign * option.gain > 0][:_OPTIONS]:
            won, usual = each.won / each.rallies, each.others_won / each.others
            yield Statement(kind, player, each, each.rallies, won, each.low, each.high, usual, each.q)


def serves(strokes: pa.Table, player: str) -> tuple[int, int]:
    """Serves of a player that are in the data, and rallies that the player served."""
    frame = rally_table(strokes)
    first = frame.filter(pa.compute.equal(frame["server"], player))["first"].to_numpy()
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
