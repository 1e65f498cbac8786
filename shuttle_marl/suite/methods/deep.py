"""Q-networks of :mod:`shuttle_marl.training.q_learning`: DQN for ``exploit``, CQL and IQL for ``offline``.

The argument is the weight of the penalty of CQL, or the inverse temperature of IQL.
"""

import dataclasses
from typing import Any, ClassVar

from shuttle_marl.analysis.tabular import greedy
from shuttle_marl.exact.profile import PairPolicy
from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording.logs import Transitions
from shuttle_marl.suite.exploit import PlayerSetting, Trained
from shuttle_marl.suite.offline import LogSetting


def dqn(setting: PlayerSetting) -> Trained:
    """Double DQN (Mnih et al. 2015; van Hasselt et al. 2016, arXiv 1509.06461), greedy."""
    from shuttle_marl.training import q_learning  # noqa: PLC0415  torch

    game, name = setting.game, setting.opponent or "bc"
    config = q_learning.QConfig()
    q = q_learning.deep_q(game, tabulate(resolve(name, game), game), setting.budget, config, setting.seed)
    return Trained(player=greedy(game, q), strokes=setting.budget // config.rows * config.rows)


@dataclasses.dataclass(frozen=True)
class ConservativeQ:
    """Conservative Q-learning (Kumar et al. 2020, arXiv 2006.04779)."""

    setting: LogSetting
    argument: str = "5"
    track: ClassVar[str] = "own"
    learner: ClassVar[tuple[str, str]] = "conservative_q", "alpha"
    """Function of :mod:`shuttle_marl.training.q_learning`, and the option that is the argument."""

    def fit(self, data: Transitions) -> PairPolicy:
        """Greedy in the Q-values, or the likeliest stroke of the policy."""
        from shuttle_marl.training import q_learning  # noqa: PLC0415  torch

        function, option = self.learner
        rows = q_learning.Transitions(data.state, data.stroke, data.reward, data.following)
        options: dict[str, Any] = {option: float(self.argument)}
        return greedy(data.game, getattr(q_learning, function)(data.game, rows, q_learning.QConfig(**options), self.setting.seed))


@dataclasses.dataclass(frozen=True)
class ImplicitQ(ConservativeQ):
    """Implicit Q-learning (Kostrikov et al. 2022, arXiv 2110.06169)."""

    argument: str = "10"
    learner: ClassVar[tuple[str, str]] = "implicit_q", "beta"
