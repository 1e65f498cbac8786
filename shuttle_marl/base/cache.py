"""The cache of computed things, a database in the user's cache folder; one that is damaged or not writable only costs time.

What the default tournament asks of the shipped policies is in a database of the package too, which ``python -m docs.tools.known``
writes: computed values depend on games and policies alone, within their error bounds, so those are kept whatever the code is.
"""

import contextlib
import contextvars
import functools
import hashlib
import logging
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Final, TypeVar

import platformdirs

from shuttle_marl.base.files import content_hash, verify

NAME: Final = "computed.sqlite"
P = TypeVar("P")
R = TypeVar("R")

KNOWN: Final = Path(__file__).parents[1] / "models" / "known.sqlite"  # by the first bytes of their keys
_OPENED: Final = f"{KNOWN.as_uri()}?mode=ro&immutable=1"
_CONTENT: Final = 32  # bytes of a key that tell what a result is of; the others tell by which code
_ROOMS: Final = ("exact", "game", "kernel", "policy")  # rooms of the code between the tables of a game and a cached result
_WAIT_S: Final = 20.0
_HASH: Final = 64
_LOG: Final = logging.getLogger(__name__)
_MEMORY: Final = contextvars.ContextVar[dict[bytes, bytes] | None]("memory", default=None)  # results, where no database is used


@contextlib.contextmanager
def forgotten() -> Iterator[None]:
    """Context without the database: everything is computed, and kept in memory until the outermost of such contexts ends."""
    token = _MEMORY.set({} if (memory := _MEMORY.get()) is None else memory)
    try:
        yield
    finally:
        _MEMORY.reset(token)


def cache_folder() -> Path | None:
    """The user's folder for caches of this package; None without a home."""
    try:
        folder = platformdirs.user_cache_path("shuttle_marl", appauthor=False)
    except RuntimeError:
        return None
    return folder if folder.is_absolute() else None  # older versions begin with a literal ~


@functools.cache
def _sources_hash(rooms: tuple[str, ...]) -> str:
    sources = sorted(path for room in rooms for path in (Path(__file__).parents[1] / room).rglob("*.py"))
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:16]


def key_of(*parts: str, rooms: tuple[str, ...] = ()) -> bytes:
    """Key of a result of this code; ``parts``: all else that it depends on; ``rooms``: of code, beside those that all need."""
    return hashlib.sha256(" ".join(parts).encode()).digest() + bytes.fromhex(_sources_hash((*_ROOMS, *rooms)))


def known_key(key: bytes) -> bytes:
    """The key of a result in :data:`KNOWN`."""
    return key[:_CONTENT]


class Cache:
    """Results of one kind; ``kind``: name of their table; ``most``: capacity; the oldest results are evicted."""

    def __init__(self, kind: str, most: int) -> None:
        self._kind, self._most = kind, most

    def read(self, keys: Iterable[bytes]) -> dict[bytes, bytes]:
        """The results that are stored undamaged, by key."""
        if (memory := _MEMORY.get()) is not None:
            return {key: memory[key] for key in keys if key in memory}
        wanted, found, folder = list(keys), dict[bytes, bytes](), cache_folder()
        with contextlib.suppress(sqlite3.Error), contextlib.closing(sqlite3.connect(_OPENED, uri=True)) as known:
            found = self._found(known, {known_key(key): key for key in wanted})
        if folder is None or not (missing := {key: key for key in wanted if key not in found}):
            return found
        path = folder / NAME
        try:
            if path.is_file():
                with self._opened(path) as database:
                    found |= self._found(database, missing)
        except (sqlite3.OperationalError, OSError) as error:
            _warn_once(f"{path}: {error}. Results are recomputed")
        except sqlite3.DatabaseError:  # damaged: created again
            with contextlib.suppress(OSError):
                path.unlink()
        return found

    def solved(
        self,
        problems: Mapping[bytes, P],
        solve: Callable[[list[P]], Iterable[R]],
        pack: Callable[[R], bytes],
        unpack: Callable[[bytes], R],
    ) -> dict[bytes, R]:
        """Results of problems by their keys: stored ones, and the others, which are solved together and stored."""
        found = {key: unpack(content) for key, content in self.read(problems).items()}
        missing = {key: problem for key, problem in problems.items() if key not in found}
        if missing:
            new = dict(zip(missing, solve(list(missing.values())), strict=True))
            self.store({key: pack(result) for key, result in new.items()})
            found |= new
        return found

    def _found(self, database: sqlite3.Connection, keys: Mapping[bytes, bytes]) -> dict[bytes, bytes]:
        """Undamaged results, from keys in the database to keys of results."""
        found = {}
        for stored, key in keys.items():
            row = database.execute(f"SELECT content FROM {self._kind} WHERE key = ?", (stored,)).fetchone()
            if row and isinstance(row[0], bytes):
                with contextlib.suppress(ValueError):  # damaged: computed again
                    verify(row[0][:_HASH].decode(), [stored, row[0][_HASH:]])
                    found[key] = row[0][_HASH:]
        return found

    def store(self, results: Mapping[bytes, bytes]) -> None:
        """Store results by key."""
        if (memory := _MEMORY.get()) is not None:
            memory.update(results)
            return
        if (folder := cache_folder()) is None:
            _warn_once("the user has no home folder. Results are recomputed by every command; set XDG_CACHE_HOME to keep them")
            return
        path = folder / NAME
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with self._opened(path) as database, database:
                rows = [(key, content_hash(key, content).encode() + content) for key, content in results.items()]
                database.executemany(f"INSERT OR REPLACE INTO {self._kind} VALUES (?, ?)", rows)
                last = f"(SELECT MAX(rowid) FROM {self._kind})"
                database.execute(f"DELETE FROM {self._kind} WHERE rowid <= {last} - ?", (self._most,))
        except (sqlite3.Error, OSError) as error:
            _warn_once(f"{path}: {error}. Results are recomputed by every command")

    @contextlib.contextmanager
    def _opened(self, path: Path) -> Iterator[sqlite3.Connection]:
        with contextlib.closing(sqlite3.connect(path, timeout=_WAIT_S)) as database:
            database.execute(f"CREATE TABLE IF NOT EXISTS {self._kind} (key BLOB PRIMARY KEY, content BLOB NOT NULL)")
            yield database


@functools.cache
def _warn_once(message: str) -> None:
    _LOG.warning(message)
