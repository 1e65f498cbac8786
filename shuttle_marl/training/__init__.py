"""Training: PPO, A2C and SAC on TorchRL, against fixed opponents or in self-play. See ``docs/training.md``.

Names are imported when first used, because PyTorch takes longer to import than a command's help.
"""

import importlib
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from shuttle_marl.training.agents import load_agent
    from shuttle_marl.training.config import A2CConfig, PPOConfig, SACConfig, TrainingConfig, TrainingError
    from shuttle_marl.training.evaluation import Evaluation, Evaluator
    from shuttle_marl.training.run import TrainingRun, train

__all__ = [
    "A2CConfig",
    "Evaluation",
    "Evaluator",
    "PPOConfig",
    "SACConfig",
    "TrainingConfig",
    "TrainingError",
    "TrainingRun",
    "load_agent",
    "train",
]

_MODULES: Final = {
    "agents": ("load_agent",),
    "config": ("A2CConfig", "PPOConfig", "SACConfig", "TrainingConfig", "TrainingError"),
    "evaluation": ("Evaluation", "Evaluator"),
    "run": ("TrainingRun", "train"),
}
_HOME: Final = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(f"shuttle_marl.training.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
