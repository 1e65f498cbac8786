"""Cache of exact odds in the user's cache folder.

A tournament of 17 solves 153 pairs, most of which the last tournament solved too. The key of a result is a hash of the game, both
policies, the tolerance, and the source code of the solvers. A damaged or unwritable cache only costs time.
"""

import contextlib
import dataclasses
import functools
import hashlib
import logging
import sqlite3
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final, TypeVar

from shuttle_marl.base.cluster import in_threads
from shuttle_marl.base.files import cache_folder
from shuttle_marl.exact.fixed_point import TOLERANCE
from shuttle_marl.exact.match import Odds
from shuttle_marl.exact.optimal import best_response, restricted_response, restricted_value
from shuttle_marl.exact.profile import Crossplay, crossplay_by, odds_of_pairs
from shuttle_marl.exact.version import solvers_hash
from shuttle_marl.game.tabulated import TabulatedPolicy

Pair = tuple[TabulatedPolicy, TabulatedPolicy]
T = TypeVar("T")

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

    Raises:
        ExactError: play may never end.
    """
    # A pair and its reverse are one problem.
    ordered = [(a, b) if (a.hash, a.game.hash) <= (b.hash, b.game.hash) else (b, a) for a, b in pairs]
    keys = [_key("pair", a.game.hash, b.game.hash, a.hash, b.hash, repr(tolerance)) for a, b in ordered]

    def solve(missing: list[Pair]) -> list[Odds]:
        used = {id(policy): policy for pair in missing for policy in pair}
        index = {key: i for i, key in enumerate(used)}
        numbers = [(index[id(a)], index[id(b)]) for a, b in missing]
        return [odds for odds, _ in odds_of_pairs(list(used.values()), numbers, tolerance=tolerance)]

    found = zip(pairs, ordered, _cached(keys, ordered, solve), strict=True)
    return [odds if pair[0] is first else _swapped(odds) for pair, (first, _), odds in found]


def _swapped(odds: Odds) -> Odds:
    """The odds of the other player."""
    return Odds(serving=1 - odds.receiving, receiving=1 - odds.serving, error_bound=odds.error_bound)


def crossplay(
    policies: Sequence[TabulatedPolicy], opponents: Sequence[TabulatedPolicy] | None = None, *, tolerance: float = TOLERANCE
) -> Crossplay:
    """:func:`shuttle_marl.exact.crossplay` of tabulated policies, with the cache."""

    def solve(everyone: list[TabulatedPolicy], pairs: list[tuple[int, int]]) -> list[tuple[Odds, Odds]]:
        found = pair_odds([(everyone[i], everyone[j]) for i, j in pairs], tolerance=tolerance)
        return [(odds, odds if i == j else _swapped(odds)) for (i, j), odds in zip(pairs, found, strict=True)]

    return crossplay_by(solve, policies, opponents)


def best_odds(policies: Sequence[TabulatedPolicy], *, tolerance: float = TOLERANCE) -> list[Odds]:
    """Odds of the best response to each policy against that policy.

    Args:
        policies: each of one game.

    Raises:
        ExactError: play may never end.
    """

    def solve(policy: TabulatedPolicy) -> Odds:
        return best_response(policy, tolerance=tolerance).value.odds()

    keys = [_key("best response", p.game.opposite.hash, p.game.hash, p.hash, repr(tolerance)) for p in policies]
    return _cached(keys, policies, lambda missing: in_threads(solve, missing))


def restricted_odds(
    pairs: Sequence[tuple[TabulatedPolicy | None, TabulatedPolicy]], p: float, *, tolerance: float = TOLERANCE
) -> list[Odds]:
    """Odds of the first policy of each pair against the second, restricted as for :func:`shuttle_marl.exact.restricted_response`.

    Args:
        pairs: each of one game; None: the restricted response.
        p: probability with which the second policy is played at each stroke.

    Raises:
        ExactError: play may never end.
    """

    def solve(pair: tuple[TabulatedPolicy | None, TabulatedPolicy]) -> Odds:
        player, opponent = pair
        if player is None:
            return restricted_response(opponent, p, tolerance=tolerance).value.odds()
        return restricted_value(player, opponent, p, tolerance=tolerance).odds()

    keys = [
        _key(f"restricted {p!r}", each.game.hash, "best" if player is None else player.hash, each.hash, repr(tolerance))
        for player, each in pairs
    ]
    return _cached(keys, pairs, lambda missing: in_threads(solve, missing))


def _key(*parts: str) -> bytes:
    return hashlib.sha256(" ".join([*parts, solvers_hash()]).encode()).digest()


def _cached(keys: Sequence[bytes], problems: Sequence[T], solve: Callable[[list[T]], Iterable[Odds]]) -> list[Odds]:
    """Odds of problems by their keys: from the cache, or solved and stored there."""
    by_key = dict(zip(keys, problems, strict=True))
    found = dict(_read(by_key))
    missing = {key: problem for key, problem in by_key.items() if key not in found}
    if missing:
        solved = dict(zip(missing, solve(list(missing.values())), strict=True))
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


def _read(keys: Iterable[bytes]) -> Iterator[tuple[bytes, Odds]]:
    path = _path()
    if path is None:
        return
    try:
        if not path.is_file():
            return
        with _opened(path) as database:
            for key in keys:
                row = database.execute("SELECT numbers FROM result WHERE key = ?", (key,)).fetchone()
                # What is damaged is solved again.
                if row and isinstance(row[0], bytes) and row[0][-4:] == _checksum(key + row[0][:-4]):
                    serving, receiving, bound = _NUMBERS.unpack(row[0][:-4])
                    yield key, Odds(serving=serving, receiving=receiving, error_bound=bound)
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
            numbers = [(key, _NUMBERS.pack(*dataclasses.astuple(odds))) for key, odds in solved.items()]
            rows = [(key, body + _checksum(key + body)) for key, body in numbers]
            database.executemany("INSERT OR REPLACE INTO result VALUES (?, ?)", rows)
            database.execute("DELETE FROM result WHERE rowid <= (SELECT MAX(rowid) FROM result) - ?", (_MOST_RESULTS,))
    except (sqlite3.Error, OSError) as error:
        _warn_once(f"{path}: {error}. Exact odds are recomputed by every command")


def _checksum(content: bytes) -> bytes:
    return zlib.crc32(content).to_bytes(4, "little")


@functools.cache
def _warn_once(message: str) -> None:
    _LOG.warning(message)
