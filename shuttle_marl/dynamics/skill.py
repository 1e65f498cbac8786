"""Skill of single players: partially pooled offsets of the average game's log-odds, by Laplace-approximated marginal likelihood.

``docs/pairs.md`` describes the model. A positive offset means more faults (``success``, of strokes of known outcome), that a good
stroke is returned more often (``return``), or that a returned one is met above the net more often (``contact``). General offsets
follow a random walk over the dates of the player's matches (Ingram, J. Quant. Anal. Sports 2019, for tennis). The variances are
those of maximum marginal likelihood; the change in a year is given (:data:`YEAR`).
"""

import dataclasses
import datetime
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from safetensors.numpy import save
from scipy.linalg import cho_solve, cholesky
from scipy.linalg.lapack import dpotri
from scipy.optimize import minimize
from scipy.sparse import block_diag, csr_matrix, identity
from scipy.special import expit
from threadpoolctl import threadpool_limits

from shuttle_marl.base.arrays import F64, I8, I64, Bools, Ints
from shuttle_marl.base.files import replace_file
from shuttle_marl.data.upstream import date_of
from shuttle_marl.dynamics.features import Rows
from shuttle_marl.dynamics.models import fold_of_match, sigmoid
from shuttle_marl.game.pairs import AVERAGE, COMPONENTS, GROUPS, ROLES, Skill
from shuttle_marl.game.shipped import SKILL
from shuttle_marl.game.stroke import N_SHOTS, SHOTS

BOUNDS: Final = (0.005, 2.0)  # range of a standard deviation; the lower bound stands for no variance
_TOLERANCE: Final = 1e-9  # squared Newton decrement at convergence, in nats
_STEPS: Final = 50
_FIRST: Final = 0.1  # standard deviation from which the search starts
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
    """Logistic regression with normal random effects: N binary observations with G distinct rows of effects.

    The log-odds of row i are an offset plus x_i'b. The effects b have the prior precision P = D' diag(1 / v) D: their innovations
    D b are independent, with mean 0 and variance v_j = s_j exp(2 t_c), where s_j is a known scale and t_c the log standard
    deviation of the variance component c of innovation j. D is the identity for independent effects, and takes differences of a
    random walk. With the posterior mode b and H = X'WX + P, the negative log marginal likelihood is approximately
    -l(b) + b'Pb / 2 + log|H| / 2 - log|P| / 2 (Tierney and Kadane, JASA 1986), as in lme4 (Bates et al., J. Stat. Softw. 2015).
    """

    x: csr_matrix  # [G, E] coefficients of the effects in each distinct row
    row: Ints  # [N] distinct row of each observation
    offset: F64  # [N] log-odds without effects
    label: Bools  # [N] observations
    difference: csr_matrix  # [E, E] D, with determinant 1
    component: Ints  # [E] variance component of each innovation
    scale: F64  # [E] variance of each innovation relative to that of its component

    @property
    def components(self) -> int:
        """Number of variance components."""
        return int(self.component.max()) + 1


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Posterior:
    """Posterior of the effects given the standard deviations."""

    sd: F64  # [C] standard deviation of each component
    mode: F64  # [E] posterior mode
    covariance: F64  # [E, E] inverse of the negative Hessian at the mode
    log_likelihood: float  # Laplace approximation of the log marginal likelihood

    @property
    def deviation(self) -> F64:
        """``[E]`` posterior standard deviations."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def posterior(model: MixedModel, sd: F64, start: F64 | None = None) -> Posterior:
    """Mode and curvature of the posterior, by Newton's method with step halving; ``sd``: ``[C]`` standard deviations of the
    components; ``start``: ``[E]`` initial effects."""
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
    """``[C]`` gradient of the log marginal likelihood in the log standard deviations; exact, W changes with the mode."""
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


def fit_variances(model: MixedModel, fixed: F64 | None = None) -> Posterior:
    """The posterior at the standard deviations of maximum marginal likelihood; ``fixed``: ``[C]`` standard deviations that are
    given; NaN, or None for all, where they are estimated."""
    given = np.log(np.full(model.components, np.nan) if fixed is None else fixed)
    mode: F64 | None = None

    def objective(log_sd: F64) -> tuple[float, F64]:
        nonlocal mode
        found = posterior(model, np.exp(log_sd), mode)
        mode = found.mode
        return -found.log_likelihood, -gradient_of(model, found)

    low, high = (np.where(np.isnan(given), np.log(bound), given) for bound in BOUNDS)
    first = np.where(np.isnan(given), np.log(_FIRST), given)
    options = {"ftol": 1e-9, "gtol": 1e-2}
    found = minimize(objective, first, jac=True, method="L-BFGS-B", bounds=np.stack([low, high], axis=1), options=options)
    return posterior(model, np.exp(found.x), mode)


SHOTS_OF_GROUP: Final[dict[str, tuple[str, ...]]] = {  # shot types that share an offset, by the group (`GROUPS`)
    "attack": ("smash", "half-smash", "net-kill"),
    "net": ("net-shot", "cross-court-net-shot"),
    "rear": ("clear", "drop"),
    "lift": ("lift", "push"),
    "block": ("block", "drive"),
    "serve": ("short-serve", "long-serve"),
}
GROUP: Final[I8] = np.array([[shot in SHOTS_OF_GROUP[group] for group in GROUPS].index(True) for shot in SHOTS], dtype=np.int8)
VARIANCES: Final = ("striker", "striker_group", "receiver", "receiver_group", "year", "match", "side", "match_group", "source")
"""Variance components: general and group offsets of each role, change of the general ones in a year, nuisance effects."""
YEAR: Final = 0.05  # standard deviation of the change of a general offset in a year
_FIXED: Final = np.where(np.array(VARIANCES) == "year", YEAR, np.nan)
_FOLDS: Final = 5
_EPOCH: Final = datetime.date(1970, 1, 1)


@dataclasses.dataclass(frozen=True, eq=False)
class Predicted:
    """Strokes of one component with the average player's predictions."""

    rows: Rows  # N strokes
    label: Bools  # [N] what happened: a fault, a return, or a contact above the net
    logit: F64  # [N] log-odds from models that were not fitted to the match

    def take(self, which: Bools) -> "Predicted":
        """Strokes by mask."""
        return Predicted(self.rows.take(which), self.label[which], self.logit[which])


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class FittedSkill:
    """Result of a fit."""

    skill: Skill  # offsets of the players on the days of their matches
    sd: F64  # [3, 9] standard deviations of the `VARIANCES` of each component

    def save(self, folder: Path) -> None:
        """Write the offsets to a model folder; :func:`shuttle_marl.game.pairs.load_skill` reads them."""
        arrays = {f.name: getattr(self.skill, f.name) for f in dataclasses.fields(Skill) if f.name != "players"}
        header = json.dumps({"players": self.skill.players}, sort_keys=True)
        replace_file(folder / SKILL, save(arrays, metadata={"skill": header}))


def shifts(skill: Skill, component: str, rows: Rows) -> F64:
    """``[N]`` offset of each stroke's log-odds by both players as of the day of the match; unknown players have none."""
    parties = np.stack([rows.match.astype(str), *(getattr(rows, role) for role in ROLES)])
    found, row = np.unique(parties, axis=1, return_inverse=True)
    known = {*skill.players}
    table = np.zeros((found.shape[1], len(COMPONENTS), N_SHOTS))
    for i, (match, striker, receiver) in enumerate(found.T.tolist()):
        names = (name if name in known else AVERAGE for name in (striker, receiver))
        table[i] = skill.of_shots(next(names), next(names), date_of(rows.matches[int(match)]))
    return np.asarray(table[row.ravel(), COMPONENTS.index(component), rows.codes["shot"]])


def fit_skill(predicted: Mapping[str, Predicted], sources: Mapping[str, str], sd: F64 | None = None) -> FittedSkill:
    """Fit the offsets of all players; ``predicted``: strokes by component, all from one table of matches; ``sources``: data set
    of each match by name; ``sd``: ``[3, 9]`` standard deviations of the components (None: estimate them)."""
    design = _Design.of(predicted, sources)
    # Another order of summation would give other offsets.
    with threadpool_limits(1):
        models = [design.model(predicted[name]) for name in COMPONENTS]
        fits = [fit_variances(model, _FIXED) if sd is None else posterior(model, sd[c]) for c, model in enumerate(models)]
    struck, players = predicted["success"].rows, len(design.players)
    striker = design.index(struck.striker)
    pairs = np.unique(np.stack([striker, struck.match]), axis=1)[0]
    discipline, hand = np.zeros(players, dtype=np.int8), np.full(players, -1, dtype=np.int8)
    for role, known in zip(ROLES, (struck.hand, struck.receiver_hand), strict=True):
        discipline[design.index(getattr(struck, role))] = struck.codes["discipline"]
        hand[design.index(getattr(struck, role))] = known
    offset, deviation = (
        np.stack([design.offsets(x) for x in values], axis=1).astype(np.float32)
        for values in ([found.mode for found in fits], [found.deviation for found in fits])
    )
    skill = Skill(
        players=tuple(design.players.tolist()),
        offset=offset,
        deviation=deviation,
        player=design.walks.player.astype(np.int32),
        day=design.walks.day.astype(np.int32),
        group=GROUP,
        discipline=discipline,
        hand=hand,
        strokes=np.bincount(striker, minlength=players).astype(np.int32),
        matches=np.bincount(pairs, minlength=players).astype(np.int32),
    )
    return FittedSkill(skill=skill, sd=np.stack([found.sd for found in fits]))


def check(predicted: Mapping[str, Predicted], sources: Mapping[str, str], sd: F64) -> dict[str, dict[str, float]]:
    """Slope of truth on predicted offset by component, each match predicted from the others; 1 if the shrinkage is right.

    Args:
        predicted, sources: as for :func:`fit_skill`.
        sd: ``[3, 9]`` standard deviations of the components.

    Returns:
        What :func:`slope_on_offset` returns for each component; no component without a player of two matches.
    """
    predicted = {name: predicted[name] for name in COMPONENTS}
    matches = np.unique(predicted["success"].rows.match)
    fold = np.zeros(int(matches[-1]) + 1, dtype=np.int64)
    fold[matches] = fold_of_match(matches, _FOLDS)
    shift = {name: np.zeros(len(part.label)) for name, part in predicted.items()}
    for k in np.unique(fold[matches]):
        inside = {name: fold[part.rows.match] == k for name, part in predicted.items()}
        if not all((~mask).any() for mask in inside.values()):
            continue
        others = fit_skill({name: part.take(~inside[name]) for name, part in predicted.items()}, sources, sd).skill
        for name, part in predicted.items():
            shift[name][inside[name]] = shifts(others, name, part.rows.take(inside[name]))
    return {
        name: slope_on_offset(part.logit, shift[name], part.label, part.rows.match)
        for name, part in predicted.items()
        if shift[name].any()
    }


def slope_on_offset(logit: F64, shift: F64, label: Bools, match: Ints) -> dict[str, float]:
    """Logistic regression of labels on offsets of log-odds, with an intercept.

    Args:
        logit: ``[N]`` log-odds without offset.
        shift: ``[N]`` predicted offsets.

    Returns:
        ``slope``, and the bounds ``low`` and ``high`` of its 95 % interval, with errors clustered by match.
    """
    x = np.stack([np.ones_like(shift), shift], axis=1)

    def loss(line: F64) -> tuple[float, F64]:
        z = logit + x @ line
        return float(np.logaddexp(0, z).sum() - z[label].sum()), x.T @ (sigmoid(z) - label)

    line = minimize(loss, np.zeros(2), jac=True, method="BFGS").x
    p = sigmoid(logit + x @ line)
    index = np.unique(match, return_inverse=True)[1]
    score = np.zeros((index.max() + 1, 2))
    np.add.at(score, index, x * (p - label)[:, None])
    bread = np.linalg.pinv(x.T @ (x * (p * (1 - p))[:, None]))
    slope, error = float(line[1]), 1.96 * float(np.sqrt((bread @ score.T @ score @ bread)[1, 1]))
    return {"slope": slope, "low": slope - error, "high": slope + error}


def summary(fitted: FittedSkill, checked: dict[str, dict[str, float]]) -> dict[str, Any]:
    """Entry of the model card; ``checked`` as :func:`check` gives it."""
    rows = zip(COMPONENTS, fitted.sd.tolist(), strict=True)
    days = [str(_EPOCH + datetime.timedelta(days=int(day))) for day in (fitted.skill.day.min(), fitted.skill.day.max())]
    return {
        "players": len(fitted.skill.players),
        "days": days,
        "deviations": {name: dict(zip(VARIANCES, row, strict=True)) for name, row in rows},
        "check": checked,
    }


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class _Design:
    """Effects of all components, in this order: general offsets of strikers ``[K]``, of receivers ``[K]``, offsets of strikers in
    groups ``[P, 6]``, of receivers ``[P, 6]``, matches ``[M]``, sides ``[M, 2]``, groups in matches ``[M, 6]`` and data sets
    ``[S, 6]``."""

    players: npt.NDArray[np.str_]
    walks: Walks
    day: I64
    source: I64

    @classmethod
    def of(cls, predicted: Mapping[str, Predicted], sources: Mapping[str, str]) -> "_Design":
        strokes = [part.rows for part in predicted.values()]
        players = np.unique(np.concatenate([getattr(rows, role) for rows in strokes for role in ROLES]))
        day = days_of(strokes[0])
        of_rows = [(np.searchsorted(players, getattr(rows, role)), day[rows.match]) for rows in strokes for role in ROLES]
        walks = Walks.of(*(np.concatenate(column) for column in zip(*of_rows, strict=True)))
        names = [sources.get(match, "") for match in strokes[0].matches]
        source = np.unique(names, return_inverse=True)[1]
        return cls(players=players, walks=walks, day=day, source=source)

    def index(self, players: npt.NDArray[np.str_]) -> I64:
        return np.searchsorted(self.players, players)

    def model(self, part: Predicted) -> MixedModel:
        rows, groups = part.rows, len(GROUPS)
        roles = [self.index(getattr(rows, role)) for role in ROLES]
        side = (roles[0] > roles[1]).astype(np.int64)
        # Strokes of one side of a match in one group have the same effects.
        key = (rows.match.astype(np.int64) * 2 + side) * groups + GROUP[rows.codes["shot"]]
        distinct, first, row = np.unique(key, return_index=True, return_inverse=True)
        match, group = rows.match[first].astype(np.int64), distinct % groups
        matches, of_match = np.unique(match, return_inverse=True)
        striker, receiver = (role[first] for role in roles)
        knots, players, sources = len(self.walks), len(self.players), int(self.source.max() + 1)
        # Variance component, number of effects, and ``[G]`` the effect of each row.
        effects: list[tuple[str, int, I64]] = [
            ("striker", knots, self.walks.index(striker, self.day[match])),
            ("receiver", knots, self.walks.index(receiver, self.day[match])),
            ("striker_group", players * groups, striker * groups + group),
            ("receiver_group", players * groups, receiver * groups + group),
            ("match", len(matches), of_match),
            ("side", 2 * len(matches), of_match * 2 + side[first]),
            ("match_group", len(matches) * groups, of_match * groups + group),
            ("source", sources * groups, self.source[match] * groups + group),
        ]
        start = np.cumsum([0, *(size for _, size, _ in effects)])
        columns = np.stack([index for *_, index in effects], axis=1) + start[:-1]
        x = csr_matrix(
            (np.ones(columns.size), columns.ravel(), np.arange(0, columns.size + 1, len(effects))),
            shape=(len(distinct), start[-1]),
        )
        walk, is_first, years = self.walks.innovations()
        component = np.repeat([VARIANCES.index(name) for name, *_ in effects], [size for _, size, _ in effects])
        component[: 2 * knots][~np.tile(is_first, 2)] = VARIANCES.index("year")
        return MixedModel(
            x=x,
            row=row,
            offset=part.logit,
            label=part.label,
            difference=csr_matrix(block_diag([walk, walk, identity(int(start[-1] - start[2]))])),
            component=component,
            scale=np.concatenate([years, years, np.ones(int(start[-1] - start[2]))]),
        )

    def offsets(self, effects: F64) -> F64:
        """``[K, 2, 7]`` offsets of the players at each knot, or their standard deviations."""
        knots, players, groups = len(self.walks), len(self.players), len(GROUPS)
        general = effects[: 2 * knots].reshape(2, knots).T
        grouped = effects[2 * knots :][: 2 * players * groups].reshape(2, players, groups).swapaxes(0, 1)
        return np.concatenate([general[:, :, None], grouped[self.walks.player]], axis=2)


def days_of(rows: Rows) -> I64:
    """``[matches]`` day of each match; matches of unknown date have the last one of the others, or day 0."""
    days = [None if (date := date_of(match)) is None else (date - _EPOCH).days for match in rows.matches]
    last = max((day for day in days if day is not None), default=0)
    return np.array([last if day is None else day for day in days], dtype=np.int64)
