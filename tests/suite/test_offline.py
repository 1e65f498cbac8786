"""Logs, estimators on a game of three strokes computed by hand, and learning from logs."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.exact import best_response, evaluate
from shuttle_marl.exact.profile import PairPolicy
from shuttle_marl.game.policy import TabulatedPolicy, from_pair_probabilities, tabulate
from shuttle_marl.game.rally import Rallies
from shuttle_marl.game.rules import FAULT, WINNER
from shuttle_marl.game.shipped import load_game
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording.logs import Log, blank, log_of, play_log
from shuttle_marl.suite import tabular
from shuttle_marl.suite.method import BASELINES
from shuttle_marl.suite.methods import logs
from shuttle_marl.suite.methods.logs import (
    Behaviour,
    Dice,
    DoublyRobust,
    FittedQEvaluation,
    ImportanceSampling,
    ModelValue,
    WeightedImportanceSampling,
    doubly_robust,
    q_and_v,
    ratios,
)
from shuttle_marl.suite.offline import OPPONENT, behaviour, errors, generate, in_game
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.results import arena_of, find_task
from shuttle_marl.suite.tabular import (
    best_of,
    by_state,
    cloned,
    estimated_game,
    fitted_q,
    greedy,
    pair_cells,
    state_cells,
    with_faults,
)
from tests import golden
from tests.exact.exact_games import THREE_STROKES, hand_made
from tests.reduced import reduced_game, reduced_model
from tests.suite.small import run, summary, unit, verified

GAME = reduced_game()
CLEAR = "clear:back-left:above:forehand"
SERVE, CLEARED, SMASH, LIFT = range(4)


def three_strokes() -> Game:
    """A serve, and then a lift from below, or a clear or a smash from above."""
    return hand_made((THREE_STROKES[0], CLEAR, THREE_STROKES[1], THREE_STROKES[2]))


def smashing(game: Game, fraction: float) -> TabulatedPolicy:
    """The policy that smashes this fraction of what is offered above the net, and clears the rest."""
    stroke = game.pair_stroke
    chance = np.where(stroke == SMASH, fraction, np.where(stroke == CLEARED, 1 - fraction, 1.0))
    return from_pair_probabilities(game, chance)


def by_hand(game: Game) -> Log:
    """Five rallies of the learner, at seat 0, who smashes half of the time.

    1: serve, lift, smash: winner. 2: serve, smash of the opponent: winner. 3: serve of the opponent, clear: fault.
    4: serve of the opponent: fault. 5: serve of the opponent, smash: winner.
    """
    strokes = [[SERVE, LIFT, SMASH], [SERVE, SMASH], [SERVE, CLEARED], [SERVE], [SERVE, SMASH]]
    n = len(strokes)
    rallies = Rallies(
        pairing=np.zeros(n, np.uint32),
        match=np.arange(n, dtype=np.uint32),
        rally=np.zeros(n, np.uint16),
        policy=np.zeros((n, 2), np.uint16),
        server=np.array([0, 0, 1, 1, 1], np.uint8),
        winner=np.array([0, 1, 1, 0, 0], np.uint8),
        reason=np.array([WINNER, WINNER, FAULT, FAULT, WINNER], np.uint8),
        score=np.zeros((n, 4), np.uint8),
        length=np.array([len(part) for part in strokes], np.int32),
        stroke=np.concatenate(strokes).astype(np.uint8),
        hurried=np.zeros(sum(map(len, strokes)), np.uint8),
    )
    return log_of(game, rallies, smashing(game, 0.5))


def test_estimators_equal_values_computed_by_hand() -> None:
    game = three_strokes()
    log, target = by_hand(game), smashing(game, 0.8)
    data = log.transitions
    assert data.reward.tolist() == [0, 1, 0, 0, 1]
    assert data.following.tolist() == [data.state[1], -1, -1, -1, -1]
    assert (data.n_rallies, data.idle_wins) == (5, 1)
    # Ratios: 1 for the serves; 0.8 / 0.5 for smashes; 0.2 / 0.5 for the clear.
    assert ratios(data, target) == pytest.approx([1, 1.6, 1, 0.4, 1.6], abs=1e-4)
    # Rallies: 1.6 won, 1 lost, 0.4 lost, 1.6 won, and one won without a stroke.
    assert ImportanceSampling().estimate(log, [target]) == pytest.approx([(1.6 + 1.6 + 1) / 5], abs=1e-4)
    assert WeightedImportanceSampling().estimate(log, [target]) == pytest.approx([4.2 / 5.6], abs=1e-4)
    # With q = v = 0.5: 0.5 + 1.6 * 0.5 = 1.3 after a winning smash, and 0.5 + (1.3 - 0.5) = 1.3 before the serve.
    half = np.full(5, 0.5)
    assert doubly_robust(data, ratios(data, target), half, half) == pytest.approx([1.3, 0, 0.3, 1.3], abs=1e-4)

    # Smashes won and the clear lost: 0.8 before them; the serve led to 0.8 once, and to a loss once.
    q, v = q_and_v(data, target, shrink=1e-9)
    assert q == pytest.approx([0.4, 1, 0.4, 0, 1], abs=1e-4)
    assert v == pytest.approx([0.4, 0.8, 0.4, 0.8, 0.8], abs=1e-4)


@dataclasses.dataclass
class Rewards:
    """Own strokes of rallies: where a rally starts, and what each stroke earned."""

    first: np.ndarray
    reward: np.ndarray

    def __len__(self) -> int:
        return len(self.first)


def rallies_at_random(lengths: list[int]) -> tuple[Rewards, np.ndarray, np.ndarray, np.ndarray]:
    """Rewards of rallies, and ratios, of which some are above 10, and values of the strokes and of the states."""
    rng, n = np.random.default_rng(5), sum(lengths)
    first, last = np.zeros(n, np.bool_), np.cumsum(lengths) - 1
    first[np.r_[0, last[:-1] + 1]] = True
    reward = np.zeros(n)
    reward[last] = rng.integers(0, 2, len(lengths))
    return Rewards(first, reward), rng.choice([0.0, 0.4, 1.6, 12.0], n), rng.random(n), rng.random(n)


LENGTHS = [3, 1, 12, 4, 1, 2]


def test_doubly_robust_values_are_computed_backwards() -> None:
    data, rho, q, v = rallies_at_random(LENGTHS)
    found, end = [], 0
    for length in LENGTHS:
        start, end, value = end, end + length, 0.0
        for t in reversed(range(start, end)):
            value = v[t] + min(rho[t], 10.0) * (data.reward[t] + value - q[t])
        found.append(value)
    np.testing.assert_allclose(doubly_robust(data, rho, q, v), found)  # type: ignore[arg-type]


def test_estimators_add_up_values_of_rallies() -> None:
    game = three_strokes()
    log, target = by_hand(game), smashing(game, 0.8)
    data = log.transitions
    assert Behaviour().estimate(log, [target, target]) == [3 / 5, 3 / 5]
    rho, (q, v) = ratios(data, target), q_and_v(data, target)
    for estimator, wins in ((FittedQEvaluation(), v[data.first].sum()), (DoublyRobust(), doubly_robust(data, rho, q, v).sum())):
        assert estimator.estimate(log, [target, target]) == [pytest.approx((wins + 1) / 5)] * 2


def test_ratios_of_visits_solve_the_equation_of_their_flow() -> None:
    """By loops: struck cells flow on to the cells that the policy would choose next; one more observation holds each back."""
    game = three_strokes()
    log, target = by_hand(game), smashing(game, 0.8)
    data = log.transitions
    cell, chance = pair_cells(game)[1], target.pair_probabilities()
    size = int(cell.max()) + 1

    def chosen(state: int) -> np.ndarray:
        out = np.zeros(size)
        for pair in range(int(game.pair_start[state]), int(game.pair_start[state + 1])):
            out[cell[pair]] += chance[pair]
        return out

    flow, begins, earned = np.eye(size), np.zeros(size), np.zeros(size)
    for i in range(len(data)):
        own = int(cell[data.pair[i]])
        flow[own, own] += 1
        earned[own] += data.reward[i]
        if data.first[i]:
            begins += chosen(int(data.state[i]))
        if i + 1 < len(data) and not data.first[i + 1]:
            flow[:, own] -= chosen(int(data.state[i + 1]))
    value = float(np.linalg.solve(flow, begins) @ earned)
    assert Dice().estimate(log, [target]) == pytest.approx([(value + 1) / 5])


def test_a_model_is_the_estimated_game_with_the_cloned_opponent() -> None:
    game = three_strokes()
    log = by_hand(game)
    policies, model = [smashing(game, share) for share in (0.2, 0.9)], estimated_game(log)
    opponent = PairPolicy(game=model, probability=cloned(game, log.pair[~log.own]))
    expected = [evaluate(TabulatedPolicy(game=model, cumulative=each.cumulative), opponent).odds().rally for each in policies]
    assert ModelValue().estimate(log, policies) == pytest.approx(expected, abs=1e-6)


SETTING: Any = None


def after_serve(game: Game, policy: Any) -> list[float]:
    """Shares of the clear and of the smash as the first stroke after a serve."""
    pairs = game.pair(game.state_of(4, SERVE, 1), np.array([CLEARED, SMASH]))
    return [float(policy.pair_probabilities()[pair]) for pair in pairs]


def test_learners_from_logs_by_hand() -> None:
    """After a serve the log has a clear that lost and a smash that won, and a clear or smash is as likely as any other before."""
    game = three_strokes()
    data = by_hand(game).transitions
    assert after_serve(game, logs.Clone(SETTING, "1e-9").fit(data)) == pytest.approx([0.5, 0.5], abs=1e-6)
    assert after_serve(game, logs.Clone(SETTING, "7").fit(data)) == pytest.approx(
        after_serve(game, PairPolicy(game=game, probability=cloned(game, data.pair, shrink=7.0)))
    )
    for method in (logs.OneStep, logs.FittedQ):
        assert after_serve(game, method(SETTING).fit(data)) == [0, 1]


def test_responses_to_a_log_are_best_against_the_cloned_opponent() -> None:
    game = three_strokes()
    log = by_hand(game)
    model = estimated_game(log)
    opponent = PairPolicy(game=model, probability=cloned(game, log.pair[~log.own], shrink=7.0))
    found = logs.respond(log, model, 7.0)
    assert found.game is log.game
    assert np.array_equal(found.cumulative, best_response(opponent).policy.cumulative)
    penalty = np.where(game.base_pair_stroke == SMASH, 0.5, 0.0)
    assert after_serve(game, found) == [0, 1]
    careful = logs.respond(log, model, 7.0, penalty=penalty)
    assert after_serve(game, careful) == [1, 0]


def test_density_ratios_recover_the_value_of_the_behaviour() -> None:
    arena = arena_of(find_task("offline-v1"), reduced_model(), "test")
    log = generate(arena, "bc", 20_000, seed=1)
    own, other = (in_game(arena.policy(name), log.game) for name in ("bc", "bc@0.7"))
    true = [evaluate(arena.policy(name), arena.policy(OPPONENT)).odds().rally for name in ("bc", "bc@0.7")]
    assert Dice().estimate(log, [own, other]) == pytest.approx(true, abs=0.04)


def test_figures_of_estimates_by_hand() -> None:
    found = errors(np.array([0.5, 0.7, 0.3]), np.array([0.4, 0.8, 0.45]), [True, False, True])
    assert found == pytest.approx({
        "error": np.sqrt((100 + 100 + 225) / 3), "bias": -5, "bias_trained": -2.5, "rank_correlation": 0.5, "regret": 0,
    })  # fmt: skip
    same = errors(np.array([0.5, 0.5]), np.array([0.4, 0.8]), [False, False])
    assert (same["rank_correlation"], same["regret"], same["bias_trained"]) == (0, pytest.approx(40), 0)


def test_counts_computed_by_hand() -> None:
    game = three_strokes()
    log = by_hand(game)
    chance = cloned(log.game, log.transitions.pair, shrink=1e-9)
    after_serve = game.pair(game.state_of(4, SERVE, 1), np.array([CLEARED, SMASH]))
    assert chance[after_serve] == pytest.approx([0.5, 0.5], abs=1e-6)
    shares = estimated_game(log, shrink=1e-9).outcome_probabilities(slice(0, game.n_base_pairs))
    # Serves: one returned below (the lift), three returned above, one fault.
    assert shares[0] == pytest.approx([1 / 5, 0, 1 / 5, 3 / 5, 0, 0], abs=4e-3)
    # The lift was returned from above.
    assert shares[game.pair(game.state_of(4, SERVE, 0), LIFT)] == pytest.approx([0, 0, 0, 1, 0, 0], abs=2e-3)


def test_clones_shrink_towards_what_is_played_in_like_states() -> None:
    pairs, state = np.random.default_rng(0).integers(GAME.n_base_pairs, size=200), GAME.base_pair_state
    chance = 1 / np.bincount(state)[state]
    for cell in state_cells(GAME):
        stroke_cell = cell[state] * GAME.n_strokes + GAME.base_pair_stroke
        played = np.array([(stroke_cell[pairs] == own).sum() for own in stroke_cell])
        number = np.array([(cell[state[pairs]] == own).sum() for own in cell])[state]
        chance = (played + 3 * chance) / (number + 3)
    assert cloned(GAME, pairs, shrink=3) == pytest.approx(chance / np.bincount(state, chance)[state])


def test_greedy_plays_the_best_stroke() -> None:
    game = three_strokes()
    q = np.where(game.base_pair_stroke == SMASH, 0.9, 0.5)
    state = np.array([game.state_of(4, SERVE, 1)])
    assert best_of(game)(q, state) == [0.9]
    assert by_state(game, q, state, np.add) == pytest.approx([1.4])
    policy = greedy(game, q)
    assert policy.probability[game.pair(state, SMASH)] == [1.0]
    assert np.bincount(game.base_pair_state, policy.probability)[game.playable[: game.n_base_states]] == pytest.approx(1)


def test_a_large_log_recovers_the_game() -> None:
    arena = arena_of(find_task("offline-v1"), reduced_model(), "test")
    log = generate(arena, "bc@1.5", 300_000, seed=1)
    target, opponent = arena.policy("bc@0.7"), arena.policy(OPPONENT)
    true = evaluate(target, opponent).odds().rally
    assert ModelValue().estimate(log, [in_game(target, log.game)]) == pytest.approx([true], abs=0.01)
    _, v = q_and_v(log.transitions, in_game(target, log.game))
    data = log.transitions
    assert (v[data.first].sum() + data.idle_wins) / data.n_rallies == pytest.approx(true, abs=0.02)


def test_logs_depend_on_their_seed_alone_and_hide_the_probabilities() -> None:
    arena = arena_of(find_task("offline-v1"), reduced_model(), "test")
    log, again, other = (generate(arena, "bc+0.1*minimax", 2000, seed) for seed in (0, 0, 1))
    assert log.hash == again.hash != other.hash
    assert log.own.sum() >= 2000 > log.own[log.rally < log.rally[-1]].sum()
    assert (log.game.threshold == blank(GAME).threshold).all()
    assert log.game.hash != GAME.hash
    mixed = behaviour(arena, "bc+0.1*minimax").pair_probabilities()
    parts = 0.9 * arena.policy("bc").pair_probabilities() + 0.1 * arena.policy("minimax").pair_probabilities()
    assert mixed == pytest.approx(parts, abs=2 / 65535)
    assert log.probability[log.own] == pytest.approx(mixed[log.pair[log.own]], abs=1e-6)
    table = log.table()
    assert table.num_rows == len(log)
    assert table["stroke"][0].as_py() == GAME.catalogue.names[log.stroke[0]]


def test_pessimism_adds_to_faults() -> None:
    penalty = np.linspace(0, 0.5, GAME.n_base_pairs)
    before, after = (g.outcome_probabilities(slice(0, g.n_base_pairs)) for g in (GAME, with_faults(GAME, penalty)))
    assert after[:, 0] == pytest.approx(np.minimum(before[:, 0] + penalty, 1), abs=1e-4)
    assert after.sum(axis=1) == pytest.approx(1)


def test_fitted_q_is_the_best_value_of_the_data() -> None:
    game = three_strokes()
    data = by_hand(game).transitions
    q = fitted_q(data, best_of(data.game), shrink=1e-9)
    # The best stroke wins, so the serve is worth one half: it led to a certain win once and to a loss once.
    assert q[data.pair[0]] == pytest.approx(0.5, abs=1e-4)


TABULAR = ("clone", "one-step", "fitted-q", "model", "model-pessimistic")


@pytest.mark.parametrize("method", BASELINES["offline"])
def test_baselines_of_offline(method: str, tmp_path: Path) -> None:
    folder = run("offline-v1", f"{method}:20" if method.endswith("boosted") else method, tmp_path / "run")
    found = summary(folder)
    # Trees have learned for 20 steps.
    assert -25 < found["score"] < found["scores"]["best"]["value"] + 1e-6
    assert verified(folder).refused == []
    if method in TABULAR:
        golden.check("offline", {method: found["scores"]})


def test_a_run_of_evaluate_is_verified(tmp_path: Path) -> None:
    folder = run("evaluate-v1", "weighted-importance-sampling", tmp_path / "run")
    found = summary(folder)
    golden.check("offline", {"weighted-importance-sampling": found["scores"]})
    assert verified(folder).refused == []


class Answering:
    def __init__(self, found: Any) -> None:
        self.found = found

    def estimate(self, log: Log, policies: Any) -> Any:
        return self.found


@pytest.mark.parametrize(
    ("found", "told"),
    [
        ((0.5,), "expected 32 estimates, got 1"),
        (("high",) * 32, "raised ValueError: could not convert string"),
        ((float("nan"),) * 32, r"no numbers from 0 to 1 .*>= 0.0"),
    ],
)
def test_estimates_are_checked(found: Any, told: str, tmp_path: Path) -> None:
    task, arena = find_task("evaluate-v1"), arena_of(find_task("evaluate-v1"), reduced_model(), "dev", quick=True)
    (case, *_) = task.cases(arena)
    with pytest.raises(SuiteError, match=told):
        task.score(arena, case, 0, task.play(arena, case, lambda _: Answering(found), 0, tmp_path))
    beyond = task.play(arena, case, lambda _: Answering((-0.5, 1.5) * 16), 0, tmp_path)
    assert beyond.answers == {"estimates": [0.0, 1.0] * 16}


def half(setting: Any) -> Answering:
    return Answering((0.5,))


def test_an_object_of_another_task_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SuiteError, match=r"expected an object with fit"):
        unit("offline-v1", f"{__name__}:half", tmp_path)


def test_what_positions_change_is_estimated() -> None:
    game = load_game(f"{reduced_model()}:recovery")
    random = tabulate(resolve("random", game), game)
    log = play_log((random, random), 150_000, 0)
    unknown = dataclasses.replace(game.recovery, effect=np.zeros_like(game.recovery.effect))
    found = tabular.with_positions(dataclasses.replace(game, recovery=unknown), log.pair, log.outcome, log.waited)
    stroke = game.pair_stroke[log.pair]
    number = np.zeros(game.recovery.effect.shape[1:])
    np.add.at(number, (game.catalogue.shot[stroke], game.catalogue.area[stroke], log.waited), 1)
    often = np.where(number > 2000, number, 0)

    def compared(effect: Any) -> Any:
        """Only differences between the positions of a stroke matter."""
        return (effect - (effect * often).sum(axis=-1, keepdims=True) / np.maximum(often.sum(axis=-1, keepdims=True), 1))[
            often > 0
        ]

    for true, estimated in zip(game.recovery.effect, found.recovery.effect, strict=True):
        assert np.corrcoef(compared(true), compared(estimated))[0, 1] > 0.6
