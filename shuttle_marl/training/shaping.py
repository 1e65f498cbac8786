"""Rewards with a bonus for shot types, and with aversion to losing points by one's own faults.

The return of a rally is G = +1 or -1, and -1 - c where it was lost by an own fault, with c the cost of a
fault. Aversion to risk is the entropic risk measure: the agent minimises rho(-G) = log(E exp(-b G)) / b (Föllmer & Schied 2002)
with b the aversion. As G takes three values only, this is the same as maximising an expected reward with u(g) = -exp(-b g),
scaled so that u(1) = 1 and u(-1) = -1: a loss by an own fault counts -1 - k, where

    k = 2 (exp(b (1 + c)) - exp(b)) / (exp(b) - exp(-b)),    k = c for b = 0.

So without a cost of faults (c = 0) no aversion to risk changes anything: a rally is won or lost, and minimising the
risk of losing is maximising the probability of winning. The cost is charged as its expectation, k times the probability of
a fault of the stroke chosen, which is the same on average and varies less.
"""

import math

import numpy as np

from shuttle_marl.arrays import F32
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.game.thresholds import ONE
from shuttle_marl.training.config import TrainingConfig


def fault_penalty(cost: float, aversion: float) -> float:
    """Penalty k above: a loss by an own fault counts -1 - k.

    Args:
        cost: c, from 0 on.
        aversion: b, from 0 on.
    """
    if aversion == 0:
        return cost
    return 2 * math.exp(aversion) * math.expm1(aversion * cost) / (2 * math.sinh(aversion))


def added_rewards(config: TrainingConfig, game: Game) -> F32:
    """``[L * base pairs]`` what bonus and penalty add to the reward of a stroke, by own effort and base pair.

    Args:
        config: of the run.
        game: the tables.
    """
    bonus = np.zeros(len(SHOTS))
    for shot, points in config.bonuses().items():
        bonus[SHOTS.index(shot)] = points
    penalty = fault_penalty(config.fault_cost, config.risk_aversion)
    fault = game.limits[..., 0].astype(np.float64) / ONE
    added = bonus[game.catalogue.shot[game.base_pair_stroke]] - penalty * fault
    return added.astype(np.float32).ravel()
