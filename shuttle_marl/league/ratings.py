"""Bradley-Terry ratings of all entrants at once, with intervals over the cells of swapped seats.

Model: entrant i beats j with chance 1 / (1 + exp(theta_j - theta_i)) (Bradley & Terry, Biometrika 1952). Fitted to all
matches together, so unlike with Elo's updates their order does not matter.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

ELO: Final = 400 / np.log(10)
"""Points of Elo's scale for a unit of theta: 400 points are odds of ten to one."""
_STEPS: Final = 500
_LONGEST_STEP: Final = 2.0


def bradley_terry(wins: Floats, prior: float = 1.0) -> Floats:
    """Fit ratings by Newton's method.

    Args:
        wins: ``[..., n, n]`` matches that i won against j; the diagonal is ignored.
        prior: everyone also wins and loses this many matches against an average entrant, which keeps the rating of one who
            won or lost everything finite; 0 is maximum likelihood and needs results that connect everyone both ways.

    Returns:
        ``[..., n]`` theta, with mean 0.
    """
    n = wins.shape[-1]
    diagonal = np.eye(n, dtype=bool)
    wins = np.where(diagonal, 0.0, wins)
    played = wins + np.swapaxes(wins, -1, -2)
    theta = np.zeros(wins.shape[:-1])
    for _ in range(_STEPS):
        chance = _logistic(theta[..., :, None] - theta[..., None, :])
        mean = _logistic(theta)
        gradient = (wins - played * chance).sum(axis=-1) + prior * (1 - 2 * mean)
        curvature = played * chance * (1 - chance)
        hessian = -curvature
        hessian[..., diagonal] = curvature.sum(axis=-1) + 2 * prior * mean * (1 - mean) + 1e-12
        # Without the prior only differences of theta are determined; the pseudo-inverse leaves their mean alone.
        step = np.clip(
            (np.linalg.pinv(hessian, hermitian=True) @ gradient[..., None])[..., 0], -_LONGEST_STEP, _LONGEST_STEP
        )
        theta = theta + step
        if np.abs(step).max(initial=0) < 1e-10:
            break
    centred: Floats = theta - theta.mean(axis=-1, keepdims=True)
    return centred


def bootstrap(cells: Floats, pairs: npt.NDArray[np.intp], n: int, seed: int, replicates: int = 1000) -> Floats:
    """Ratings under other draws of the cells: a Bayesian bootstrap (Rubin, Annals of Statistics 1981).

    The two matches of a cell share their draws, so cells are drawn and not matches. Half a cell is added to each outcome
    (Jeffreys' prior): without it, 500 cells out of 500 would come out as certain.

    Args:
        cells: ``[P, 3]`` for each pairing, in how many cells its first entrant won no match, one, both; all above 0 in sum.
        pairs: ``[P, 2]`` the entrants of each pairing.
        n: number of entrants.
        seed: of the draws.
        replicates: number of draws.

    Returns:
        ``[replicates, n]`` theta.
    """
    rng = np.random.default_rng(seed)
    wins = np.zeros((replicates, n, n))
    for counts, (a, b) in zip(cells, pairs, strict=True):
        share = rng.dirichlet(counts + 0.5, size=replicates)
        won = counts.sum() * (share[:, 1] + 2 * share[:, 2])
        wins[:, a, b] = won
        wins[:, b, a] = 2 * counts.sum() - won
    return bradley_terry(wins)


def _logistic(x: Floats) -> Floats:
    return np.asarray(1 / (1 + np.exp(-np.clip(x, -700, 700))))
