"""Two-player badminton for multi-agent reinforcement learning, learned from elite matches."""

from typing import TYPE_CHECKING

import lazy_loader

from shuttle_marl.environment_ids import register_when_imported

if TYPE_CHECKING:
    from shuttle_marl.env import match_v0, rally_v0

__version__ = "0.1.0"

__all__ = ["__version__", "match_v0", "rally_v0"]

# The environments are imported when first used, so that ``import shuttle_marl`` does not import PettingZoo.
__getattr__, _, _ = lazy_loader.attach(__name__, submod_attrs={"env": ["match_v0", "rally_v0"]})


def __dir__() -> list[str]:
    return __all__


register_when_imported()
