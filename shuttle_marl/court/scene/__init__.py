"""Recorded rallies as scenes for Foxglove and Lichtblick: players, shuttle, score, probabilities. See ``docs/foxglove.md``.

Needs the extra ``scene``, whose libraries are imported when a function is first used.
"""

from typing import TYPE_CHECKING

from shuttle_marl.base.extras import lazily

if TYPE_CHECKING:
    from shuttle_marl.court.scene.write import select, write_scene

__all__ = ["select", "write_scene"]

__getattr__, __dir__ = lazily(__name__)
