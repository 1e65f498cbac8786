"""The live 3D court: a page to watch, analyse and play matches, and its server. See ``docs/watch.md``.

The server plays (:mod:`~shuttle_marl.court.match`), stages and evaluates; the page under ``page/`` draws what it receives and
contains no rules of the game.
"""

from shuttle_marl.base.errors import ShuttleError

__all__ = ["WatchError"]


class WatchError(ShuttleError):
    """A match, rally or request that cannot be answered, or an invalid option."""
