"""Baselines of ``exploit`` from Stable-Baselines3 and sb3-contrib, with the settings of those libraries."""

from pathlib import Path

from shuttle_marl.suite.exploit import PlayerSetting, Trained
from shuttle_marl.suite.options import SuiteError

_ENVS = 16


def maskable_ppo(setting: PlayerSetting) -> Trained:
    """PPO with invalid action masking (Huang & Ontañón 2022, arXiv 2006.14171), of sb3-contrib."""
    try:
        from sb3_contrib import MaskablePPO  # noqa: PLC0415
        from stable_baselines3.common.env_util import make_vec_env  # noqa: PLC0415
    except ModuleNotFoundError as error:
        raise SuiteError("maskable-ppo needs sb3-contrib: `pip install sb3-contrib`") from error

    # Rollouts of 128 strokes of each environment; the last one may not pass the budget.
    steps = min(128, setting.budget // _ENVS)
    strokes = setting.budget // (steps * _ENVS) * steps * _ENVS
    options = {"opponent": setting.opponent or "bc", "game": setting.game, "mask": "info", "render_mode": None}
    envs = make_vec_env("shuttle_marl:shuttle_marl/Rally-v0", _ENVS, seed=setting.seed, env_kwargs=options)
    agent = MaskablePPO("MlpPolicy", envs, n_steps=steps, batch_size=256, gamma=1.0, seed=setting.seed, device="cpu")
    agent.learn(strokes)
    path = Path(setting.folder) / "agent.zip"
    agent.save(path)
    return Trained(player=f"sb3:{path}", strokes=int(agent.num_timesteps))
