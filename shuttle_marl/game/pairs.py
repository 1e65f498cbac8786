"""Skill of players, and the game of a pair: two players, each with the tables of their own strokes, over the same states.

Skill is by how much the log-odds of a player differ from those of the average player: of a fault (**success**), that a good
stroke is returned (**return**) and that it is met above the net (**contact**). Each has a part for the striker and one for the
receiver, and each part is the sum of a general offset and one of the group of the shot type. It changes with time, so a player
has one set of offsets for each of several days (*knots*). Tables are computed in whole numbers, the same on every machine.
"""

import dataclasses
import datetime
import functools
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F32, F64, I8, I32, I64, U16, Ints
from shuttle_marl.base.files import parsed
from shuttle_marl.base.tensor_files import checked
from shuttle_marl.game.court import HANDS, Hands
from shuttle_marl.game.draws import odds_of_steps
from shuttle_marl.game.layout import GameError
from shuttle_marl.game.recovery import NO_CHOICE
from shuttle_marl.game.shipped import (
    OPPOSITE,
    PROFILES,
    RECOVERY,
    SKILL,
    Origin,
    between_hands,
    game_of,
    hands_of_variant,
    is_refit,
    load_game,
    moved,
    origin_named,
    origin_of,
    readable,
    steps_between,
    variant_of,
    variants,
    with_odds,
)
from shuttle_marl.game.stroke import N_SHOTS, frozen
from shuttle_marl.game.tables import Game

COMPONENTS: Final = ("success", "return", "contact")  # components of a stroke, in the order of the offsets
ROLES: Final = ("striker", "receiver")  # roles of a player in a stroke, in the order of the offsets
GROUPS: Final = ("attack", "net", "rear", "lift", "block", "serve")
"""Groups of shot types; offset 0 is the general one, offset 1 + g that of group g."""
AVERAGE: Final = "average"  # name of the player without offsets
DISCIPLINES: Final = ("men", "women")  # names of the numbers in `Skill.discipline`

Day = datetime.date | str | None  # a day, or its ISO 8601 text (``2021-07-31``)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Skill:
    """Skill of M players at K knots."""

    players: tuple[str, ...]  # M names
    offset: F32  # [K, 3, 2, 7] float32 differences of log-odds, by component, role, and general or group
    deviation: F32  # [K, 3, 2, 7] float32 their posterior standard deviations
    player: I32  # [K] int32 index of the player; sorted by player, then day
    day: I32  # [K] int32 days since 1970-01-01
    group: I8  # [13] int8 group of each shot type
    discipline: I8  # [M] int8 index into `DISCIPLINES`
    hand: I8  # [M] int8 index into `HANDS`; -1 where the data do not tell it
    strokes: I32  # [M] int32 strokes of each player in the data
    matches: I32  # [M] int32 matches of each player in the data

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
        """Number of a player. Raises GameError: the player is unknown."""
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


def day_of(day: datetime.date | str) -> datetime.date:
    """The day of an ISO 8601 text. Raises GameError: it is no date."""
    try:
        return day if isinstance(day, datetime.date) else datetime.date.fromisoformat(day)
    except ValueError as error:
        raise GameError(f"date {day!r}: expected year-month-day, such as 2021-07-31") from error


def has_skill(folder: Path) -> bool:
    """Whether a model folder has the skill of players."""
    return (folder / SKILL).is_file()


@functools.cache
def load_skill(folder: Path) -> Skill:
    """Read the skill of the players of a model folder. Raises GameError: the model has none, or its file is damaged."""
    if not has_skill(folder):
        raise GameError(f"{folder}: this model has no skill of players ({SKILL}); fit the model again, or name one that has it")
    with readable(folder, SKILL, "skill of players") as tensors:
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
        skill = Skill(players=tuple(names), **{name: checked(tensors.arrays[name], *kind) for name, kind in wanted.items()})
        if (np.unique(skill.player) != np.arange(m)).any() or (np.diff(skill.player) < 0).any():
            raise ValueError("a player without knots, or knots that are not sorted by player")
        if (np.diff(skill.day)[np.diff(skill.player) == 0] <= 0).any():
            raise ValueError("knots that are not sorted by day")
        for numbers, least, end in (
            (skill.group, 0, len(GROUPS)),
            (skill.discipline, 0, len(DISCIPLINES)),
            (skill.hand, -1, len(HANDS)),
        ):
            if not np.isin(numbers, range(least, end)).all():
                raise ValueError("a group of shot types, a discipline or a hand that does not exist")
    return skill


STEP: Final = 2.0**-10  # difference of log-odds to which the offsets of a pair are rounded
_LARGEST: Final = 4.0  # offsets are limited to this difference of log-odds


@dataclasses.dataclass(frozen=True, kw_only=True)
class People:
    """Two players in whose game seats 0 and 1 strike with their skill."""

    players: tuple[str, str]  # their names; `average` for the average player
    model: str = "default"  # the model or variant whose tables the offsets are applied to, by name or folder
    date: datetime.date | None = None  # day of the skill; None: the last one known
    discipline: str | None = None  # `men` or `women` for the tables of that discipline; None: the average of both
    hands: Hands = (HANDS[0], HANDS[0])  # their hands; an unknown one, and that of the average player, counts as right

    def game(self, model: str | None = None) -> Game:
        """Their game, in another model if one is named."""
        return pair_game(*self.players, date=self.date, discipline=self.discipline, game=model or self.model)

    @property
    def title(self) -> str:
        """The players, and the day of their skill, in words."""
        return " against ".join(self.players) + ("" if self.date is None else f" as of {self.date}")

    @property
    def swapped(self) -> "People":
        """The same players at the other seats."""
        return dataclasses.replace(self, players=self.players[::-1], hands=self.hands[::-1])

    @property
    def origin(self) -> Origin:
        """The model, and the discipline as the variant, for policies of the model."""
        variant = variant_of(self.discipline, opposite=self.opposite)
        return origin_named(self.model)._replace(variant=variant or AVERAGE)

    @property
    def opposite(self) -> bool:
        """Whether their hands differ."""
        return self.hands[0] != self.hands[1]

    @property
    def average(self) -> Game:
        """The game of the model, without skill and discipline, whose agents can play this one."""
        return game_of(self.origin._replace(variant=None))

    @property
    def profile(self) -> Game:
        """The game of their discipline and hands, without skill, in which imitated players choose as they do here."""
        known = self.discipline if self.discipline in variants(self.origin.folder) else None
        return game_of(self.origin._replace(variant=variant_of(known, opposite=self.opposite)))

    @property
    def skill(self) -> Skill:
        """Skill of the players of the model. Raises GameError: the file of the model is damaged."""
        return load_skill(origin_named(self.model).folder)

    def refits(self) -> tuple[Game, ...]:
        """Their game in the refits of the model; none in a refit. Raises GameError: a file of the model is damaged."""
        origin = origin_named(self.model)
        names = () if origin.variant is not None else variants(origin.folder)
        model = self.model.removesuffix(f":{RECOVERY}")
        return tuple(self.game(origin._replace(variant=name).name_in(model)) for name in names if is_refit(name))


def people_of(game: Game) -> People:
    """The players of the game of a pair, or of one seat of it. Raises GameError: both seats have the same tables."""
    people = game.people if game.whole is None else game.whole.people
    if people is None:
        raise GameError("this is not the game of two players; make one with pair_game")
    return people


def seat_names(game: Game, policies: tuple[str, str]) -> tuple[str, str]:
    """Names of the seats: of the policies, in the game of a pair behind those of the players whose skill they have."""
    if game.people is None:
        return policies
    first, second = (
        player if policy in (player, f"bc:{player}") else f"{player} ({policy})"
        for player, policy in zip(game.people.players, policies, strict=True)
    )
    return first, second


class Looks(NamedTuple):
    """How the players at seats 0 and 1 look on the court."""

    hands: Hands = (HANDS[0], HANDS[0])  # ``right`` or ``left``
    athletes: tuple[str, str] = ("male", "male")  # ``male`` or ``female``

    @property
    def left(self) -> tuple[bool, bool]:
        """Whether they are left-handed."""
        return self.hands[0] == HANDS[1], self.hands[1] == HANDS[1]


def looks_of(game: Game, policies: tuple[str, str]) -> Looks:
    """Hands and sexes of the players of a match.

    The players of the game of a pair have their own. In any other game the first one who imitates a person of known hand has
    theirs, and the other player has the same one or, in a game of different hands, the other one: a rally is as true in
    the mirror. An agent, which is nobody, is a man or a woman as the other player is.

    Args:
        policies: names of the policies at seats 0 and 1; ``bc:PLAYER`` and ``PLAYER`` are persons.
    """
    if game.people is not None:
        people = people_of(game)
        athlete = "female" if people.discipline == "women" else "male"
        return Looks(hands=people.hands, athletes=(athlete, athlete))
    origin = origin_of(game)
    if origin is None or not has_skill(origin.folder):
        return Looks()
    skill, (discipline, opposite) = load_skill(origin.folder), hands_of_variant(origin.variant)
    known = _persons(skill, policies)
    seat, hand = next(((seat, hand) for seat, hand in enumerate(map(skill.hand_of, known)) if hand), (0, HANDS[0]))
    other = HANDS[(HANDS.index(hand) + opposite) % 2]
    kinds = [discipline if discipline in PROFILES else skill.discipline_of(name) for name in known]
    usual = next(filter(None, kinds), PROFILES[0])
    first, second = ("female" if (kind or usual) == "women" else "male" for kind in kinds)
    return Looks(hands=(other, hand) if seat else (hand, other), athletes=(first, second))


def game_between(game: Game, policies: tuple[str, str]) -> Game:
    """The game in which two policies meet: that of different hands if they imitate persons whose hands differ, else ``game``.

    Args:
        game: the game of a model or a variant of it; any other, and the game of a pair, is that of all meetings.
        policies: names of the policies at seats 0 and 1, see :func:`looks_of`.

    Raises:
        GameError: a file of the model is damaged.
    """
    origin = None if game.people is not None else origin_of(game)
    if origin is None or not has_skill(origin.folder) or hands_of_variant(origin.variant)[1]:
        return game
    skill = load_skill(origin.folder)
    if set(map(skill.hand_of, _persons(skill, policies))) != set(HANDS):
        return game
    return game_of(origin._replace(variant=variant_of(origin.variant, opposite=True)))


def _persons(skill: Skill, policies: tuple[str, str]) -> list[str]:
    """Names of the persons whom policies imitate; ``average`` for nobody."""
    names = [policy.removeprefix("bc:").partition("@")[0] for policy in policies]
    return [name if name in skill.players else AVERAGE for name in names]


def trained_game(game: Game) -> Game:
    """The game on which agents that play a game were trained: the average game, or a variant, of equal hands."""
    average, origin = game.average, origin_of(game.average)
    equal, opposite = (None, False) if origin is None else hands_of_variant(origin.variant)
    return average if origin is None or not opposite else game_of(origin._replace(variant=equal))


def without_skill(game: Game) -> Game:
    """The average game over the states of a game: itself, but in the game of a pair."""
    if game.people is None and game.whole is None:
        return game.average
    people = people_of(game)
    if not people.opposite:
        return game.average
    return game_of(people.origin._replace(variant=OPPOSITE))


def without_recovery(game: Game) -> Game:
    """The same game in which receivers have no choice: itself if they have none."""
    origin = origin_of(game)
    if not game.hides:
        return game
    if origin is None or game.people is not None or game.whole is not None:
        return dataclasses.replace(game, recovery=NO_CHOICE)
    return game_of(origin._replace(recovery=False))


def opponent_tables(game: Game, seat: int | Ints) -> Game:
    """The tables with which the opponent of a learner strikes.

    Args:
        seat: seat of the learner, or ``[B]`` seats, which are equal in the game of a pair.

    Raises:
        GameError: the seats of the game of a pair differ, because the opponent would be another player in each.
    """
    if game.people is None:
        return game
    learners = np.unique(seat)
    if len(learners) != 1 or learners[0] not in (0, 1):
        raise GameError(f"seat {seat!r}: in the game of {game.people.title} expected 0 or 1 for all rows, the player that learns")
    return game.seats[1 - int(learners[0])]


@functools.lru_cache(maxsize=8)
def pair_game(a: str, b: str, *, date: Day = None, discipline: str | None = None, game: str = "default") -> Game:
    """The game of two players with their skill.

    Args:
        a: player at seat 0; ``average`` for the average player.
        b: player at seat 1.
        date: day of the skill, such as ``2021-07-31``: the last estimate on or before it, or the first one; None: the last one.
        discipline: ``men`` or ``women``; None: that of the players, and the average of both for two average players.
        game: a model by name or folder, or a refit of it (``default:3``), in which the same offsets are applied.

    Raises:
        GameError: the model has no skill of players, a player is unknown, the players are not of one discipline, or the date is
            none.
    """
    folder, variant, hidden = origin_named(game)
    equal, opposite = hands_of_variant(variant)
    model = game.rpartition(":")[0] if variant is not None or hidden else game
    if opposite:  # the hands are those of the players
        variant = equal
    game = Origin(folder, variant, hidden).name_in(model)
    skill = load_skill(folder)
    of_players = {name: skill.discipline_of(name) for name in (a, b) if name != AVERAGE}
    chosen = discipline or next(iter(of_players.values()), None)
    if chosen not in (None, *PROFILES):
        raise GameError(f"discipline {discipline!r}: expected one of {', '.join(PROFILES)}, or None")
    wrong = [f"{name} plays {kind}'s singles" for name, kind in of_players.items() if kind != chosen]
    if wrong:
        raise GameError(f"{a} and {b} in {chosen}'s singles: {' and '.join(wrong)}; choose two players of one discipline")
    if variant in PROFILES:
        if chosen not in (None, variant):
            raise GameError(f"{a} and {b} play {chosen}'s singles, and {game} is the game of {variant}'s")
        game, chosen = Origin(folder, None, hidden).name_in(model), variant
    hands = (skill.hand_of(a) or HANDS[0], skill.hand_of(b) or HANDS[0])
    day = None if date is None else day_of(date)
    people = People(players=(a, b), model=game, date=day, discipline=chosen, hands=hands)
    base = _base(game, chosen, opposite=people.opposite)
    threshold = np.stack([_with_skill(base, skill.of_shots(*names, date)) for names in ((a, b), (b, a))])
    return dataclasses.replace(base, threshold=threshold, people=people)


def game_of_people(game: Game, people: tuple[str, str], date: Day = None) -> Game | None:
    """The game of the two people of a real match, as of its day; None where ``game`` is of no model that has their skill."""
    origin = origin_of(game) if game.people is None else None
    if origin is None:
        return None
    try:
        return pair_game(*people, date=date, game=origin.name_in(origin.folder))
    except GameError:
        return None


@functools.lru_cache(maxsize=32)
def _base(game: str, discipline: str | None, *, opposite: bool) -> Game:
    """The tables without skill: of a model or a refit, in one discipline if the model tells them apart."""
    tables, (folder, variant, _) = load_game(game), origin_named(game)
    recovery = tables.recovery
    if discipline in variants(folder):
        model, profile = game_of(Origin(folder)), game_of(Origin(folder, discipline))
        tables = profile if variant is None else moved(tables, steps_between(model, profile), profile.fault_odds)
    return dataclasses.replace(between_hands(tables, folder) if opposite else tables, recovery=recovery)


def _with_skill(base: Game, offset: F64) -> U16:
    """Thresholds of strokes whose log-odds differ by ``[3, 13]`` offsets of success, return and contact, by shot type."""
    # Tables hold faults, winners and contacts below: the last two are what is not returned, and not met above.
    towards = np.array([1.0, -1.0, -1.0])[:, None]
    steps: I64 = np.rint(towards * offset.clip(-_LARGEST, _LARGEST) / STEP).astype(np.int64)
    of_pair = base.catalogue.shot[base.base_pair_stroke]
    up, down = (odds[:, of_pair] for odds in odds_of_steps(steps, step=STEP))
    table = with_odds(base, up, down).threshold.copy()
    # A stroke that ends rallies in the average game still does; else exact values would have no error bound.
    table[:, 1:] = np.maximum(table[:, 1:], (base.threshold[:, 1:2] > 0).astype(np.uint16))
    return frozen(table)
