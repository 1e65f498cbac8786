"""Cache of tables that take seconds to compute, of trained agents and of solved policies, in the user's cache folder.

The name of a file is a hash of everything that its content depends on. Damaged files are replaced; a cache that cannot be written
only costs time.
"""

import contextlib
import functools
import hashlib
import logging
import os
from collections.abc import Callable
from pathlib import Path
from typing import Final

import platformdirs

from shuttle_marl.files import FileWriteError
from shuttle_marl.game.policy import PolicyError
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy

_MOST_TABLES: Final = 48
"""Capacity of the cache; the least recently used tables are evicted."""
_LOG: Final = logging.getLogger(__name__)


def cached_table(game: Game, key: str, compute: Callable[[], TabulatedPolicy]) -> TabulatedPolicy:
    """A table from the cache, or computed and stored there.

    Args:
        game: the tables of the game.
        key: everything that the result depends on besides the game.
        compute: computes the table.
    """
    path = _folder() / f"{hashlib.sha256(f'{game.hash} {key}'.encode()).hexdigest()[:32]}.safetensors"
    with contextlib.suppress(PolicyError):  # missing or damaged
        table = TabulatedPolicy.load(path, game)
        with contextlib.suppress(OSError):
            os.utime(path)
        return table
    table = compute()
    _store(table, path)
    return table


def _folder() -> Path:
    return platformdirs.user_cache_path("shuttle_marl", appauthor=False) / "policies"


def _store(table: TabulatedPolicy, path: Path) -> None:
    """Store a table in the cache, if it can be written."""
    try:
        table.save(path)
    except FileWriteError as error:
        _warn_once(f"{error}. Tables of trained and solved policies are computed again in every process, which takes seconds")
        return
    with contextlib.suppress(OSError):
        tables = sorted(path.parent.glob("*.safetensors"), key=lambda found: found.stat().st_mtime, reverse=True)
        for old in tables[_MOST_TABLES:]:
            old.unlink()


@functools.cache
def _warn_once(message: str) -> None:
    _LOG.warning(message)
