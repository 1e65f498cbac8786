"""The live 3D court: a page to watch, analyse and play rallies, and the server behind it. See ``docs/watch.md``.

The server plays (:mod:`~shuttle_marl.watch.match`), stages and measures; the page under ``page/`` draws what it is sent, and
holds no rules of the game.
"""

from shuttle_marl.errors import ShuttleError

__all__ = ["WatchError"]


class WatchError(ShuttleError):
    """A match, a rally or a request that cannot be shown, or an unknown option."""
