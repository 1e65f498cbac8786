"""The game of a pair: two players with their skill, each with the tables of their own strokes, over the same states.

The tables of a player's strokes are those of the average game with other odds: those of a fault, of a return and of a contact
above the net are multiplied by the offsets of the striker and of the receiver (:mod:`shuttle_marl.game.skill`). They are computed
in whole numbers, so the game of a pair has the same tables, and the same hash, on every machine.
"""

import dataclasses
import datetime
import functools
import hashlib
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import F64, I32, I64, U8, U16, Ints
from shuttle_marl.game.layout import Layout
from shuttle_marl.game.shipped import PROFILES, load_game, origin_named, origin_of, resolve_game, variants
from shuttle_marl.game.skill import AVERAGE, Day, Skill, day_of, load_skill
from shuttle_marl.game.stroke import frozen
from shuttle_marl.game.tables import Game, GameError, Origin
from shuttle_marl.game.variants import moved, odds_of_steps, steps_between, with_odds

STEP: Final = 2.0**-10
"""Difference of log-odds to which the offsets of a pair are rounded."""
_LARGEST: Final = 4.0
"""Offsets are limited to this difference of log-odds."""
LAYOUT: Final = tuple(field.name for field in dataclasses.fields(Layout))


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class PairGame(Layout):
    """The game of two players; its layout is that of both tables.

    Attributes:
        players: names of the players at seats 0 and 1.
        threshold: ``[base pairs, 3]`` each: thresholds of the strokes of seats 0 and 1, as in :class:`~shuttle_marl.game.Game`.
        hurry: ``[base pairs, 2]`` uint8 chance of a hurried receiver, at both seats.
        fault_odds: ``[L]`` int32 odds of a fault by effort.
        model: the model or variant whose tables the offsets are applied to, by name or folder.
        date: day of the skill; None: the last one known.
        discipline: ``men`` or ``women`` for the tables of that discipline; None: the average of both.
    """

    players: tuple[str, str]
    threshold: tuple[U16, U16]
    hurry: U8
    fault_odds: I32
    model: str
    date: datetime.date | None
    discipline: str | None

    def __repr__(self) -> str:
        return f"PairGame(players={self.players}, hash={self.hash[:12]!r}, date={self.date}, discipline={self.discipline!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        return _pickled, (*self.players, self.date, self.discipline, self.model, self.hash)

    def __deepcopy__(self, memo: dict[int, Any]) -> "PairGame":
        return self  # nothing in it can be changed

    @property
    def levels(self) -> int:
        """Number of levels of effort L; 1 where effort does not count."""
        return len(self.fault_odds)

    @functools.cached_property
    def seats(self) -> tuple["SeatGame", "SeatGame"]:
        """The tables with which seats 0 and 1 strike."""
        layout = {name: getattr(self, name) for name in LAYOUT}
        first, second = (
            SeatGame(**layout, threshold=threshold, hurry=self.hurry, fault_odds=self.fault_odds, pair_game=self, seat=seat)
            for seat, threshold in enumerate(self.threshold)
        )
        return first, second

    @functools.cached_property
    def hash(self) -> str:
        """SHA-256 over the hashes of both tables, hexadecimal: the version of the game of the pair."""
        return hashlib.sha256(f"pair {self.seats[0].hash} {self.seats[1].hash}".encode()).hexdigest()

    @property
    def title(self) -> str:
        """The players, and the day of their skill, in words."""
        return " against ".join(self.players) + ("" if self.date is None else f" as of {self.date}")

    @functools.cached_property
    def swapped(self) -> "PairGame":
        """The same game with the seats exchanged."""
        return dataclasses.replace(self, players=self.players[::-1], threshold=self.threshold[::-1])

    @property
    def skill(self) -> Skill:
        """Skill of the players of the model.

        Raises:
            GameError: the file of the model is damaged.
        """
        return load_skill(origin_named(self.model).folder)

    def refits(self) -> tuple["PairGame", ...]:
        """The same pair in the refits of the game on resampled matches; none in a refit.

        Raises:
            GameError: a file of the model is damaged.
        """
        folder, variant = origin_named(self.model)
        if variant is not None:
            return ()
        names = [name for name in variants(str(folder)) if name not in PROFILES]
        return tuple(
            pair_game(*self.players, date=self.date, discipline=self.discipline, game=f"{self.model}:{name}") for name in names
        )


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class SeatGame(Game):
    """The tables with which one player of a pair strikes.

    Attributes:
        pair_game: the game of the pair.
        seat: seat of the player.
    """

    pair_game: PairGame
    seat: int

    def __reduce__(self) -> tuple[Any, ...]:
        return _seat, (self.pair_game, self.seat)

    @property
    def origin(self) -> Origin:
        """The model, and the discipline as the variant, for policies of the model."""
        return Origin(origin_named(self.pair_game.model).folder, self.pair_game.discipline or AVERAGE)

    @property
    def profile(self) -> Game:
        """The game of the discipline, without skill, in which imitated players choose as they do here."""
        folder, discipline = self.origin
        return load_game(f"{folder}:{discipline}") if discipline in variants(str(folder)) else self.average

    @property
    def average(self) -> Game:
        """The game of the model, without skill and discipline, whose agents can play this one."""
        return load_game(str(origin_named(self.pair_game.model).folder))

    def meets(self, other: "SeatGame") -> bool:
        """Whether other tables are those of the opponent: of the other player against this one."""
        mine, theirs = self.pair_game.players, other.pair_game.players
        return (mine[self.seat], mine[1 - self.seat]) == (theirs[1 - other.seat], theirs[other.seat])

    @property
    def opposite(self) -> Game:
        """The tables with which the other player of the pair strikes."""
        return self.pair_game.seats[1 - self.seat]


AnyGame = Game | PairGame
"""A game in which both players strike with the same tables, or that of a pair."""


def seat_names(game: AnyGame, policies: tuple[str, str]) -> tuple[str, str]:
    """Names of the seats: of the policies, in the game of a pair behind those of the players whose skill they have."""
    if not isinstance(game, PairGame):
        return policies
    first, second = (
        player if policy in (player, f"bc:{player}") else f"{player} ({policy})"
        for player, policy in zip(game.players, policies, strict=True)
    )
    return first, second


def opponent_tables(game: AnyGame, seat: int | Ints) -> Game:
    """The tables with which the opponent of a learner strikes.

    Args:
        game: the game.
        seat: seat of the learner, or ``[B]`` seats, which are equal in the game of a pair.

    Raises:
        GameError: the seats of the game of a pair differ, because the opponent would be another player in each.
    """
    if not isinstance(game, PairGame):
        return game
    learners = np.unique(seat)
    if len(learners) != 1 or learners[0] not in (0, 1):
        raise GameError(f"seat {seat!r}: in the game of {game.title} expected 0 or 1 for all rows, the player that learns")
    return game.seats[1 - int(learners[0])]


def _seat(pair: PairGame, seat: int) -> SeatGame:
    return pair.seats[seat]


@functools.lru_cache(maxsize=8)
def pair_game(a: str, b: str, *, date: Day = None, discipline: str | None = None, game: str = "default") -> PairGame:
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
    folder, variant = origin_named(game)
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
        game, variant, chosen = game.rpartition(":")[0], None, variant
    base = _base(game, chosen)
    threshold = tuple(_with_skill(base, skill.of_shots(*names, date)) for names in ((a, b), (b, a)))
    return PairGame(
        **{name: getattr(base, name) for name in LAYOUT},
        players=(a, b),
        threshold=(threshold[0], threshold[1]),
        hurry=base.hurry,
        fault_odds=base.fault_odds,
        model=game,
        date=None if date is None else day_of(date),
        discipline=chosen,
    )


def resolve_players(
    game: AnyGame | str | None, profile: str | None, players: tuple[str, str] | None, *, date: Day = None
) -> AnyGame:
    """The game of two players, or :func:`shuttle_marl.game.shipped.resolve_game` without players.

    Args:
        game: a model by name or folder, or its game; None: the default model. The game of a pair is returned as it is.
        profile: a variant of that model, such as ``men``; None: the game itself, or with players that of their discipline.
        players: names of the players at seats 0 and 1; None: both strike with the same tables.
        date: day of the players' skill; None: the last one known.

    Raises:
        GameError: as :func:`pair_game`, or two names are expected, or the game belongs to no model.
    """
    if isinstance(game, PairGame):
        if profile is not None or players is not None:
            raise GameError(f"the game of {game.title} together with players or a profile; give one of them")
        return game
    if players is None:
        return resolve_game(game, profile)
    if isinstance(players, str) or len(players) != 2:
        raise GameError(f"players {players!r}: expected two names, such as ('viktor-axelsen', 'kento-momota')")
    if isinstance(game, Game):
        origin = origin_of(game)
        if origin is None:
            raise GameError("players need a model with their skill; this game was not loaded from one")
        game = str(origin.folder) if origin.variant is None else f"{origin.folder}:{origin.variant}"
    return pair_game(*players, date=date, discipline=profile, game=game or "default")


def game_of_people(game: Game, people: tuple[str, str], date: Day = None) -> PairGame | None:
    """The game of the two people of a real match, as of its day; None where the model of ``game`` does not have their skill."""
    try:
        found = resolve_players(game, None, people, date=date)
    except GameError:
        return None
    assert isinstance(found, PairGame)
    return found


@functools.lru_cache(maxsize=32)
def _base(game: str, discipline: str | None) -> Game:
    """The tables without skill: of a model or a refit, in one discipline if the model tells them apart."""
    tables, (folder, variant) = load_game(game), origin_named(game)
    if discipline not in variants(str(folder)):
        return tables
    model = load_game(str(folder))
    profile = load_game(f"{folder}:{discipline}")
    return profile if variant is None else moved(tables, steps_between(model, profile), profile.fault_odds)


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


def _pickled(a: str, b: str, date: datetime.date | None, discipline: str | None, model: str, value: str) -> PairGame:
    """A pair that was pickled by its names.

    Raises:
        GameError: the model has changed since.
    """
    pair = pair_game(a, b, date=date, discipline=discipline, game=model)
    if pair.hash != value:
        raise GameError(f"{pair.title}: pickled with game {value[:12]}, and the model has {pair.hash[:12]}; make it again")
    return pair
