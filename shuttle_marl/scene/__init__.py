"""Recorded rallies as scenes for Foxglove and Lichtblick: players, shuttle, score, probabilities. See ``docs/foxglove.md``.

Needs the extra ``scene``.
"""

from shuttle_marl.base.errors import ShuttleError

__all__ = ["SceneError"]


class SceneError(ShuttleError):
    """A scene that cannot be written or drawn, or an unknown option."""
