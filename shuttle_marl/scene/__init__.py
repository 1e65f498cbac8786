"""Recorded rallies as scenes for Foxglove and Lichtblick: players, shuttle, score, probabilities. See ``docs/foxglove.md``.

Needs the extra ``scene``, whose libraries are imported when a function is first used.
"""

from typing import TYPE_CHECKING

import lazy_loader

from shuttle_marl.base.errors import ShuttleError

if TYPE_CHECKING:
    from shuttle_marl.scene.write import select, write_scene

__all__ = ["SceneError", "select", "write_scene"]


class SceneError(ShuttleError):
    """A scene that cannot be written or drawn, or an unknown option."""


__getattr__, __dir__, _ = lazy_loader.attach(__name__, submod_attrs={"write": ("select", "write_scene")})
