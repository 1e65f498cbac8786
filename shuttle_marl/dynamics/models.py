"""The five networks of the game, the trees and the ridge regression: inputs, labels and fits.

========  =======================================  ==================================================
network   inputs                                   prediction
========  =======================================  ==================================================
choice    the state                                shot type and technique
target    the state, shot type, technique          target area
success   the state and the whole stroke           good, out, or short (net, short of the net, foul)
return    the state and the whole stroke           the opponent returns a good stroke
contact   the state and the whole stroke           the opponent meets it above the net
(hurried) the state and the whole stroke           who meets it is hurried: trees, one model for each contact height
========  =======================================  ==================================================

**Targets of faults are latent.** The data record where a fault landed, not where it was aimed. The target of a stroke that did
not cross the net is unknown, so its likelihood is the sum over the nine areas of (probability of the target) x (probability of
falling short at this target), and target and success networks are fitted by expectation maximisation.

**Return and contact are blends**, means of logits: of the network, of small boosted trees, and, for the return, of a ridge
logistic regression on products of attributes. Adaptive optimisers overfit rare products, because they move them as fast as common
ones; the ridge shrinks products the more, the rarer they are (products of two and three attributes are scaled down, which
strengthens their ridge), and trees group codes of an attribute with similar effects. In cross-validation over the training
matches, the log-loss of the return relative to that of the evaluation's trees is 1.002 with the network alone, .999 with the
ridge, .997 with both; that of the contact is 1.003 alone and .998 with trees.

**Trees correct the success model.** They do not read the target, so they add the same to the logit of a fault at every target.
They are fitted to out-of-fold predictions. The relative out-of-fold log-loss is 1.001 without and .9999 with them (ensembles of
five).
"""

import itertools
import math
from typing import Final

import numpy as np
import torch
from scipy.optimize import minimize
from scipy.sparse import csr_matrix
from torch import Tensor, nn
from torch.nn import functional

from shuttle_marl.base.arrays import F64, I16, I64, Bools
from shuttle_marl.data.schema import REASONS, Outcome
from shuttle_marl.dynamics.features import SLOTS, STATE, Rows
from shuttle_marl.dynamics.network import Ensemble, EnsembleConfig, NetworkSpec, attributes, encode, fit_ensemble, in_chunks
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.stroke import N_SHOTS, N_TECHNIQUES

GOOD, OUT, SHORT = range(3)
_STROKE: Final = (*STATE, "shot", "technique", "area")
_CONTEXT_CROSSES: Final = (
    ("shot", "contact", "technique"),
    ("incoming_shot", "incoming_area"),
    ("incoming_shot", "shot"),
    ("incoming_area", "shot"),
    ("own_shot", "incoming_shot"),
    ("shot", "area"),
    ("hurried", "shot"),
    ("hurried", "incoming_shot"),
)
_FLIGHT_CROSSES: Final = (
    *_CONTEXT_CROSSES,
    ("shot", "area", "technique"),
    ("incoming_area", "area"),
    ("own_area", "area"),
    ("hands", "area"),
)
SPECS: Final = {
    "choice": NetworkSpec(
        inputs=STATE,
        crosses=(
            ("incoming_shot", "incoming_area", "contact"),
            ("own_shot", "incoming_shot"),
            ("own_area", "incoming_shot"),
            ("hurried", "incoming_shot"),
        ),
        outputs=N_SHOTS * N_TECHNIQUES,
    ),
    "target": NetworkSpec(
        inputs=(*STATE, "shot", "technique"),
        crosses=(
            ("shot", "technique", "contact"),
            ("incoming_area", "shot"),
            ("incoming_shot", "shot"),
            ("own_area", "shot"),
            ("incoming_area", "technique"),
            ("hurried", "shot"),
            ("hands", "shot"),
            ("hands", "incoming_area"),
        ),
        outputs=N_AREAS,
    ),
    "success": NetworkSpec(inputs=_STROKE, crosses=_CONTEXT_CROSSES, outputs=3),
    "return": NetworkSpec(inputs=_STROKE, crosses=_FLIGHT_CROSSES, outputs=1),
    "contact": NetworkSpec(inputs=_STROKE, crosses=_FLIGHT_CROSSES, outputs=1),
}
HURRIED: Final = ("hurried_below", "hurried_above")
"""Trees of hurried receivers, by the height at which they meet the shuttle."""
_PAIRS: Final = tuple(itertools.combinations(SLOTS, 2))
_TRIPLES: Final = (
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
_RIDGE: Final = NetworkSpec(inputs=tuple(SLOTS), crosses=(*_PAIRS, *_TRIPLES), outputs=1)
"""Inputs of the ridge regression."""
_SCALE: Final = np.array([1.0] * len(SLOTS) + [0.25] * len(_PAIRS) + [0.3] * len(_TRIPLES))
_PENALTY: Final = 2.0
_GRADIENT: Final = 0.5
"""Norm of the gradient at convergence of the ridge regression; its logits are then accurate to some thousandths."""
_SIZES: Final = (*SLOTS.values(), *(math.prod(SLOTS[name] for name in cross) for cross in _RIDGE.crosses))
RIDGE_COLUMNS: Final = sum(_SIZES)
"""Inputs of the ridge regression: attributes and products of attributes."""


def fault_class(rows: Rows) -> I64:
    """``[N]`` GOOD, OUT or SHORT; faults of unknown kind count as short."""
    fault = rows.outcome == Outcome.FAULT
    return np.where(~fault, GOOD, np.where(rows.reason == REASONS.index("out"), OUT, SHORT))


def latent_target(rows: Rows) -> Bools:
    """``[N]`` whether the target is unknown: the shuttle fell short, or no landing was recorded."""
    return (fault_class(rows) == SHORT) | (rows.codes["area"] < 0)


def softmax(logits: F64) -> F64:
    """Softmax over the last axis."""
    z = np.exp(logits - logits.max(axis=-1, keepdims=True))
    return np.asarray(z / z.sum(axis=-1, keepdims=True))


def log_odds(p: F64) -> F64:
    """Logit of probabilities, clipped to [1e-9, 1 - 1e-9]."""
    p = np.clip(p, 1e-9, 1 - 1e-9)
    return np.asarray(np.log(p) - np.log1p(-p))


def sigmoid(logits: F64) -> F64:
    """Logistic function."""
    return np.asarray(0.5 * (1 + np.tanh(0.5 * logits)))


def log_loss(label: Bools, p: F64) -> float:
    """Mean log-loss of probabilities ``[N]``, in nats."""
    p = np.clip(p, 1e-9, 1 - 1e-9)
    return float(-np.where(label, np.log(p), np.log1p(-p)).mean())


def mean_probabilities(network: Ensemble, codes: dict[str, I16]) -> F64:
    """``[N, outputs]`` probabilities of the classes, averaged over the ensemble."""
    return np.asarray(softmax(network.logits(codes)).mean(axis=0))


def fit_choice(rows: Rows, config: EnsembleConfig, seed: int) -> Ensemble:
    """Fit the choice of shot types and techniques, on all strokes."""
    label = labels_of("choice", rows)
    prior = np.log(np.bincount(label, minlength=SPECS["choice"].outputs) + 1.0)
    labels = torch.from_numpy(label)

    def loss(logits: Tensor, batch: Tensor) -> Tensor:
        k, n, c = logits.shape
        y = labels[batch].expand(k, n)
        return functional.cross_entropy(logits.reshape(k * n, c), y.reshape(-1), reduction="none").view(k, n)

    return fit_ensemble(SPECS["choice"], rows.codes, loss, rows.match, prior - prior.max(), config, seed)


def fit_target(rows: Rows, weights: F64, config: EnsembleConfig, seed: int) -> Ensemble:
    """Fit the target areas to soft labels.

    Args:
        weights: ``[N, 9]`` probability of each target; rows of zeros are left out.
    """
    used = weights.sum(axis=1) > 0
    rows = rows.take(used)
    soft = torch.from_numpy(weights[used].astype(np.float32))
    prior = np.log(weights.sum(axis=0) + 1.0)

    def loss(logits: Tensor, batch: Tensor) -> Tensor:
        return -(soft[batch] * torch.log_softmax(logits, dim=-1)).sum(dim=-1)

    return fit_ensemble(SPECS["target"], rows.codes, loss, rows.match, prior - prior.max(), config, seed)


def fit_success(rows: Rows, target: F64, config: EnsembleConfig, seed: int) -> Ensemble:
    """Fit the outcome of strokes, summing over unknown targets.

    Args:
        target: ``[N, 9]`` probability of each target given the state, shot type and technique.
    """
    label = fault_class(rows)
    latent = latent_target(rows)
    count = np.where(latent, N_AREAS, 1)
    start = np.r_[0, np.cumsum(count)[:-1]]
    source = np.repeat(np.arange(len(rows)), count)
    area = np.where(latent[source], np.arange(len(source)) - start[source], rows.codes["area"][source])
    expanded = {name: code[source] for name, code in rows.codes.items()} | {"area": area.astype(np.int16)}
    share = torch.from_numpy(np.where(latent[source], target[source, area], 1.0).astype(np.float32))
    starts, counts, labels = (torch.from_numpy(x.astype(np.int64)) for x in (start, count, label))

    def expand(batch: Tensor) -> Tensor:
        n = counts[batch]
        first = torch.repeat_interleave(starts[batch] - torch.cumsum(n, 0) + n, n)
        return first + torch.arange(int(n.sum()))

    def loss(logits: Tensor, batch: Tensor) -> Tensor:
        n = counts[batch]
        owner = torch.repeat_interleave(torch.arange(len(batch)), n)
        probability = torch.softmax(logits, dim=-1)
        y = torch.repeat_interleave(labels[batch], n).expand(len(logits), -1)
        terms = torch.gather(probability, 2, y[:, :, None])[:, :, 0] * share[expand(batch)]
        total = torch.zeros(len(logits), len(batch)).index_add_(1, owner, terms)
        return -torch.log(total.clamp_min(1e-12))

    prior = np.log(np.bincount(label, minlength=3) / len(label))
    return fit_ensemble(SPECS["success"], expanded, loss, rows.match, prior, config, seed, expand=expand)


def fit_binary(name: str, rows: Rows, label: Bools, config: EnsembleConfig, seed: int) -> Ensemble:
    """Fit one of the networks with a single logit (return, contact)."""
    y = torch.from_numpy(label.astype(np.float32))
    rate = float(label.mean())

    def loss(logits: Tensor, batch: Tensor) -> Tensor:
        z = logits[:, :, 0]
        return functional.binary_cross_entropy_with_logits(z, y[batch].expand_as(z), reduction="none")

    prior = np.array([np.log(rate / (1 - rate))])
    return fit_ensemble(SPECS[name], rows.codes, loss, rows.match, prior, config, seed)


def known_outcome(rows: Rows) -> Bools:
    """``[N]`` rows that the success network is fitted to."""
    return rows.outcome != Outcome.UNKNOWN


def was_good(rows: Rows) -> Bools:
    """``[N]`` rows that the return network is fitted to."""
    return ((rows.outcome == Outcome.RETURNED) | (rows.outcome == Outcome.WINNER)) & (rows.codes["area"] >= 0)


def was_met(rows: Rows) -> Bools:
    """``[N]`` rows that the contact network is fitted to."""
    return (rows.outcome == Outcome.RETURNED) & (rows.next_contact >= 0) & (rows.codes["area"] >= 0)


def was_timed(rows: Rows) -> Bools:
    """``[N]`` rows that the trees of hurried receivers are fitted to."""
    return was_met(rows) & (rows.next_hurried >= 0)


def judged(rows: Rows) -> dict[str, tuple[Rows, Bools]]:
    """Rows and labels by binary model: a fault, a return, a contact above, a hurried receiver."""
    known, good, met, timed = (rows.take(mask(rows)) for mask in (known_outcome, was_good, was_met, was_timed))
    return {
        "success": (known, known.outcome == Outcome.FAULT),
        "return": (good, good.outcome == Outcome.RETURNED),
        "contact": (met, met.next_contact == 1),
        "hurried": (timed, timed.next_hurried == 1),
    }


def labelled(name: str, rows: Rows) -> Bools:
    """``[N]`` rows with a known label of the network ``choice`` or ``target``."""
    return np.ones(len(rows), dtype=bool) if name == "choice" else ~latent_target(rows)


def labels_of(name: str, rows: Rows) -> I64:
    """``[N]`` label of the network: shot type and technique (``choice``), or area (``target``)."""
    if name == "target":
        return rows.codes["area"].astype(np.int64)
    return rows.codes["shot"].astype(np.int64) * N_TECHNIQUES + rows.codes["technique"]


def all_targets(success: Ensemble, rows: Rows) -> F64:
    """``[K, N, 9, 3]`` probabilities of good, out, short for each of the nine targets."""
    return np.stack([softmax(success.logits(rows.with_area(a))) for a in range(N_AREAS)], axis=2)


class Ridge(nn.Module):
    """Logistic regression on attributes and products of attributes.

    Args:
        weight: ``[1 + columns]`` coefficients, the intercept first.
    """

    weight: Tensor

    def __init__(self, weight: F64) -> None:
        super().__init__()
        self.register_buffer("weight", torch.from_numpy(weight))

    def forward(self, codes: Tensor) -> Tensor:
        """``[N]`` logits, from ``[N, 15]`` codes of :data:`~shuttle_marl.dynamics.features.SLOTS`."""
        return self.weight[0] + self.weight[1:][encode(_RIDGE, codes)].sum(dim=1)

    def logits(self, codes: dict[str, I16]) -> F64:
        """``[N]`` logits."""
        return in_chunks(self, codes)


def fit_ridge(codes: dict[str, I16], label: Bools, start: Ridge | None = None) -> Ridge:
    """Fit the ridge logistic regression.

    Args:
        start: a similar fit, from which the search starts.
    """
    active = encode(_RIDGE, attributes(codes)).numpy()
    n, width = len(active), RIDGE_COLUMNS
    indptr = np.arange(0, active.size + 1, active.shape[1])
    x = csr_matrix((np.tile(_SCALE, n), active.ravel(), indptr), shape=(n, width))
    y = label.astype(np.float64)
    scale = np.r_[1.0, np.repeat(_SCALE, _SIZES)]
    penalty = np.r_[0.0, np.full(width, _PENALTY)]

    def gradient_of(error: F64) -> F64:
        return np.r_[error.sum(), x.T @ error]

    def objective(w: F64) -> tuple[float, F64]:
        z = w[0] + x @ w[1:]
        value = float(np.logaddexp(0, z).sum() - y @ z + 0.5 * penalty @ (w * w))
        return value, gradient_of(sigmoid(z) - y) + penalty * w

    # Consecutive Hessian products are at the same point.
    variance_at: dict[bytes, F64] = {}

    def hessian_product(w: F64, direction: F64) -> F64:
        key = w.tobytes()
        if key not in variance_at:
            p = sigmoid(w[0] + x @ w[1:])
            variance_at.clear()
            variance_at[key] = p * (1 - p)
        return gradient_of(variance_at[key] * (direction[0] + x @ direction[1:])) + penalty * direction

    first = np.r_[log_odds(y.mean()), np.zeros(width)] if start is None else start.weight.numpy() / scale
    solution = minimize(objective, first, jac=True, hessp=hessian_product, method="trust-ncg", options={"gtol": _GRADIENT})
    return Ridge(solution.x * scale)
