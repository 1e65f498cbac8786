"""Policies by name, those that come with the package, and scores of a policy.

Names are imported when first used, because what measures policies needs numba.
"""

from typing import TYPE_CHECKING

from shuttle_marl.base.extras import lazily

if TYPE_CHECKING:
    from shuttle_marl.policy.baselines import ScriptedPolicy
    from shuttle_marl.policy.foreign import FunctionPolicy
    from shuttle_marl.policy.plain_network import NetworkPolicy, from_network, save_network
    from shuttle_marl.policy.registry import Family, names, register, resolve, resolve_recorded
    from shuttle_marl.policy.scorecard import Scorecard, Scorer

__all__ = [
    "Family",
    "FunctionPolicy",
    "NetworkPolicy",
    "Scorecard",
    "Scorer",
    "ScriptedPolicy",
    "from_network",
    "names",
    "register",
    "resolve",
    "resolve_recorded",
    "save_network",
]

__getattr__, __dir__ = lazily(__name__)
