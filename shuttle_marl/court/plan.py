"""The plan of a match: the content of a link. Plans are untrusted; decoding validates every field."""

from typing import Annotated, Any, Final

import msgspec
from msgspec import Meta, Struct

from shuttle_marl.court import WatchError
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.scoring import BWF, Rules

DUEL: Final = 7  # points that win a duel: with enough decisions that the better decider is ahead in nine of ten
# Opponents of duels, each stronger than the one before: a defender, a left-hander, a net player and an attacker among them.
LADDER: Final = ("defensive", "bc:kento-momota", "bc", "bc:viktor-axelsen", "safe", "attacking", "human:0.05")
MAX_CHANGES: Final = 200  # maximum number of changes of players in a match
MAX_CHOSEN: Final = 20_000  # maximum number of strokes in a match that no policy chose
MAX_RALLIES: Final = 1000  # rally numbers of a match are below this; no match by the rules of the sport is as long

Seat = Annotated[int, Meta(ge=0, le=1)]
RallyNumber = Annotated[int, Meta(ge=0, lt=MAX_RALLIES)]
StrokeNumber = Annotated[int, Meta(ge=0, lt=MAX_CHOSEN)]
CatalogueIndex = Annotated[int, Meta(ge=0, lt=1 << 16)]
Chosen = dict[StrokeNumber, CatalogueIndex]  # catalogue index of the strokes of a rally that no policy chose, by their number
Tried = dict[StrokeNumber, Annotated[int, Meta(ge=-N_POSITIONS, lt=1 << 16)]]
"""Alternatives in a recorded rally, by the number of the stroke: a catalogue index, or -1 - p for position p of the receiver."""
Waited = dict[StrokeNumber, Annotated[int, Meta(ge=0, lt=N_POSITIONS)]]  # of receivers


class Side(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The player of a seat."""

    policy: Annotated[str, Meta(min_length=1, max_length=200)]
    temperature: Annotated[float, Meta(ge=0, le=100)] = 1.0  # 1: unchanged, below 1: sharper, 0: greedy


class Change(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A change of player during a match."""

    rally: RallyNumber  # first rally of the new player
    seat: Seat
    side: Side


class Person(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A person who plays instead of a policy."""

    seat: Seat
    rally: RallyNumber
    stroke: StrokeNumber  # the first stroke of that rally that they may choose, or for which they may wait
    practice: bool = False  # they play a rally again, which is not recorded
    friend: bool = False  # another person plays at the other seat

    def chooses(self, rally: int, stroke: int, seat: int) -> bool:
        """Whether a person chooses for a seat: as the striker a stroke, as the receiver a position."""
        return (self.friend or seat == self.seat) and (rally, stroke) >= (self.rally, self.stroke)


class Plan(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A match."""

    seed: Annotated[int, Meta(ge=0, lt=1 << 53)]  # random seed; JavaScript represents integers up to 2^53
    sides: tuple[Side, Side]  # players of seats 0 and 1 in the first rally
    changes: Annotated[tuple[Change, ...], Meta(max_length=MAX_CHANGES)] = ()
    chosen: dict[RallyNumber, Chosen] = {}  # by rally, the strokes that no policy chose
    waited: dict[RallyNumber, Waited] = {}  # by rally, the positions that a person chose
    points: Annotated[int, Meta(ge=1, le=21)] | None = None  # points that win a duel; None: the rules of the sport

    def __post_init__(self) -> None:
        if sum(map(len, (*self.chosen.values(), *self.waited.values()))) > MAX_CHOSEN:
            raise ValueError(f"a match with more than {MAX_CHOSEN:,} strokes and positions that no policy chose")

    @classmethod
    def parse(cls, raw: Any) -> "Plan":
        """From the decoded JSON of a page. Raises WatchError: it is not a plan."""
        try:
            return msgspec.json.decode(msgspec.json.encode(raw), type=cls)
        except (msgspec.MsgspecError, TypeError) as error:
            raise WatchError(f"a plan of a match: {error}") from error

    @property
    def rules(self) -> Rules:
        """When the match is won."""
        return BWF if self.points is None else Rules(points=self.points, clear=1, cap=self.points, games=1)

    @property
    def key(self) -> bytes:
        """Equal for equal plans; hashable."""
        chosen = {rally: self.chosen_in(rally) for rally in sorted(self.chosen)}
        waited = {rally: self.waited_in(rally) for rally in sorted(self.waited)}
        return msgspec.json.encode(msgspec.structs.replace(self, chosen=chosen, waited=waited))

    def sides_in(self, rally: int) -> tuple[Side, Side]:
        """Players of a rally, seats 0 and 1."""
        sides = [*self.sides]
        for change in sorted(self.changes, key=lambda change: change.rally):
            if change.rally <= rally:
                sides[change.seat] = change.side
        return sides[0], sides[1]

    def chosen_in(self, rally: int) -> Chosen:
        """Strokes of a rally that no policy chose, in order of their number."""
        return dict(sorted(self.chosen.get(rally, {}).items()))

    def waited_in(self, rally: int) -> Waited:
        """Positions of a rally that a person chose, in order of the number of the stroke."""
        return dict(sorted(self.waited.get(rally, {}).items()))

    def without(self, rally: int, stroke: int) -> "Plan":
        """The plan without what was chosen in a rally from a stroke on, and in later rallies."""

        def before(choices: dict[RallyNumber, dict[StrokeNumber, int]]) -> dict[RallyNumber, dict[StrokeNumber, int]]:
            kept = {number: of for number, of in choices.items() if number < rally}
            first = {k: choice for k, choice in sorted(choices.get(rally, {}).items()) if k < stroke}
            return {**kept, rally: first} if first else kept

        return msgspec.structs.replace(self, chosen=before(self.chosen), waited=before(self.waited))
