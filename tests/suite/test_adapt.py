"""The task adapt-v0: populations, play, regret, and what a method may know."""

import datetime as dt
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from shuttle_marl.exact import best_response, evaluate, restricted_response, solve
from shuttle_marl.exact.fixed_point import ExactError
from shuttle_marl.game.draws import stream
from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.policy import baselines
from shuttle_marl.policy.registry import resolve
from shuttle_marl.policy.stored import StoredPolicies
from shuttle_marl.suite import store
from shuttle_marl.suite.adapt import CHANGES, PlayedRally, observed
from shuttle_marl.suite.frontier import objective
from shuttle_marl.suite.methods.adapters import (
    PosteriorMean,
    change_point,
    features,
    fitted_shift,
    mixture_weights,
    shifted,
)
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.population import FAMILIES, HIDDEN_ROUND, known, opponent
from shuttle_marl.suite.registry import arena_of, find_task
from shuttle_marl.suite.task import Arena, Case, Outcome
from tests import golden
from tests.reduced import reduced_game, reduced_model
from tests.suite import small
from tests.suite.small import summary, verified

GAME = reduced_game()
TASK = find_task("adapt-v0")


@pytest.fixture(scope="module")
def arena() -> Arena:
    return arena_of(TASK, reduced_model(), "dev", quick=True)


def run(tmp_path: Path, method: str) -> Path:
    return small.run("adapt-v0", method, tmp_path / "run")


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
    switcher = opponent(arena, "switcher", 0)
    assert 100 <= switcher.starts[1] <= 400
    assert switcher.at(switcher.starts[1] - 1) is switcher.policies[0]
    assert switcher.at(switcher.starts[1]) is switcher.policies[1]


def test_the_hidden_split_needs_the_randomness_of_the_beacon() -> None:
    for wrong in ("x" * 64, "5" * 62, "A" * 64, None):
        with pytest.raises(SuiteError, match=f"{HIDDEN_ROUND}, which appears on 1 June 2027"):
            arena_of(TASK, reduced_model(), "hidden", beacon=wrong)
    # Time of a round of the chain: genesis and 3 seconds for each round before.
    assert dt.datetime.fromtimestamp(1_692_803_367 + 3 * (HIDDEN_ROUND - 1), dt.UTC) == dt.datetime(2027, 6, 1, tzinfo=dt.UTC)
    first, second = (arena_of(TASK, reduced_model(), "hidden", beacon=digit * 64) for digit in "56")
    arenas = (first, second, arena_of(TASK, reduced_model(), "test"))
    assert len({opponent(arena, "synthetic", 0).policies[0].hash for arena in arenas}) == 3


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


class Watching(Oracle):
    seen: ClassVar[list[PlayedRally]] = []

    def observe_rally(self, rally: PlayedRally) -> None:
        self.seen.append(rally)


class Peeking(Oracle):
    def __init__(self, setting: Any) -> None:
        super().__init__(setting)
        self.name = setting.opponent


def test_regret_is_exact(tmp_path: Path, arena: Arena) -> None:
    folder = run(tmp_path, f"{__name__}:Oracle")
    first, second = (store.read_entry(store.entry_path(folder, number, 0)) for number in (0, 1))
    assert first.scores["regret_500"] == pytest.approx(0, abs=1e-6)
    player, human = (
        StoredPolicies(folder / store.POLICIES, GAME).read(first.policies["0"]),
        opponent(arena, "human", 0).policies[0],
    )
    lost = best_response(human).value.odds().rally - evaluate(player, human).odds().rally
    assert [second.scores[f"regret_{n}"] for n in (20, 500)] == pytest.approx([lost, lost], abs=2e-6)
    assert second.scores["exploitability"] == pytest.approx(best_response(player).value.odds().value, abs=2e-6)
    assert verified(folder).refused == []
    assert set(first.policies) == {str(change) for change in CHANGES}


def test_scores_of_a_quick_run_count_every_rally(arena: Arena) -> None:
    assert [case.name for case in TASK.cases(arena)] == ["synthetic/0", "human/0"]
    against = opponent(arena, "switcher", 0)
    tables = {start: arena.policy("bc" if start < 80 else "minimax") for start in CHANGES}
    ends = sorted({*CHANGES, *against.starts, 500})
    played = [(tables[max(start for start in CHANGES if start <= first)], against.at(first)) for first in ends[:-1]]
    expected = objective(arena, played, rallies=np.diff(ends).tolist(), tolerance=1e-9)
    case = Case(name="switcher/0", options={"family": "switcher", "number": 0})
    found = TASK.score(arena, case, 0, Outcome(policies={str(start): table for start, table in tables.items()}))
    assert found["objective"] == pytest.approx(expected, abs=1e-5)


def test_draws_follow_from_the_name_of_the_case_and_the_seed(tmp_path: Path, arena: Arena) -> None:
    Watching.seen.clear()
    run(tmp_path, f"{__name__}:Watching")
    name = TASK.cases(arena)[0].name.encode()
    assert len(name) > 7
    numbers = [int.from_bytes(name[first : first + 7], "big") for first in range(0, len(name), 7)]
    hidden = opponent(arena, "synthetic", 0).policies[0]
    again = observed(GAME, (best_response(hidden).policy, hidden), CHANGES[1], int(stream(0, *numbers, 0)[0] >> np.uint64(1)))
    for first, second in zip(Watching.seen, again, strict=False):
        assert first.stroke.tolist() == second.stroke.tolist()


def test_a_method_that_reads_the_opponent_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SuiteError, match="no attribute 'opponent'"):
        run(tmp_path, f"{__name__}:Peeking")


@pytest.mark.parametrize("method", ["minimax", "restricted-nash:0.5", "bandit", "bayes", "thompson", "counts:0.8"])
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


class _Setting:
    def __init__(self, arena: Arena) -> None:
        self.game, self.known, self.seed = GAME, known(arena), 0


def test_the_posterior_finds_a_known_type(arena: Arena) -> None:
    setting: Any = _Setting(arena)
    names = list(setting.known)
    agent = PosteriorMean(setting)
    for rally in observed(GAME, (setting.known["bc"], setting.known["defensive"]), 40, 1):
        agent.observe_rally(rally)
    assert agent.posterior.sum() == pytest.approx(1, abs=1e-9)
    assert names[int(agent.posterior.argmax())] == "defensive"
    assert agent.mean().block_probabilities(0) == pytest.approx(setting.known["defensive"].block_probabilities(0), abs=0.2)


def test_shifts_are_the_maximum_a_posteriori() -> None:
    feature, deviation = features(GAME)
    rng = np.random.default_rng(0)
    base = np.log(baselines.probabilities(None, GAME))
    played = rng.choice(GAME.n_base_pairs, 200)
    theta = fitted_shift(GAME, base, feature, deviation, played, np.zeros(len(deviation)))

    def loss(theta: Any) -> float:
        chance = shifted(GAME, base, feature, theta)
        return float(-np.log(chance[played]).sum() + 0.5 * ((theta / deviation) ** 2).sum())

    assert loss(theta) < loss(np.zeros_like(theta))
    for step in rng.normal(size=(5, len(theta))):
        assert loss(theta) < loss(theta + 0.1 * step)
