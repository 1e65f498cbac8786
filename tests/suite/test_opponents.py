"""Drawn opponents of adapt, in a game of four strokes."""

from typing import Any

import numpy as np
import pytest

from shuttle_marl.game.draws import stream
from shuttle_marl.game.recovery import CENTRE
from shuttle_marl.suite import population
from shuttle_marl.suite.adapt import Adapt, PlayedRally, observed
from shuttle_marl.suite.population import Opponent, luck, rng_of
from shuttle_marl.suite.task import Arena
from tests.exact.exact_games import THREE_STROKES, hand_made, random_game, random_policy
from tests.exact.test_hidden_positions_solved import waiting, with_recovery

GAME = hand_made((*THREE_STROKES, "clear:back-left:above:forehand"))
HIDDEN = with_recovery(random_game(2), 2)


def test_random_numbers_are_of_a_split_or_of_a_seed() -> None:
    def drawn(*arguments: Any) -> int:
        return int(rng_of(*arguments).integers(1 << 62))

    asked: list[Any] = [("adapt-v1", "dev", None, "a 1"), ("adapt-v1", "test", None, "a 1"), ("adapt-v1", "dev", None, "a 2")]
    asked += [("adapt-v1", "round", seed * 32, "a 1") for seed in ("ab", "cd")]
    assert len({drawn(*each) for each in asked}) == len(asked)
    assert luck("dev", None, 3, 4) == luck("test", "ab" * 32, 3, 4) == int(stream(3, 4)[0]) // 2
    assert len({luck("round", seed * 32, *numbers) for seed in ("ab", "cd") for numbers in ((3, 4), (4, 3))}) == 4


def test_an_opponent_plays_what_started_last() -> None:
    one, two = (random_policy(GAME, seed) for seed in range(2))
    changing = Opponent((one, two), (0, 150))
    assert [changing.at(rally) for rally in (0, 149, 150, 499)] == [one, one, two, two]


def test_habits_of_position_follow_the_own_stroke() -> None:
    policy = waiting(random_policy(HIDDEN, 0), 0)
    shift = np.random.default_rng(1).normal(size=(14, 9))
    before, found = policy.position_probabilities(), population.waiting(policy, shift).position_probabilities()
    for state in range(0, HIDDEN.n_states, 17):
        weight = before[state] * np.exp(shift[HIDDEN.incoming_shot(state)])
        np.testing.assert_allclose(found[state], weight / weight.sum(), atol=2e-5)
    assert population.waiting(policy, shift).cumulative is policy.cumulative


def test_cases_of_adapt() -> None:
    cases = Adapt().cases(Arena(game=HIDDEN))
    names = [case.name for case in cases]
    assert names == [f"{family}/{number}" for family in population.FAMILIES for number in range(8)] + [
        f"people/{i}" for i in range(8)
    ]
    assert [case.name for case in cases if not case.counts] == [f"people/{number}" for number in range(8)]
    assert {case.stratum for case in cases} == {*population.FAMILIES, "people"}
    assert cases[9].options == {"family": "waiting", "number": 1}
    assert [case.name for case in Adapt().cases(Arena(game=HIDDEN, quick=True))] == ["synthetic/0"]
    assert len(Adapt().cases(Arena(game=GAME))) == 56


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
        assert (rally.position >= 0).all()
    waited = {place for rally in rallies for place in rally.position.tolist()}
    assert waited == {CENTRE} if game is GAME else len(waited) > 1
    assert len({rally.own[0] for rally in rallies}) == 2
    assert len({rally.won for rally in rallies}) == 2
