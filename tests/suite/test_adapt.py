"""The task adapt-v1: populations, play, regret, and what a method may know."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.exact import best_response, evaluate, restricted_response, solve
from shuttle_marl.exact.fixed_point import ExactError
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.game.shipped import load_game
from shuttle_marl.game.tables import Game
from shuttle_marl.policy import baselines
from shuttle_marl.policy.computed import StoredPolicies
from shuttle_marl.policy.registry import resolve
from shuttle_marl.suite import results
from shuttle_marl.suite.adapt import CHANGES, AdaptSetting, PlayedRally, observed
from shuttle_marl.suite.methods.adapters import (
    Mixture,
    Population,
    PosteriorMean,
    change_point,
    mixture_weights,
    tilted_positions,
)
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.population import FAMILIES, families, known, opponent, waiting
from shuttle_marl.suite.results import arena_of, find_task
from shuttle_marl.suite.task import WEIGHT, Arena, Case, Outcome, exploitabilities, gains
from tests import golden
from tests.exact.exact_games import THREE_STROKES, hand_made, random_policy
from tests.reduced import reduced_game, reduced_model
from tests.suite import small
from tests.suite.small import summary, verified

GAME = load_game(f"{reduced_model()}:recovery")
PLAIN = reduced_game()
TASK = find_task("adapt-v1")


@pytest.fixture(scope="module")
def arena() -> Arena:
    return arena_of(TASK, reduced_model(), "dev", quick=True)


def run(tmp_path: Path, method: str) -> Path:
    return small.run("adapt-v1", method, tmp_path / "run")


def test_a_restricted_response_lies_between_minimax_and_the_best_response() -> None:
    bc = tabulate(resolve("bc", GAME), GAME)
    best, perfect = best_response(bc), solve(GAME)
    assert restricted_response(bc, 1.0).value.odds().value == pytest.approx(best.value.odds().value, abs=1e-8)
    assert restricted_response(bc, 0.0).value.odds().value == pytest.approx(0, abs=1e-8)
    policies = [restricted_response(bc, p).policy for p in (0, 0.3, 0.6, 1)]
    won = [evaluate(policy, bc).odds().rally for policy in policies]
    risk = [best_response(policy).value.odds().value for policy in policies]
    assert won == sorted(won)
    assert risk == sorted(risk)
    assert policies[0].hash == perfect.policy[0].hash
    with pytest.raises(ExactError, match="from 0 to 1"):
        restricted_response(bc, 1.5)


def test_populations_share_no_player_and_follow_from_their_seed(arena: Arena) -> None:
    test = arena_of(TASK, reduced_model(), "test", quick=True)
    players = baselines.players(GAME)
    named = {name.partition(":")[2] for name in known(arena) if name.startswith("bc:")}
    assert named == set(players[0::3])
    for family in FAMILIES:
        one, other = opponent(arena, family, 3), opponent(test, family, 3)
        assert [policy.hash for policy in one.policies] != [policy.hash for policy in other.policies]
        again = opponent(Arena(game=GAME, split="dev"), family, 3)
        assert [policy.hash for policy in again.policies] == [policy.hash for policy in one.policies]
        assert again.starts == one.starts
    found = {}
    for family in FAMILIES:
        for number in range(3 if family in ("switcher", "synthetic") else 1):
            opposed = opponent(arena, family, number)
            sums = [golden.weighted_sum(policy.pair_probabilities()) for policy in opposed.policies]
            found[f"{family} {number}"] = {"policies": sums, "starts": opposed.starts, "learns": opposed.learns}
    golden.check("opponents", found)
    switcher = opponent(arena, "switcher", 0)
    assert 100 <= switcher.starts[1] <= 400
    assert switcher.at(switcher.starts[1] - 1) is switcher.policies[0]
    assert switcher.at(switcher.starts[1]) is switcher.policies[1]


def test_opponents_wait_somewhere_and_learn(arena: Arena) -> None:
    (habit,) = opponent(arena, "waiting", 0).policies
    assert np.abs(habit.position_probabilities() - arena.policy("bc").position_probabilities()).max() > 0.2
    assert "waiting" not in families(PLAIN)
    learner, met = opponent(arena, "learner", 0), arena.policy("safe")
    assert learner.at(0) is learner.policies[0]
    answer, plain = best_response(met).policy, learner.policies[0]
    mixed = learner.at(300, met)
    expected = learner.learns * answer.position_probabilities() + (1 - learner.learns) * plain.position_probabilities()
    np.testing.assert_allclose(mixed.position_probabilities(), expected, atol=1e-4)
    assert evaluate(met, mixed).odds().rally < evaluate(met, plain).odds().rally


def test_positions_are_tilted_towards_what_was_seen(arena: Arena) -> None:
    bc, rng = arena.policy("bc"), np.random.default_rng(0)
    target = waiting(bc, np.random.default_rng(1).normal(scale=2, size=(14, 9))).position_probabilities()
    state = rng.choice(np.flatnonzero(GAME.playable), 20_000)
    place = (rng.random((len(state), 1)) > target[state].cumsum(axis=1)).sum(axis=1).clip(0, 8).astype(np.int8)
    found = tilted_positions(bc.position_probabilities(), GAME, state, place)
    before, after = (np.abs(each - target)[state].sum(axis=1).mean() for each in (bc.position_probabilities(), found))
    assert after < 0.35 * before
    nothing = tilted_positions(bc.position_probabilities(), GAME, state[:0], place[:0])
    np.testing.assert_allclose(nothing, bc.position_probabilities())


class Oracle:
    """Plays the best response to the first opponent of the dev split, which a method cannot know."""

    def __init__(self, setting: Any) -> None:
        self.rallies: list[Any] = []
        hidden = opponent(arena_of(TASK, reduced_model(), "dev", quick=True), "synthetic", 0).policies[0]
        self.policy = best_response(hidden).policy

    def policy_for_next_rally(self) -> Any:
        assert len(self.rallies) in CHANGES
        return self.policy

    def observe_rally(self, rally: Any) -> None:
        assert (np.diff(rally.own.astype(int)) != 0).all()
        self.rallies.append(rally)


class Peeking(Oracle):
    def __init__(self, setting: Any) -> None:
        super().__init__(setting)
        self.name = setting.opponent


def test_regret_is_exact(tmp_path: Path, arena: Arena) -> None:
    folder = run(tmp_path, f"{__name__}:Oracle")
    first = results.read_entry(results.entry_path(folder, 0, 0))
    assert first.scores["regret"] == pytest.approx(0, abs=1e-3)
    player = StoredPolicies(folder / results.POLICIES, GAME).read(first.policies["0"])
    habit = opponent(arena, "waiting", 0).policies[0]
    case = Case(name="waiting/0", options={"family": "waiting", "number": 0})
    second = TASK.score(arena, case, 0, Outcome(policies=dict.fromkeys(map(str, CHANGES), player)))
    lost = 100 * (best_response(habit).value.odds().rally - evaluate(player, habit).odds().rally)
    assert second["regret"] == pytest.approx(lost, abs=1e-2)
    risk = 100 * (best_response(player).value.odds().rally - 0.5)
    assert second["exploitability"] == pytest.approx(risk, abs=1e-2)
    assert verified(folder).refused == []
    assert set(first.policies) == {str(change) for change in CHANGES}


def test_scores_of_a_quick_run_count_every_rally(arena: Arena) -> None:
    assert [case.name for case in TASK.cases(arena)] == ["synthetic/0"]
    against = opponent(arena, "switcher", 0)
    tables = {start: arena.policy("bc" if start < 80 else "minimax") for start in CHANGES}
    ends = sorted({*CHANGES, *against.starts, 500})
    played = [(tables[max(start for start in CHANGES if start <= first)], against.at(first)) for first in ends[:-1]]
    expected = gains(arena, played, rallies=np.diff(ends).tolist(), tolerance=1e-6)
    case = Case(name="switcher/0", options={"family": "switcher", "number": 0})
    found = TASK.score(arena, case, 0, Outcome(policies={str(start): table for start, table in tables.items()}))
    assert (found["gain"], found["best"]) == pytest.approx(expected, abs=1e-2)
    assert found["gain"] < found["best"]
    assert found["exploitability"] == pytest.approx(
        60 / 480 * exploitabilities([arena.policy("bc")], tolerance=1e-6)[0], abs=1e-2
    )


def test_a_method_that_reads_the_opponent_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SuiteError, match="no attribute 'opponent'"):
        small.unit("adapt-v1", f"{__name__}:Peeking", tmp_path)


@pytest.mark.parametrize("method", ["minimax", "restricted-nash:0.5", "counts:0.8", "mixture"])
def test_baselines(tmp_path: Path, method: str) -> None:
    found = summary(run(tmp_path, method))
    golden.check("adapt", {method: found["scores"]})


def test_weights_of_a_mixture_are_those_that_generated_the_strokes() -> None:
    rng = np.random.default_rng(0)
    chance = rng.dirichlet(np.ones(50), size=3)
    strokes = rng.choice(50, 20_000, p=np.array([0.6, 0.3, 0.1]) @ chance)
    weight, value = mixture_weights(chance[:, strokes], np.full(3, 1.0))
    assert weight == pytest.approx([0.6, 0.3, 0.1], abs=0.02)
    for step in rng.normal(scale=0.02, size=(5, 3)):
        other = np.abs(weight + step) / np.abs(weight + step).sum()
        assert value > np.log(other @ chance[:, strokes]).sum() + np.log(other).sum()


def test_a_change_is_found_where_it_is_and_nowhere_else() -> None:
    rng = np.random.default_rng(0)
    chance = rng.dirichlet(np.ones(50), size=3)
    strokes = np.concatenate([rng.choice(50, 5 * rallies, p=chance[kind]) for rallies, kind in ((80, 0), (120, 1))])
    ends, prior = np.arange(5, 1001, 5), np.full(3, 1.0)
    assert change_point(chance[:, strokes], ends, prior) == pytest.approx(80, abs=5)
    assert change_point(chance[:, rng.choice(50, 1000, p=chance.mean(axis=0))], ends, prior) == 0


def setting_of(game: Game, types: Mapping[str, TabulatedPolicy]) -> AdaptSetting:
    return AdaptSetting(game=game, model="", seed=0, folder=Path(), known=types)


def test_the_posterior_finds_a_known_type(arena: Arena) -> None:
    setting = setting_of(GAME, known(arena))
    names = list(setting.known)
    agent = PosteriorMean(setting)
    for rally in observed(GAME, (setting.known["bc"], setting.known["defensive"]), 40, 1):
        agent.observe_rally(rally)
    assert agent.posterior.sum() == pytest.approx(1, abs=1e-9)
    assert names[int(agent.posterior.argmax())] == "defensive"
    np.testing.assert_allclose(
        agent.estimate().block_probabilities(0), setting.known["defensive"].block_probabilities(0), atol=0.2
    )


def test_a_model_from_rallies_answers_habits_of_position(arena: Arena) -> None:
    (habit,) = opponent(arena, "waiting", 1).policies
    agent = Mixture(setting_of(GAME, known(arena)))
    before = gains(arena, [(agent.policy_for_next_rally(), habit)], tolerance=1e-4)[0]
    for rally in observed(GAME, (agent.policy_for_next_rally(), habit), 240, 1):
        agent.observe_rally(rally)
    after, best = gains(arena, [(agent.policy_for_next_rally(), habit)], tolerance=1e-4)
    assert before < after <= best + 1e-2
    assert agent.p == WEIGHT


SMALL = hand_made((*THREE_STROKES, "clear:back-left:above:forehand"))
"""Without recovery: from above, a smash or a clear."""
THREE = {"bc": random_policy(SMALL, 0), "other": random_policy(SMALL, 1), "third": random_policy(SMALL, 2)}


def rallies_against(policy: TabulatedPolicy, number: int, seed: int = 0) -> list[PlayedRally]:
    return list(observed(SMALL, (THREE["bc"], policy), number, seed))


def test_the_posterior_is_that_of_bayes_and_forgets(arena: Arena) -> None:
    agent, rallies = Population(setting_of(SMALL, THREE)), rallies_against(THREE["third"], 3)
    posterior = np.full(3, 1 / 3)
    assert agent.posterior == pytest.approx(posterior)
    for rally in rallies:
        agent.observe_rally(rally)
        theirs = rally.pair[~rally.own]
        likelihood = np.array([policy.pair_probabilities()[theirs].clip(1e-4).prod() for policy in THREE.values()])
        posterior = posterior * likelihood / (posterior @ likelihood) * 0.99 + 0.01 / 3
        assert agent.posterior == pytest.approx(posterior, rel=1e-6)
    assert agent.seen == rallies
    assert not np.allclose(posterior, 1 / 3)
    types = {name: known(arena)[name] for name in ("bc", "defensive")}
    hidden = Population(setting_of(GAME, types))
    (rally,) = observed(GAME, (types["bc"], types["defensive"]), 1, 3)
    found = [
        sum(
            np.log(
                max(
                    policy.probability_of(np.array([pair]))[0] if not own else policy.position_probabilities()[state, place], 1e-4
                )
            )
            for pair, own, state, place in zip(rally.pair, rally.own, rally.state, rally.position, strict=True)
        )
        for policy in types.values()
    ]
    assert hidden.likelihood(rally) == pytest.approx(found, rel=1e-4)
