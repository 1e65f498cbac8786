"""Baselines of ``robust``: exact solutions of the game, of its refits together, and of their mean."""

import dataclasses

import numpy as np

from shuttle_marl.exact import solve, solve_robust
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.suite.robust import RobustSetting


def minimax_robust(setting: RobustSetting) -> TabulatedPolicy:
    """Best worst case over the game and the given refits (Iyengar 2005; Nilim & El Ghaoui 2005)."""
    return solve_robust([setting.game, *setting.refits]).policy


def mean_game(setting: RobustSetting) -> TabulatedPolicy:
    """Perfect play of the mean of the game and the given refits (domain randomisation, Tobin et al. 2017, arXiv 1703.06907)."""
    games = [setting.game, *setting.refits]
    threshold = np.rint(np.mean([game.threshold for game in games], axis=0)).astype(np.uint16)
    hurry = np.rint(np.mean([game.hurry for game in games], axis=0)).astype(np.uint8)
    policy = solve(dataclasses.replace(setting.game, threshold=threshold, hurry=hurry)).policy[0]
    return TabulatedPolicy(game=setting.game, cumulative=policy.cumulative)


def human(setting: RobustSetting, argument: str = "0.05") -> str:  # noqa: ARG001
    """Strong play at a cost for each nat away from bc; the argument is the cost."""
    return f"human:{argument}"
