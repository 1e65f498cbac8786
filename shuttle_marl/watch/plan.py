"""The plan of a match: all that a link has to name so that the same match is seen again.

A plan comes from a page or a link, so every part of it is checked here.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, Final

from shuttle_marl.watch import WatchError

MOST_CHANGES: Final = 200
"""Changes of players in a match."""
MOST_CHOSEN: Final = 20_000
"""Strokes of a match that no policy chose."""
MOST_RALLIES: Final = 1000
"""Numbers of rallies are below this; no match by the rules of the sport is as long."""
MOST_NUMBERS: Final = 1 << 40
"""Numbers of rallies in a log are below this."""
_LONGEST_NAME: Final = 200
_HIGHEST_SEED: Final = 1 << 53
"""JavaScript holds whole numbers up to this."""
_HIGHEST_TEMPERATURE: Final = 100.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class Side:
    """The player of a seat.

    Attributes:
        policy: its name.
        temperature: 1: as it is, below: sharper, 0: always its likeliest stroke.
    """

    policy: str
    temperature: float = 1.0

    @classmethod
    def parse(cls, raw: Any) -> "Side":
        """From ``{"policy": NAME, "temperature": T}``.

        Raises:
            WatchError: it is something else.
        """
        fields = _fields(raw, "a side", {"policy"}, {"temperature"})
        policy, temperature = fields["policy"], fields.get("temperature", 1.0)
        if not isinstance(policy, str) or not 0 < len(policy) <= _LONGEST_NAME:
            raise WatchError(f"a policy is named by a text of 1 to {_LONGEST_NAME} characters")
        if not _is_number(temperature) or not 0 <= temperature <= _HIGHEST_TEMPERATURE:
            raise WatchError(f"a temperature is a number from 0 to {_HIGHEST_TEMPERATURE:g}")
        return cls(policy=policy, temperature=float(temperature))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Change:
    """A side that changes during a match.

    Attributes:
        rally: the first one that it plays.
        seat: 0 or 1.
        side: who plays from there.
    """

    rally: int
    seat: int
    side: Side


@dataclasses.dataclass(frozen=True, kw_only=True)
class Plan:
    """A match.

    Attributes:
        seed: names all draws.
        sides: of seats 0 and 1 in the first rally.
        changes: later ones, in the order of rallies.
        chosen: catalogue index of every stroke that no policy chose: a person's, or one that was tried out; by the number of the
            rally and of the stroke, both from 0.
    """

    seed: int
    sides: tuple[Side, Side]
    changes: tuple[Change, ...] = ()
    chosen: tuple[tuple[int, tuple[tuple[int, int], ...]], ...] = ()

    @classmethod
    def parse(cls, raw: Any) -> "Plan":
        """From the JSON that a page sends: ``seed``, ``sides``, and perhaps ``changes`` and ``chosen``.

        Raises:
            WatchError: it is something else.
        """
        fields = _fields(raw, "a plan", {"seed", "sides"}, {"changes", "chosen"})
        seed = whole(fields["seed"], "the seed", _HIGHEST_SEED)
        sides, changes, chosen = fields["sides"], fields.get("changes", []), fields.get("chosen", {})
        if not isinstance(sides, list) or len(sides) != 2:
            raise WatchError("a plan has two sides")
        if not isinstance(changes, list) or len(changes) > MOST_CHANGES:
            raise WatchError(f"changes are a list of at most {MOST_CHANGES}")
        if not isinstance(chosen, dict):
            raise WatchError("chosen strokes are given by the number of their rally")
        first, second = (Side.parse(side) for side in sides)
        found = {_key(number, MOST_RALLIES): parse_chosen(strokes) for number, strokes in chosen.items()}
        if sum(map(len, found.values())) > MOST_CHOSEN:
            raise WatchError(f"a match with more than {MOST_CHOSEN:,} strokes that no policy chose")
        return cls(
            seed=seed,
            sides=(first, second),
            changes=tuple(sorted((_change(change) for change in changes), key=lambda change: change.rally)),
            chosen=tuple(sorted(found.items())),
        )

    def sides_in(self, rally: int) -> tuple[Side, Side]:
        """Players of a rally, seats 0 and 1."""
        sides = [*self.sides]
        for change in self.changes:
            if change.rally <= rally:
                sides[change.seat] = change.side
        return sides[0], sides[1]

    def chosen_in(self, rally: int) -> dict[int, int]:
        """Catalogue index of the strokes of a rally that no policy chose, by their number."""
        return dict(next((strokes for number, strokes in self.chosen if number == rally), ()))

    def without(self, rally: int, stroke: int) -> "Plan":
        """The plan without what was chosen in a rally from a stroke on, and after that rally."""
        kept = tuple((k, s) for k, s in self.chosen_in(rally).items() if k < stroke)
        before = tuple(entry for entry in self.chosen if entry[0] < rally)
        return dataclasses.replace(self, chosen=(*before, (rally, kept)) if kept else before)


def whole(value: Any, name: str, limit: int) -> int:
    """A whole number from 0 up to, and without, a limit.

    Raises:
        WatchError: it is something else.
    """
    if type(value) is not int or not 0 <= value < limit:
        raise WatchError(f"{name}: expected a whole number from 0 to {limit - 1:,}")
    return value


def _change(raw: Any) -> Change:
    fields = _fields(raw, "a change", {"rally", "seat", "side"}, set())
    rally, seat = whole(fields["rally"], "the rally of a change", MOST_RALLIES), whole(fields["seat"], "a seat", 2)
    return Change(rally=rally, seat=seat, side=Side.parse(fields["side"]))


def parse_chosen(raw: Any) -> tuple[tuple[int, int], ...]:
    """Strokes of a rally by their number, in order, from ``{"NUMBER": STROKE}``.

    Raises:
        WatchError: it is something else.
    """
    if not isinstance(raw, dict):
        raise WatchError("the chosen strokes of a rally are given by their number")
    return tuple(
        sorted((_key(number, MOST_CHOSEN), whole(stroke, "a stroke of the catalogue", 1 << 16)) for number, stroke in raw.items())
    )


def _key(text: str, limit: int) -> int:
    """A whole number that is the key of a JSON object."""
    if not (text.isascii() and text.isdigit() and len(text) <= 9):
        raise WatchError(f"{text[:20]!r}: expected the number of a rally or a stroke")
    return whole(int(text), "the number of a rally or a stroke", limit)


def _fields(raw: Any, name: str, needed: set[str], allowed: set[str]) -> Mapping[str, Any]:
    if not isinstance(raw, dict) or not needed <= raw.keys() <= needed | allowed:
        raise WatchError(f"{name}: expected an object with {', '.join(sorted(needed))}")
    return raw


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and math.isfinite(value)
