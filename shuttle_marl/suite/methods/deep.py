"""Networks of :mod:`shuttle_marl.training.q_learning` that learn from a log."""

import dataclasses
from typing import ClassVar

from shuttle_marl.analysis.tabular import greedy
from shuttle_marl.exact.profile import PairPolicy
from shuttle_marl.recording.logs import Transitions
from shuttle_marl.suite.offline import LogSetting


@dataclasses.dataclass(frozen=True)
class ImplicitQ:
    """Implicit Q-learning (Kostrikov et al. 2022, arXiv 2110.06169); the argument is the inverse temperature."""

    setting: LogSetting
    argument: str = "10"
    track: ClassVar[str] = "own"

    def fit(self, data: Transitions) -> PairPolicy:
        """The likeliest stroke of the policy."""
        from shuttle_marl.training import q_learning  # noqa: PLC0415  torch

        rows = q_learning.Transitions(data.state, data.stroke, data.reward, data.following)
        config = q_learning.QConfig(beta=float(self.argument))
        return greedy(data.game, q_learning.implicit_q(data.game, rows, config, self.setting.seed))
