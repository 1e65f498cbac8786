"""Where people wait and what it changes: planted effects return, sides are those of the receiver's hand, files are whole."""

import dataclasses
import functools
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from scipy.special import expit

from shuttle_marl.base.tensor_files import read_tensors
from shuttle_marl.data import read_matches
from shuttle_marl.data.schema import STROKES, Outcome
from shuttle_marl.dynamics.evaluate import as_markdown, write_card
from shuttle_marl.dynamics.features import Rows, rows_from_strokes
from shuttle_marl.dynamics.recovery import (
    FEATURES,
    GROUPS,
    LEAST_SHARE,
    MIN_ROWS,
    FittedRecovery,
    fit_recovery,
    load_recovery,
    save_recovery,
)
from shuttle_marl.dynamics.skill import Predicted
from shuttle_marl.game.draws import CHOICE_ONE
from shuttle_marl.game.layout import GameError
from shuttle_marl.game.recovery import EFFECTS, N_POSITIONS, STEP, Recovery
from shuttle_marl.game.shipped import POSITIONS, load_game, model_folder, read_model_card
from shuttle_marl.game.stroke import N_SERVES, SHOTS
from tests import golden
from tests.dynamics.rows import plain_rows

SAMPLE = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"
N = 120_000
PLACES = np.array([(x, y) for y in (2.6, 3.8, 5.0) for x in (1.0, 0.0, -1.0)], dtype=np.float32)
"""One place in each position."""
MET = np.array([(x, y) for y in (2.0, 4.0, 5.8) for x in (1.4, 0.1, -1.1)])
"""Where a stroke to each area is met."""
TRUTH = np.array([
    [[0.7, 0.2, 0.0], [0.4, 0.0, 0.5], [0.7, 0.0, 0.0], [0.0, 0.0, 0.1]],
    [[-0.3, 0.0, 0.3], [-0.4, -0.3, 0.0], [-0.4, -0.4, 0.2], [-0.3, 0.0, -0.4]],
    [[0.4, 0.6, 0.0], [0.1, 0.0, 0.3], [0.4, -0.1, 0.3], [0.2, 0.0, 0.5]],
])  # fmt: skip
GROUP = {shot: group for group, shots in enumerate(GROUPS.values()) for shot in shots}


def waits(position: np.ndarray, area: np.ndarray) -> np.ndarray:
    """The features, computed otherwise."""
    away = PLACES[position] - MET[area]
    return np.stack([abs(away[:, 0]), np.where(away[:, 1] > 0, away[:, 1], 0), np.where(away[:, 1] < 0, -away[:, 1], 0)], axis=1)


@functools.cache
def strokes(n: int = N) -> tuple[Rows, dict[str, Predicted]]:
    """Strokes whose outcomes depend on the position as :data:`TRUTH` says, and what models know that do not see it."""
    rng = np.random.default_rng(2)
    shot = rng.choice([SHOTS.index(shot) for shot in GROUP], n).astype(np.int16)
    area, own, incoming = (rng.integers(0, size, n).astype(np.int16) for size in (9, 3, 2))
    # Nobody waits in the last position, and hardly anybody in the one before it.
    share = np.array([0.1, 0.2, 0.1, 0.1, 0.2, 0.1, 0.18, 0.02, 0.0])
    position = rng.choice(N_POSITIONS, n, p=share)
    meeting = (MET[area] + rng.normal(0, 0.3, (n, 2))).astype(np.float32)
    group = np.array([GROUP[SHOTS[s]] for s in shot.tolist()])
    x = waits(position, area)
    codes = {"shot": shot, "area": area, "own_area": own, "incoming_area": own, "incoming_shot": incoming + 5}
    rows = plain_rows(n, codes=codes, waiting=PLACES[position], meeting=meeting)
    predicted = {}
    for k, name in enumerate(("return", "contact", "hurried")):
        effect = (TRUTH[k, group] * (x - _usual(x, shot.astype(int) * 9 + area))).sum(axis=1)
        base = rng.normal(0, 0.5, n)
        happens = rng.random(n) < expit(base + effect)
        sign = -1 if name == "return" else 1
        predicted[name] = Predicted(rows, happens if sign > 0 else ~happens, sign * base)
    return rows, predicted


def _usual(x: np.ndarray, stroke: np.ndarray) -> np.ndarray:
    """Mean features in strokes of a shot type and area."""
    count = np.bincount(stroke)[:, None]
    return np.stack([np.bincount(stroke, column) for column in x.T], axis=1)[stroke] / count[stroke]


@pytest.fixture(scope="module")
def fitted() -> FittedRecovery:
    found = fit_recovery(*strokes())
    assert found is not None
    return found


def test_planted_effects_are_recovered(fitted: FittedRecovery) -> None:
    assert fitted.coefficients == pytest.approx(TRUTH, abs=0.1)
    assert (fitted.coefficients - TRUTH).std() < 0.035
    position, area = np.indices((N_POSITIONS, 9)).reshape(2, -1)
    for shot, group in GROUP.items():
        expected = (TRUTH[:, group, None] * waits(position, area)).sum(axis=-1)
        found = fitted.recovery.effect[:, SHOTS.index(shot), area, position] * STEP
        assert found[:, position < N_POSITIONS - 1] == pytest.approx(expected[:, position < N_POSITIONS - 1], abs=0.3)
    assert not fitted.recovery.effect[:, :N_SERVES].any()
    people, effect = (golden.weighted_sum(part.ravel()) for part in (fitted.recovery.people, fitted.recovery.effect))
    golden.check("dynamics", {"recovery": {"coefficients": fitted.coefficients, "people": people, "effect": effect}})


def test_positions_that_hardly_anybody_chooses_are_not_feasible(fitted: FittedRecovery) -> None:
    people = fitted.recovery.people
    assert (people.sum(axis=-1, dtype=np.int64) == CHOICE_ONE).all()
    assert (people[5:7, :3, ..., :7] > 0).all()
    assert not people[..., 7:].any(), f"two positions are below {LEAST_SHARE}"


def test_shares_are_shrunk_to_those_of_the_cell_around() -> None:
    """A cell of 75 strokes of one position keeps three quarters of its own share; one without any has that around it."""
    rows, predicted = strokes(20_000)
    incoming = rows.codes["incoming_shot"] == 5
    number = np.cumsum(incoming & (rows.codes["own_area"] == 0)) * (incoming & (rows.codes["own_area"] == 0))
    few = (number > 0) & (number <= 75)
    contact = np.where(few, 1, 0).astype(np.int16)
    waiting = np.where(few[:, None], PLACES[3], rows.waiting)
    changed = dataclasses.replace(rows, codes={**rows.codes, "contact": contact}, waiting=waiting)
    found = fit_recovery(changed, predicted)
    assert found is not None
    people = found.recovery.people / CHOICE_ONE
    around = people[5, 0, 1, 0, 0]  # no stroke with this incoming area
    assert people[5, 0, 1, 1, 0] == pytest.approx(around, abs=1e-4)
    inside = people[5, 0, 0, 1, 0]
    others = np.delete(np.arange(7), 3)
    ratio = inside[others] / people[5, 0, 0, 0, 1][others]  # of 25 among 100, as all of the 75 wait elsewhere
    assert ratio == pytest.approx(np.full(6, 0.25), abs=0.02)


def test_positions_are_named_from_the_forehand_side_of_the_receiver() -> None:
    table = read_matches(SAMPLE).slice(0, 2)
    serve, reply = table.to_pylist()
    assert serve["outcome"] == Outcome.RETURNED
    for hand, side in ((None, 1), (0, 1), (1, -1)):
        field = STROKES.field("hand")
        hands = pa.array([None if name != serve["opponent"] else hand for name in table["player"].to_pylist()], field.type)
        rows = rows_from_strokes(table.set_column(table.schema.get_field_index("hand"), field, hands))
        assert rows.waiting[0] == pytest.approx([-side * serve["receiver_x"], serve["receiver_y"]])
        assert rows.meeting[0] == pytest.approx([side * reply["contact_x"], -reply["contact_y"]])
        # The area of the stroke, as the receiver's hand sees it, and the place where it is met have the same frame.
        assert (rows.game_codes["area"][0] != rows_from_strokes(table).codes["area"][0]) == (side < 0 and serve["area"] % 3 != 1)
    assert np.isnan(rows.meeting[1]).all(), "nobody met the last stroke of the table"


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A copy of the shipped model."""
    return Path(shutil.copytree(model_folder(), tmp_path / "model", ignore=shutil.ignore_patterns("agents")))


def test_a_fit_is_the_same_after_saving(fitted: FittedRecovery, model: Path) -> None:
    rows, predicted = strokes()
    card = read_model_card(model)
    summary = save_recovery(model, rows, predicted)
    with pytest.raises(GameError, match="checksum"):
        load_game(f"{model}:recovery")
    write_card(model, {**card, "recovery": summary})
    read = Recovery.checked(read_tensors(model / POSITIONS))
    assert read.hash == fitted.recovery.hash
    whole = load_recovery(model)
    assert whole is not None
    assert np.array_equal(whole.coefficients, fitted.coefficients)
    shot, place = np.full(9, SHOTS.index("drop")), whole.court.mean
    steps = np.rint(whole.shift(shot, np.full(9, 2), place) / STEP)
    assert np.array_equal(steps, read.effect[:, shot[0], 2]), "a position is the mean place of its cell"
    assert load_game(f"{model}:recovery").hides
    assert summary is not None
    assert summary["strokes"] == N
    assert summary["feasible"] == 7
    assert summary["inside"] == pytest.approx(0.98, abs=0.002)
    assert list(summary["coefficients"]) == list(EFFECTS)
    assert list(summary["coefficients"]["winner"]["smash"]) == list(FEATURES)
    assert "| winner | smash | +0.7" in as_markdown(read_model_card(model))


def test_few_positions_give_no_file(model: Path) -> None:
    rows, predicted = strokes(MIN_ROWS - 1)
    assert save_recovery(model, rows, predicted) is None
    assert not (model / POSITIONS).exists()
    write_card(model, {**read_model_card(model), "recovery": None})
    assert POSITIONS not in read_model_card(model)["sha256"]
    assert "The model has none" in as_markdown(read_model_card(model))
    with pytest.raises(GameError, match="without positions of receivers"):
        load_game(f"{model}:recovery")
