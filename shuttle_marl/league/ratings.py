"""Bradley-Terry ratings: the fit, its intervals, and diagnostics.

Model: entrant i beats j with probability 1 / (1 + exp(theta_j - theta_i)) (Bradley & Terry, Biometrika 1952). It is
fitted to all matches at once, so unlike Elo updates it does not depend on their order. Intervals resample cells, because the two
matches of a cell have the same random numbers and are dependent.
"""

import dataclasses
from typing import Final

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.stats import chi2

from shuttle_marl.base.arrays import F64, Bools, Intp

ELO: Final = 400 / np.log(10)
"""Elo points for a unit of theta: 400 points are odds of ten to one."""
TAILS: Final = (2.5, 97.5)
"""Percentiles of a 95 % interval."""
_STEPS: Final = 200
_FIXED_PRIOR: Final = 0.1
_INDEPENDENT: Final = np.array([0.25, 0.5, 0.25])
"""Probabilities of zero, one and two matches won in a cell between equals, if the matches are independent."""
_AT_ONCE: Final = 1 << 21
"""Number of matrix entries that are fitted in one batch."""
_SURE: Final = 5e-7
"""Exact odds are rounded to six decimals; probabilities are clipped to this distance from 0 and 1, so ratings are finite."""


def bradley_terry(wins: F64, start: F64 | None = None) -> F64:
    """Fit ratings by a damped Newton's method on the likelihood.

    Args:
        wins: ``[..., n, n]`` matches that i won against j, the same pairings in all; the diagonal is ignored. The graph of wins
            must be strongly connected within each component, or the maximum is infinite; :func:`prior_wins` ensures it.
        start: ``[n]`` initial theta; affects the running time only.

    Returns:
        ``[..., n]`` theta, with mean 0; entrants without matches have 0.
    """
    n = wins.shape[-1]
    diagonal = np.eye(n, dtype=bool)
    wins = np.where(diagonal, 0.0, wins)
    played = wins + np.swapaxes(wins, -1, -2)
    anchor = _anchor(np.asarray(played.reshape(-1, n, n).any(axis=0)))
    theta = np.zeros(wins.shape[:-1]) if start is None else np.broadcast_to(start, wins.shape[:-1])
    for _ in range(_STEPS):
        probability = 1 / (1 + np.exp(theta[..., None, :] - theta[..., :, None]))
        gradient = (wins - played * probability).sum(axis=-1)
        curvature = played * probability * (1 - probability)
        hessian = anchor - curvature
        hessian[..., diagonal] += curvature.sum(axis=-1)
        step = np.linalg.solve(hessian, gradient[..., None])[..., 0]
        # A full Newton step may diverge; a step of this length never lowers the likelihood (Bach, EJS 2010).
        longest = np.maximum(np.ptp(step, axis=-1, keepdims=True), 1e-300)
        theta = theta + step * (np.log1p(longest) / longest)
        if longest.max(initial=0) < 1e-9:
            break
    centred: F64 = theta - theta.mean(axis=-1, keepdims=True)
    return centred


def _anchor(met: Bools) -> F64:
    """``[n, n]`` term of the curvature that fixes the mean of each connected component, which the likelihood leaves open."""
    _, part = connected_components(met, directed=False)
    together = part[:, None] == part
    return np.asarray(together / together.sum(axis=1))


def wins_of(cells: F64, pairs: Intp, n: int) -> F64:
    """``[..., n, n]`` matches won, for :func:`bradley_terry`.

    Args:
        cells: ``[..., P, 3]`` numbers of cells in which the first entrant of a pairing won no match, one, and both.
        pairs: ``[P, 2]`` the entrants of each pairing.
    """
    wins = np.zeros((*cells.shape[:-2], n, n))
    wins[..., pairs[:, 0], pairs[:, 1]] = cells[..., 1] + 2 * cells[..., 2]
    wins[..., pairs[:, 1], pairs[:, 0]] = cells[..., 1] + 2 * cells[..., 0]
    return wins


def prior_wins(wins: F64) -> F64:
    """``[n, n]`` pseudo-wins of Jeffreys' prior (Firth, Biometrika 1993); their sum is n - 1.

    Ratings of unbeaten entrants become finite, and the first-order bias of the maximum is removed. A fixed number of pseudo-wins
    for each pair would shrink the strongest entrants towards the others.
    """
    played = wins + wins.T
    prior = np.where(played > 0, 0.5, 0.0)
    theta = bradley_terry(wins + prior)
    for _ in range(_STEPS):
        curvature, covariance = _information(played, theta)
        variance = covariance.diagonal()[:, None] + covariance.diagonal() - 2 * covariance
        following = np.where(played > 0, curvature * variance / 2, 0.0)
        change = np.abs(following - prior).max(initial=0)
        prior = following
        if change < 1e-9:
            break
        theta = bradley_terry(wins + prior, theta)
    return prior


def _information(played: F64, theta: F64) -> tuple[F64, F64]:
    """``[n, n]`` curvature of each pair's likelihood, and the covariance of the ratings."""
    probability = 1 / (1 + np.exp(theta[None, :] - theta[:, None]))
    curvature = played * probability * (1 - probability)
    np.fill_diagonal(curvature, 0)
    # No pseudo-inverse, because rounding makes the zero eigenvalue tiny and its inverse huge.
    return curvature, np.asarray(np.linalg.inv(_anchor(played > 0) + np.diag(curvature.sum(axis=1)) - curvature))


def expected_share(theta: F64, pairs: Intp) -> F64:
    """``[P]`` probability that the first entrant of a pairing wins a match, by the ratings."""
    return np.asarray(1 / (1 + np.exp(theta[pairs[:, 1]] - theta[pairs[:, 0]])))


def ratings(cells: F64, pairs: Intp, n: int, rng: np.random.Generator, replicates: int = 1000) -> tuple[F64, F64]:
    """Ratings and their Bayesian bootstrap (Rubin, Ann. Statist. 1981) over cells of two dependent matches.

    Args:
        cells: ``[P, 3]`` numbers of cells in which the first entrant of a pairing won no match, one, and both.
        pairs: ``[P, 2]`` the entrants of each pairing.
        replicates: number B of bootstrap samples.

    Returns:
        ``[n]`` theta and ``[B, n]`` theta.
    """
    wins = wins_of(cells, pairs, n)
    prior = prior_wins(wins)
    theta = bradley_terry(wins + prior)
    # The prior is resampled too, so unobserved outcomes are possible; a tenth of it is fixed, so that all ratings are finite.
    drawn_prior = (1 - _FIXED_PRIOR) * prior[pairs[:, 0], pairs[:, 1], None] * _INDEPENDENT
    weights = cells + drawn_prior + 1e-12
    drawn = np.array([rng.dirichlet(weight, size=replicates) for weight in weights]).reshape(-1, replicates, 3).swapaxes(0, 1)
    drawn = drawn * weights.sum(axis=1)[:, None]
    together = max(1, _AT_ONCE // max(1, n * n))
    parts = [wins_of(drawn[first : first + together], pairs, n) for first in range(0, replicates, together)]
    return theta, np.concatenate([bradley_terry(part + _FIXED_PRIOR * prior, theta) for part in parts])


def exact_ratings(match: F64) -> F64:
    """Limit of the sampled ratings as the number of matches of every pair grows.

    Args:
        match: ``[n, n]`` probability that the entrant of the row wins a match against that of the column; NaN where
            there are no exact odds.

    Returns:
        ``[n]`` theta, with mean 0 over entrants with odds; NaN for the others.
    """
    known = np.flatnonzero(~np.isnan(match).all(axis=1))
    theta = np.full(len(match), np.nan)
    if len(known):
        theta[known] = bradley_terry(match[np.ix_(known, known)].clip(_SURE, 1 - _SURE))
    return theta


def rank_intervals(theta: F64, drawn: F64) -> Intp:
    """95 % confidence intervals of the ranks (Mogstad, Romano, Shaikh & Wilhelm, Rev. Econ. Stud. 2024).

    Percentiles of bootstrapped ranks are too narrow where entrants are nearly equal. Here a rank is bounded by the numbers of
    entrants that are significantly above and below, by simultaneous intervals of the differences to all others.

    Args:
        theta: ``[n]`` ratings.
        drawn: ``[B, n]`` bootstrap samples of them.

    Returns:
        ``[n, 2]`` lowest and highest rank, from 1 for the best.
    """
    n = len(theta)
    found = np.empty((n, 2), dtype=np.intp)
    for i in range(n):
        others = np.arange(n) != i
        lead = theta[i] - theta[others]
        noise = drawn[:, i, None] - drawn[:, others] - lead
        deviation = noise.std(axis=0)
        known = deviation > 0
        largest = (np.abs(noise[:, known]) / deviation[known]).max(axis=1, initial=0)
        margin = np.percentile(largest, 95) * deviation
        found[i] = 1 + (known & (lead < -margin)).sum(), n - (known & (lead > margin)).sum()
    return found


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Misfit:
    """Goodness of fit of the ratings to the results of P pairings.

    Attributes:
        share: ``[P]`` fraction of the matches that the first entrant won.
        expected: ``[P]`` the same by the ratings.
        z: ``[P]`` their difference in standard errors, corrected for the correlation within cells.
        statistic: sum of squared z.
        degrees: degrees of freedom, pairings - (entrants - 1) in each connected component.
        p: p-value of the chi-squared test of the Bradley-Terry model; NaN without degrees of freedom.
    """

    share: F64
    expected: F64
    z: F64
    statistic: float
    degrees: int
    p: float


def misfit(cells: F64, pairs: Intp, theta: F64) -> Misfit:
    """Goodness of fit; arguments as in :func:`ratings`."""
    total = cells.sum(axis=1)
    won = np.array([0.0, 0.5, 1.0])
    share = cells @ won / total
    expected = expected_share(theta, pairs)
    # The two matches of a cell are not independent; their effect on the variance is estimated over all pairings.
    independent = (share * (1 - share) / 2 * total).sum()
    within = (cells * (won - share[:, None]) ** 2).sum()
    factor = max(within / independent, 1e-3) if independent else 1.0
    z = (share - expected) / np.sqrt(factor * expected * (1 - expected) / (2 * total))
    entrants = len(np.unique(pairs))
    links = 0
    if len(pairs):
        n = len(theta)
        graph = np.zeros((n, n), dtype=bool)
        graph[pairs[:, 0], pairs[:, 1]] = True
        parts, _ = connected_components(graph, directed=False)
        links = entrants - (parts - (n - entrants))
    degrees = len(pairs) - links
    statistic = float((z**2).sum())
    return Misfit(
        share=share,
        expected=expected,
        z=z,
        statistic=statistic,
        degrees=degrees,
        p=float(chi2.sf(statistic, degrees)) if degrees else float("nan"),
    )
