"""What stands at the head of a rally log, and what its rallies can be played again from."""

import dataclasses
import hashlib
import json
from typing import Any, BinaryIO, Final, Literal, get_args

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Header, Metadata

from shuttle_marl import __version__
from shuttle_marl.game.draws import UInt64s
from shuttle_marl.game.draws import stream as draw_stream
from shuttle_marl.game.scoring import BWF, Rules
from shuttle_marl.recording.container import FRAME, MAGIC, PROFILE, read_record, stream
from shuttle_marl.recording.sampling import Sampling
from shuttle_marl.recording.schema import EXTRA_COLUMNS, VERSION, DamagedLogError, OtherFileError, Rallies, RecordingError

METADATA: Final = "shuttle_marl.rally_log"
"""Name of the MCAP metadata record that holds the header."""
SINGLE_RALLY: Final = Rules(points=1, clear=1, cap=1, games=1)
"""Rules of logs in which every rally stands for itself: a match of one point."""

Draws = Literal["league", "rally_v0", "match_v0", "training", "unknown"]
"""What names the draws of a rally, beside the seed.

``league``: key of the pairing, match // matches_per_draw, 2 x rally + server; ``rally_v0``: match; ``match_v0``: match, rally;
``training``: match, but the key of the pairing takes the place of the seed, because a run names its draws anew now and then;
``unknown``: the draws cannot be made again.
"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Player:
    """A policy that played.

    Attributes:
        name: as the registry knows it.
        hash: SHA-256 of its table, hexadecimal; empty for a policy that has none because it reads the score.
    """

    name: str
    hash: str = ""


@dataclasses.dataclass(frozen=True, kw_only=True)
class LogHeader:
    """What all rallies of a log share.

    Attributes:
        seed: names all draws.
        game: hash of the game, see :attr:`shuttle_marl.game.rally.Game.hash`.
        strokes: names of the catalogue, by number.
        policies: who played, by number.
        pairings: key of each pairing, by number, from 0 up to 2^64; names its draws.
        matches_per_draw: this many matches of a pairing, one after the other, share the draws of rallies that have the same
            number and the same seat serving.
        rules: when games and matches were won.
        draws: what names the draws of a rally, see :data:`Draws`.
        record: which rallies were recorded, see :class:`shuttle_marl.recording.sampling.Sampling`.
        columns: those of :data:`shuttle_marl.recording.schema.EXTRA_COLUMNS` that the log has, in that order.
        software: what wrote the log.
        part: number of this file among those of the log, from 0; logs that differ in this and the next field alone are equal.
        first_rally: number of the first rally of this file.

    Raises:
        RecordingError: a field with a value that it cannot have.
    """

    seed: int
    game: str
    strokes: tuple[str, ...]
    policies: tuple[Player, ...]
    pairings: tuple[int, ...] = (0,)
    matches_per_draw: int = 2
    rules: Rules = BWF
    draws: Draws = "league"
    record: str = "all"
    columns: tuple[str, ...] = ()
    software: str = f"shuttle_marl {__version__}"
    part: int = dataclasses.field(default=0, compare=False)
    first_rally: int = dataclasses.field(default=0, compare=False)

    def __post_init__(self) -> None:
        if self.draws not in get_args(Draws):
            raise RecordingError(f"draws {self.draws!r}: expected {', '.join(get_args(Draws))}")
        if self.columns != tuple(name for name in EXTRA_COLUMNS if name in self.columns):
            raise RecordingError(f"columns {self.columns}: expected some of {EXTRA_COLUMNS}, in that order")
        for name, least, limit in (("matches_per_draw", 1, 1 << 32), ("part", 0, 1 << 31), ("first_rally", 0, 1 << 62)):
            if not least <= getattr(self, name) < limit:
                raise RecordingError(f"{name} {getattr(self, name)}: expected a number from {least} up to {limit}")
        Sampling.parse(self.record)

    def rally_key(self, rallies: Rallies) -> UInt64s:
        """``[R]`` key of the draws of each rally, see :mod:`shuttle_marl.game.draws`; the counter is the stroke, from 0.

        Raises:
            RecordingError: the draws are unknown.
        """
        match, rally = rallies.match.astype(np.int64), rallies.rally.astype(np.int64)
        if self.draws == "league":
            keys = np.array(self.pairings, dtype=np.uint64)[rallies.pairing]
            return draw_stream(self.seed, keys, match // self.matches_per_draw, 2 * rally + rallies.server)
        if self.draws == "rally_v0":
            return draw_stream(self.seed, match)
        if self.draws == "match_v0":
            return draw_stream(self.seed, match, rally)
        if self.draws == "training":
            keys = np.empty(len(rallies), dtype=np.uint64)
            for pairing in np.unique(rallies.pairing):
                mine = rallies.pairing == pairing
                keys[mine] = draw_stream(self.pairings[pairing], match[mine])
            return keys
        raise RecordingError("the draws of this log are unknown")

    def to_metadata(self) -> dict[str, str]:
        """The MCAP metadata record: the header as canonical JSON, its SHA-256 and the version of the schema."""
        text = json.dumps(dataclasses.asdict(self), sort_keys=True, separators=(",", ":"), ensure_ascii=False)
        return {"header": text, "sha256": hashlib.sha256(text.encode()).hexdigest(), "version": str(VERSION)}

    @classmethod
    def from_metadata(cls, metadata: dict[str, str]) -> "LogHeader":
        """Read what :meth:`to_metadata` wrote.

        Raises:
            RecordingError: another version of the schema.
            DamagedLogError: the header is not what was written.
        """
        version = metadata.get("version")
        if version != str(VERSION):
            raise RecordingError(f"schema version {version}, this program reads version {VERSION}; install a fitting one")
        text = metadata.get("header", "")
        if hashlib.sha256(text.encode()).hexdigest() != metadata.get("sha256"):
            raise DamagedLogError("the header, which names policies, strokes and seed")
        try:
            fields: dict[str, Any] = json.loads(text)
            fields["policies"] = tuple(Player(**player) for player in fields["policies"])
            fields["rules"] = Rules(**fields["rules"])
            fields |= {name: tuple(fields[name]) for name in ("strokes", "pairings", "columns")}
            header = cls(**fields)
            _check_types(header)
            return header
        except (TypeError, ValueError, KeyError, AttributeError) as error:
            raise RecordingError(f"its header is none of version {VERSION} ({error})") from error


def _check_types(header: LogHeader) -> None:
    """Raise TypeError for what JSON can hold and a header cannot."""
    names = (header.game, header.record, header.software, *header.strokes, *(p.name for p in header.policies))
    numbers = (header.seed, header.matches_per_draw, header.part, header.first_rally, *header.pairings)
    numbers += dataclasses.astuple(header.rules)
    if not all(isinstance(name, str) for name in names) or not all(type(number) is int for number in numbers):
        raise TypeError("a number where a text is expected, or the other way round")
    if not all(0 <= key < 1 << 64 for key in header.pairings):
        raise ValueError("the key of a pairing is not below 2^64")


def read_header(file: BinaryIO, size: int) -> tuple[LogHeader, int]:
    """The header of a rally log, finished or not, and the byte behind it.

    Raises:
        OtherFileError: this is no rally log.
        RecordingError: it is one of another version.
        DamagedLogError: the header is cut off or damaged.
    """
    file.seek(0)
    if file.read(len(MAGIC)) != MAGIC:
        raise OtherFileError("no rally log: it does not begin as an MCAP file does")
    start = read_record(file, len(MAGIC), size, Opcode.HEADER)
    profile = Header.read(stream(start)).profile
    if profile != PROFILE:
        raise OtherFileError(f"no rally log: an MCAP file of profile {profile!r}, expected {PROFILE!r}")
    at = len(MAGIC) + FRAME.size + len(start)
    body = read_record(file, at, size, Opcode.METADATA)
    metadata = Metadata.read(stream(body))
    if metadata.name != METADATA:
        raise DamagedLogError("the header is missing")
    return LogHeader.from_metadata(metadata.metadata), at + FRAME.size + len(body)
