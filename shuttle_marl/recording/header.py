"""What stands at the head of a rally log, and what its rallies can be played again from."""

import dataclasses
import hashlib
import json
from typing import Any, Final

import numpy as np

from shuttle_marl import __version__, draws
from shuttle_marl.recording.schema import VERSION, DamagedLogError, Rallies, RecordingError
from shuttle_marl.scoring import BWF, Rules

METADATA: Final = "shuttle_marl.rally_log"
"""Name of the MCAP metadata record that holds the header."""


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
        game: hash of the game, see :attr:`shuttle_marl.rally.Game.hash`.
        strokes: names of the catalogue, by number.
        policies: who played, by number.
        pairings: key of each pairing, by number, from 0 up to 2^64; names its draws.
        matches_per_draw: this many matches of a pairing, one after the other, share the draws of rallies that have the same
            number and the same seat serving.
        rules: when games and matches were won.
        software: what wrote the log.
    """

    seed: int
    game: str
    strokes: tuple[str, ...]
    policies: tuple[Player, ...]
    pairings: tuple[int, ...]
    matches_per_draw: int = 2
    rules: Rules = BWF
    software: str = f"shuttle_marl {__version__}"

    def rally_key(self, rallies: Rallies) -> draws.UInt64s:
        """``[R]`` key of the draws of each rally, see :mod:`shuttle_marl.draws`; the counter is the stroke, from 0."""
        keys = np.array(self.pairings, dtype=np.uint64)[rallies.pairing]
        match, rally = rallies.match.astype(np.int64), rallies.rally.astype(np.int64)
        return draws.stream(self.seed, keys, match // self.matches_per_draw, 2 * rally + rallies.server)

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
            fields["strokes"], fields["pairings"] = tuple(fields["strokes"]), tuple(fields["pairings"])
            return cls(**fields)
        except (TypeError, ValueError, KeyError, AttributeError) as error:
            raise RecordingError(f"its header is none of version {VERSION} ({error})") from error
