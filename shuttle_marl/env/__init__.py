"""Environments over the rules of :mod:`shuttle_marl.game.rules` and :mod:`shuttle_marl.game.scoring`.

``rally_v0`` and ``match_v0`` are PettingZoo AEC environments; they run on tables and do not import torch.
"""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from shuttle_marl.env import match_v0, rally_v0
    from shuttle_marl.env.wrappers import component_masks

__all__ = ["component_masks", "match_v0", "rally_v0"]

# Imported when first used: PettingZoo takes longer to import than a command's help.
__getattr__, __dir__, _ = lazy_loader.attach(__name__, ["match_v0", "rally_v0"], {"wrappers": ["component_masks"]})
