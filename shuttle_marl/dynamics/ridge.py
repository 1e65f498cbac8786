"""Logistic regression on products of attributes, with a ridge: the convex half of the return model.

Adaptive optimisers move rare products as fast as common ones and so overfit them; a ridge shrinks them in proportion to
how little data they have. Products of two and three attributes are scaled down, which makes their ridge stronger.
"""

import itertools
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize
from scipy.sparse import csr_matrix

from shuttle_marl.dynamics.features import SLOTS, Codes

Floats = npt.NDArray[np.float64]

PAIRS: Final = tuple(itertools.combinations(SLOTS, 2))
TRIPLES: Final = (
    ("incoming_shot", "shot", "area"),
    ("contact", "shot", "area"),
    ("own_area", "incoming_area", "area"),
    ("shot", "area", "technique"),
    ("own_area", "shot", "area"),
    ("incoming_area", "shot", "area"),
    ("own_shot", "incoming_shot", "shot"),
    ("discipline", "shot", "area"),
    ("incoming_shot", "incoming_area", "shot"),
)
CROSSES: Final = (*((name,) for name in SLOTS), *PAIRS, *TRIPLES)
_SCALE: Final = np.array([1.0] * len(SLOTS) + [0.25] * len(PAIRS) + [0.3] * len(TRIPLES))
_PENALTY: Final = 2.0


def ridge_columns(codes: dict[str, Codes]) -> npt.NDArray[np.int32]:
    """``[N, crosses]`` active columns."""
    columns, offset = [], 0
    for cross in CROSSES:
        index = np.zeros(len(codes["shot"]), dtype=np.int32)
        size = 1
        for name in cross:
            index = index * SLOTS[name] + codes[name]
            size *= SLOTS[name]
        columns.append(index + offset)
        offset += size
    return np.stack(columns, axis=1)


def fit_ridge(codes: dict[str, Codes], label: npt.NDArray[np.bool_]) -> Floats:
    """Coefficients ``[1 + columns]``, the intercept first, scales folded in."""
    active = ridge_columns(codes)
    n, width = len(active), sum(int(np.prod([SLOTS[name] for name in cross])) for cross in CROSSES)
    indptr = np.arange(0, active.size + 1, active.shape[1])
    x = csr_matrix((np.tile(_SCALE, n), active.ravel(), indptr), shape=(n, width))
    y = label.astype(np.float64)

    def objective(w: Floats) -> tuple[float, Floats]:
        z = w[0] + x @ w[1:]
        error = 1 / (1 + np.exp(-z)) - y
        value = float(np.logaddexp(0, z).sum() - y @ z + 0.5 * _PENALTY * (w[1:] @ w[1:]))
        return value, np.r_[error.sum(), x.T @ error + _PENALTY * w[1:]]

    rate = y.mean()
    start = np.zeros(1 + width)
    start[0] = np.log(rate / (1 - rate))
    solution = minimize(objective, start, jac=True, method="L-BFGS-B", options={"maxiter": 400, "ftol": 1e-10})
    sizes = [int(np.prod([SLOTS[name] for name in cross])) for cross in CROSSES]
    weights: Floats = solution.x
    weights[1:] *= np.repeat(_SCALE, sizes)
    return weights


def ridge_logits(weights: Floats, codes: dict[str, Codes], chunk: int = 65536) -> Floats:
    """``[N]`` logits."""
    n = len(codes["shot"])
    out = np.empty(n)
    for start in range(0, n, chunk):
        part = ridge_columns({name: code[start : start + chunk] for name, code in codes.items()})
        out[start : start + chunk] = weights[0] + weights[1:][part].sum(axis=1)
    return out
