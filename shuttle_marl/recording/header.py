"""Header of a rally log: game, policies, and seed."""

import dataclasses
import json
from typing import Final, Literal

import msgspec
import numpy as np

from shuttle_marl import __version__
from shuttle_marl.base.arrays import U64
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import seal, unsealed
from shuttle_marl.game.draws import extend
from shuttle_marl.game.draws import stream as draw_stream
from shuttle_marl.game.pairs import Looks, looks_of, pair_game
from shuttle_marl.game.rally import OPTIONAL, Rallies
from shuttle_marl.game.scoring import BWF, Rules
from shuttle_marl.game.shipped import shipped_game
from shuttle_marl.game.tables import Game

VERSION: Final = 4  # version of the columns and the header of a log
SINGLE_RALLY: Final = Rules(points=1, clear=1, cap=1, games=1)  # rules of logs of single rallies: each is a match of one point

MAX_NAME: Final = 1000  # limit of the names of policies and strokes [characters]: tables of rallies repeat them in every row

Draws = Literal["league", "rally_v0", "match_v0", "training", "unknown"]
"""Numbers from which the draws of a rally follow, with the seed.

``league``: key of the pairing, match // matches_per_draw, 2 x rally + server; ``rally_v0``: match; ``match_v0``: match, rally;
both with the episode instead of the match where each rally has a seed and an episode; ``training``: match, with the key of the
pairing as the seed, because a run is reseeded at each checkpoint; ``unknown``: the draws cannot be reproduced.
"""


class RecordingError(ShuttleError):
    """A log that cannot be written, or a file that is not a rally log of this version."""


class DamagedLogError(RecordingError):
    """A rally log that is truncated or damaged."""


class OtherFileError(RecordingError):
    """A file that is not a rally log."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Player:
    """A policy that played."""

    name: str
    hash: str = ""  # hexadecimal SHA-256 of its table; empty if it has no table because it reads the score


@dataclasses.dataclass(frozen=True, kw_only=True)
class Pair:
    """The players whose skill the seats have."""

    players: tuple[str, str]
    date: str | None = None  # day of their skill in ISO 8601; None: the last one known
    discipline: str | None = None  # `men` or `women`; None: the average of both

    @classmethod
    def of(cls, game: Game) -> "Pair | None":
        """The players of a game; None if it is not that of a pair."""
        if (people := game.people) is None:
            return None
        return cls(players=people.players, date=None if people.date is None else str(people.date), discipline=people.discipline)

    def game(self, model: str = "default") -> Game:
        """The game of these players in a model."""
        return pair_game(*self.players, date=self.date, discipline=self.discipline, game=model)


@dataclasses.dataclass(frozen=True, kw_only=True)
class LogHeader:
    """Properties that all rallies of a log share.

    Attributes:
        game: hash of the game, see :attr:`shuttle_marl.game.tables.Game.hash`, or of the game of a pair.
        strokes: names of the catalogue, by number.
        policies: policies, by number.
        pairings: key of each pairing, by number, from 0 up to 2^64; its draws follow from it.
        matches_per_draw: number of consecutive matches of a pairing with the same draws for rallies of equal number and server.
        rules: when games and matches are won.
        draws: numbers from which the draws of a rally follow, see :data:`Draws`.
        columns: the columns of :data:`shuttle_marl.game.rally.OPTIONAL` in the log, in that order.
        pair: the players whose skill the seats have; None: both seats strike with the same tables.

    Raises:
        RecordingError: an invalid value.
    """

    seed: int
    game: str
    strokes: tuple[str, ...]
    policies: tuple[Player, ...]
    pairings: tuple[int, ...] = (0,)
    matches_per_draw: int = 2
    rules: Rules = BWF
    draws: Draws = "league"
    columns: tuple[str, ...] = ()
    pair: Pair | None = None
    software: str = f"shuttle_marl {__version__}"

    def looks(self, seats: tuple[int, int]) -> Looks:
        """Hands and sexes of the policies at seats 0 and 1, by number; right-handed men where the game is of no shipped model."""
        game = shipped_game(self.game) if self.pair is None else self.pair.game()
        names = self.policies[seats[0]].name, self.policies[seats[1]].name
        return Looks() if game is None else looks_of(game, names)

    def __post_init__(self) -> None:
        players = () if self.pair is None else self.pair.players
        if not all(len(name) <= MAX_NAME for name in (*self.strokes, *(p.name for p in self.policies), *players)):
            raise RecordingError(f"strokes, policies and players: expected names of up to {MAX_NAME} characters")
        if self.columns != tuple(name for name in OPTIONAL if name in self.columns):
            raise RecordingError(f"columns {self.columns}: expected some of {OPTIONAL}, in that order")
        if not 1 <= self.matches_per_draw < 1 << 32:
            raise RecordingError(f"matches_per_draw {self.matches_per_draw}: expected a number from 1 up to {1 << 32}")
        if not all(0 <= key < 1 << 64 for key in self.pairings):
            raise RecordingError("pairings: expected keys from 0 up to 2^64")

    def rally_key(self, rallies: Rallies) -> U64:
        """``[R]`` key of the draws of each rally, see :mod:`shuttle_marl.game.draws`; the counter is the stroke, from 0."""
        match, rally = rallies.match.astype(np.int64), rallies.rally.astype(np.int64)
        keys = np.array(self.pairings, dtype=np.uint64)[rallies.pairing]
        if self.draws == "league":
            return draw_stream(self.seed, keys, match // self.matches_per_draw, 2 * rally + rallies.server)
        if self.draws in ("rally_v0", "match_v0"):
            seeds = self.seed if rallies.seed is None else rallies.seed
            episode = match if rallies.episode is None else rallies.episode.astype(np.int64)
            return draw_stream(seeds, episode, *([rally] if self.draws == "match_v0" else []))
        if self.draws == "training":
            numbers, number = np.unique(rallies.pairing, return_inverse=True)
            seeded = np.concatenate([draw_stream(self.pairings[i]) for i in numbers])
            return extend(seeded[number], match)
        raise RecordingError("the draws of this log are unknown")

    def to_metadata(self) -> dict[str, str]:
        """The MCAP metadata record: the header as sealed JSON, and the version of the schema."""
        fields = dataclasses.asdict(self)
        if self.pair is None:
            del fields["pair"]
        return {"header": seal(fields, indent=None).decode(), "version": str(VERSION)}

    @classmethod
    def from_metadata(cls, metadata: dict[str, str]) -> "LogHeader":
        """Parse the result of :meth:`to_metadata`."""
        version = metadata.get("version")
        if version != str(VERSION):
            other = f"schema version {version}, this program reads version {VERSION}"
            raise RecordingError(f"{other}; install a version of shuttle_marl that reads it")
        try:
            fields = unsealed(metadata.get("header", "").encode())
        except ValueError as error:
            raise DamagedLogError("the header, which names policies, strokes and seed") from error
        try:
            # JSON can hold unpaired surrogates, which UTF-8 and terminals cannot.
            json.dumps(fields, ensure_ascii=False).encode()
            header = msgspec.convert(fields, cls)
            if not header.strokes:
                raise ValueError("no strokes")
            return header
        except (ShuttleError, msgspec.ValidationError, ValueError, RecursionError) as error:
            raise RecordingError(f"its header is not one of version {VERSION} ({error})") from error
