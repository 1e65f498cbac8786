"""Logistic regression with normal random effects; variances by Laplace-approximated marginal likelihood.

The log-odds of row i are an offset plus x_i'b. The effects b have the prior precision P = D' diag(1 / v) D: their innovations
D b are independent, with mean 0 and variance v_j = s_j exp(2 t_c), where s_j is a known scale and t_c the log standard deviation
of the variance component c of innovation j. D is the identity for independent effects, and takes differences of a random walk.

With the posterior mode b and H = X'WX + P, the negative log marginal likelihood is approximately
-l(b) + b'Pb / 2 + log|H| / 2 - log|P| / 2 (Tierney and Kadane, JASA 1986), as in lme4 (Bates et al., J. Stat. Softw. 2015).
Its gradient is exact; it includes the change of W with the mode.
"""

import dataclasses
from typing import Final

import numpy as np
from scipy.linalg import cho_solve, cholesky
from scipy.linalg.lapack import dpotri
from scipy.optimize import minimize
from scipy.sparse import csr_matrix, identity
from scipy.special import expit

from shuttle_marl.base.arrays import F64, I64, Bools, Ints

BOUNDS: Final = (0.005, 2.0)
"""Range of a standard deviation; the lower bound stands for no variance."""
_TOLERANCE: Final = 1e-9
"""Squared Newton decrement at convergence, in nats."""
_STEPS: Final = 50
_YEAR: Final = 365.25
_DAYS: Final = 1 << 32


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Walks:
    """Random walks of several players, at the days (knots) on which each is observed; sorted by player and day."""

    player: I64
    day: I64

    @classmethod
    def of(cls, player: I64, day: I64) -> "Walks":
        """Walks with knots at all pairs ``[N]`` of a player and a day."""
        knots = np.unique(np.stack([player, day]), axis=1)
        return cls(player=knots[0], day=knots[1])

    def __len__(self) -> int:
        return len(self.day)

    def index(self, player: I64, day: I64) -> I64:
        """``[N]`` knot of each player as of a day: the last one on or before it, else the first; -1 for unknown players."""
        first, last = (np.searchsorted(self.player, player, side=side) for side in ("left", "right"))
        key = self.player * _DAYS + self.day
        until = np.searchsorted(key, player * _DAYS + day, side="right") - 1
        return np.where(first < last, np.maximum(first, until), -1)

    def innovations(self) -> tuple[csr_matrix, Bools, F64]:
        """``[K, K]`` innovations of the values, whether each is a player's first value, and ``[K]`` years since the previous."""
        first = np.r_[True, np.diff(self.player) != 0]
        later = np.flatnonzero(~first)
        before = csr_matrix((np.ones(len(later)), (later, later - 1)), shape=(len(self), len(self)))
        years = np.where(first, 1.0, np.diff(self.day, prepend=0) / _YEAR)
        return csr_matrix(identity(len(self)) - before), first, years


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class MixedModel:
    """N binary observations with G distinct rows of effects.

    Attributes:
        x: ``[G, E]`` coefficients of the effects in each distinct row.
        row: ``[N]`` distinct row of each observation.
        offset: ``[N]`` log-odds without effects.
        label: ``[N]`` observations.
        difference: ``[E, E]`` D, with determinant 1.
        component: ``[E]`` variance component of each innovation.
        scale: ``[E]`` variance of each innovation relative to that of its component.
    """

    x: csr_matrix
    row: Ints
    offset: F64
    label: Bools
    difference: csr_matrix
    component: Ints
    scale: F64

    @property
    def components(self) -> int:
        """Number of variance components."""
        return int(self.component.max()) + 1


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Posterior:
    """Posterior of the effects given the standard deviations.

    Attributes:
        sd: ``[C]`` standard deviation of each component.
        mode: ``[E]`` posterior mode.
        covariance: ``[E, E]`` inverse of the negative Hessian at the mode.
        log_likelihood: Laplace approximation of the log marginal likelihood.
    """

    sd: F64
    mode: F64
    covariance: F64
    log_likelihood: float

    @property
    def deviation(self) -> F64:
        """``[E]`` posterior standard deviations."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def posterior(model: MixedModel, sd: F64, start: F64 | None = None) -> Posterior:
    """Mode and curvature of the posterior, by Newton's method with step halving.

    Args:
        sd: ``[C]`` standard deviations of the components.
        start: ``[E]`` initial effects.
    """
    variance = model.scale * sd[model.component] ** 2
    precision = csr_matrix(model.difference.T @ model.difference.multiply((1 / variance)[:, None]))
    effects = np.zeros(model.x.shape[1]) if start is None else start
    groups = model.x.shape[0]

    def loss(b: F64) -> float:
        z = model.offset + (model.x @ b)[model.row]
        return float(np.logaddexp(0, z).sum() - z[model.label].sum() + 0.5 * b @ precision @ b)

    current = loss(effects)
    for _ in range(_STEPS):
        p = expit(model.offset + (model.x @ effects)[model.row])
        gradient = model.x.T @ np.bincount(model.row, p - model.label, groups) + precision @ effects
        weight = np.bincount(model.row, p * (1 - p), groups)
        hessian = (model.x.T @ model.x.multiply(weight[:, None]) + precision).toarray()
        factor = cholesky(hessian, lower=True, overwrite_a=True, check_finite=False)
        step = cho_solve((factor, True), gradient, check_finite=False)
        if float(gradient @ step) < _TOLERANCE:
            break
        size = 1.0
        while (following := loss(effects - size * step)) > current and size > _TOLERANCE:
            size /= 2
        effects, current = effects - size * step, following
    value = current + float(np.log(np.diag(factor)).sum()) + 0.5 * float(np.log(variance).sum())
    lower = dpotri(factor, lower=1, overwrite_c=1)[0]
    covariance = np.tril(lower) + np.tril(lower, -1).T
    return Posterior(sd=sd, mode=effects, covariance=covariance, log_likelihood=-value)


def gradient_of(model: MixedModel, found: Posterior) -> F64:
    """``[C]`` gradient of the log marginal likelihood in the log standard deviations."""
    variance = model.scale * found.sd[model.component] ** 2
    innovation = model.difference @ found.mode
    p = expit(model.offset + (model.x @ found.mode)[model.row])
    leverage = np.asarray(model.x.multiply(model.x @ found.covariance).sum(axis=1)).ravel()
    slope = np.bincount(model.row, p * (1 - p) * (1 - 2 * p), model.x.shape[0])
    # The change of log|H| with the mode, through the weights.
    moved = model.difference @ (found.covariance @ (model.x.T @ (leverage * slope)))
    spread = np.asarray(model.difference.multiply(model.difference @ found.covariance).sum(axis=1)).ravel()
    terms = (innovation**2 + spread - moved * innovation) / variance - 1
    return np.asarray(np.bincount(model.component, terms, model.components), dtype=np.float64)


def fit_variances(model: MixedModel, fixed: F64 | None = None, start: float = 0.1) -> Posterior:
    """The posterior at the standard deviations of maximum marginal likelihood.

    Args:
        fixed: ``[C]`` standard deviations that are given; NaN, or None for all, where they are estimated.
        start: initial standard deviation of the others.
    """
    given = np.log(np.full(model.components, np.nan) if fixed is None else fixed)
    mode: F64 | None = None

    def objective(log_sd: F64) -> tuple[float, F64]:
        nonlocal mode
        found = posterior(model, np.exp(log_sd), mode)
        mode = found.mode
        return -found.log_likelihood, -gradient_of(model, found)

    low, high = (np.where(np.isnan(given), np.log(bound), given) for bound in BOUNDS)
    first = np.where(np.isnan(given), np.log(start), given)
    options = {"ftol": 1e-9, "gtol": 1e-2}
    found = minimize(objective, first, jac=True, method="L-BFGS-B", bounds=np.stack([low, high], axis=1), options=options)
    return posterior(model, np.exp(found.x), mode)
