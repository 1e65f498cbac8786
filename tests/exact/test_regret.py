"""Losses by state, error bounds, and the counts that solvers report."""

import dataclasses
import re
from typing import Any

import numpy as np
import pytest

from shuttle_marl.exact import (
    ExactError,
    PairPolicy,
    best_response,
    crossplay,
    evaluate,
    holes,
    optimal,
    policy_regret,
    solve,
    solve_robust,
    solve_soft,
    visits,
)
from shuttle_marl.exact.fixed_point import (
    FIRST_RALLY_STATE,
    ROUNDING,
    TOLERANCE,
    accelerated,
    error_bound,
    largest_continuation,
    newton,
    solve_linear,
)
from shuttle_marl.exact.match import Odds, least_gain, match_table
from shuttle_marl.exact.optimal import gap_bound, limited, pure_policy, restricted_response
from shuttle_marl.exact.profile import crossplay_by, induced, odds_of_pairs, tabulated_pairs
from shuttle_marl.exact.regret import Hole, Holes, Regret
from shuttle_marl.exact.saddles import Saddle
from shuttle_marl.exact.solver import ProfileValue, by_blocks, solve_players
from shuttle_marl.game.scoring import Rules
from shuttle_marl.game.shipped import Estimate
from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.game.thresholds import ONE
from tests.exact.exact_games import random_game, random_policy, tiring_game, with_probabilities
from tests.exact.test_hidden_positions_solved import waiting, with_recovery

GAME = random_game(4, 3)
"""Two levels of effort, and no duels."""


def test_the_largest_losses_are_weighted_by_visits() -> None:
    """Losses 0.5, 0.2, 2 and 0.2: the first of equal ones comes first."""
    loss = Regret(state=np.array([1.0, 2.0, 0.5, 0.5]), weight=np.array([0.5, 0.1, 4.0, 0.4]), per_rally=2.9, error_bound=0.0)
    assert loss.largest(4).tolist() == [2, 0, 1, 3]
    assert loss.largest(2).tolist() == [2, 0]
    assert (loss.waiting, loss.waiting_weight) == (None, None)


def hole(loss: float, expected: Estimate | None = None) -> Hole:
    return Hole(
        state=3, description="own", played="a", played_share=0.5, best="b", best_share=0.25, in_self_play=1.0,
        against_best_response=2.0, played_real=None, best_real=7.0, regret=loss / 2, loss=loss, expected=expected,
    )  # fmt: skip


def test_holes_as_json_with_their_share_of_the_loss() -> None:
    found = Holes(
        exploitability=0.3, loss=0.4, given_up=0.1, states=5, error_bound=1e-9,
        holes=(hole(0.2, Estimate(0.5, 0.25, 1.0)), hole(0.1)),
    )  # fmt: skip
    told = found.as_json()
    assert told["share"] == found.share == pytest.approx(0.75)
    assert told["holes"][0]["expected"] == {"value": 0.5, "low": 0.25, "high": 1.0}
    assert told["holes"][1] == {**dataclasses.asdict(hole(0.1)), "expected": None}
    assert {name: told[name] for name in ("exploitability", "loss", "given_up", "states")} == {
        "exploitability": 0.3, "loss": 0.4, "given_up": 0.1, "states": 5,
    }  # fmt: skip
    assert dataclasses.replace(found, holes=(), states=0, loss=0.0).share == 1


def test_states_with_small_losses_are_no_holes() -> None:
    game, least = tiring_game(), 1e-3
    policy, solution = random_policy(game, 3, 3.0), solve(game)
    answer = best_response(policy)
    found = holes(policy, top=game.n_states, solution=solution, response=answer, tolerance=least)
    loss = policy_regret(policy, answer.policy, solution=solution, tolerance=least)
    lost = loss.state * loss.weight
    expected = [state for state in np.argsort(-lost, kind="stable").tolist() if lost[state] > least]
    assert [each.state for each in found.holes] == expected
    assert 0 < found.states == len(expected) < (lost > 0).sum()
    assert max(expected) >= game.n_base_states, "states of other efforts too"
    assert found.error_bound == max(
        loss.error_bound,
        policy_regret(answer.policy, policy, solution=solution, tolerance=least).error_bound,
        answer.value.error_bound,
    )
    assert len(holes(policy, solution=solution, response=answer).holes) == 10
    assert found.exploitability == answer.value.odds().value


def test_losses_with_hidden_positions_are_those_of_the_policy_alone() -> None:
    game = with_recovery(random_game(2), 2)
    policy = waiting(random_policy(game, 2), 2)
    found = holes(policy, top=3)
    assert found.given_up == 0
    assert found.loss == pytest.approx(found.exploitability, abs=1e-6)
    assert found.holes[0].loss == pytest.approx(found.holes[0].regret * found.holes[0].against_best_response)


@pytest.mark.parametrize("hidden", [False, True])
def test_errors_of_losses_add_up(hidden: bool) -> None:
    """The bound adds that of two values for each counted visit, and twice the bound of the visits of each player who chooses."""
    game = with_recovery(random_game(2), 2) if hidden else GAME
    policy, solution = random_policy(game, 0), solve(game)
    seen = visits(*(policy, solution.policy[1]), tolerance=TOLERANCE)
    both = float(seen.states[0].sum() + (seen.states[1].sum() if hidden else 0))
    for bound in (0.0, 0.25):
        given = dataclasses.replace(solution, error_bound=bound)
        found = policy_regret(policy, solution=given)
        if not hidden:
            assert found.error_bound == pytest.approx(2 * bound * both + 2 * seen.error_bound, rel=1e-6)
        elif not bound:
            least = found.error_bound
        else:
            assert found.error_bound - least == pytest.approx(2 * bound * (found.weight.sum() + found.waiting_weight.sum()))
    assert (found.waiting is None) != hidden


def test_the_bound_of_a_contraction_by_numbers() -> None:
    """A residual of 1/4 bounds the error by 1/4 for contractions by 1/2, and by 1 for 4/5; rounding counts three times."""
    assert error_bound(0.25, 0.5) == pytest.approx(0.25 + 3 * ROUNDING, abs=ROUNDING / 100)
    assert error_bound(0.25, 0.8) == pytest.approx(1.0 + 6 * ROUNDING, abs=ROUNDING / 100)
    assert error_bound(0.0, 0.0) == 2 * ROUNDING
    assert ROUNDING == 2.0**-40


def contraction(size: int, factor: float, seed: int = 0) -> Any:
    """A matrix with rows of mixed signs whose absolute values add up to a factor, for all but the first four columns."""
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(size, size))
    matrix[:, :FIRST_RALLY_STATE] = 0
    return factor * matrix / np.abs(matrix).sum(axis=1, keepdims=True)


def test_linear_equations_are_solved_in_few_directions() -> None:
    matrix, constant = contraction(30, 0.95), np.random.default_rng(1).normal(size=30)
    expected = np.linalg.solve(np.eye(30) - matrix, constant)
    calls: list[int] = []

    def linear(x: Any) -> Any:
        calls.append(1)
        return matrix @ x

    before = constant.copy()
    found = accelerated(linear, constant, lambda residual: bool(np.abs(residual).max() < 1e-12))
    np.testing.assert_allclose(found, expected, atol=1e-10)
    assert len(calls) <= 28
    np.testing.assert_array_equal(constant, before)
    assert np.array_equal(accelerated(linear, constant, lambda _: True), constant)
    zero = np.zeros(30)
    assert np.array_equal(accelerated(linear, zero, lambda _: False), zero), "stagnates at once"
    slow = accelerated(lambda x: np.roll(x, 1), np.eye(200)[0], lambda _: False)
    assert np.isfinite(slow).all(), "ends without a solution"


def test_affine_equations_are_solved_within_their_tolerance() -> None:
    matrix, constant = contraction(30, 0.9), np.random.default_rng(1).normal(size=30)
    expected = np.linalg.solve(np.eye(30) - matrix, constant)
    for tolerance in (1.0, 1e-3, 1e-9):
        found, residual, error = solve_linear(
            constant,
            lambda x: matrix @ x,
            norm=lambda x: float(np.abs(x).max()),
            bound=lambda norm, _: 0.9 * norm / 0.1,
            tolerance=tolerance,
        )
        assert np.abs(found - expected).max() <= error + 1e-14
        assert error == pytest.approx(9 * residual)
        assert error <= tolerance
    _, residual, error = solve_linear(
        constant, lambda x: matrix @ x, norm=lambda x: float(np.abs(x).max()), bound=lambda *_: 1.0, tolerance=0.5
    )
    assert residual <= ROUNDING
    assert error == 1.0


@pytest.mark.parametrize("affine", [False, True])
def test_newton_steps_of_affine_operators_are_exact(affine: bool) -> None:
    matrix, constant = contraction(30, 0.9), np.random.default_rng(1).normal(size=30)
    expected = np.linalg.solve(np.eye(30) - matrix, constant)

    def operator(x: Any) -> Any:
        return constant + matrix @ x, lambda change: matrix @ change

    found, applications, residual, bound = newton(operator, np.zeros(30), 0.9, 1e-9, affine=affine)
    assert np.abs(found - expected)[FIRST_RALLY_STATE:].max() <= bound <= 1e-9
    assert bound == error_bound(residual, 0.9)
    assert applications == 2 if affine else 2 <= applications <= 6
    again = newton(operator, expected, 0.9, 1e-9, affine=affine)
    assert again[1] == 1, "the guess is the solution"
    np.testing.assert_allclose(again[0], expected, atol=1e-12)


def test_plain_sweeps_replace_steps_that_lead_astray() -> None:
    """The linear part has the wrong sign: each round costs two applications, and the residual falls as in plain iteration."""
    constant = np.random.default_rng(1).normal(size=10)

    def operator(x: Any) -> Any:
        return constant + 0.5 * x, lambda change: -0.9 * change

    found, applications, residual, bound = newton(operator, np.zeros(10), 0.5, 1e-4, affine=True)
    np.testing.assert_allclose(found[FIRST_RALLY_STATE:], 2 * constant[FIRST_RALLY_STATE:], atol=bound)
    sweeps = int(np.ceil(np.log2(np.abs(constant[FIRST_RALLY_STATE:]).max() / 1e-4)))
    assert (applications - 1) % 2 == 0
    assert abs((applications - 1) // 2 - sweeps) <= 1
    assert residual <= 1e-4


def test_the_value_of_serves_is_not_in_the_residual() -> None:
    """States 0 to 3 follow no state: a change there is no error of the others."""

    def operator(x: Any) -> Any:
        moved = np.zeros(8)
        moved[:FIRST_RALLY_STATE] = x[:FIRST_RALLY_STATE] + 1
        return moved, lambda change: np.where(np.arange(8) < FIRST_RALLY_STATE, change, 0)

    _, applications, residual, _ = newton(operator, np.zeros(8), 0.5, 1e-9, affine=False)
    assert (applications, residual) == (1, 0.0)


def test_the_largest_continuation_of_strokes_and_of_policies() -> None:
    outcome, state = GAME.outcome_probabilities(), GAME.base(GAME.pair_state)
    continues = outcome[:, 2:].sum(axis=1)
    rally = state >= FIRST_RALLY_STATE
    assert largest_continuation(GAME) == pytest.approx(continues[rally].max(), abs=1e-12)
    policy = random_policy(GAME, 1)
    share = np.bincount(GAME.pair_state, policy.pair_probabilities() * continues, GAME.n_states)
    chain = induced(policy)
    assert chain.contraction == pytest.approx(share[GAME.base(np.arange(GAME.n_states)) >= FIRST_RALLY_STATE].max(), abs=1e-12)
    reward = np.bincount(GAME.pair_state, policy.pair_probabilities() * (outcome[:, 1] - outcome[:, 0]), GAME.n_states)
    np.testing.assert_allclose(chain.reward, reward, atol=1e-12)
    value = evaluate(policy, policy)
    assert value.contraction == pytest.approx(chain.contraction**2)
    assert solve(GAME).contraction == pytest.approx(largest_continuation(GAME))
    other = with_probabilities(GAME, 8)
    both = solve(GAME, other)
    assert both.contraction == pytest.approx(largest_continuation(GAME) * largest_continuation(other))
    assert both.error_bound == error_bound(both.residual, both.contraction)


def alike(game: Game) -> PairPolicy:
    """Every legal stroke equally likely, whatever the efforts."""
    return PairPolicy(game=game, probability=1 / np.bincount(game.base_pair_state)[game.base_pair_state])


def test_policies_that_ignore_efforts_have_one_array() -> None:
    policy = alike(GAME)
    assert np.array_equal(policy.pair_probabilities(), np.tile(policy.probability, GAME.n_blocks))
    assert policy.block_probabilities(1) is policy.probability
    chain = induced(policy)
    assert len({id(chance) for chance in chain.chance}) == 1
    wide = dataclasses.replace(policy, probability=policy.pair_probabilities())
    assert [np.array_equal(wide.block_probabilities(block), policy.probability) for block in range(GAME.n_blocks)] == [True] * 4
    mixed = random_policy(GAME, 0).pair_probabilities()
    blocks = [PairPolicy(game=GAME, probability=mixed).block_probabilities(block) for block in range(4)]
    np.testing.assert_array_equal(np.concatenate(blocks), mixed)
    np.testing.assert_allclose(tabulated_pairs(policy).pair_probabilities(), policy.pair_probabilities(), atol=1e-5)


@pytest.mark.parametrize(("serving", "receiving"), [(0.25, -0.5), (1 + 1e-12, -1 - 1e-12), (-1 - 1e-12, 1 + 1e-12)])
def test_odds_are_probabilities(serving: float, receiving: float) -> None:
    """A value v is a probability of (1 + v) / 2, that of the other player's serve the opposite; rounding is cut off."""
    striking = tuple(np.full(5, value) for value in (serving, receiving))
    value = ProfileValue(striking=striking, residual=0.0, contraction=0.5, error_bound=0.02)  # type: ignore[arg-type]
    first, second = value.odds(), value.odds(1)
    assert first.serving == pytest.approx((1 + serving) / 2, abs=1e-9)
    assert first.receiving == pytest.approx((1 - receiving) / 2, abs=1e-9)
    assert second.serving == pytest.approx((1 + receiving) / 2, abs=1e-9)
    assert second.receiving == pytest.approx((1 - serving) / 2, abs=1e-9)
    for odds in (first, second):
        assert 0 <= min(odds.serving, odds.receiving) <= max(odds.serving, odds.receiving) <= 1
        assert odds.error_bound == 0.01


def test_matches_of_one_point() -> None:
    """The winner of a rally wins the match."""
    sudden, odds = Rules(points=1, clear=1, cap=1, games=1), Odds(serving=0.3, receiving=0.6, error_bound=0.1)
    assert (odds.rally, odds.value) == (pytest.approx(0.45), pytest.approx(-0.1))
    assert [odds.match(sudden, server) for server in (0, 1, None)] == pytest.approx([0.3, 0.6, 0.45])
    assert odds.match_error_bound(sudden) == pytest.approx(0.1)
    assert Odds(serving=1.0, receiving=0.95, error_bound=0.1).match_error_bound(sudden) == pytest.approx(0.1)
    assert Odds(serving=0.0, receiving=0.02, error_bound=0.1).match_error_bound(sudden) == pytest.approx(0.1)
    assert match_table(0.3, 0.6, sudden) == {(0, 0, 0, 0, 0): (1.0, 0.0), (0, 0, 0, 0, 1): (1.0, 0.0)}
    assert least_gain(0.3, 0.6, sudden) == 1.0


@pytest.mark.parametrize(("serving", "receiving"), [(0.3, 0.6), (0.02, 0.99), (0.9, 0.9)])
def test_what_a_rally_is_worth_in_a_match(serving: float, receiving: float) -> None:
    """In every situation the chance before a rally is the mean of those after it, and the winner serves next."""
    rules = Rules(points=2, clear=2, cap=3, games=2)
    table = match_table(serving, receiving, rules)

    def chance(situation: tuple[int, int, int, int, int]) -> float:
        won, lost = table[situation]
        p = receiving if situation[4] else serving
        return p * won + (1 - p) * lost

    for (mine, theirs, points, against, server), (won, lost) in table.items():
        for winner, after in ((0, won), (1, lost)):
            score, games = [points, against], [mine, theirs]
            score[winner] += 1
            if score[winner] == 3 or (score[winner] >= 2 and score[winner] - score[1 - winner] >= 2):
                games[winner] += 1
                score = [0, 0]
            expected = float(winner == 0) if games[winner] == 2 else chance((games[0], games[1], score[0], score[1], winner))
            assert after == pytest.approx(expected)
        assert table[mine, theirs, points, against, 1 - server] == (won, lost)
    assert least_gain(serving, receiving, rules) == min(won - lost for won, lost in table.values())


def test_crossplay_of_two_groups() -> None:
    first, second = [random_policy(GAME, seed) for seed in (0, 1)], [random_policy(GAME, seed) for seed in (2, 3, 4)]
    solved: list[int] = []
    found = crossplay(first, second, progress=lambda: solved.append(1))
    assert found.serving.shape == found.receiving.shape == (2, 3)
    assert len(solved) == 6
    for i, j in np.ndindex(2, 3):
        odds = evaluate(first[i], second[j]).odds()
        assert (found.serving[i, j], found.receiving[i, j]) == pytest.approx((odds.serving, odds.receiving), abs=2e-9)
    nobody: list[Any] = [([], None), (first, []), ([], second)]
    for groups in nobody:
        with pytest.raises(ExactError, match="crossplay of no policies"):
            crossplay(*groups)
    assert len(odds_of_pairs(first, [(0, 1)])) == 1


def test_crossplay_places_the_odds_of_each_pair() -> None:
    """Of policies 0, 1 and 2: pair (i, j) has 0.1 i + 0.01 j serving; receiving is 1 less the other's serve."""

    def given(everyone: Any, pairs: Any) -> Any:
        return [
            (
                Odds(serving=0.1 * i + 0.01 * j, receiving=0.5, error_bound=0.001 * (i + j)),
                Odds(serving=0.1 * j + 0.01 * i, receiving=0.7, error_bound=0.0),
            )
            for i, j in pairs
        ]

    policies: Any = ["a", "b", "c"]
    found = crossplay_by(given, policies, None)
    expected = np.array([[0.1 * i + 0.01 * j for j in range(3)] for i in range(3)])
    np.testing.assert_allclose(found.serving, expected)
    np.testing.assert_allclose(found.receiving, 1 - expected.T)
    np.testing.assert_allclose(found.rally, (expected + 1 - expected.T) / 2)
    assert found.error_bound == pytest.approx(0.004)
    apart = crossplay_by(given, policies[:1], policies[1:])
    np.testing.assert_allclose(apart.serving, expected[:1, 1:])
    np.testing.assert_allclose(apart.receiving, [[0.5, 0.5]])


@pytest.mark.parametrize("tau", [0.0, -1.0, float("inf"), float("nan")])
def test_the_cost_of_divergence_is_finite_and_above_0(tau: float) -> None:
    with pytest.raises(ExactError, match="expected a finite number above 0"):
        solve_soft(alike(GAME), tau=tau)


@pytest.mark.parametrize("p", [-1e-9, 1 + 1e-9, float("nan"), 2.0])
def test_restrictions_are_from_0_to_1(p: float) -> None:
    with pytest.raises(ExactError, match="expected a number from 0 to 1"):
        restricted_response(random_policy(GAME, 0), p)


def test_refusals_of_solvers() -> None:
    with pytest.raises(ExactError, match="robust play over no games: give one or more"):
        solve_robust([])
    with pytest.raises(ExactError, match="differ in"):
        solve_robust([GAME, random_game(7)])
    game = with_recovery(random_game(2), 2)
    policy = waiting(random_policy(game, 2), 2)
    chain = induced(dataclasses.replace(policy, game=dataclasses.replace(game, recovery=None), waits=None))
    with pytest.raises(ExactError, match="a best response with recovery needs the policy, not its chain"):
        best_response(dataclasses.replace(chain, game=game))


def test_robust_play_of_one_game_is_minimax() -> None:
    found, solution = solve_robust([GAME]), solve(GAME)
    np.testing.assert_allclose(found.value.striking[0], solution.value[0], atol=2e-9)
    assert np.array_equal(found.policy.cumulative, solution.policy[0].cumulative)
    assert found.odds().serving == pytest.approx((1 + solution.value_at_serve) / 2, abs=1e-9)
    assert found.games == (GAME,)
    assert found.sweeps % 2 == 0
    assert solution.value_at_serve == solution.value[0][ROOT]


def test_gaps_of_matrix_games_are_in_the_bound() -> None:
    value = ProfileValue(striking=(np.zeros(5), np.zeros(5)), residual=0.0, contraction=0.75, error_bound=0.0)
    first, second = Saddle((GAME,), gap=0.01), Saddle((GAME,), gap=0.03)
    assert gap_bound(value, first, None, second) == pytest.approx(0.24)
    assert gap_bound(value, first) == pytest.approx(0.08)
    assert gap_bound(value, None, object()) == 0


def test_limits_make_rare_strokes_faults(monkeypatch: pytest.MonkeyPatch) -> None:
    allowed = np.arange(GAME.n_base_pairs) % 3 > 0
    monkeypatch.setattr("shuttle_marl.exact.optimal.supported", lambda game, least: allowed if least == 5 else None)
    found = limited(GAME, 5)
    assert (found.threshold[~allowed] == ONE - 1).all()
    np.testing.assert_array_equal(found.threshold[allowed], GAME.threshold[allowed])
    assert limited(GAME, 0) is limited(GAME, -1) is GAME


def test_pure_policies_play_one_rank() -> None:
    rank = np.where(GAME.legal_count(np.arange(GAME.n_states)) > 0, 0, -1).astype(np.int32)
    rank[GAME.legal_count(np.arange(GAME.n_states)) > 1] = 1
    share = pure_policy(GAME, rank).pair_probabilities()
    ranks = GAME.rank(GAME.pair_state, GAME.pair_stroke)
    np.testing.assert_array_equal(share, (ranks == rank[GAME.pair_state]).astype(float))


class Counting:
    """A player who counts the blocks that it sweeps."""

    def __init__(self, game: Game) -> None:
        self.player, self.calls = optimal._BestStrokes((game,)), 0
        self.game, self.contraction = game, self.player.contraction

    def block_sweep(self, block: int, plain: Any, after_attack: Any) -> Any:
        self.calls += 1
        return self.player.block_sweep(block, plain, after_attack)


def test_sweeps_are_counted() -> None:
    """Those of the first player; in the symmetric game one more block is swept for the guess, which is not counted."""
    game = random_game(3, 3)
    assert game.n_blocks == 1
    first, second, alone = Counting(game), Counting(with_probabilities(game, 1)), Counting(game)
    _, sweeps = solve_players(first, second, 1e-9)
    assert first.calls == sweeps
    assert second.calls == sweeps + 1
    _, sweeps = solve_players(alone, None, 1e-9)
    assert alone.calls == sweeps + 1
    wide = Counting(GAME)
    _, sweeps = solve_players(wide, None, 1e-9, start=np.zeros(GAME.n_states))
    assert wide.calls == GAME.n_blocks * (sweeps - 1) + 1
    blocks = Counting(GAME)
    guess, swept = by_blocks(blocks, None, 1e-9)
    pairs = 3  # of blocks with the efforts exchanged: 00, 01 with 10, 11
    assert swept == -(-(blocks.calls - pairs) // GAME.n_blocks)
    np.testing.assert_allclose(guess[FIRST_RALLY_STATE:], solve(GAME).value[0][FIRST_RALLY_STATE:], atol=1e-8)


def test_solutions_count_the_sweeps_of_both_players(monkeypatch: pytest.MonkeyPatch) -> None:
    counted: list[int] = []

    def solving(*arguments: Any, **options: Any) -> Any:
        value, sweeps = solve_players(*arguments, **options)
        counted.append(sweeps)
        return value, sweeps

    monkeypatch.setattr(optimal, "solve_players", solving)
    other, hidden = with_probabilities(GAME, 1), with_recovery(random_game(3, 3), 3)
    twin = with_recovery(with_probabilities(random_game(3, 3), 5), 3)
    prior, theirs = (waiting(random_policy(game, 1), 1) for game in (hidden, twin))
    found: list[tuple[Any, int]] = [
        (solve(GAME), 1), (solve(GAME, other), 2), (solve(hidden), 1), (solve(hidden, twin), 2), (solve_robust([GAME, other]), 2),
        (solve_robust([hidden, twin]), 2), (solve_soft(alike(GAME), tau=0.1), 1),
        (solve_soft(alike(GAME), alike(other), tau=0.1), 2),
        (solve_soft(prior, tau=0.5), 1), (solve_soft(prior, theirs, tau=0.5), 2), (best_response(random_policy(GAME, 0)), 1),
    ]  # fmt: skip
    assert [each.sweeps for each, _ in found] == [times * sweeps for (_, times), sweeps in zip(found, counted, strict=True)]
    assert min(counted) > 1


def test_endless_states_are_named() -> None:
    """The only state whose only stroke never ends the rally."""
    single = np.flatnonzero(np.diff(GAME.base_pair_start) == 1)
    state = int(single[single >= FIRST_RALLY_STATE][2])
    threshold = GAME.threshold.copy()
    threshold[int(GAME.base_pair_start[state]), :2] = 0
    endless = dataclasses.replace(GAME, threshold=threshold)
    stroke = GAME.catalogue.names[int(GAME.base_pair_stroke[GAME.base_pair_start[state]])]
    with pytest.raises(ExactError, match=re.escape(f"{stroke} never ends the rally in state: {GAME.describe(state)};")):
        largest_continuation(endless)
    with pytest.raises(ExactError, match=re.escape(f"ever ends the rally in state: {GAME.describe(state)}")):
        induced(random_policy(endless, 0))
