"""Drawn opponents, cases of the other tasks, and their figures, in a game of four strokes."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from shuttle_marl.exact.match import Odds
from shuttle_marl.exact.profile import positions_of
from shuttle_marl.game.draws import stream
from shuttle_marl.suite import adapt, frontier, offline, population
from shuttle_marl.suite.adapt import Adapt, PlayedRally, _blocks, _met, observed
from shuttle_marl.suite.offline import Evaluate, Offline, errors
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.population import Opponent, checked_beacon, families, luck, rng_of
from shuttle_marl.suite.task import Arena, Case, Outcome
from tests.exact.exact_games import THREE_STROKES, hand_made, random_game, random_policy
from tests.exact.test_hidden_positions_solved import waiting, with_recovery

GAME = hand_made((*THREE_STROKES, "clear:back-left:above:forehand"))
HIDDEN = with_recovery(random_game(2), 2)
ONE, TWO, THREE = (random_policy(GAME, seed) for seed in range(3))


def test_an_opponent_plays_what_started_last_and_learns(monkeypatch: pytest.MonkeyPatch) -> None:
    changing = Opponent((ONE, TWO), (0, 150))
    assert [changing.at(rally) for rally in (0, 149, 150, 499)] == [ONE, ONE, TWO, TWO]
    assert changing.at(200, THREE) is TWO
    monkeypatch.setattr(population, "best_response_policy", lambda met: THREE if met is TWO else None)
    learner = Opponent((ONE,), learns=0.25)
    assert learner.at(9) is ONE
    expected = 0.75 * ONE.pair_probabilities() + 0.25 * THREE.pair_probabilities()
    np.testing.assert_allclose(learner.at(9, TWO).pair_probabilities(), expected, atol=2e-5)


def test_random_numbers_are_of_a_split_or_of_a_beacon() -> None:
    def drawn(*arguments: Any) -> int:
        return int(rng_of(*arguments).integers(1 << 62))

    first = drawn("adapt-v0", "dev", None, "a 1")
    assert first == drawn("adapt-v0", "dev", "ab" * 32, "a 1")
    others = {
        drawn(*each)
        for each in (
            ("adapt-v0", "test", None, "a 1"), ("adapt-v1", "dev", None, "a 1"), ("adapt-v0", "dev", None, "a 2"),
            ("adapt-v0", "round", "ab" * 32, "a 1"), ("adapt-v0", "round", "cd" * 32, "a 1"),
        )
    }  # fmt: skip
    assert len({first, *others}) == 6
    assert drawn("x", "round", "ab" * 32, "a") == drawn("y", "round", "ab" * 32, "a")
    assert luck("dev", None, 3, 4) == luck("test", "ab" * 32, 3, 4) == int(stream(3, 4)[0]) // 2
    seeds = {luck("round", beacon * 32, *numbers) for beacon in ("ab", "cd") for numbers in ((3, 4), (4, 3), (3,))}
    assert len(seeds) == 6
    assert 0 <= min(seeds) <= max(seeds) < 1 << 63
    assert max(seeds) > 1 << 61


@pytest.mark.parametrize("wrong", [None, "", "a" * 63, "a" * 65, "A" * 64, "g" * 64, "a" * 64 + "\n"])
def test_randomness_is_64_digits(wrong: str | None) -> None:
    with pytest.raises(SuiteError, match="64 hexadecimal digits"):
        checked_beacon(wrong)
    assert checked_beacon("0f" * 32) == "0f" * 32


def test_players_are_of_one_population(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shuttle_marl.policy.baselines.players", lambda _: list("abcdefgh"))
    arena = Arena(game=GAME)
    assert ["".join(population._players(arena, part)) for part in range(3)] == ["adg", "beh", "cf"]
    assert (Arena(game=GAME, split="dev").players, Arena(game=GAME, split="test").players) == (tuple("bdfh"), tuple("aceg"))
    monkeypatch.setattr("shuttle_marl.policy.baselines.players", lambda _: ["a"])
    assert population._players(arena, 2) == ["a"]
    assert "waiting" in families(HIDDEN)
    assert families(GAME) == tuple(name for name in population.FAMILIES if name != "waiting")


def test_features_of_tilts_by_pair() -> None:
    found, catalogue = population._features(GAME), GAME.catalogue
    fault = GAME.outcome_probabilities()[:, 0]
    for pair in range(GAME.n_base_pairs):
        k = int(GAME.base_pair_stroke[pair])
        _, place, *_ = catalogue.names[k].split(":")
        assert [found[name][pair] for name in ("net", "deep", "side", "attack")] == [
            place.startswith("front"), place.startswith("back"), not place.endswith("centre"), "smash" in catalogue.names[k],
        ]  # fmt: skip
        assert found["risk"][pair] == pytest.approx(min(3.0, 10 * fault[pair]))


def test_a_tilt_changes_the_logarithms_of_shares(monkeypatch: pytest.MonkeyPatch) -> None:
    before = ONE.block_probabilities(0)
    monkeypatch.setattr("shuttle_marl.policy.baselines.probabilities", lambda player, game: before)
    shift = np.random.default_rng(0).normal(size=GAME.n_base_pairs)
    weight = before * np.exp(shift)
    expected = weight / np.bincount(GAME.base_pair_state, weight)[GAME.base_pair_state]
    found = population.tilted(Arena(game=GAME), shift)
    np.testing.assert_allclose(found.block_probabilities(0), expected, atol=2e-5)


def test_habits_of_position_follow_the_own_stroke() -> None:
    policy = waiting(random_policy(HIDDEN, 0), 0)
    shift = np.random.default_rng(1).normal(size=(14, 9))
    before, found = positions_of(policy), positions_of(population.waiting(policy, shift))
    for state in range(0, HIDDEN.n_states, 17):
        weight = before[state] * np.exp(shift[HIDDEN.incoming_shot(state)])
        np.testing.assert_allclose(found[state], weight / weight.sum(), atol=2e-5)
    assert population.waiting(policy, shift).cumulative is policy.cumulative


def test_blocks_of_rallies_without_a_change() -> None:
    plain = [(0, 5), (5, 20), (20, 80), (80, 240), (240, 500)]
    assert _blocks(Opponent((ONE,))) == plain
    assert _blocks(Opponent((ONE, TWO), (0, 150))) == [*plain[:3], (80, 150), (150, 240), (240, 500)]
    assert _blocks(Opponent((ONE, TWO), (0, 240))) == plain
    tables = {start: random_policy(GAME, 10 + start) for start, _ in plain}
    met: list[Any] = []

    class Asked:
        def at(self, start: int, before: Any) -> str:
            met.append((start, before))
            return f"at {start}"

    asked: Any = Asked()
    assert [_met(asked, tables, start) for start in (0, 5, 150, 240)] == [
        (tables[0], "at 0"), (tables[5], "at 5"), (tables[80], "at 150"), (tables[240], "at 240"),
    ]  # fmt: skip
    assert met == [(0, None), (5, tables[0]), (150, tables[20]), (240, tables[80])]


def test_cases_of_adapt() -> None:
    cases = Adapt().cases(Arena(game=HIDDEN))
    names = [case.name for case in cases]
    assert names == [f"{family}/{number}" for family in population.FAMILIES for number in range(3)] + ["control/0"]
    assert [case.name for case in cases if not case.counts] == ["control/0"]
    assert {case.stratum for case in cases} == {*population.FAMILIES, "control"}
    assert cases[4].options == {"family": "waiting", "number": 1}
    assert [case.name for case in Adapt().cases(Arena(game=HIDDEN, quick=True))] == ["synthetic/0", "waiting/0"]
    assert len(Adapt().cases(Arena(game=GAME))) == 19


def test_scores_of_adapt_are_means_over_rallies(monkeypatch: pytest.MonkeyPatch) -> None:
    """The best response wins .8; the tables win .5, .6, .7, .75 and .8 of the rallies from 0, 5, 20, 80 and 240 on."""
    tables = {start: random_policy(GAME, 20 + start) for start in adapt.CHANGES}
    won = dict(zip(map(id, tables.values()), (0.5, 0.6, 0.7, 0.75, 0.8), strict=True))

    def odds(rally: float) -> Odds:
        return Odds(serving=rally, receiving=rally, error_bound=0.0)

    asked: list[Any] = []

    def gains(arena: Any, played: Any, *, rallies: Any, tolerance: float) -> tuple[float, float]:
        asked.append((played, rallies))
        return 3.0, 9.0

    monkeypatch.setattr(adapt, "_opponent", lambda *_: Opponent((ONE,)))
    monkeypatch.setattr(adapt, "best_odds", lambda policies, tolerance: [odds(0.8) for _ in policies])
    monkeypatch.setattr(adapt, "pair_odds", lambda played, tolerance: [odds(won[id(mine)]) for mine, _ in played])
    monkeypatch.setattr(adapt, "exploitabilities", lambda policies, tolerance: [10 * won[id(each)] for each in policies])
    monkeypatch.setattr(adapt, "gains", gains)
    outcome = Outcome(policies={str(start): table for start, table in tables.items()})
    found = Adapt().score(Arena(game=GAME), Case(name="x"), 0, outcome)
    lost = np.repeat([30.0, 20.0, 10.0, 5.0, 0.0], [5, 15, 60, 160, 260])
    assert found == pytest.approx({
        "gain": 3.0, "best": 9.0, "regret_20": lost[:20].mean(), "regret_100": lost[:100].mean(), "regret_500": lost.mean(),
        "exploitability": np.average([7.0, 7.5, 8.0], weights=[60, 160, 260]),
    })  # fmt: skip
    ((played, rallies),) = asked
    assert [id(mine) for mine, _ in played] == list(won)
    assert {id(theirs) for _, theirs in played} == {id(ONE)}
    assert rallies == [5, 15, 60, 160, 260]
    with pytest.raises(SuiteError, match="no policy '5' is stored"):
        Adapt().score(Arena(game=GAME), Case(name="x"), 0, Outcome(policies={"0": ONE}))


@pytest.mark.parametrize("game", [GAME, HIDDEN], ids=["plain", "hidden"])
def test_rallies_are_observed_from_seat_0(game: Any) -> None:
    policy = random_policy(game, 0)
    rallies: list[PlayedRally] = list(observed(game, (policy, policy), 12, 5))
    assert len(rallies) == 12
    for rally in rallies:
        assert len(rally.state) == len(rally.pair) == len(rally.stroke) == len(rally.own) == len(rally.position) > 0
        assert game.pair(rally.state, rally.stroke).tolist() == rally.pair.tolist()
        assert (np.diff(rally.own.astype(int)) != 0).all(), "in turn"
        assert isinstance(rally.won, bool)
        assert (rally.position >= 0).all() == (game is HIDDEN)
    assert len({rally.own[0] for rally in rallies}) == 2
    assert len({rally.won for rally in rallies}) == 2


def test_gains_are_above_perfect_play_in_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two pairs that win .6 and .8 in the restricted game, perfect play .5 and .55, the best responses .7 and .9."""
    worth = {(0, 0): 0.6, (1, 1): 0.8, (2, 0): 0.5, (2, 1): 0.55, (None, 0): 0.7, (None, 1): 0.9}
    asked: list[Any] = []

    def restricted(pairs: Any, p: float, *, tolerance: float) -> list[Odds]:
        asked.append((p, tolerance))
        return [Odds(serving=worth[pair], receiving=worth[pair], error_bound=0.0) for pair in pairs]

    monkeypatch.setattr(frontier, "restricted_odds", restricted)
    arena: Any = SimpleNamespace(policy=lambda name: 2 if name == "minimax" else None)
    played: Any = [(0, 0), (1, 1)]
    assert frontier.gains(arena, played, tolerance=0.1) == pytest.approx((17.5, 27.5))
    assert frontier.gains(arena, played, rallies=[3, 1], tolerance=0.1) == pytest.approx((65 - 51.25, 75 - 51.25))
    assert {*asked} == {(0.75, 0.1)}
    risks = [Odds(serving=x, receiving=x, error_bound=0.0) for x in (0.55, 0.5, 0.49)]
    monkeypatch.setattr(frontier, "best_odds", lambda policies, tolerance: risks)
    assert frontier.exploitabilities([], tolerance=0.1) == pytest.approx([5, 0, 0])


def test_figures_of_estimates_by_hand() -> None:
    found = errors(np.array([0.5, 0.7, 0.3]), np.array([0.4, 0.8, 0.45]), [True, False, True])
    assert found == pytest.approx({
        "error": np.sqrt((100 + 100 + 225) / 3), "bias": -5, "bias_trained": -2.5, "rank_correlation": 0.5, "regret": 0,
    })  # fmt: skip
    same = errors(np.array([0.5, 0.5]), np.array([0.4, 0.8]), [False, False])
    assert (same["rank_correlation"], same["regret"], same["bias_trained"]) == (0, pytest.approx(40), 0)


def test_behaviours_of_logs(monkeypatch: pytest.MonkeyPatch) -> None:
    known: dict[str, Any] = {"a": ONE, "b": TWO}
    monkeypatch.setattr(Arena, "policy", lambda self, name: known[name])
    monkeypatch.setattr("shuttle_marl.policy.baselines.players", lambda _: ["ann", "bob"])
    arena = Arena(game=GAME)
    assert offline.behaviour(arena, "b") is TWO
    expected = 0.75 * ONE.pair_probabilities() + 0.25 * TWO.pair_probabilities()
    np.testing.assert_allclose(offline.behaviour(arena, "a+0.25*b").pair_probabilities(), expected, atol=2e-5)
    assert Offline().behaviours(arena) == ("bc", "bc+0.1*minimax", "attacking@greedy", "minimax", "bc:bob")
    cases = Offline().cases(arena)
    assert [case.name for case in cases[:2]] == ["bc/10,000", "bc/100,000"]
    assert [case.budget for case in cases] == [10**4, 10**5] * 5 + [10**6]
    assert [case.name for case in cases if not case.counts] == ["minimax/10,000", "minimax/100,000"]
    assert [(case.name, case.budget) for case in Offline().cases(Arena(game=GAME, quick=True))] == [("bc/3,000", 3000)]
    logs = Evaluate().cases(arena)
    assert len(logs) == 20
    assert [(case.name, case.stratum, case.budget) for case in logs[:4]] == [
        ("bc/10,000/same", "10,000/same", 10**4), ("bc/10,000/fresh", "10,000/fresh", 10**4),
        ("bc/100,000/same", "100,000/same", 10**5), ("bc/100,000/fresh", "100,000/fresh", 10**5),
    ]  # fmt: skip
    monkeypatch.setattr(offline, "generate", lambda arena, name, strokes, seed: (name, strokes, seed))
    assert [offline.log_of_unit(arena, case, 3) for case in logs[:2]] == [("bc", 10**4, 3), ("bc", 10**4, 1003)]


def test_estimates_are_probabilities(monkeypatch: pytest.MonkeyPatch) -> None:
    arena, case = Arena(game=GAME), Case(name="x", budget=9, options={"behaviour": "bc", "log": "same"})
    monkeypatch.setattr(offline, "log_of_unit", lambda *_: SimpleNamespace(game=GAME, hash="h"))
    monkeypatch.setattr(offline, "targets", lambda *_: {"safe": ONE, "clone": TWO})
    monkeypatch.setattr(Arena, "policy", lambda self, name: THREE)
    rallies = [Odds(serving=x, receiving=x, error_bound=0.0) for x in (0.4, 0.8)]
    monkeypatch.setattr(offline, "pair_odds", lambda pairs: rallies if [other for _, other in pairs] == [THREE] * 2 else None)
    given: list[Any] = []

    def estimator(found: Any) -> Any:
        def estimate(log: Any, policies: Any) -> Any:
            given.append(policies)
            return found

        return lambda setting: SimpleNamespace(estimate=estimate)

    task = Evaluate()
    assert task.play(arena, case, estimator([-0.5, 1.5]), 0, Path()).answers == {"estimates": [0.0, 1.0]}
    assert [each.hash for each in given[0]] == [ONE.hash, TWO.hash]
    for wrong in ("x", [[1], [1, 2]], {"a": 1}):
        with pytest.raises(SuiteError, match="the estimates are no list of numbers"):
            task.play(arena, case, estimator(wrong), 0, Path())
    found = task.score(arena, case, 0, Outcome(answers={"estimates": [0.5, 0.7]}))
    assert found == pytest.approx({"error": 10, "bias": 0, "bias_trained": -10, "rank_correlation": 1, "regret": 0})
    for estimates, says in (
        ([0.5], "expected 2 estimates, got 1"),
        ([0.5, 0.5, 0.5], "expected 2 estimates, got 3"),
        ([0.5, 1.01], "the estimates are no numbers from 0 to 1"),
        ([0.5, -0.01], "the estimates are no numbers from 0 to 1"),
        (None, "the estimates are no numbers from 0 to 1"),
    ):
        with pytest.raises(SuiteError, match=says):
            task.score(arena, case, 0, Outcome(answers={"estimates": estimates}))
    assert list(task.given(arena, case, 0)) == ["h", ONE.hash, TWO.hash]
