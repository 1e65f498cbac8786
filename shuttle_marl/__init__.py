"""Two-player badminton for multi-agent reinforcement learning, learned from elite matches.

The public API; ``docs/api.md`` has a line about each name. Everything is imported when first used, so that
``import shuttle_marl`` imports neither numpy nor PettingZoo nor PyTorch.
"""

import sys
from typing import TYPE_CHECKING, Any

from shuttle_marl.base.environment_ids import RegistersLoaded

if TYPE_CHECKING:
    from shuttle_marl.base.errors import ActionError
    from shuttle_marl.data import read_matches, to_df
    from shuttle_marl.dynamics import fit_model, load_models
    from shuttle_marl.env import match_v0, rally_v0
    from shuttle_marl.env.batched import RallyEnv, VersusEnv
    from shuttle_marl.env.wrappers import component_masks
    from shuttle_marl.exact import best_response, crossplay, evaluate, nash_conv, solve
    from shuttle_marl.game import Game, Policy, Rules, Score, States, default_game, load_game, pair_game, tabulate
    from shuttle_marl.game.recovery import POSITIONS
    from shuttle_marl.game.rules import IllegalStrokeError
    from shuttle_marl.game.scoring import match_win_probability
    from shuttle_marl.game.stroke import SHOTS
    from shuttle_marl.kernel import play_matches
    from shuttle_marl.league import LeagueConfig, run_league
    from shuttle_marl.policy import register, resolve
    from shuttle_marl.policy.plain_network import from_network, save_network
    from shuttle_marl.recording import RallyLog, RallyLogWriter
    from shuttle_marl.reports import analyse_rally, report, scouting_report
    from shuttle_marl.training import A2CConfig, PPOConfig, SACConfig, agent_network, train

__version__ = "0.4.0"

__all__ = [
    "POSITIONS",
    "SHOTS",
    "A2CConfig",
    "ActionError",
    "Game",
    "IllegalStrokeError",
    "LeagueConfig",
    "PPOConfig",
    "Policy",
    "RallyEnv",
    "RallyLog",
    "RallyLogWriter",
    "Rules",
    "SACConfig",
    "Score",
    "States",
    "VersusEnv",
    "__version__",
    "agent_network",
    "analyse_rally",
    "best_response",
    "component_masks",
    "crossplay",
    "default_game",
    "evaluate",
    "fit_model",
    "from_network",
    "load_game",
    "load_models",
    "match_v0",
    "match_win_probability",
    "nash_conv",
    "pair_game",
    "play_matches",
    "rally_v0",
    "read_matches",
    "register",
    "report",
    "resolve",
    "run_league",
    "save_network",
    "scouting_report",
    "solve",
    "tabulate",
    "to_df",
    "train",
]


def __getattr__(name: str) -> Any:
    from shuttle_marl.base.errors import did_you_mean  # noqa: PLC0415
    from shuttle_marl.base.extras import hinted, lazily  # noqa: PLC0415

    if name in __all__:
        with hinted():
            return lazily(__name__)[0](name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}{did_you_mean(name, __all__)}")


def __dir__() -> list[str]:
    return __all__


_IDS = RegistersLoaded()
_IDS.find_spec()
sys.meta_path.insert(0, _IDS)
