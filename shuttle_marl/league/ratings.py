"""Bradley-Terry ratings of all entrants at once, with intervals over the cells of swapped seats.

Model: entrant i beats j with probability 1 / (1 + exp(theta_j - theta_i)) (Bradley & Terry, Biometrika 1952). Fitted to all
matches together, so unlike with Elo's updates their order does not matter.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

ELO: Final = 400 / np.log(10)
"""Points of Elo's scale for a unit of theta: 400 points are odds of ten to one."""
_STEPS: Final = 200
_LONGEST_STEP: Final = 2.0


def bradley_terry(wins: Floats) -> Floats:
    """Fit ratings by Newton's method on the likelihood.

    Args:
        wins: ``[..., n, n]`` matches that i won against j; the diagonal is ignored. Results must connect all entrants both
            ways, or the likeliest ratings are infinite; :func:`smoothed` sees to that.

    Returns:
        ``[..., n]`` theta, with mean 0; entrants without matches have 0.
    """
    diagonal = np.eye(wins.shape[-1], dtype=bool)
    wins = np.where(diagonal, 0.0, wins)
    played = wins + np.swapaxes(wins, -1, -2)
    theta = np.zeros(wins.shape[:-1])
    for _ in range(_STEPS):
        probability = 1 / (1 + np.exp(theta[..., None, :] - theta[..., :, None]))
        gradient = (wins - played * probability).sum(axis=-1)
        curvature = played * probability * (1 - probability)
        hessian = -curvature
        hessian[..., diagonal] = curvature.sum(axis=-1)
        # Only differences of theta are determined; the pseudo-inverse leaves their mean alone.
        step = (np.linalg.pinv(hessian, hermitian=True) @ gradient[..., None])[..., 0]
        theta = theta + np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)
        if np.abs(step).max(initial=0) < 1e-10:
            break
    centred: Floats = theta - theta.mean(axis=-1, keepdims=True)
    return centred


def smoothed(cells: Floats) -> Floats:
    """``[P, 3]`` counts of cells with half a cell added to each outcome (Jeffreys' prior).

    So 500 cells out of 500 neither give an infinite rating nor come out as certain.
    """
    return cells + 0.5


def wins_of(shares: Floats, cells: Floats, pairs: npt.NDArray[np.intp], n: int) -> Floats:
    """``[..., n, n]`` matches won, for :func:`bradley_terry`.

    Args:
        shares: ``[..., P, 3]`` share of the cells of which the first entrant of each pairing won no match, one, both.
        cells: ``[P]`` number of cells.
        pairs: ``[P, 2]`` the entrants of each pairing.
        n: number of entrants.
    """
    wins = np.zeros((*shares.shape[:-2], n, n))
    wins[..., pairs[:, 0], pairs[:, 1]] = cells * (shares[..., 1] + 2 * shares[..., 2])
    wins[..., pairs[:, 1], pairs[:, 0]] = cells * (shares[..., 1] + 2 * shares[..., 0])
    return wins


def ratings(cells: Floats, pairs: npt.NDArray[np.intp], n: int, seed: int, replicates: int = 1000) -> tuple[Floats, Floats]:
    """Ratings, and what they would be under other draws of the cells: a Bayesian bootstrap (Rubin, Ann. Statist. 1981).

    The two matches of a cell share their draws, so cells are drawn and not matches.

    Args:
        cells: ``[P, 3]`` for each pairing, in how many cells its first entrant won no match, one, both.
        pairs: ``[P, 2]`` the entrants of each pairing.
        n: number of entrants.
        seed: of the draws.
        replicates: number of draws B.

    Returns:
        ``[n]`` theta and ``[B, n]`` theta.
    """
    counts = smoothed(cells)
    total = counts.sum(axis=1)
    rng = np.random.default_rng(seed)
    drawn = np.array([rng.dirichlet(count, size=replicates) for count in counts]).reshape(-1, replicates, 3)
    theta = bradley_terry(wins_of(counts / total[:, None], total, pairs, n))
    return theta, bradley_terry(wins_of(drawn.swapaxes(0, 1), total, pairs, n))
