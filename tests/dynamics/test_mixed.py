"""Mixed logistic regression against quadrature and lme4, and the skill of players that it recovers from simulated strokes."""

from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import dblquad, quad
from scipy.optimize import minimize
from scipy.sparse import csr_matrix, identity
from scipy.special import expit, gammaln
from scipy.stats import multivariate_normal, norm

from shuttle_marl.base.arrays import F64, I64, Ints
from shuttle_marl.base.files import seal
from shuttle_marl.data.upstream import date_of, matches_of
from shuttle_marl.dynamics.features import Rows
from shuttle_marl.dynamics.skill import (
    GROUP,
    VARIANCES,
    FittedSkill,
    MixedModel,
    Predicted,
    Walks,
    check,
    fit_skill,
    fit_variances,
    gradient_of,
    posterior,
    summary,
)
from shuttle_marl.game.pairs import COMPONENTS, load_skill
from shuttle_marl.game.shipped import CARD, SKILL
from shuttle_marl.game.stroke import N_SHOTS
from tests import golden
from tests.dynamics.rows import plain_rows

CBPP = (
    "2/14 3/12 4/9 0/5", "3/22 1/18 1/21 -", "8/22 2/16 0/16 2/20", "2/10 0/10 2/9 0/6", "5/18 0/25 0/24 1/4",
    "3/17 0/17 0/18 1/20", "8/16 1/10 3/9 0/5", "12/34 - - -", "2/9 0/6 0/8 0/6", "1/22 1/22 0/18 2/22", "0/25 5/27 3/22 1/22",
    "2/10 1/8 0/6 0/5", "1/21 2/24 0/19 0/23", "11/19 0/2 0/3 0/2", "1/19 1/15 1/15 0/15",
)  # fmt: skip
"""Cattle with pleuropneumonia of the examined ones, by herd and period (Lesnoff et al., Prev. Vet. Med. 2004; lme4's cbpp)."""


def independent(component: I64, x: F64, row: I64, offset: F64, label: F64) -> MixedModel:
    effects = len(component)
    return MixedModel(
        x=csr_matrix(x), row=row, offset=offset, label=label.astype(bool), difference=csr_matrix(identity(effects)),
        component=component, scale=np.ones(effects),
    )  # fmt: skip


def simulated(sd: tuple[float, float], seed: int, players: int = 30, n: int = 6000) -> tuple[MixedModel, F64]:
    """Players with a general effect and one in each of three situations; the model and the true effects."""
    rng = np.random.default_rng(seed)
    player, situation = rng.integers(players, size=n), rng.integers(3, size=n)
    effects = np.r_[rng.normal(0, sd[0], players), rng.normal(0, sd[1], 3 * players)]
    row, offset = player * 3 + situation, rng.normal(-1, 1, n)
    x = np.concatenate([np.repeat(np.eye(players), 3, axis=0), np.eye(3 * players)], axis=1)
    label = rng.random(n) < expit(offset + (x @ effects)[row])
    component = np.repeat([0, 1], [players, 3 * players])
    return independent(component, x, row, offset, label), effects


def test_the_marginal_likelihood_is_that_of_quadrature() -> None:
    rng = np.random.default_rng(0)
    row, offset, sd = np.repeat([0, 1, 2], [40, 60, 80]), rng.normal(-1, 1, 180), 0.7
    label = rng.random(180) < expit(offset + np.array([0.8, -0.5, 0.1])[row])
    model = independent(np.zeros(3, np.int64), np.eye(3), row, offset, label)

    def density(b: float, k: int) -> float:
        p = expit(offset[row == k] + b)
        return float(np.where(label[row == k], p, 1 - p).prod() * norm.pdf(b, 0, sd))

    exact = sum(np.log(quad(density, -6, 6, args=(k,), epsabs=0, points=[-1, 0, 1])[0]) for k in range(3))
    assert posterior(model, np.array([sd])).log_likelihood == pytest.approx(exact, abs=0.03)
    # Without observations, the integral is that of the prior.
    empty = independent(np.zeros(3, np.int64), np.eye(3), row[:0], offset[:0], label[:0])
    assert posterior(empty, np.array([sd])).log_likelihood == pytest.approx(0, abs=1e-12)


def walking(seed: int) -> MixedModel:
    """One player on two days, 1.5 years apart."""
    rng = np.random.default_rng(seed)
    walks = Walks.of(np.zeros(2, np.int64), np.array([100, 648]))
    difference, first, years = walks.innovations()
    row = np.repeat([0, 1], [70, 90])
    return MixedModel(
        x=csr_matrix(np.eye(2)), row=row, offset=np.full(160, -0.5), label=rng.random(160) < np.array([0.5, 0.3])[row],
        difference=difference, component=np.where(first, 0, 1), scale=years,
    )  # fmt: skip


def test_a_random_walk_is_that_of_quadrature() -> None:
    model, sd = walking(1), np.array([0.6, 0.4])
    years = 548 / 365.25
    covariance = np.array([[0.36, 0.36], [0.36, 0.36 + 0.16 * years]])

    def density(b: float, a: float) -> float:
        p = expit(-0.5 + np.array([a, b])[model.row])
        return float(np.where(model.label, p, 1 - p).prod() * multivariate_normal.pdf([a, b], cov=covariance))

    scale = 2.0 ** len(model.label)
    integral = dblquad(lambda b, a: scale * density(b, a), -2, 2, -2, 2, epsabs=1e-3, epsrel=1e-3)[0]
    assert posterior(model, sd).log_likelihood == pytest.approx(np.log(integral / scale), abs=0.03)


def test_the_mode_is_that_of_a_penalised_regression() -> None:
    (plain, _), walk = simulated((0.4, 0.2), 3, players=5, n=400), walking(2)
    for model, sd in ((plain, np.array([0.4, 0.2])), (walk, np.array([0.6, 0.4]))):
        x = model.x.toarray()[model.row]
        inverse = np.linalg.inv(model.difference.toarray())
        precision = np.linalg.inv(inverse @ np.diag(model.scale * sd[model.component] ** 2) @ inverse.T)

        def loss(b: F64, x: F64 = x, model: MixedModel = model, precision: F64 = precision) -> float:
            z = model.offset + x @ b
            return float(np.logaddexp(0, np.where(model.label, -z, z)).sum() + b @ precision @ b / 2)

        found = posterior(model, sd)
        assert found.mode == pytest.approx(minimize(loss, np.zeros(x.shape[1]), tol=1e-8).x, abs=1e-4)
        p = expit(model.offset + x @ found.mode)
        hessian = x.T @ (x * (p * (1 - p))[:, None]) + precision
        assert found.covariance == pytest.approx(np.linalg.inv(hessian), rel=1e-6, abs=1e-9)


def test_the_gradient_is_that_of_the_marginal_likelihood() -> None:
    model, _ = simulated((0.3, 0.2), 4, n=3000)
    for sd in (np.array([0.3, 0.1]), np.array([0.05, 0.6])):
        gradient = gradient_of(model, posterior(model, sd))
        for c in range(2):
            step = np.exp(1e-4 * np.eye(2)[c])
            change = posterior(model, sd * step).log_likelihood - posterior(model, sd / step).log_likelihood
            assert gradient[c] == pytest.approx(change / 2e-4, abs=1e-3)


def test_lme4_finds_the_same() -> None:
    """``glmer(cbind(incidence, size - incidence) ~ period + (1 | herd), binomial)`` of lme4 1.1, from its documentation."""
    intercept, periods = -1.3983, np.array([0, -0.9919, -1.1282, -1.5797])
    constant, herds, offsets, labels = 0.0, [], [], []
    for herd, line in enumerate(CBPP):
        for period, cell in enumerate(line.split()):
            if cell != "-":
                cases, size = map(int, cell.split("/"))
                herds += [herd] * size
                offsets += [intercept + periods[period]] * size
                labels += [True] * cases + [False] * (size - cases)
                constant += float(gammaln(size + 1) - gammaln(cases + 1) - gammaln(size - cases + 1))
    model = independent(np.zeros(15, np.int64), np.eye(15), np.array(herds), np.array(offsets), np.array(labels))
    found = fit_variances(model)
    assert found.sd[0] == pytest.approx(0.6421, abs=2e-4)
    assert found.log_likelihood + constant == pytest.approx(-92.0266, abs=1e-3)


PLAYERS, MATCHES, STROKES = 20, 36, 700
SD = np.array([0.3, 0.25, 0.25, 0.2, 0.1, 0.1, 0.1, 0.1, 0.1])
"""Standard deviations of the simulated_players players, in the order of :data:`~shuttle_marl.dynamics.skill.VARIANCES`."""


def rows_of(match: Ints, striker: Ints, receiver: Ints, shot: Ints, names: tuple[str, ...]) -> Rows:
    """Rows of which only the players, the match and the shot type matter."""
    players = np.array([f"p{i:02d}" for i in range(PLAYERS)])
    return plain_rows(
        len(match),
        codes={"shot": shot.astype(np.int16), "discipline": (striker % 2).astype(np.int16)},
        match=match.astype(np.int32), matches=names, striker=players[striker], receiver=players[receiver],
    )  # fmt: skip


def simulated_players(seed: int, years: float = 4.0) -> tuple[dict[str, Predicted], F64]:
    """Strokes by component, and the true ``[PLAYERS, MATCHES, 3, 2, 7]`` offsets as of each match."""
    rng = np.random.default_rng(seed)
    sd = dict(zip(VARIANCES, SD, strict=True))
    day = np.sort(rng.integers(0, int(365 * years), MATCHES))
    names = tuple(f"{np.datetime64('2020-01-01') + int(d)} match {m}" for m, d in enumerate(day))
    # Each player meets others of the same parity, so of the same discipline.
    pair = np.stack([rng.choice(np.arange(m % 2, PLAYERS, 2), 2, replace=False) for m in range(MATCHES)])
    match = np.repeat(np.arange(MATCHES), STROKES)
    side = rng.integers(0, 2, len(match))
    striker, receiver, shot = pair[match, side], pair[match, 1 - side], rng.integers(0, N_SHOTS, len(match))
    rows = rows_of(match, striker, receiver, shot, names)
    step = np.sqrt(np.diff(day, prepend=day[0]) / 365.25)[:, None, None] * sd["year"]
    walk = np.cumsum(rng.normal(size=(PLAYERS, MATCHES, 3, 2)) * step, axis=1)
    general = rng.normal(size=(PLAYERS, 1, 3, 2)) * [sd["striker"], sd["receiver"]] + walk
    group = rng.normal(size=(PLAYERS, 1, 3, 2, 6)) * np.array([sd["striker_group"], sd["receiver_group"]])[:, None]
    truth = np.concatenate([general[..., None], np.broadcast_to(group, (PLAYERS, MATCHES, 3, 2, 6))], axis=-1)
    predicted = {}
    for component, name in enumerate(COMPONENTS):
        shift = rng.normal(0, sd["match"], MATCHES)[match] + rng.normal(0, sd["side"], (MATCHES, 2))[match, side]
        shift += rng.normal(0, sd["match_group"], (MATCHES, 6))[match, GROUP[shot]]
        shift += rng.normal(0, sd["source"], (2, 6))[match % 2, GROUP[shot]]
        for role, player in enumerate((striker, receiver)):
            own = truth[player, match, component, role]
            shift += own[:, 0] + own[np.arange(len(own)), 1 + GROUP[shot]]
        logit = rng.normal(-1.5, 0.7, len(match))
        predicted[name] = Predicted(rows=rows, logit=logit, label=rng.random(len(match)) < expit(logit + shift))
    return predicted, truth


def sources(predicted: dict[str, Predicted]) -> dict[str, str]:
    return {name: f"set {m % 2}" for m, name in enumerate(predicted["success"].rows.matches)}


@pytest.fixture(scope="module")
def case() -> tuple[dict[str, Predicted], F64, FittedSkill]:
    predicted, truth = simulated_players(0)
    return predicted, truth, fit_skill(predicted, sources(predicted), np.tile(SD, (3, 1)))


def test_intervals_of_known_players_cover_their_skill() -> None:
    inside: list[F64] = []
    for seed in range(2):
        predicted, truth = simulated_players(seed)
        skill = fit_skill(predicted, sources(predicted), np.tile(SD, (3, 1))).skill
        days = [str(date_of(name)) for name in predicted["success"].rows.matches]
        match = np.array([days.index(str(np.datetime64(0, "D") + int(day))) for day in skill.day])
        number = np.array([int(name[1:]) for name in skill.players])[skill.player]
        inside.append(np.abs(skill.offset - truth[number, match]) < 1.645 * skill.deviation)
    covered = np.concatenate(inside)
    assert covered.mean() == pytest.approx(0.9, abs=0.03)
    assert covered[..., 0].mean() == pytest.approx(0.9, abs=0.05)
    for role in range(2):
        assert covered[:, :, role].mean() == pytest.approx(0.9, abs=0.05)


def test_the_check_finds_too_little_shrinkage(case: tuple[dict[str, Predicted], F64, FittedSkill]) -> None:
    predicted, _, _ = case
    right = check(predicted, sources(predicted), np.tile(SD, (3, 1)))
    assert all(found["low"] - 0.1 < 1 < found["high"] + 0.1 for found in right.values())
    assert all(found["high"] - found["low"] < 0.7 for found in right.values())
    half = {name: part.take(part.rows.match < MATCHES // 2) for name, part in predicted.items()}
    assert check(half, sources(half), np.tile(8 * SD, (3, 1)))["success"]["high"] < 1


def test_a_model_folder_has_the_skill(case: tuple[dict[str, Predicted], F64, FittedSkill], tmp_path: Path) -> None:
    _, _, fitted = case
    fitted.save(tmp_path)
    first = (tmp_path / SKILL).read_bytes()
    fitted.save(tmp_path)
    assert (tmp_path / SKILL).read_bytes() == first
    card = {"skill": summary(fitted, {}), "sha256": {SKILL: sha256(first).hexdigest()}}
    (tmp_path / CARD).write_bytes(seal(card))
    read = load_skill(tmp_path)
    assert read.players == fitted.skill.players
    assert (read.offset == fitted.skill.offset).all()
    assert (read.deviation > 0).all()
    assert (read.group == GROUP).all()
    offset, deviation = (golden.weighted_sum(part.ravel()) for part in (read.offset, read.deviation))
    figures = {"offset": offset, "deviation": deviation, "summary": card["skill"]}
    golden.check("dynamics", {"skill": figures}, 1e-3)


def test_dates_of_matches() -> None:
    assert all(date_of(match) is not None for split in ("train", "validation", "test") for match in matches_of(split))
    assert str(date_of("Kento_MOMOTA_CHOU_Tien_Chen_Fuzhou_Open_2019_Finals")) == "2019-11-10"
    assert str(date_of("club 2025-03-01 final")) == "2025-03-01"
    assert date_of("club 2025-13-41 final") is None
    assert date_of("12025-03-011") is None
