"""Training: PPO, A2C and SAC on TorchRL, against fixed opponents or in self-play. See ``docs/training.md``.

Names are imported when first used, because PyTorch takes longer to import than a command's help.
"""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from shuttle_marl.training.a2c import A2CConfig
    from shuttle_marl.training.config import TrainingConfig, TrainingError
    from shuttle_marl.training.evaluation import Evaluation, Evaluator
    from shuttle_marl.training.ppo import PPOConfig
    from shuttle_marl.training.run import TrainingRun, train
    from shuttle_marl.training.sac import SACConfig

__all__ = [
    "A2CConfig",
    "Evaluation",
    "Evaluator",
    "PPOConfig",
    "SACConfig",
    "TrainingConfig",
    "TrainingError",
    "TrainingRun",
    "train",
]

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "a2c": ("A2CConfig",),
        "config": ("TrainingConfig", "TrainingError"),
        "evaluation": ("Evaluation", "Evaluator"),
        "ppo": ("PPOConfig",),
        "run": ("TrainingRun", "train"),
        "sac": ("SACConfig",),
    },
)
