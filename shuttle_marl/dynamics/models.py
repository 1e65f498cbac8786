"""Fits of the models from strokes in context, and of what corrects them; ``docs/models.md`` describes the models.

Networks predict shot type and technique (``choice``), the target area given these (``target``), whether a stroke is good, out or
short: net, short of the net, foul (``success``), whether the opponent returns it (``return``), and meets it above the net
(``contact``). Targets of faults are latent: target and success networks are fitted by expectation maximisation over the nine
areas.

**Return and contact are blends**, means of logits: of the network, of small boosted trees, and, for the return, of a ridge
logistic regression on products of attributes. Adaptive optimisers overfit rare products, because they move them as fast as common
ones; the ridge shrinks products the more, the rarer they are, and trees group codes of an attribute with similar effects. Trees
correct the success model too: they do not read the target, and are fitted to out-of-fold predictions.
"""

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np
import torch
from scipy.optimize import minimize
from scipy.sparse import csr_matrix
from scipy.special import expit
from torch import Tensor
from torch.nn import functional

from shuttle_marl.base.arrays import F64, I16, I64, Bools, Floats, Ints
from shuttle_marl.data.schema import REASONS, Outcome
from shuttle_marl.dynamics import modules
from shuttle_marl.dynamics.boosting import PARAMETERS, lightgbm, stored_trees
from shuttle_marl.dynamics.features import NET_SHOT, SLOTS, Rows
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.stroke import N_TECHNIQUES

Loss = Callable[[Tensor, Tensor], Tensor]  # from the logits [K, B', outputs] of a batch and its row numbers [B] to losses [K, B]
_PENALTY: Final = 2.0
_GRADIENT: Final = 0.5  # norm of the gradient at convergence of the ridge; logits are accurate to some thousandths


@dataclasses.dataclass(frozen=True, kw_only=True)
class EnsembleConfig:
    """Settings of the fit of an ensemble, chosen on the validation matches."""

    epochs: int = 12
    batch: int = 1024
    learning_rate: float = 3e-3  # peak of the one-cycle schedule of AdamW
    decay: float = 0.2  # weight decay of the perceptron
    decay_linear: float = 1e-3  # weight decay of the linear part
    dropout: float = 0.2  # dropout probability of hidden units
    folds: int = 10  # number of folds of matches; member k leaves out fold k modulo this number
    members: int | None = None  # size of the ensemble; None: that of its `NetworkSpec`


QUICK: Final = EnsembleConfig(folds=5, members=5)  # half the cost, for refits; log-loss at most .2 % higher


def fault_class(rows: Rows) -> I64:
    """``[N]`` GOOD, OUT or SHORT; faults of unknown kind count as short."""
    fault = rows.outcome == Outcome.FAULT
    return np.where(~fault, modules.GOOD, np.where(rows.reason == REASONS.index("out"), modules.OUT, modules.SHORT))


def latent_target(rows: Rows) -> Bools:
    """``[N]`` whether the target is unknown: the shuttle fell short, or no landing was recorded."""
    return (fault_class(rows) == modules.SHORT) | (rows.codes["area"] < 0)


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


def mean_probabilities(network: modules.Ensemble, codes: dict[str, I16]) -> F64:
    """``[N, outputs]`` probabilities of the classes, averaged over the ensemble."""
    return np.asarray(softmax(network.logits(codes)).mean(axis=0))


def fit_choice(rows: Rows, config: EnsembleConfig, seed: int) -> modules.Ensemble:
    """Fit the choice of shot types and techniques, on all strokes."""
    label = labels_of("choice", rows)
    prior = np.log(np.bincount(label, minlength=modules.SPECS["choice"].outputs) + 1.0)
    labels = torch.from_numpy(label)

    def loss(logits: Tensor, batch: Tensor) -> Tensor:
        k, n, c = logits.shape
        y = labels[batch].expand(k, n)
        return functional.cross_entropy(logits.reshape(k * n, c), y.reshape(-1), reduction="none").view(k, n)

    return fit_ensemble(modules.SPECS["choice"], rows.codes, loss, rows.match, prior - prior.max(), config, seed)


def fit_target(rows: Rows, weights: F64, config: EnsembleConfig, seed: int) -> modules.Ensemble:
    """Fit the target areas to soft labels; ``weights``: ``[N, 9]`` probability of each target; rows of zeros are left out."""
    used = weights.sum(axis=1) > 0
    rows = rows.take(used)
    soft = torch.from_numpy(weights[used].astype(np.float32))
    prior = np.log(weights.sum(axis=0) + 1.0)

    def loss(logits: Tensor, batch: Tensor) -> Tensor:
        return -(soft[batch] * torch.log_softmax(logits, dim=-1)).sum(dim=-1)

    return fit_ensemble(modules.SPECS["target"], rows.codes, loss, rows.match, prior - prior.max(), config, seed)


def fit_success(rows: Rows, target: F64, config: EnsembleConfig, seed: int) -> modules.Ensemble:
    """Fit the outcome of strokes, summing over unknown targets; ``target``: ``[N, 9]`` probability of each target given the
    state, shot type and technique."""
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
    return fit_ensemble(modules.SPECS["success"], expanded, loss, rows.match, prior, config, seed, expand=expand)


def fit_binary(name: str, rows: Rows, label: Bools, config: EnsembleConfig, seed: int) -> modules.Ensemble:
    """Fit one of the networks with a single logit (return, contact)."""
    y = torch.from_numpy(label.astype(np.float32))
    rate = float(label.mean())

    def loss(logits: Tensor, batch: Tensor) -> Tensor:
        z = logits[:, :, 0]
        return functional.binary_cross_entropy_with_logits(z, y[batch].expand_as(z), reduction="none")

    prior = np.array([np.log(rate / (1 - rate))])
    return fit_ensemble(modules.SPECS[name], rows.codes, loss, rows.match, prior, config, seed)


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


def all_targets(success: modules.Ensemble, rows: Rows) -> F64:
    """``[K, N, 9, 3]`` probabilities of good, out, short for each of the nine targets."""
    return np.stack([softmax(success.logits(rows.with_area(a))) for a in range(N_AREAS)], axis=2)


def fit_ridge(codes: dict[str, I16], label: Bools, start: modules.Ridge | None = None) -> modules.Ridge:
    """Fit the ridge logistic regression; ``start``: a similar fit, from which the search starts."""
    active = modules.encode(modules.RIDGE, modules.attributes(codes)).numpy()
    n, width = len(active), sum(modules.RIDGE_SIZES)
    indptr = np.arange(0, active.size + 1, active.shape[1])
    x = csr_matrix((np.tile(modules.RIDGE_SCALES, n), active.ravel(), indptr), shape=(n, width))
    y = label.astype(np.float64)
    scale = np.r_[1.0, np.repeat(modules.RIDGE_SCALES, modules.RIDGE_SIZES)]
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
    return modules.Ridge(solution.x * scale)


def fold_of_match(matches: Ints, folds: int) -> I64:
    """``[N]`` fold of each row; matches are assigned to folds in turn, in the order of their first rows."""
    _, first, inverse = np.unique(matches, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    return rank[inverse] % folds


def fit_ensemble(
    spec: modules.NetworkSpec,
    codes: dict[str, I16],
    loss: Loss,
    matches: Ints,
    prior: Floats,
    config: EnsembleConfig,
    seed: int,
    expand: Callable[[Tensor], Tensor] | None = None,
) -> modules.Ensemble:
    """Fit all members at once; weights are rounded to half precision, in which they are stored, and computed with in double.

    Args:
        codes: ``[M]`` codes of the inputs.
        matches: ``[N]`` match of each row; the rows of a member's fold have weight zero.
        prior: ``[outputs]`` logits of an untrained network.
        expand: maps row numbers to the rows of ``codes`` that the loss needs; None: the same rows.
    """
    generator = torch.Generator().manual_seed(seed)
    spec = dataclasses.replace(spec, members=config.members or spec.members)
    model = modules.Ensemble(spec)
    model.initialise(generator, torch.as_tensor(prior, dtype=torch.float32))
    inputs = modules.attributes(codes)
    n = len(matches)
    fold = torch.from_numpy(fold_of_match(matches, config.folds))
    member_fold = torch.arange(spec.members) % config.folds
    weight = (fold[None, :] != member_fold[:, None]).float()
    weight /= weight.mean(dim=1, keepdim=True)
    groups = [
        {"params": [model.first, model.second, model.last], "weight_decay": config.decay},
        {"params": [model.linear], "weight_decay": config.decay_linear},
        {"params": [model.first_bias, model.second_bias, model.last_bias], "weight_decay": 0.0},
    ]
    optimiser = torch.optim.AdamW(groups, lr=config.learning_rate, fused=True)
    steps_per_epoch = max(1, n // config.batch)
    steps = config.epochs * steps_per_epoch
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, max_lr=config.learning_rate, total_steps=steps + 1, pct_start=0.15)
    for step in range(steps):
        if step % steps_per_epoch == 0:
            order = torch.randperm(n, generator=generator)
        start = step % steps_per_epoch * config.batch
        rows = order[start : start + config.batch]
        logits = model(inputs[rows if expand is None else expand(rows)], config.dropout, generator)
        total = (loss(logits, rows) * weight[:, rows]).mean(dim=1).sum()
        optimiser.zero_grad()
        torch.autograd.backward(total)
        optimiser.step()
        schedule.step()
    model.requires_grad_(False)
    # Half of the space in a file, which holds the model as it predicts.
    for weight in model.parameters():
        weight.copy_(weight.half())
    return model.double().eval()


def unseen(values: F64, matches: Ints, folds: int) -> F64:
    """Out-of-fold mean ``[N, ...]`` of ``[K, N, ...]`` values: over the members that were not fitted to a row's match."""
    fold = fold_of_match(matches, folds)
    left_out = (np.arange(len(values)) % folds)[:, None] == fold[None, :]
    extra = (1,) * (values.ndim - 2)
    return (values * left_out.reshape(*left_out.shape, *extra)).sum(axis=0) / left_out.sum(axis=0).reshape(-1, *extra)


_LEAVES: Final = 8
_ROUNDS: Final = 300  # chosen by cross-validation: 4 leaves with 200, 400, 600 rounds, 8 with 100, 200, 300


def fit_trees(
    codes: dict[str, I16],
    label: Bools,
    *,
    leaves: int = _LEAVES,
    rounds: int = _ROUNDS,
    rate: float = PARAMETERS["learning_rate"],
    offset: F64 | None = None,
) -> modules.Trees:
    """Fit trees that predict a binary label; ``offset``: ``[N]`` logits to which those of the trees are added (None: no
    offset)."""
    lgb = lightgbm()
    x = modules.attributes(codes).numpy()
    data = lgb.Dataset(x, label.astype(int), init_score=offset, categorical_feature=list(range(len(modules.INPUTS))))
    parameters = {**PARAMETERS, "num_leaves": leaves, "learning_rate": rate}
    arrays, nodes = stored_trees(lgb.train(parameters, data, num_boost_round=rounds), leaves)
    left = np.zeros(arrays["attribute"].shape, dtype=np.int32)
    for t, m, threshold in nodes:
        left[t, m] = sum(1 << int(code) for code in threshold.split("||"))
    return modules.Trees(left=left, **arrays)


_PRIOR_STROKES: Final = 20.0
_PRECISION: Final = 4.0  # precision of the normal prior of an offset of the log-odds; its standard deviation is 0.5


def fit_situations(logit: F64, share: F64, rows: Rows, *, levels: int = modules.LEVELS) -> tuple[F64, modules.Situations]:
    """Fit the calibration of the log-odds of faults together with the offsets of the situations.

    Args:
        logit: ``[N, M]`` out-of-fold logit of a fault for each of M targets.
        share: ``[N, M]`` probability of each target.
        rows: N strokes of known outcome.
        levels: L, levels of effort.

    Returns:
        ``[2]`` slope and intercept of the logit, and the situations.
    """
    known = (rows.attacks >= 0) & (rows.net_run >= 0)
    effort = np.minimum(rows.attacks, levels - 1)
    net = NET_SHOT[rows.codes["shot"]]
    columns = np.stack([effort, net & (rows.net_run >= modules.LONG_DUEL)], axis=1)[known].astype(np.float64)
    z, part, fault = logit[known], share[known], (rows.outcome == Outcome.FAULT)[known]

    def loss(x: F64) -> tuple[float, F64]:
        q = expit(x[0] * z + (x[1] + columns @ x[2:])[:, None])
        p = np.clip((part * q).sum(axis=1), 1e-9, 1 - 1e-9)
        value = -np.where(fault, np.log(p), np.log1p(-p)).sum() + 0.5 * _PRECISION * (x[2:] @ x[2:])
        slope = part * q * (1 - q)
        outer = np.where(fault, -1 / p, 1 / (1 - p))
        moved = outer * slope.sum(axis=1)
        gradient = np.r_[(outer * (slope * z).sum(axis=1)).sum(), moved.sum(), columns.T @ moved + _PRECISION * x[2:]]
        return value / len(z), gradient / len(z)

    found = minimize(loss, np.array([1.0, 0.0, 0.0, 0.0]), jac=True, method="BFGS", options={"gtol": 1e-8}).x
    count = np.zeros((SLOTS["own_shot"], levels))
    np.add.at(count, (rows.codes["own_shot"][known], effort[known]), 1)
    count[count.sum(axis=1) == 0] = count.sum(axis=0)  # that of all strokes for shot types without strokes
    third = known & net & (rows.net_run >= modules.LONG_DUEL - 1)
    situations = modules.Situations(
        effort=found[2] * np.arange(levels),
        duel=float(found[3]),
        effort_share=count / count.sum(axis=1, keepdims=True),
        duel_share=float((rows.net_run[third] >= modules.LONG_DUEL).sum() / max(1, third.sum())),
        hurried_share=_hurried_shares(rows),
    )
    return found[:2], situations


def _hurried_shares(rows: Rows) -> F64:
    count = rows.take(rows.hurried >= 0).count("hurried", "incoming_shot", "shot")
    total = count.sum(axis=(0, 2))
    usual = (count[1].sum(axis=1) / np.maximum(total, 1))[:, None]
    return np.asarray((count[1] + _PRIOR_STROKES * usual) / (count.sum(axis=0) + _PRIOR_STROKES))


def intended_targets(target: modules.Ensemble, success: modules.Ensemble, rows: Rows) -> F64:
    """``[N, 9]`` probability of each target given the outcome; rows of unknown outcome are zero."""
    soft = known_targets(rows)
    latent = np.flatnonzero(latent_target(rows) & known_outcome(rows))
    hidden = rows.take(latent)
    probability = all_targets(success, hidden).mean(axis=0)
    label = fault_class(hidden)
    joint = mean_probabilities(target, hidden.codes) * probability[np.arange(len(hidden)), :, label]
    soft[latent] = joint / joint.sum(axis=1, keepdims=True)
    return soft


def known_targets(rows: Rows) -> F64:
    """``[N, 9]`` one-hot target; zero where it is unknown."""
    soft = np.zeros((len(rows), N_AREAS))
    seen = np.flatnonzero(~latent_target(rows))
    soft[seen, rows.codes["area"][seen]] = 1.0
    return soft
