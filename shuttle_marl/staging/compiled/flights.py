"""Flights of shuttles. What the numbers mean stands in :mod:`shuttle_marl.staging.flight`."""

import math

import numpy as np

from shuttle_marl.arrays import F64
from shuttle_marl.kernel.compiling import compiled


@compiled
def integrate(vx: F64, vy: F64, nodes: F64, out: F64) -> None:
    """Classical Runge-Kutta of flights in scaled units: ``[4, N, K + 1]`` places and velocities at instants ``[N, K + 1]``."""
    k = np.empty((4, 4))
    for n in range(len(vx)):
        out[0, n, 0], out[1, n, 0], out[2, n, 0], out[3, n, 0] = 0.0, 0.0, vx[n], vy[n]
        for i in range(nodes.shape[1] - 1):
            h = nodes[n, i + 1] - nodes[n, i]
            for stage in range(4):
                share = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
                u, w = out[2, n, i], out[3, n, i]
                if stage:
                    u += share * k[stage - 1, 2]
                    w += share * k[stage - 1, 3]
                drag = -math.sqrt(u * u + w * w)
                k[stage, 0], k[stage, 1], k[stage, 2], k[stage, 3] = u, w, drag * u, drag * w - 1.0
            for c in range(4):
                out[c, n, i + 1] = out[c, n, i] + h / 6 * (k[0, c] + 2 * k[1, c] + 2 * k[2, c] + k[3, c])
