"""Cache of exact odds in the user's cache folder.

A tournament of 17 solves 153 pairs, most of which the last tournament solved too. The key of a result is a hash of the game, both
policies, the tolerance, and the source code of the solvers. A damaged or unwritable cache only costs time.
"""

import contextlib
import functools
import hashlib
import logging
import sqlite3
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from shuttle_marl.base.cluster import in_threads
from shuttle_marl.base.files import cache_folder
from shuttle_marl.exact.fixed_point import TOLERANCE
from shuttle_marl.exact.match import Odds
from shuttle_marl.exact.optimal import best_response, restricted_response, restricted_value
from shuttle_marl.exact.profile import Crossplay, odds_of_pairs
from shuttle_marl.exact.version import solvers_hash
from shuttle_marl.game.tabulated import TabulatedPolicy

Pair = tuple[TabulatedPolicy, TabulatedPolicy]

_MOST_RESULTS: Final = 200_000
"""Capacity of the cache, about 20 MB; the oldest results are evicted."""
_WAIT_S: Final = 20.0
"""Timeout while another process writes [s]."""
_NUMBERS: Final = struct.Struct("<3d")
_LOG: Final = logging.getLogger(__name__)


def pair_odds(pairs: Sequence[Pair], *, tolerance: float = TOLERANCE) -> list[Odds]:
    """Odds of the first policy of each pair against the second; unknown pairs are solved on all cores.

    Args:
        pairs: each of one game, or of both tables of the game of a pair.
        tolerance: largest acceptable error bound of a value.

    Raises:
        ExactError: play may never end.
    """
    # A pair and its reverse are one problem.
    ordered = [(a, b) if (a.hash, a.game.hash) <= (b.hash, b.game.hash) else (b, a) for a, b in pairs]
    keys = [_key("pair", a.game.hash, b.game.hash, a.hash, b.hash, repr(tolerance)) for a, b in ordered]
    missing = dict(zip(keys, ordered, strict=True))

    def solve(wanted: Sequence[bytes]) -> list[Odds]:
        used = {id(policy): policy for key in wanted for policy in missing[key]}
        index = {key: i for i, key in enumerate(used)}
        numbers = [(index[id(a)], index[id(b)]) for a, b in (missing[key] for key in wanted)]
        return [odds for odds, _ in odds_of_pairs(list(used.values()), numbers, tolerance=tolerance)]

    found = zip(pairs, ordered, _cached(keys, solve), strict=True)
    return [odds if pair[0] is first else _swapped(odds) for pair, (first, _), odds in found]


def _swapped(odds: Odds) -> Odds:
    """The odds of the other player."""
    return Odds(serving=1 - odds.receiving, receiving=1 - odds.serving, error_bound=odds.error_bound)


def crossplay(
    policies: Sequence[TabulatedPolicy], opponents: Sequence[TabulatedPolicy] | None = None, *, tolerance: float = TOLERANCE
) -> Crossplay:
    """:func:`shuttle_marl.exact.crossplay` of tabulated policies, with the cache."""
    n, m = len(policies), len(policies if opponents is None else opponents)
    rows, columns = (index.ravel() for index in (np.triu_indices(n) if opponents is None else np.indices((n, m))))
    pairs = [(policies[i], (opponents or policies)[j]) for i, j in zip(rows.tolist(), columns.tolist(), strict=True)]
    found = pair_odds(pairs, tolerance=tolerance)
    serving, receiving = np.empty((n, m)), np.empty((n, m))
    if opponents is None:
        serving[columns, rows] = [1 - odds.receiving for odds in found]
    serving[rows, columns] = [odds.serving for odds in found]
    if opponents is None:
        receiving = 1 - serving.T
    else:
        receiving[rows, columns] = [odds.receiving for odds in found]
    return Crossplay(serving=serving, receiving=receiving, error_bound=max((odds.error_bound for odds in found), default=0.0))


def best_odds(policies: Sequence[TabulatedPolicy], *, tolerance: float = TOLERANCE) -> list[Odds]:
    """Odds of the best response to each policy against that policy.

    Args:
        policies: each of one game.
        tolerance: largest acceptable error bound of a value.

    Raises:
        ExactError: play may never end.
    """
    keys = [_key("best response", p.game.opposite.hash, p.game.hash, p.hash, repr(tolerance)) for p in policies]
    by_key = dict(zip(keys, policies, strict=True))

    def solve(wanted: Sequence[bytes]) -> list[Odds]:
        return list(in_threads(lambda key: best_response(by_key[key], tolerance=tolerance).value.odds(), wanted))

    return _cached(keys, solve)


def restricted_odds(
    pairs: Sequence[tuple[TabulatedPolicy | None, TabulatedPolicy]], p: float, *, tolerance: float = TOLERANCE
) -> list[Odds]:
    """Odds of the first policy of each pair against the second, restricted as for :func:`shuttle_marl.exact.restricted_response`.

    Args:
        pairs: each of one game; None: the restricted response.
        p: probability with which the second policy is played at each stroke.
        tolerance: largest acceptable error bound of a value.

    Raises:
        ExactError: play may never end.
    """
    keys = [
        _key(f"restricted {p!r}", each.game.hash, "best" if player is None else player.hash, each.hash, repr(tolerance))
        for player, each in pairs
    ]
    by_key = dict(zip(keys, pairs, strict=True))

    def value(key: bytes) -> Odds:
        player, opponent = by_key[key]
        if player is None:
            return restricted_response(opponent, p, tolerance=tolerance).value.odds()
        return restricted_value(player, opponent, p, tolerance=tolerance).odds()

    def solve(wanted: Sequence[bytes]) -> list[Odds]:
        return list(in_threads(value, wanted))

    return _cached(keys, solve)


def _key(*parts: str) -> bytes:
    return hashlib.sha256(" ".join([*parts, solvers_hash()]).encode()).digest()


def _cached(keys: Sequence[bytes], solve: Callable[[Sequence[bytes]], list[Odds]]) -> list[Odds]:
    """Odds by key: from the cache, or solved and stored there."""
    found = dict(_read(list(dict.fromkeys(keys))))
    missing = [key for key in dict.fromkeys(keys) if key not in found]
    if missing:
        solved = dict(zip(missing, solve(missing), strict=True))
        _store(solved)
        found |= solved
    return [found[key] for key in keys]


def _path() -> Path | None:
    folder = cache_folder()
    return None if folder is None else folder / "odds.sqlite"


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[sqlite3.Connection]:
    with contextlib.closing(sqlite3.connect(path, timeout=_WAIT_S)) as database:
        database.execute("CREATE TABLE IF NOT EXISTS result (key BLOB PRIMARY KEY, numbers BLOB NOT NULL)")
        yield database


def _read(keys: Sequence[bytes]) -> Iterator[tuple[bytes, Odds]]:
    path = _path()
    if path is None:
        return
    try:
        if not path.is_file():
            return
        with _opened(path) as database:
            for key in keys:
                row = database.execute("SELECT numbers FROM result WHERE key = ?", (key,)).fetchone()
                if row and (odds := _unpacked(key, row[0])) is not None:
                    yield key, odds
    except (sqlite3.OperationalError, OSError) as error:
        _warn_once(f"{path}: {error}. Exact odds are recomputed")
    except sqlite3.DatabaseError:  # damaged: created again
        with contextlib.suppress(OSError):
            path.unlink()


def _store(solved: dict[bytes, Odds]) -> None:
    path = _path()
    if path is None:
        _warn_once("the user has no home folder. Exact odds are recomputed by every command; set XDG_CACHE_HOME to keep them")
        return
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with _opened(path) as database, database:
            rows = [(key, _packed(key, odds)) for key, odds in solved.items()]
            database.executemany("INSERT OR REPLACE INTO result VALUES (?, ?)", rows)
            database.execute("DELETE FROM result WHERE rowid <= (SELECT MAX(rowid) FROM result) - ?", (_MOST_RESULTS,))
    except (sqlite3.Error, OSError) as error:
        _warn_once(f"{path}: {error}. Exact odds are recomputed by every command")


def _packed(key: bytes, odds: Odds) -> bytes:
    body = _NUMBERS.pack(odds.serving, odds.receiving, odds.error_bound)
    return struct.pack("<I", zlib.crc32(key + body)) + body


def _unpacked(key: bytes, packed: object) -> Odds | None:
    """The odds; None if they are damaged."""
    if not isinstance(packed, bytes) or len(packed) != 4 + _NUMBERS.size:
        return None
    (crc,), body = struct.unpack("<I", packed[:4]), packed[4:]
    if crc != zlib.crc32(key + body):
        return None
    serving, receiving, bound = _NUMBERS.unpack(body)
    return Odds(serving=serving, receiving=receiving, error_bound=bound)


@functools.cache
def _warn_once(message: str) -> None:
    _LOG.warning(message)
