"""Fixed-point probabilities, and strokes decided by them."""

import dataclasses
import hashlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.game import default_game
from shuttle_marl.game.draws import CHOICE_ONE, HURRY_ONE, ONE, with_fault_odds
from shuttle_marl.game.layout import GameError
from shuttle_marl.game.recovery import STEP, Recovery
from shuttle_marl.game.rules import HURRIED_BELOW, RETURNED_BELOW
from shuttle_marl.game.tables import Game, thresholds
from shuttle_marl.kernel import struck
from tests.exact.exact_games import tiring_game
from tests.recovery import with_recovery

probability = st.floats(0.0, 1.0)


def test_thresholds_of_round_probabilities() -> None:
    table = thresholds(np.array([0.75, 1.0, 0.0]), np.array([0.5, 0.5, 0.3]), np.array([0.5, 0.25, 0.7]))
    # good 3/4: fault below 1/4; winner 3/8 more; returned 3/8, half of it from below.
    assert table[0].tolist() == [0.25 * ONE, 0.625 * ONE, 0.8125 * ONE]
    assert table[1].tolist() == [0, 0.5 * ONE, 0.875 * ONE]
    assert table[2].tolist() == [ONE - 1, ONE - 1, ONE - 1], "the last outcome keeps the smallest probability there is"


@given(st.lists(st.tuples(probability, probability, probability), min_size=1, max_size=20))
def test_thresholds_are_monotone_and_nearest(probabilities: list[tuple[float, float, float]]) -> None:
    good, returned, above = np.array(probabilities).T
    table = thresholds(good, returned, above).astype(np.int64)
    assert (np.diff(table, axis=1) >= 0).all()
    exact = np.stack([1 - good, 1 - good * returned, 1 - good * returned * above], axis=1)
    error = np.abs(table / ONE - exact)
    assert (error[exact * ONE <= ONE - 1] <= 0.5 / ONE + 1e-12).all()
    assert (error <= 1 / ONE + 1e-12).all()


@pytest.mark.parametrize("position", [0, 1, 2])
def test_thresholds_refuse_nan(position: int) -> None:
    probabilities = [np.array([0.5]), np.array([0.5]), np.array([0.5])]
    probabilities[position] = np.array([np.nan])
    with pytest.raises(GameError, match="not a number"):
        thresholds(*probabilities)


def test_probabilities_invert_thresholds() -> None:
    game = default_game()
    rng = np.random.default_rng(4)
    size = game.n_base_pairs
    wanted = np.concatenate([rng.uniform(0.05, 1, (2, size)), rng.uniform(0, 1, (1, size))])
    found = np.stack(dataclasses.replace(game, threshold=thresholds(*wanted)).stroke_probabilities(game.block_pairs(0)))
    # A conditional probability is a quotient of two rounded numbers: its error grows as what it is conditional on shrinks.
    condition = np.stack([np.ones(size), wanted[0], wanted[0] * wanted[1]])
    assert (np.abs(found - wanted) <= 2.5 / ONE / condition).all()


def test_all_draws_of_a_stroke_give_its_probabilities_exactly() -> None:
    game = default_game()
    rng = np.random.default_rng(5)
    draws = (HURRY_ONE - 1) * ONE + np.arange(ONE)  # of the highest upper part, with which nobody is hurried
    pairs = np.array([0, game.n_pairs - 1, *rng.integers(game.n_pairs, size=30)])
    for pair, good, returned, above in zip(pairs, *game.stroke_probabilities(pairs), strict=True):
        state = game.pair_state[pair]
        k = pair - game.pair_start[state]
        outcome, _ = struck(game, np.full(ONE, state), np.full(ONE, k), draws)
        share = np.bincount(outcome, minlength=4) / ONE
        q = good * returned
        expected = [1 - good, good - q, q * (1 - above), q * above]
        assert share == pytest.approx(expected, abs=1e-12)
        assert (np.diff(outcome) >= 0).all(), "outcomes are ordered by draw"
        for end in set(outcome.tolist()):
            upper = np.arange(HURRY_ONE) * ONE + int((outcome == end).argmax())
            found, _ = struck(game, np.full(HURRY_ONE, state), np.full(HURRY_ONE, k), upper)
            hurried = game.hurry_of(pair)[end - RETURNED_BELOW] if end >= RETURNED_BELOW else 0
            assert (found != end).mean() == hurried
            assert set(found.tolist()) <= {end, end + HURRIED_BELOW - RETURNED_BELOW}


def recovery_game() -> Game:
    """A small game with few positions, three levels of effort, and some probabilities of 0 and almost 1."""
    game = with_recovery(tiring_game(), 3, positions=3)
    threshold, hurry = game.threshold.copy(), game.hurry.copy()
    # Neither faults nor winners; no winners; only faults or winners but for the last draw; all met above, and all but one below.
    threshold[::7, :2], threshold[1::7, 1] = 0, threshold[1::7, 0]
    threshold[2::28], threshold[16::28, 1:] = ONE - 1, ONE - 1
    threshold[3::7, 2], threshold[4::7, 2] = threshold[3::7, 1], ONE - 1
    hurry[5::9], hurry[6::9] = 0, HURRY_ONE - 1
    return dataclasses.replace(
        game, threshold=threshold, hurry=hurry, recovery=Recovery(game.recovery.people, game.recovery.effect // 4)
    )


def test_positions_multiply_odds_and_leave_the_mean_of_people() -> None:
    game = recovery_game()
    recovery, waiting, catalogue = game.recovery, game.waiting, game.catalogue
    most = 0.0
    for pair in range(0, game.n_base_pairs, 13):
        state, k, stroke = (int(table[pair]) for table in (game.base_pair_state, game.base_pair_rank, game.base_pair_stroke))
        own, incoming, contact, _, _, _, hurried = game.observation(state).tolist()
        areas = [*catalogue.area.tolist(), 9]
        shot = catalogue.shot[incoming] if incoming < game.n_strokes else 13
        people = recovery.people[shot, areas[own], areas[incoming], contact, hurried] / CHOICE_ONE
        if shot == 13:
            people = np.eye(9)[4]
        where = np.flatnonzero(people)
        assert game.people_positions(state).tolist() == people.tolist()
        assert np.flatnonzero(waiting.mask(np.array(state))).tolist() == where.tolist()
        assert waiting.position[state].tolist() == [*where, *[-1] * (9 - len(where))]
        rows = waiting.row(np.array(state), np.array(k), where)
        assert rows.tolist() == [waiting.start[state] + k * len(where) + i for i in range(len(where))]
        effect = np.exp(STEP * recovery.effect[:, catalogue.shot[stroke], areas[stroke], where])
        if catalogue.is_serve[stroke]:
            effect[:] = 1
        limits, late = waiting.limits[0, rows] / ONE, waiting.hurry[rows] / HURRY_ONE
        before, hurry = game.threshold[pair] / ONE, game.hurry[pair] / HURRY_ONE
        assert (limits[:, 0] == before[0]).all()
        wins, weight = (limits[:, 1] - limits[:, 0]) / (1 - limits[:, 0]), people[where]
        above = (1 - limits[:, 2]) / (1 - limits[:, 1])
        met = weight * (1 - wins)
        for found, mean, ratio, by, unit in (
            (wins, (before[1] - before[0]) / (1 - before[0]), effect[0], weight, 1 / ONE / (1 - before[0])),
            (above, (1 - before[2]) / (1 - before[1]), effect[1], met, 1 / ONE / (1 - limits[:, 1].max())),
            (late[:, 0], hurry[0], effect[2], met * (1 - above), 1 / HURRY_ONE),
            (late[:, 1], hurry[1], effect[2], met * above, 1 / HURRY_ONE),
        ):
            expected = _with_mean(mean, ratio, by)
            if unit < 0.01:
                most = max(most, float(np.abs(found - expected).max() / unit))
    assert most < 6, "units of the tables, where a part is conditional on another rounded one"
    for effort, odds in enumerate(game.fault_odds.tolist()):
        assert np.array_equal(waiting.limits[effort], with_fault_odds(waiting.limits[0], odds))
    tables = b"".join(table.tobytes() for table in waiting)
    assert hashlib.sha256(tables).hexdigest()[:16] == "80f05d10ec831107", "the same on every machine"


def _with_mean(mean: float, ratio: F64, weight: F64) -> F64:
    """Probabilities whose odds differ by ratios, with a weighted mean."""
    if not 0 < mean < 1 or not weight.any():
        return np.full(len(ratio), mean)
    odds = mean / (1 - mean) * ratio

    def off(scale: float) -> float:
        p = odds * np.exp(scale) / (1 + odds * np.exp(scale))
        return float(weight @ p / weight.sum() - mean)

    scale = np.exp(brentq(off, -9, 9, xtol=1e-12))
    return np.asarray(odds * scale / (1 + odds * scale))


def test_positions_in_tables_that_do_not_fit_are_refused() -> None:
    recovery = recovery_game().recovery
    people, effect = recovery.people, recovery.effect
    most = np.clip(effect, -4096, 4096)
    most[0, 0, 0, :2] = 4096, -4096
    assert Recovery(people, most).hash != recovery.hash != Recovery(people[..., ::-1], effect).hash
    assert repr(recovery) == f"Recovery(hash='{recovery.hash[:12]}')"
    for wrong in (people[:-1], people[..., :8], np.where(np.arange(9) == 8, people + 1, people).astype(np.uint16)):
        with pytest.raises(ShuttleError, match="probabilities of nine positions in every cell"):
            Recovery(wrong, effect)
    low, high = most.copy(), most.copy()
    low[2, 12, 8, 8], high[2, 12, 8, 8] = -4097, 4097
    for beyond in (low, high, effect[:2], effect[:, :12], effect[..., :8]):
        with pytest.raises(ShuttleError, match="at most 4096 steps"):
            Recovery(people, beyond)
