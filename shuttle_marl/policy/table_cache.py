"""Tables of policies that take seconds to make, in the user's cache folder: of trained agents and of solved policies.

A file is named by all that decides its content. A damaged one is made again; a folder that cannot be written costs time and
nothing else.
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

_KEPT: Final = 48
"""Tables in the cache; those that were not played for the longest time make room for others."""
_LOG: Final = logging.getLogger(__name__)


def cached_table(game: Game, decided_by: str, make: Callable[[], TabulatedPolicy]) -> TabulatedPolicy:
    """A table from the cache, or made and kept there.

    Args:
        game: that the policy plays.
        decided_by: all that decides the table beside the game.
        make: makes it.
    """
    path = _folder() / f"{hashlib.sha256(f'{game.hash} {decided_by}'.encode()).hexdigest()[:32]}.safetensors"
    with contextlib.suppress(PolicyError):  # not there, or damaged: made again
        table = TabulatedPolicy.load(path, game)
        with contextlib.suppress(OSError):
            os.utime(path)
        return table
    table = make()
    _keep(table, path)
    return table


def _folder() -> Path:
    return platformdirs.user_cache_path("shuttle_marl", appauthor=False) / "policies"


def _keep(table: TabulatedPolicy, path: Path) -> None:
    """Keep a table in the cache, if it can be written."""
    try:
        table.save(path)
    except FileWriteError as error:
        _say_once(f"{error}. Tables of trained and solved policies are made again in every process, which takes seconds")
        return
    with contextlib.suppress(OSError):
        tables = sorted(path.parent.glob("*.safetensors"), key=lambda found: found.stat().st_mtime, reverse=True)
        for old in tables[_KEPT:]:
            old.unlink()


@functools.cache
def _say_once(message: str) -> None:
    _LOG.warning(message)
