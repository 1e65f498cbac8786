"""Training: PPO, A2C and SAC on TorchRL, against fixed opponents or in self-play. See ``docs/training.md``.

Names are imported lazily, because PyTorch is slow to import.
"""

from typing import TYPE_CHECKING

from shuttle_marl.base.extras import hinted, lazily

if TYPE_CHECKING:
    from shuttle_marl.training.config import A2CConfig, PPOConfig, SACConfig, TrainingConfig, TrainingError
    from shuttle_marl.training.networks import agent_network
    from shuttle_marl.training.run import Evaluation, Evaluator, train, train_seeds

__all__ = [
    "A2CConfig",
    "Evaluation",
    "Evaluator",
    "PPOConfig",
    "SACConfig",
    "TrainingConfig",
    "TrainingError",
    "agent_network",
    "train",
    "train_seeds",
]

_load, __dir__ = lazily(__name__)
__getattr__ = hinted()(_load)
