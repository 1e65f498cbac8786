"""Skill of players, recovered from simulated strokes of players whose skill is known."""

import json
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from scipy.special import expit

from shuttle_marl.base.arrays import F64, Ints
from shuttle_marl.base.files import seal
from shuttle_marl.data.upstream import date_of, matches_of
from shuttle_marl.dynamics.features import Rows
from shuttle_marl.dynamics.skill import (
    GROUP,
    VARIANCES,
    FittedSkill,
    Predicted,
    check,
    deviations_in,
    fit_skill,
    shifts,
    summary,
)
from shuttle_marl.game.shipped import CARD, SKILL
from shuttle_marl.game.skill import COMPONENTS, load_skill
from shuttle_marl.game.stroke import N_SHOTS
from tests.dynamics.rows import plain_rows

PLAYERS, MATCHES, STROKES = 20, 36, 700
SD = np.array([0.3, 0.25, 0.25, 0.2, 0.1, 0.1, 0.1, 0.1, 0.1])
"""Standard deviations of the simulated players, in the order of :data:`~shuttle_marl.dynamics.skill.VARIANCES`."""


def rows_of(match: Ints, striker: Ints, receiver: Ints, shot: Ints, names: tuple[str, ...]) -> Rows:
    """Rows of which only the players, the match and the shot type matter."""
    players = np.array([f"p{i:02d}" for i in range(PLAYERS)])
    return plain_rows(
        len(match),
        codes={"shot": shot.astype(np.int16), "discipline": (striker % 2).astype(np.int16)},
        match=match.astype(np.int32), matches=names, striker=players[striker], receiver=players[receiver],
    )  # fmt: skip


def simulated(seed: int, years: float = 4.0) -> tuple[dict[str, Predicted], F64]:
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
    predicted, truth = simulated(0)
    return predicted, truth, fit_skill(predicted, sources(predicted), np.tile(SD, (3, 1)))


def test_intervals_of_known_players_cover_their_skill() -> None:
    """90 % intervals of 2 x 20 players in three components, general and in six groups of shots."""
    inside: list[F64] = []
    for seed in range(2):
        predicted, truth = simulated(seed)
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


def test_shifts_add_both_players_as_of_the_day(case: tuple[dict[str, Predicted], F64, FittedSkill]) -> None:
    predicted, _, fitted = case
    rows, skill = predicted["return"].rows, fitted.skill
    found = shifts(skill, "return", rows)
    for row in (0, 777, len(rows) - 1):
        day = date_of(rows.matches[rows.match[row]])
        expected = skill.of_shots(str(rows.striker[row]), str(rows.receiver[row]), day)[1, rows.codes["shot"][row]]
        assert found[row] == pytest.approx(expected)
    strangers = rows_of(rows.match[:3], np.array([0, 1, 2]), np.array([1, 2, 0]), rows.codes["shot"][:3], rows.matches)
    strangers.striker[:] = strangers.receiver[:] = "nobody"
    assert shifts(skill, "return", strangers) == pytest.approx(0)


def test_the_check_finds_too_little_shrinkage(case: tuple[dict[str, Predicted], F64, FittedSkill]) -> None:
    predicted, _, _ = case
    right = check(predicted, sources(predicted), np.tile(SD, (3, 1)))
    assert all(found["low"] - 0.1 < 1 < found["high"] + 0.1 for found in right.values())
    assert all(found["high"] - found["low"] < 0.7 for found in right.values())
    half = {name: part.take(part.rows.match < MATCHES // 2) for name, part in predicted.items()}
    assert check(half, sources(half), np.tile(8 * SD, (3, 1)))["success"]["high"] < 1


def test_a_single_match_has_skill_and_no_check(case: tuple[dict[str, Predicted], F64, FittedSkill]) -> None:
    predicted, _, _ = case
    one = {name: part.take(part.rows.match == 3) for name, part in predicted.items()}
    fitted = fit_skill(one, sources(one))
    assert len(fitted.skill.players) == len(fitted.skill.day) == 2
    assert np.isfinite(fitted.skill.offset).all()
    assert check(one, sources(one), fitted.sd) == {}


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
    # What a fit with a prior takes from the card.
    assert deviations_in(json.loads(json.dumps(card))) == pytest.approx(np.tile(SD, (3, 1)))
    assert deviations_in({}) is None


def test_dates_of_matches() -> None:
    assert all(date_of(match) is not None for split in ("train", "validation", "test") for match in matches_of(split))
    assert str(date_of("Kento_MOMOTA_CHOU_Tien_Chen_Fuzhou_Open_2019_Finals")) == "2019-11-10"
    assert str(date_of("club 2025-03-01 final")) == "2025-03-01"
    assert date_of("club 2025-13-41 final") is None
    assert date_of("12025-03-011") is None
