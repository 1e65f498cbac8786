"""Rallies of a learner that acts from a table: the rules, the draws, the network's numbers, and the sums."""

import itertools

import numpy as np
import pytest

from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.game.tables import ROOT
from shuttle_marl.kernel import KernelError, RallySampler
from shuttle_marl.policy.registry import resolve
from tests.kernel.episodes import Assess, compare_with_rally_v0, network
from tests.reduced import reduced_game

GAME = reduced_game()
RANDOM = tabulate(resolve("random", GAME), GAME)
BC = tabulate(resolve("bc", GAME), GAME)


@pytest.mark.parametrize("opponents", [(), (RANDOM,), (RANDOM, BC)], ids=["self-play", "one", "two"])
def test_the_rallies_are_those_of_the_environment(opponents: tuple[TabulatedPolicy, ...]) -> None:
    sampler = RallySampler(GAME, opponents)
    sampler.reset(5)
    sampler.collect(1000, network(0))
    played = sampler.record(sampler.numbers[:300])
    compare_with_rally_v0(5, played, game=GAME)
    assert (played.policy[:, 0] == 0).all()
    assert (played.policy[:, 1] == (1 + played.match % len(opponents) if opponents else 0)).all()


def test_strokes_that_are_not_taken_are_dropped() -> None:
    calls = itertools.count()

    def failing(states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if next(calls) == 3:
            raise FloatingPointError
        return network(2)(states)

    found = []
    for disturbed in (False, True):
        sampler = RallySampler(GAME, [RANDOM])
        if disturbed:
            sampler.collect(2000, network(0))
            with pytest.raises(FloatingPointError):
                sampler.collect(2000, failing)
        sampler.reset(3, np.array([ROOT]))
        sampler.collect(500, network(1))
        found.append(sampler.take()._asdict())
    for name, one in found[0].items():
        assert np.array_equal(one, found[1][name]), name


def gae_by_hand(sampler: RallySampler, assess: Assess, decay: float, both: bool) -> dict[int, float]:
    """Sum of the advantages by legal pair, rally by rally from the log."""
    played = sampler.record(sampler.numbers)
    total: dict[int, float] = {}
    at = 0
    for server, winner, length in zip(played.server, played.winner, played.length, strict=True):
        strokes, hurried = (column[at : at + length].astype(int) for column in (played.stroke, played.hurried))
        at += length
        seen = [ROOT]
        for stroke, following, late in zip(strokes, strokes[1:], hurried[1:], strict=False):
            # The contact offered is that of the stroke that was played from it.
            seen.append(int(GAME.arrivals(GAME.pair(seen[-1], stroke))[GAME.catalogue.height[following] + 2 * late]))
        learner = [t for t in range(length) if both or (server + t) % 2 == 0]
        a, after = 0.0, 0.0
        for position, t in enumerate(reversed(learner)):
            seat = (server + t) % 2
            reward = (1.0 if winner == seat else -1.0) if position == 0 else 0.0
            sign = -1.0 if both else 1.0
            v = float(assess(np.array([seen[t]]))[1][0])
            a = reward + sign * after - v + sign * decay * a
            after = v
            pair = int(GAME.pair(seen[t], strokes[t]))
            total[pair] = total.get(pair, 0.0) + a
    return total


@pytest.mark.parametrize("both", [False, True])
def test_advantages_are_those_of_the_recursion(both: bool) -> None:
    assess = network(2)
    sampler = RallySampler(GAME, () if both else (RANDOM,), gae_lambda=0.7)
    sampler.collect(3000, assess)
    expected = gae_by_hand(sampler, assess, 0.7, both)
    found = sampler.take()
    total: dict[int, float] = {}
    for pair, advantage in zip(GAME.pair(found.state[found.row], found.stroke).tolist(), found.advantage.tolist(), strict=True):
        total[pair] = total.get(pair, 0.0) + advantage
    assert total.keys() == expected.keys()
    assert [total[pair] for pair in expected] == pytest.approx(list(expected.values()), abs=1e-3)


@pytest.mark.parametrize("opponents", [(), (RANDOM,)], ids=["self-play", "fixed"])
def test_the_sums_are_those_of_the_strokes_one_by_one(opponents: tuple[TabulatedPolicy, ...]) -> None:
    sampler = RallySampler(GAME, opponents, gae_lambda=0.6)
    sampler.collect(5000, network(3), keep=True)
    strokes, found = sampler.strokes, sampler.take()
    assert len(strokes.state) == found.strokes == sampler.count
    states, counts = np.unique(strokes.state, return_counts=True)
    assert (found.state == states).all()
    assert (found.visits == counts).all()
    value = network(3)(states)[1]
    returns = np.bincount(np.searchsorted(states, strokes.state), strokes.advantage) / counts + value
    np.testing.assert_allclose(found.returns, returns, atol=1e-4)
    for sign in (1, -1):
        rows = np.sign(found.advantage) == sign
        chosen = np.sign(strokes.advantage) == sign
        pair = GAME.pair(found.state[found.row[rows]], found.stroke[rows])
        assert len(np.unique(pair)) == len(pair)
        expected = np.bincount(strokes.pair[chosen], strokes.advantage[chosen], GAME.n_pairs)
        np.testing.assert_allclose(found.advantage[rows], expected[pair], rtol=1e-4, atol=1e-4)
        assert set(np.flatnonzero(expected)) == set(pair.tolist())
    assert found.deviation == pytest.approx(strokes.advantage.std(), rel=1e-4)
    ended = strokes.following < 0
    assert (np.abs(strokes.reward[ended]) == 1).all()
    assert (strokes.reward[~ended] == 0).all()
    again = sampler.take()
    assert not again.visits.size or not np.isfinite(again.returns).any()


@pytest.mark.parametrize("iterations", [1, 2, 3])
def test_outputs_are_reused_in_so_many_iterations(iterations: int) -> None:
    sampler = RallySampler(GAME, [RANDOM], cache_iterations=iterations)
    known, later = list[set[int]](), list[set[int]]()
    for _ in range(4):
        asked: list[set[int]] = []

        def assess(states: np.ndarray, asked: list[set[int]] = asked) -> tuple[np.ndarray, np.ndarray]:
            asked.append(set(states.tolist()))
            return network(0)(states)

        before = set(sampler.known.tolist())
        sampler.collect(2000, assess)
        assert asked[0] == before or not before, "those of the last iteration are refreshed first"
        known.append(set(sampler.known.tolist()))
        later.append(set().union(*asked[1 if before else 0 :]))
    # Outputs of states that came in the first iteration alone are as old as the second, at whose beginning they were refreshed.
    for number in (2, 3):
        old = known[0] - set().union(*known[1:number])
        assert old & known[number], "some come again"
        reused = number - 1 < iterations
        assert bool(old & later[number]) != reused


def test_distinct_states_are_returned_in_the_order_that_is_asked_for() -> None:
    found = []
    for backwards in (False, True):
        sampler = RallySampler(GAME, [RANDOM])
        sampler.collect(500, network(0))
        order = np.arange(len(sampler.known))[::-1] if backwards else None
        known, taken = sampler.known, sampler.take(order)
        assert taken.state.tolist() == (known[::-1] if backwards else np.sort(known)).tolist()
        assert taken.start[0] == 0
        assert taken.start[-1] == len(taken.row) == len(taken.advantage)
        assert taken.row.tolist() == np.repeat(np.arange(len(taken.state)), np.diff(taken.start)).tolist()
        found.append(dict(zip(taken.state.tolist(), taken.visits.tolist(), strict=True)))
    assert found[0] == found[1]


def test_records_are_of_the_last_iteration() -> None:
    sampler = RallySampler(GAME, [RANDOM])
    sampler.collect(50, network(0))
    sampler.collect(50, network(0))
    first, last = int(sampler.numbers[0]), int(sampler.numbers[-1])
    assert sampler.numbers.tolist() == list(range(first, last + 1))
    assert sampler.record(np.array([last, first])).match.tolist() == [last, first]
    for number in (first - 1, last + 1):
        with pytest.raises(KernelError, match=f"rallies: {number} to {number}; expected {first} to {last}"):
            sampler.record(np.array([number]))
    for states in ([-1], [GAME.n_states]):
        with pytest.raises(KernelError, match="states: "):
            sampler.reset(1, np.array(states))


def test_some_rallies_may_be_of_self_play() -> None:
    sampler = RallySampler(GAME, [RANDOM, BC])
    sampler.assign(np.array([-1, 1]))
    sampler.collect(500, network(0))
    played = sampler.record(sampler.numbers)
    assert set(played.policy[played.match % 2 == 1, 1]) == {2}
    sampler.replace_opponent(1, RANDOM)
    with pytest.raises(KernelError, match="opponents: -1 to 2"):
        sampler.assign(np.array([-1, 2]))
    with pytest.raises(KernelError, match="expected 0 or more"):
        sampler.replace_opponent(-1, BC)


def test_some_rallies_may_begin_anywhere() -> None:
    sampler = RallySampler(GAME)
    states = np.flatnonzero(GAME.playable)[500:700]
    sampler.restart(states, 0.25)
    sampler.collect(20_000, network(0))
    found, served = sampler.take(), len(sampler.numbers)
    assert abs(served / found.rallies - 0.75) < 0.05
    counted = dict(zip(found.state.tolist(), found.visits.tolist(), strict=True))
    # Every rally begins with a serve or in one of those states.
    assert counted[ROOT] == served
    assert sum(counted.get(s, 0) for s in states.tolist()) >= found.rallies - served
    played = sampler.record(sampler.numbers)
    assert (played.stroke[np.cumsum(played.length) - played.length] < GAME.n_strokes).all()
    with pytest.raises(KernelError, match="fraction"):
        sampler.restart(states, 1.5)
    with pytest.raises(KernelError, match="no legal strokes"):
        sampler.restart(np.array([1]), 0.5)


def test_records_have_the_figures_of_the_learner() -> None:
    sampler = RallySampler(GAME, [RANDOM])
    sampler.collect(2000, network(0))
    played = sampler.record(sampler.numbers[::-3], figures=True)
    assert played.optional_columns == ("log_probability", "value")
    own = played.striker == 0
    assert np.array_equal(np.isnan(played.value), ~own)
    logits, value = network(0)(played.states(GAME)[own])
    logits = np.where(GAME.mask(played.states(GAME)[own]), logits, -np.inf)
    chance = np.take_along_axis(logits, played.stroke[own, None].astype(np.int64), axis=1)[:, 0]
    np.testing.assert_allclose(played.log_probability[own], chance - np.logaddexp.reduce(logits, axis=1), atol=1e-5)
    assert np.array_equal(played.value[own], value)


def test_numbers_that_cannot_be_meant_are_refused() -> None:
    with pytest.raises(KernelError, match="gae_lambda"):
        RallySampler(GAME, gae_lambda=1.5)
    with pytest.raises(KernelError, match="cache_iterations"):
        RallySampler(GAME, cache_iterations=0)
    with pytest.raises(KernelError, match="shaping"):
        RallySampler(GAME, shaping=np.zeros(3, np.float32))
    sampler = RallySampler(GAME)
    with pytest.raises(KernelError, match="are not finite"):
        sampler.collect(
            10, lambda states: (np.full((len(states), GAME.n_strokes), np.nan, np.float32), np.zeros(len(states), "f4"))
        )
    with pytest.raises(KernelError, match="logits"):
        sampler.collect(10, lambda states: (np.zeros((len(states), 2), np.float32), np.zeros(len(states), "f4")))
    with pytest.raises(KernelError, match="states"):
        sampler.reset(0, np.array([GAME.n_states]))
    assert len(sampler.record(np.array([], np.int64)).length) == 0
    sampler.reset(0, np.array([GAME.n_states - 1]))
    assert sampler.known.tolist() == [GAME.n_states - 1]
    with pytest.raises(KernelError, match="no legal strokes"):
        sampler.reset(0, np.array([1]))
    sampler.reset(0)
    sampler.collect(10, network(0))
    with pytest.raises(KernelError, match="rallies"):
        sampler.record(np.array([10**6]))
