"""Skill of players: by how much their log-odds differ from those of the average player, with dates.

The offsets of a player are partially pooled estimates. Three components describe a stroke: **success** (log-odds of a fault),
**return** (log-odds that a good stroke is returned) and **contact** (log-odds that a returned stroke is met above the net). Each
has a part for the player who strikes and a part for the player who receives, and each part is the sum of a general offset and one
of the group of the shot type. Skill changes with time, so a player has one set of offsets for each of several days (*knots*).
"""

import dataclasses
import datetime
import functools
from pathlib import Path
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F32, F64, I8, I32
from shuttle_marl.base.tensor_files import Tensors, checked, parsed
from shuttle_marl.game.court import HANDS
from shuttle_marl.game.shipped import SKILL, read_model
from shuttle_marl.game.stroke import N_SHOTS
from shuttle_marl.game.tables import GameError

COMPONENTS: Final = ("success", "return", "contact")
"""Components of a stroke, in the order of the offsets."""
ROLES: Final = ("striker", "receiver")
"""Roles of a player in a stroke, in the order of the offsets."""
GROUPS: Final = ("attack", "net", "rear", "lift", "block", "serve")
"""Groups of shot types; offset 0 is the general one, offset 1 + g that of group g."""
AVERAGE: Final = "average"
"""Name of the player without offsets."""
DISCIPLINES: Final = ("men", "women")
"""Names of the numbers in :attr:`Skill.discipline`."""

Day = datetime.date | str | None
"""A day, or its ISO 8601 text (``2021-07-31``)."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Skill:
    """Skill of M players at K knots.

    Attributes:
        players: M names.
        offset: ``[K, 3, 2, 7]`` float32 differences of log-odds, by component, role, and general or group.
        deviation: ``[K, 3, 2, 7]`` float32 their posterior standard deviations.
        player: ``[K]`` int32 index of the player; sorted by player, then day.
        day: ``[K]`` int32 days since 1970-01-01.
        group: ``[13]`` int8 group of each shot type.
        discipline: ``[M]`` int8 index into :data:`DISCIPLINES`.
        hand: ``[M]`` int8 index into :data:`~shuttle_marl.game.court.HANDS`; -1 where the data do not tell it.
        strokes: ``[M]`` int32 strokes of each player in the data.
        matches: ``[M]`` int32 matches of each player in the data.
    """

    players: tuple[str, ...]
    offset: F32
    deviation: F32
    player: I32
    day: I32
    group: I8
    discipline: I8
    hand: I8
    strokes: I32
    matches: I32

    def knot(self, name: str, day: Day = None) -> int:
        """Number of the last knot of a player on or before a day; the first one if there is none, the last one for None.

        Raises:
            GameError: the player is unknown, or the day is no date.
        """
        knots = np.flatnonzero(self.player == self.index(name))
        if day is None:
            return int(knots[-1])
        since = (day_of(day) - datetime.date(1970, 1, 1)).days
        return int(knots[max(0, int(np.searchsorted(self.day[knots], since, side="right")) - 1)])

    def since(self, name: str, day: Day = None) -> datetime.date | None:
        """Day of the knot that :meth:`knot` finds; None for the average player."""
        if name == AVERAGE:
            return None
        return datetime.date(1970, 1, 1) + datetime.timedelta(days=int(self.day[self.knot(name, day)]))

    def index(self, name: str) -> int:
        """Number of a player.

        Raises:
            GameError: the player is unknown.
        """
        if name not in self.players:
            raise GameError(f"no skill of the player {name!r}; there are: {', '.join((AVERAGE, *self.players))}")
        return self.players.index(name)

    def discipline_of(self, name: str) -> str | None:
        """Name of the discipline of a player; None for the average player."""
        return None if name == AVERAGE else DISCIPLINES[self.discipline[self.index(name)]]

    def hand_of(self, name: str) -> str | None:
        """Hand of a player, ``right`` or ``left``; None for the average player and where it is unknown."""
        number = -1 if name == AVERAGE else int(self.hand[self.index(name)])
        return None if number < 0 else HANDS[number]

    def of_shots(self, striker: str, receiver: str, day: Day = None) -> F64:
        """``[3, 13]`` offsets of strokes of one player to another as of a day, by component and shot type."""
        total = np.zeros((len(COMPONENTS), N_SHOTS))
        for role, name in enumerate((striker, receiver)):
            if name != AVERAGE:
                own = self.offset[self.knot(name, day), :, role].astype(np.float64)
                total += own[:, :1] + own[:, 1 + self.group]
        return total

    def variances(self, striker: str, receiver: str, day: Day = None) -> F64:
        """``[3, 7]`` posterior variances of the sum of both players' offsets, by component, and general or group."""
        total = np.zeros((len(COMPONENTS), 1 + len(GROUPS)))
        for role, name in enumerate((striker, receiver)):
            if name != AVERAGE:
                total += self.deviation[self.knot(name, day), :, role].astype(np.float64) ** 2
        return total


def day_of(day: datetime.date | str) -> datetime.date:
    """The day of an ISO 8601 text.

    Raises:
        GameError: it is no date.
    """
    try:
        return day if isinstance(day, datetime.date) else datetime.date.fromisoformat(day)
    except ValueError as error:
        raise GameError(f"date {day!r}: expected year-month-day, such as 2021-07-31") from error


def has_skill(folder: Path) -> bool:
    """Whether a model folder has the skill of players."""
    return (folder / SKILL).is_file()


@functools.cache
def load_skill(folder: Path) -> Skill:
    """Read the skill of the players of a model folder.

    Raises:
        GameError: the model has none, or its file is damaged.
    """
    if not has_skill(folder):
        raise GameError(f"{folder}: this model has no skill of players ({SKILL}); fit the model again, or name one that has it")
    try:
        return _skill(read_model(folder, SKILL))
    except (OSError, KeyError, ValueError) as error:
        raise GameError(f"{folder / SKILL}: no readable skill of players ({error}); fit or install the model again") from error


def _skill(tensors: Tensors) -> Skill:
    (text,) = tensors.metadata.values()
    names = parsed(text)["players"]
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names) or AVERAGE in names:
        raise ValueError("the players are no list of names")
    m, k = len(names), len(tensors.arrays["day"])
    shape = (k, len(COMPONENTS), len(ROLES), 1 + len(GROUPS))
    wanted = {
        "offset": (np.float32, shape), "deviation": (np.float32, shape), "player": (np.int32, (k,)), "day": (np.int32, (k,)),
        "group": (np.int8, (N_SHOTS,)), "discipline": (np.int8, (m,)), "hand": (np.int8, (m,)), "strokes": (np.int32, (m,)),
        "matches": (np.int32, (m,)),
    }  # fmt: skip
    arrays = {"hand": np.full(m, -1, np.int8), **tensors.arrays}  # TODO: until the refit
    skill = Skill(players=tuple(names), **{name: checked(arrays[name], *kind) for name, kind in wanted.items()})
    if (np.unique(skill.player) != np.arange(m)).any() or (np.diff(skill.player) < 0).any():
        raise ValueError("a player without knots, or knots that are not sorted by player")
    if (np.diff(skill.day)[np.diff(skill.player) == 0] <= 0).any():
        raise ValueError("knots that are not sorted by day")
    if not (np.isin(skill.group, range(len(GROUPS))).all() and np.isin(skill.discipline, range(len(DISCIPLINES))).all()):
        raise ValueError("a group of shot types or a discipline that does not exist")
    if not np.isin(skill.hand, range(-1, len(HANDS))).all():
        raise ValueError("a hand that does not exist")
    return skill
