"""Reward shaping: bonuses for shot types, and risk aversion to losing rallies by own faults.

The return of a rally is G = +1 or -1, and -1 - c if it was lost by an own fault, where c is the cost of a fault. With risk
aversion b, the agent minimises the entropic risk measure rho(-G) = log(E exp(-b G)) / b (Föllmer & Schied 2002). G takes three
values only, so this is equivalent to maximising the expected utility u(g) = -exp(-b g), scaled to u(1) = 1 and u(-1) = -1: a
loss by an own fault counts -1 - k, where

    k = 2 (exp(b (1 + c)) - exp(b)) / (exp(b) - exp(-b)),    k = c for b = 0.

Without a cost of faults (c = 0), risk aversion has no effect: minimising the risk of losing maximises the probability of winning.
The reward contains the expected cost, k times the fault probability of the chosen stroke, which has less variance.
"""

import math

import numpy as np

from shuttle_marl.arrays import F32
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.game.thresholds import ONE
from shuttle_marl.training.config import TrainingConfig


def fault_penalty(cost: float, aversion: float) -> float:
    """Penalty k for a fault ``cost`` c >= 0 and a risk ``aversion`` b >= 0: a loss by an own fault counts -1 - k."""
    if aversion == 0:
        return cost
    return 2 * math.exp(aversion) * math.expm1(aversion * cost) / (2 * math.sinh(aversion))


def added_rewards(config: TrainingConfig, game: Game) -> F32:
    """``[L * base pairs]`` bonus and penalty of each stroke, by own effort and base pair."""
    bonus = np.zeros(len(SHOTS))
    for shot, points in config.bonuses().items():
        bonus[SHOTS.index(shot)] = points
    penalty = fault_penalty(config.fault_cost, config.risk_aversion)
    fault = game.limits[..., 0].astype(np.float64) / ONE
    added = bonus[game.catalogue.shot[game.base_pair_stroke]] - penalty * fault
    return added.astype(np.float32).ravel()
