"""Targets that mean the same whether a stroke was returned or not.

The file says of a returned stroke where the receiver met the shuttle, and of a winner or an out stroke where it came down on
the floor, farther along its flight: recorded like that, the depth tells the outcome. So each landing on the floor is moved
along the line of flight to a depth at which a receiver could have met it.

- **Winners**: the quantile, among the returned strokes of the same shot type and contact height, at which the landing stands
  among the winners of these. Which depth wins more often is then left to the context of the strokes: nothing else in the data
  tells where a winner would have been met (expectation maximisation over the three depths, with the returned strokes' choice as
  prior, predicts unseen matches no better).
- **Out strokes**: at most the depth below which nine tenths of the returned strokes of the same shot type and height are met.
  Otherwise most drives and net kills that went out would stand in areas where hardly any is met, which no player of the game
  can aim at, and the game would miss these faults.

Simulated strokes need none of this: they record the target itself.
"""

from typing import Final

import numpy as np

from shuttle_marl.arrays import F64, Bools, Ints
from shuttle_marl.game.stroke import N_SHOTS

LEAST_LANDINGS: Final = 20
"""With fewer winners or returned strokes of a shot type and height, both heights count; with still fewer nothing is moved."""
DEEPEST: Final = 0.9
"""Share of the returned strokes that are met nearer to the net than an out stroke can have been aimed."""


def met_points(landing: F64, start: F64, shot: Ints, height: Ints, winner: Bools, out: Bools) -> F64:
    """Points ``[N, 2]`` at which a receiver met the shuttle of each stroke, or would have met it.

    Args:
        landing: ``[N, 2]`` recorded landing points [m] in the striker's frame; NaN where there is none, or where it says
            nothing of the target.
        start: ``[N, 2]`` where the flight began; where it is NaN a landing moves straight ahead.
        shot, height: ``[N]`` shot type and contact height.
        winner: ``[N]`` strokes that fell to the floor in court.
        out: ``[N]`` strokes that fell to the floor out of court. All others with a landing were returned.

    Returns:
        The landing points, those of winners and out strokes moved.
    """
    depth = landing[:, 1]
    moved = depth.copy()
    returned = ~winner & ~out & ~np.isnan(depth)
    for kind in range(N_SHOTS):
        for level in (0, 1):
            here = (shot == kind) & (height == level)
            for alike in (here, shot == kind):
                fallen, met = np.sort(depth[alike & winner]), np.sort(depth[alike & returned])
                if min(len(fallen), len(met)) >= LEAST_LANDINGS:
                    moved[here & winner] = np.quantile(met, _share_below(fallen, depth[here & winner]))
                    break
            met = depth[here & returned]
            if len(met) >= LEAST_LANDINGS:
                moved[here & out] = np.minimum(depth[here & out], np.quantile(met, DEEPEST))
    along = (moved - start[:, 1]) / (depth - start[:, 1])
    sideways = np.where(np.isnan(along), landing[:, 0], start[:, 0] + along * (landing[:, 0] - start[:, 0]))
    return np.stack([np.where(moved == depth, landing[:, 0], sideways), moved], axis=1)


def _share_below(ordered: F64, values: F64) -> F64:
    """Share of a sorted sample below each value, half of the equal ones counted, never 0 or 1."""
    share = 0.5 * (np.searchsorted(ordered, values) + np.searchsorted(ordered, values, side="right")) / len(ordered)
    return np.clip(share, 0.5 / len(ordered), 1 - 0.5 / len(ordered))
