"""Advice and tactics against an opponent: compared with exact values of changed policies."""

import dataclasses

import numpy as np
import pytest

from shuttle_marl.analysis.advice import (
    LEAST_STEADY,
    Refitted,
    advise,
    calibrated,
    followed,
)
from shuttle_marl.analysis.outlook import outlook
from shuttle_marl.analysis.tactics import STEPS, TACTICS, changed, effects
from shuttle_marl.exact import PairPolicy, evaluate
from shuttle_marl.exact.profile import StatePolicy
from shuttle_marl.game.shipped import RELIABLE, Estimate, real_strokes
from shuttle_marl.game.stroke import SHOTS


@pytest.mark.parametrize("seat", [0, 1])
def test_advantages_are_the_derivative_of_the_result(found: Refitted, seat: int) -> None:
    policy, advantage = found.home.policies[seat], found.home.advantages(seat)
    game, usual = policy.game, policy.block_probabilities(0)
    assert abs(float(usual @ advantage)) < 1e-6  # what is usually played gains nothing
    other = np.random.default_rng(seat).random(game.n_base_pairs)
    other /= np.bincount(game.base_pair_state, other, game.n_base_states)[game.base_pair_state]
    step = 1e-4

    def result(by: float) -> float:
        sides: list[StatePolicy] = [*found.home.policies]
        sides[seat] = PairPolicy(game=game, probability=usual + by * (other - usual))
        return evaluate(*sides, tolerance=1e-9).odds(0).rally * (1 if seat == 0 else -1)

    assert (result(step) - result(-step)) / (2 * step) == pytest.approx(float((other - usual) @ advantage), abs=1e-5)


def test_advice_has_real_strokes_behind_it_and_gains_in_the_refits(found: Refitted) -> None:
    advised = advise(found, average=found.home)
    assert 3 <= len(advised) <= 5
    real = real_strokes(found.pair.seats[0])
    assert real is not None
    assert [each.expected.value for each in advised] == sorted((each.expected.value for each in advised), reverse=True)
    assert len({each.situation for each in advised}) == len(advised)
    for each in advised:
        assert each.behind >= RELIABLE
        assert each.situation.shot < 0 or each.situation_behind >= RELIABLE
        assert each.home > 0
        assert (each.refits > 0).mean() == each.steady >= LEAST_STEADY
        assert each.against_average == pytest.approx(each.home)  # the same meeting was given for both
        assert each.expected.low < each.expected.value < each.expected.high
    assert advise(found, at_least=1e9) == []
    assert advise(dataclasses.replace(found, refits=found.refits[:3])) == []


def test_the_gain_of_one_advice_is_that_of_the_changed_policy(found: Refitted) -> None:
    (best, *_) = advise(found)
    home, refits = followed(found, [best])
    # To first order: with the advice, the situation occurs about as often.
    assert home.rally - found.home.odds.rally == pytest.approx(best.home, rel=0.35)
    assert len(refits) == len(found.refits)


def test_a_gain_is_reduced_to_what_matches_realise() -> None:
    gains = np.array([0.01, 0.012, 0.008, 0.01])
    whole = calibrated(gains, None)
    assert whole.value == pytest.approx(0.01)
    spread = np.std(gains, ddof=1) * np.sqrt(1.25) * 1.6448536
    assert whole.high - whole.value == pytest.approx(spread)
    part = calibrated(gains, Estimate(0.75, 0.75 - 0.196, 0.75 + 0.196))
    assert part.value == pytest.approx(0.0075)
    assert part.high - part.value == pytest.approx(np.hypot(0.75 * spread, 0.01 * 0.1 * 1.6448536), rel=1e-4)


def test_a_tactic_moves_its_share_and_nothing_else(found: Refitted) -> None:
    policy = found.home.policies[0]
    game, usual = policy.game, policy.block_probabilities(0)
    shot = game.catalogue.shot[game.base_pair_stroke]
    smash, above = shot == SHOTS.index("smash"), game.contact(game.base_pair_state) == 1
    after = changed(game, usual, smash & above, above, 0.1)
    state, n = game.base_pair_state, game.n_base_states
    assert np.bincount(state, after, n)[game.legal_count(np.arange(n)) > 0] == pytest.approx(1.0)
    before, later = (np.bincount(state[smash], part[smash], n) for part in (usual, after))
    inside = (before > 0) & (before < 0.9)
    assert later[inside] - before[inside] == pytest.approx(0.1)
    assert after[~above] == pytest.approx(usual[~above])
    assert changed(game, usual, smash & above, above, 0.0) == pytest.approx(usual)


def test_effects_of_tactics_are_exact(found: Refitted) -> None:
    listed = effects(found)
    assert [effect.tactic for effect in listed] == [*TACTICS]
    odds, middle = found.home.odds, STEPS.index(0.0)
    for effect in listed:
        assert effect.serving[middle] == odds.serving
        assert 0 <= effect.share <= 1
    serve = listed[0]
    # A rally has one serve, so the result is linear in its probability as long as none reaches 0 or 1.
    rally = (serve.serving + serve.receiving) / 2
    assert np.diff(rally)[1] == pytest.approx(np.diff(rally)[2], abs=1e-7)
    assert serve.receiving == pytest.approx(odds.receiving)


def test_the_outlook_contains_both_uncertainties(found: Refitted) -> None:
    seen = outlook(found)
    odds = found.home.odds
    assert seen.rally.value == pytest.approx(odds.rally)
    # The mean over what is not known is less certain than the match of known odds.
    assert abs(seen.match.value - 0.5) < abs(odds.match() - 0.5)
    for estimate in (seen.serving, seen.receiving, seen.rally, seen.game, seen.match):
        assert estimate.low < estimate.value < estimate.high
    alone = outlook(dataclasses.replace(found, refits=()))
    assert alone.rally.high - alone.rally.low < seen.rally.high - seen.rally.low
