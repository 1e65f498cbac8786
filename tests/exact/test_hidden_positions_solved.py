"""The game with recovery against linear programs, against the game without, and against itself."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linprog

from shuttle_marl.exact import best_response, evaluate, nash_conv, policy_regret, solve, solve_robust, solve_soft, visits
from shuttle_marl.exact.optimal import restricted_response, restricted_value
from shuttle_marl.exact.profile import moved, tabulated_pairs
from shuttle_marl.game.draws import CHOICE_ONE, ONE
from shuttle_marl.game.policy import TabulatedPolicy, cumulative_positions
from shuttle_marl.game.recovery import EFFECTS, N_POSITIONS, NO_CHOICE, STEP, Recovery
from shuttle_marl.game.shipped import load_game
from shuttle_marl.game.tables import ROOT, Game
from tests.exact.exact_games import random_game, random_policy

Floats = np.ndarray[Any, np.dtype[np.float64]]


def with_recovery(game: Game, seed: int, size: float = 0.8) -> Game:
    """The game with positions and effects drawn at random."""
    rng = np.random.default_rng([seed, 3])
    people = rng.dirichlet(np.full(N_POSITIONS, 0.4), (14, 10, 10, 2, 2))
    people[people < 0.05] = 0
    cumulative = np.rint(np.cumsum(people / people.sum(axis=-1, keepdims=True), axis=-1) * CHOICE_ONE)
    effect = rng.normal(0, size, (len(EFFECTS), 13, 9, N_POSITIONS)).clip(-3, 3) / STEP
    units = np.diff(cumulative, prepend=0, axis=-1).astype(np.uint16)
    return dataclasses.replace(game, recovery=Recovery(units, np.rint(effect).astype(np.int16)))


def waiting(policy: TabulatedPolicy, seed: int) -> TabulatedPolicy:
    """The policy with feasible positions drawn at random."""
    game = policy.game
    feasible = np.tile(game.waiting.mask(np.arange(game.n_base_states)), (game.n_blocks, 1))
    weight = np.random.default_rng([seed, 4]).gamma(1, size=feasible.shape) * feasible
    return dataclasses.replace(policy, waits=cumulative_positions(weight / weight.sum(axis=1, keepdims=True)))


def value_by_program(matrix: Floats) -> float:
    """Value of a matrix game to the row player, by the linear program of the column player."""
    k, m = matrix.shape
    found = linprog(
        np.r_[np.zeros(m), 1.0],
        A_ub=np.hstack([matrix, -np.ones((k, 1))]),
        b_ub=np.zeros(k),
        A_eq=np.r_[np.ones(m), 0.0][None],
        b_eq=[1.0],
        bounds=[(0, None)] * m + [(None, None)],
    )
    return float(found.fun)


def entries(game: Game, state: int, following: Floats) -> Floats:
    """Matrix of a state, strokes by feasible positions: means over all 2^24 draws of what :func:`strike` does, by thresholds."""
    table, base, level = game.waiting, state % game.n_base_states, state // game.n_base_states // game.levels
    strokes, m = int(game.legal_count(state)), int(table.choices[base])
    after = game.arrivals(np.arange(game.pair_start[state], game.pair_start[state + 1]))
    out = np.empty((strokes, m))
    for k in range(strokes):
        for i in range(m):
            row = int(table.start[base]) + k * m + i
            fault, winner, below = (int(x) for x in table.limits[level, row])
            late = table.hurry[row] / 256
            low, high = below - winner, ONE - below
            then = following[after[k]]
            lower, upper = (1 - late[0]) * then[0] + late[0] * then[2], (1 - late[1]) * then[1] + late[1] * then[3]
            out[k, i] = (winner - 2 * fault - low * lower - high * upper) / ONE
    return out


@pytest.mark.parametrize(("seeds", "least"), [(range(30), 22), pytest.param(range(200), 150, marks=pytest.mark.slow)])
def test_values_of_random_games_are_those_of_linear_programs(seeds: range, least: int) -> None:
    """In every state, so that they are the fixed point of the equation that defines them."""
    mixed = 0
    for seed in seeds:
        game = with_recovery(random_game(seed, 3 + seed % 3), seed, size=0.8 * (seed % 5 > 0))  # many ties without effects
        found = solve(game)
        assert found.error_bound <= 2e-9
        for state in range(min(game.n_states, 20)):
            if game.legal_count(state):
                matrix = entries(game, state, found.value[1])
                assert found.value[0][state] == pytest.approx(value_by_program(matrix), abs=1e-8)
                mixed += matrix.min(axis=1).max() < matrix.max(axis=0).min() - 1e-6
    assert mixed > least, "states in which perfect play mixes"


@pytest.mark.parametrize("seed", range(6))
def test_no_response_beats_the_solution(seed: int) -> None:
    game = with_recovery(random_game(seed), seed)
    found = solve(game)
    assert nash_conv(found.policy[0]).exploitability == pytest.approx(0, abs=2e-4)  # probabilities of tables are rounded
    policy = waiting(random_policy(game, seed), seed)
    answer = best_response(policy)
    assert evaluate(answer.policy, policy).odds().rally == pytest.approx(answer.value.odds().rally, abs=1e-9)
    assert answer.value.odds().rally > 0.5
    assert evaluate(found.policy[0], policy).odds().rally >= 0.5 - 1e-4
    other = waiting(random_policy(game, seed + 1), seed + 1)
    assert evaluate(other, policy).odds().rally <= answer.value.odds().rally


@pytest.mark.parametrize("seed", range(3))
def test_restricted_and_robust_play(seed: int) -> None:
    game = with_recovery(random_game(seed), seed)
    policy = waiting(random_policy(game, seed), seed)
    won = []
    for p in (0.0, 0.5, 1.0):
        answer = restricted_response(policy, p)
        won.append(answer.value.odds().rally)
        assert restricted_value(answer.policy, policy, p).odds().rally == pytest.approx(won[-1], abs=1e-4)
        assert restricted_value(waiting(random_policy(game, 9), 9), policy, p).odds().rally <= won[-1] + 1e-9
    assert won[0] == pytest.approx(0.5, abs=1e-9)
    assert won == sorted(won)
    assert won[2] == pytest.approx(best_response(policy).value.odds().rally, abs=1e-9)
    other = with_recovery(dataclasses.replace(game, recovery=NO_CHOICE, hurry=game.hurry // 2), seed)
    robust = solve_robust([game, other])
    for each in (game, other):
        worst = 1 - best_response(moved(robust.policy[0], each)).value.odds().rally
        assert worst >= robust.odds().rally - 1e-4
    assert solve_robust([game]).odds().rally == pytest.approx(0.5, abs=1e-9)


@pytest.mark.parametrize("tau", [0.02, 0.3, 50.0])
def test_human_play_is_between_perfect_play_and_its_prior(tau: float) -> None:
    game = with_recovery(random_game(1), 1)
    prior = waiting(random_policy(game, 1), 1)
    found = solve_soft(prior, tau=tau)
    assert found.error_bound < 1e-7
    policy = tabulated_pairs(found.policy[0])
    if tau > 1:
        assert np.abs(policy.pair_probabilities() - prior.pair_probabilities()).max() < 0.02
        return
    # Optimality: each side's strategy is the soft best response to the other's in every state.
    x, y = found.policy[0].probability, found.policy[0].positions
    people, before = prior.position_probabilities(), prior.pair_probabilities()
    assert y is not None
    assert people is not None
    for state in np.flatnonzero(np.diff(game.pair_start))[4:60].tolist():
        matrix, pairs = entries(game, state, found.value[1]), game.pairs_of(state)
        those = game.waiting.position[state % game.n_base_states][: matrix.shape[1]]
        strokes = before[pairs] * np.exp(matrix @ y[state, those] / tau)
        waits = people[state, those] * np.exp(-x[pairs] @ matrix / tau)
        np.testing.assert_allclose(strokes / strokes.sum(), x[pairs], atol=1e-5)
        np.testing.assert_allclose(waits / waits.sum(), y[state, those], atol=1e-5)


@pytest.mark.parametrize("seed", range(4))
def test_losses_of_strokes_and_positions_add_up(seed: int) -> None:
    game = with_recovery(random_game(seed), seed)
    policy = waiting(random_policy(game, seed), seed)
    answer = best_response(policy)
    found = policy_regret(policy, answer.policy)
    assert found.per_rally == pytest.approx(answer.value.odds().value, abs=1e-7)
    against_perfect = policy_regret(policy)
    assert against_perfect.per_rally == pytest.approx(-evaluate(policy, solve(game).policy[1]).odds().value, abs=1e-3)
    assert against_perfect.waiting is not None
    assert against_perfect.waiting.min() > -1e-4, "no position does better against perfect strokes"


def test_people_who_wait_as_people_play_the_game_without_recovery() -> None:
    game, without = load_game("default:recovery"), load_game()
    policy = random_policy(without, 0)
    found, expected = evaluate(moved(policy, game), moved(policy, game)), evaluate(policy, policy)
    assert np.abs(found.striking[0] - expected.striking[0])[ROOT] < 2e-5


def test_visits_of_a_mixing_pair_end_every_rally_once() -> None:
    found = solve(with_recovery(random_game(5), 5))
    seen = visits(*found.policy)
    assert sum(seen.endings().values()) == pytest.approx(1, abs=1e-7)
