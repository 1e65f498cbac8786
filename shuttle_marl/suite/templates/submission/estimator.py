"""A method for evaluate-v1: weighted importance sampling with clipped weights."""

from typing import Any

import numpy as np


class Estimator:
    """Estimates the fraction of rallies that each policy wins."""

    def estimate(self, log: Any, policies: Any) -> list[float]:
        """One number from 0 to 1 for each policy."""
        data = log.transitions
        first = np.flatnonzero(data.first)
        won = data.won[first]
        found = []
        for policy in policies:
            ratio = policy.probability_of(data.pair) / data.probability
            weight = np.minimum(np.multiply.reduceat(ratio, first), 20.0)
            found.append(float((weight @ won + 1) / (weight.sum() + 2)))
        return found
