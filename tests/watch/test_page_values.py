"""Values that the page shows: those of the exact solvers."""

import numpy as np
import pytest

from shuttle_marl.exact import evaluate
from shuttle_marl.game import default_game
from shuttle_marl.game.shipped import RELIABLE, real_strokes
from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.watch.match import Match
from shuttle_marl.watch.plan import Plan, Side
from shuttle_marl.watch.policies import PolicyTables
from shuttle_marl.watch.values import StrokeValues

SIDES = (Side(policy="bc"), Side(policy="attacking"))


@pytest.fixture(scope="module")
def values(tables: PolicyTables) -> StrokeValues:
    return StrokeValues(tables)


def test_values_are_those_of_the_exact_solvers_in_a_hundred_states(values: StrokeValues) -> None:
    game = default_game()
    policies = [tabulate(resolve(side.policy, game), game) for side in SIDES]
    value = evaluate(policies[0], policies[1])
    players = values.players(SIDES)
    drawn = np.random.default_rng(4)
    for state in drawn.choice(np.flatnonzero(game.playable), 100, replace=False).tolist():
        seat = int(drawn.integers(2))
        decision = values.decision(state, seat, players)
        pairs = np.arange(game.n_pairs)[game.pairs_of(state)]
        np.testing.assert_allclose(decision.probability, policies[seat].probability_of(pairs), atol=1e-12)
        np.testing.assert_allclose(decision.win, (1 + game.stroke_values(value.striking[1 - seat], pairs)) / 2, atol=1e-6)
        assert (decision.probability * decision.win).sum() == pytest.approx((1 + value.striking[seat][state]) / 2, abs=1e-6)


def test_an_analysis_follows_the_rally(values: StrokeValues) -> None:
    game = default_game()
    plan = Plan(seed=9, sides=SIDES)
    match = Match(plan, game, PolicyTables(game))
    value = evaluate(*(tabulate(resolve(side.policy, game), game) for side in SIDES))
    for number in range(5):
        rally = match.rally(number)
        found = values.analysis(rally, values.players(SIDES))
        assert len(found.strokes) == len(rally.stroke)
        assert found.win_after == float(rally.winner == 0)
        for i, entry in enumerate(found.strokes):
            names = [option.stroke for option in entry.options]
            assert {rally.stroke[i], entry.better} <= set(names)
            assert len(names) == len(set(names))
            assert entry.loss >= 0
            state, seat = int(rally.states(game)[i]), int(rally.striker[i])
            pair = game.pair(np.array([state]), rally.stroke[i : i + 1])
            striker = (1 + value.striking[seat][state]) / 2, (1 + game.stroke_values(value.striking[1 - seat], pair)[0]) / 2
            seat_0 = striker if seat == 0 else (1 - striker[0], 1 - striker[1])
            assert (entry.win, entry.chosen) == pytest.approx(seat_0, abs=1e-4)
            assert 0 <= entry.match <= 1
            if "?" in entry.mark:
                assert entry.change is not None
                assert entry.change <= -0.02
                assert entry.loss >= -entry.change - 1e-6
                assert entry.better != rally.stroke[i]
            if entry.mark.startswith("!"):
                assert entry.change is not None
                assert entry.change >= 0.04


def test_questions_rest_on_enough_real_strokes_behind_all_answers(values: StrokeValues) -> None:
    game = default_game()
    real = real_strokes(game)
    assert real is not None
    match = Match(Plan(seed=9, sides=SIDES), game, PolicyTables(game))
    asked = 0
    for number in range(10):
        rally = match.rally(number)
        for i, entry in enumerate(values.analysis(rally, values.players(SIDES)).strokes):
            state = int(rally.states(game)[i])
            legal = game.legal_strokes(state)
            pair = game.pair_at(state, np.arange(len(legal)))
            support = dict(zip(legal.tolist(), real[game.base_pair_edge[pair % game.n_base_pairs]], strict=True))
            if entry.question is None:
                continue
            asked += 1
            best = {option.stroke: option.best for option in entry.options}
            answers = [entry.question.right, *entry.question.wrong]
            assert entry.question.wrong[0] == rally.stroke[i]
            assert min(support[stroke] for stroke in answers) >= RELIABLE
            assert best[entry.question.right] - max(best[stroke] for stroke in entry.question.wrong) >= 0.02 - 1e-6
            assert 3 <= len(set(answers)) == len(answers) <= 4
    assert asked >= 10
