"""Q-networks of :mod:`shuttle_marl.training.q_learning`: DQN for ``exploit``, IQL for ``offline``."""

import dataclasses
from typing import ClassVar

from shuttle_marl.analysis.tabular import greedy
from shuttle_marl.exact.profile import PairPolicy
from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording.logs import Transitions
from shuttle_marl.suite.exploit import PlayerSetting, Trained
from shuttle_marl.suite.offline import LogSetting
from shuttle_marl.suite.options import SuiteError


def dqn(setting: PlayerSetting) -> Trained:
    """Double DQN (Mnih et al. 2015; van Hasselt et al. 2016, arXiv 1509.06461), greedy."""
    from shuttle_marl.training import q_learning  # noqa: PLC0415  torch

    game, name = setting.game, setting.opponent or "bc"
    if game.recovery is not None:
        raise SuiteError("dqn chooses no positions; it plays exploit-entrance-v0")
    config = q_learning.QConfig()
    q = q_learning.deep_q(game, tabulate(resolve(name, game), game), setting.budget, config, setting.seed)
    return Trained(player=greedy(game, q), strokes=setting.budget // config.rows * config.rows)


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
