"""Optima and the frontier of the restricted Nash objective, and rounds whose games and opponents follow from a seed."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.commands.suite import main
from shuttle_marl.exact import best_response, evaluate, restricted_response
from shuttle_marl.exact.optimal import restricted_value
from shuttle_marl.exact.profile import PairPolicy, StatePolicy
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.game.shipped import load_game
from shuttle_marl.policy.registry import resolve
from shuttle_marl.suite.adapt import CHANGES
from shuttle_marl.suite.exploit import opponent_of
from shuttle_marl.suite.offline import OPPONENT, targets
from shuttle_marl.suite.options import Split, SuiteError
from shuttle_marl.suite.population import opponent
from shuttle_marl.suite.results import TASKS, arena_of
from shuttle_marl.suite.task import STEPS, WEIGHT, Arena, Case, Outcome, frontier
from tests import golden
from tests.reduced import reduced_game, reduced_model
from tests.suite.small import run, summary, verified


def exploit(arena: Arena, case: Case) -> Outcome:
    return Outcome(policies={"player": restricted_response(opponent_of(arena, case), WEIGHT).policy})


def equilibrium(arena: Arena, case: Case) -> Outcome:
    return Outcome(policies={"player": arena.policy("minimax")})


def adapt(arena: Arena, case: Case) -> Outcome:
    against = opponent(arena, case.options["family"], case.options["number"])
    answers = {start: restricted_response(against.at(start), WEIGHT).policy for start in CHANGES}
    return Outcome(policies={str(start): answers[start] for start in CHANGES})


def offline(arena: Arena, case: Case) -> Outcome:
    return Outcome(policies={"player": best_response(arena.policy(OPPONENT)).policy})


def valued(arena: Arena, case: Case) -> Outcome:
    values = [evaluate(each, arena.policy(OPPONENT)).odds().rally for each in targets(arena, case, 0).values()]
    return Outcome(answers={"estimates": values})


OMNISCIENT: dict[str, Any] = {
    "exploit-v1": exploit,
    "exploit-entrance-v1": exploit,
    "equilibrium-v1": equilibrium,
    "adapt-v1": adapt,
    "offline-v1": offline,
    "evaluate-v1": valued,
}


@pytest.mark.parametrize("name", OMNISCIENT)
def test_who_knows_what_is_hidden_reaches_the_optimum(name: str) -> None:
    task = TASKS[name]
    arena = arena_of(task, reduced_model(), "test", quick=True)
    case = task.cases(arena)[0]
    found = task.score(arena, case, 0, OMNISCIENT[name](arena, case))
    assert found[task.metric] == pytest.approx(found["best"] if task.optimum is None else task.optimum, abs=0.01)
    assert (arena.game.hides) == task.recovery == ("position of the receiver" in task.hidden)


SEEDS = ("5" * 64, "secret")


def arena(task: str, split: Split, seed: str | None = None) -> Arena:
    return arena_of(TASKS[task], reduced_model(), split, quick=True, seed=seed)


@pytest.mark.parametrize(
    ("task", "method"),
    [("exploit-entrance-v1", "minimax"), ("offline-v1", "clone"), ("equilibrium-v1", "random"), ("evaluate-v1", "model")],
)
def test_a_round_follows_from_its_seed(task: str, method: str, tmp_path: Path) -> None:
    with pytest.raises(SuiteError, match="name it with --seed"):
        arena(task, "round")
    folder = run(task, method, tmp_path / "run", split="round", seed=SEEDS[0])
    assert verified(folder, SEEDS[0]).refused == []
    assert verified(folder, SEEDS[1]).refused
    assert summary(folder, SEEDS[0])["game"] == arena(task, "round", SEEDS[0]).base


def test_opponents_and_games_of_a_round_are_drawn(tmp_path: Path) -> None:
    drawn = [arena("exploit-v1", "round", seed) for seed in SEEDS]
    case = TASKS["exploit-v1"].all_cases(drawn[0])[0]
    one, other = (opponent_of(each, case) for each in drawn)
    assert one.hash != other.hash
    assert one.game.hash != other.game.hash
    assert all(each.game.hides for each in drawn)
    golden.check("drawn_game", {"round": golden.weighted_sum(drawn[0].game.threshold.astype(float))})
    # Learners train in the drawn game.
    folder = run("exploit-v1", "ppo", tmp_path / "run", split="round", seed=SEEDS[0])
    assert verified(folder, SEEDS[0]).refused == []


def test_the_shipped_game_does_not_answer_a_drawn_one() -> None:
    test, shipped = arena("offline-v1", "test"), arena("exploit-entrance-v1", "test")
    assert test.game.hash != shipped.game.hash == test.base
    assert arena("evaluate-v1", "test").game.hash == test.game.hash
    opponent = test.policy("human:0.05")
    best = best_response(opponent).value.odds().rally
    known = TabulatedPolicy(game=test.game, cumulative=best_response(shipped.policy("human:0.05")).policy.cumulative)
    assert (evaluate(known, opponent).odds().rally - 0.5) / (best - 0.5) < 0.5
    assert np.ptp(test.game.threshold.astype(int) - shipped.game.threshold) > 0
    golden.check("drawn_game", {"thresholds": np.arange(len(test.game.threshold)) % 7 @ test.game.threshold.astype(float)})


def test_perfect_play_of_the_shipped_game_is_weak_in_drawn_ones() -> None:
    """A table of answers beside the code is no rank in ``equilibrium`` either."""
    task = TASKS["equilibrium-v1"]
    shipped = arena_of(task, reduced_model(), "test", budget=10**7).policy("minimax")
    drawn = arena_of(task, reduced_model(), "round", budget=10**7, seed=SEEDS[0])
    outcome = Outcome(policies={"player": dataclasses.replace(shipped, game=drawn.game)})
    assert task.score(drawn, task.cases(drawn)[0], 0, outcome)["exploitability"] > 2


GAME = reduced_game()
BC, SAFE = (tabulate(resolve(name, GAME), GAME) for name in ("bc", "safe"))


def worth(player: StatePolicy, p: float = WEIGHT) -> float:
    """Rallies won against SAFE restricted with p: with probability p it is SAFE that strikes, and else the worst enemy."""
    return restricted_value(player, SAFE, p).odds().rally


@pytest.mark.parametrize("variant", ["", ":recovery"])
def test_a_frontier_is_monotone_and_exact(variant: str) -> None:
    game = load_game(f"{reduced_model()}{variant}")
    safe = tabulate(resolve("safe", game), game)
    points = frontier(Arena(game=game), safe, tolerance=1e-6)
    assert [each["p"] for each in points] == list(STEPS)
    assert (STEPS[0], STEPS[-1]) == (0, 1)
    for name in ("score", "exploitability"):
        column = [float(each[name]) for each in points]
        assert column == sorted(column)
    by_p = {each["p"]: each["gain"] for each in points}
    assert (points[0]["exploitability"], points[0]["score"], by_p[0]) == pytest.approx((0, 0, 0), abs=2e-3)
    assert by_p[WEIGHT] == max(by_p.values()) > 0.1
    zero, one, best = (
        100 * restricted_value(restricted_response(safe, p).policy, safe, WEIGHT).odds().rally for p in (0, WEIGHT, 1)
    )
    assert by_p[1] == pytest.approx(best - zero, abs=2e-3)
    assert by_p[WEIGHT] == pytest.approx(one - zero, abs=2e-3)


def test_the_value_in_the_restricted_game_is_that_of_play() -> None:
    assert worth(BC, 1) == pytest.approx(evaluate(BC, SAFE).odds().rally, abs=1e-8)
    assert worth(BC, 0) == pytest.approx(1 - best_response(BC).value.odds().rally, abs=1e-8)
    # The enemy's answer, as a policy: the mixture of it and the opponent, stroke by stroke, wins at most that much.
    enemy = best_response(BC).policy.pair_probabilities()
    mixed = PairPolicy(game=GAME, probability=WEIGHT * SAFE.pair_probabilities() + (1 - WEIGHT) * enemy)
    assert worth(BC) <= evaluate(BC, mixed).odds().rally + 1e-9


def test_no_mixture_is_better_than_the_restricted_response() -> None:
    tables = [restricted_response(SAFE, p).policy.pair_probabilities() for p in (0, 0.5, WEIGHT, 1)]
    one = worth(restricted_response(SAFE, WEIGHT).policy)
    rng = np.random.default_rng(0)
    for _ in range(20):
        weights = rng.dirichlet(np.full(len(tables), 0.5))
        mixed = PairPolicy(game=GAME, probability=np.tensordot(weights, tables, axes=1))
        assert worth(mixed) <= one + 1e-9


@pytest.mark.parametrize("method", ["minimax", "best-response", "bc"])
def test_neither_perfect_play_nor_a_best_response_is_the_best_player(method: str, tmp_path: Path) -> None:
    scores = summary(run("exploit-entrance-v1", method, tmp_path / "run"))["scores"]
    gain, best = scores["gain"]["value"], scores["best"]["value"]
    if method == "minimax":
        assert gain == pytest.approx(0, abs=1e-5)
    assert gain < 0.9 * best


def test_the_command_prints_a_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(("frontier", "exploit-entrance-v1", "--opponent", "safe", "--game", reduced_model(), "--json")) == 0
    assert set(json.loads(capsys.readouterr().out)[0]) == {"p", "score", "exploitability", "gain"}
    assert main(("frontier", "adapt-v1", "--opponent", "bc", "--game", reduced_model())) == 1
    assert "exploit-v1 has" in capsys.readouterr().err
