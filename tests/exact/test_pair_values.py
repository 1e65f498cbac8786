"""Exact values of the game of a pair, against simulation and value iteration."""

import itertools

import numpy as np
import pytest

from shuttle_marl.exact import ExactError, best_response, crossplay, evaluate, moved, nash_conv, solve, visits
from shuttle_marl.game.pairs import pair_game, without_skill
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.policy.registry import resolve
from tests.reduced import reduced_model

A, B = "viktor-axelsen", "kento-momota"


@pytest.fixture(scope="module")
def pair() -> Game:
    return pair_game(A, B, game=reduced_model())


@pytest.fixture(scope="module")
def clones(pair: Game) -> tuple[TabulatedPolicy, TabulatedPolicy]:
    return seated(pair, f"bc:{A}", f"bc:{B}")


def seated(pair: Game, *names: str) -> tuple[TabulatedPolicy, TabulatedPolicy]:
    first, second = (tabulate(resolve(name, game), game) for name, game in zip(names, pair.seats, strict=True))
    return first, second


def test_exchanged_players_have_mirrored_values(pair: Game, clones: tuple[TabulatedPolicy, TabulatedPolicy]) -> None:
    other = pair.swapped
    mirrored = evaluate(moved(clones[1], other.seats[0]), moved(clones[0], other.seats[1]))
    here = evaluate(*clones)
    for seat in (0, 1):
        assert np.abs(here.striking[seat] - mirrored.striking[1 - seat]).max() < 1e-8
    assert here.odds(0).match() == pytest.approx(1 - mirrored.odds(0).match(), abs=1e-7)
    assert solve(pair).value[0][ROOT] == pytest.approx(solve(other).value[1][ROOT], abs=1e-8)


def test_average_players_have_the_values_of_the_average_game() -> None:
    both = pair_game("average", "average", game=reduced_model())
    (first, second), game = seated(both, "bc", "bc"), both.seats[0].average
    plain = moved(first, game)
    assert evaluate(first, second).odds() == pytest.approx(evaluate(plain, plain).odds(), abs=1e-8)
    assert solve(both).value_at_serve == pytest.approx(solve(game).value_at_serve, abs=1e-8)


def test_best_responses_are_those_of_the_other_player(pair: Game, clones: tuple[TabulatedPolicy, TabulatedPolicy]) -> None:
    answer = best_response(clones[1])
    assert answer.game is pair.seats[0]
    assert evaluate(answer.policy, clones[1]).odds().value == pytest.approx(answer.value.odds().value, abs=1e-8)
    own, theirs = answer.value.odds().value, best_response(clones[0]).value.odds().value
    assert nash_conv(*clones).nash_conv == pytest.approx(own + theirs, abs=1e-8)
    # The same strokes by the other player, where no opponent is given.
    alone = nash_conv(clones[0], moved(clones[0], pair.seats[1])).nash_conv
    assert nash_conv(clones[0]).nash_conv == pytest.approx(alone, abs=1e-6)


def test_crossplay_of_both_players(pair: Game) -> None:
    names = ("bc", "random")
    first, second = zip(*(seated(pair, name, name) for name in names), strict=True)
    odds, again = crossplay(first, second), crossplay(first, second)
    for i, j in itertools.product(range(2), repeat=2):
        expected = evaluate(first[i], second[j]).odds()
        assert (odds.serving[i, j], odds.receiving[i, j]) == pytest.approx((expected.serving, expected.receiving), abs=1e-8)
    assert np.abs(odds.match() - again.match()).max() < 1e-6
    assert odds.error_bound < 1e-8


def test_tables_of_a_pair_meet_only_each_other(pair: Game, clones: tuple[TabulatedPolicy, TabulatedPolicy]) -> None:
    average = moved(clones[0], without_skill(clones[0].game))
    for opponent in (clones[0], average):
        with pytest.raises(ExactError, match=f"{A} strikes with the tables of a pair, and the opponent does not strike as {B}"):
            evaluate(clones[0], opponent)
    with pytest.raises(ExactError, match="does not strike"):
        visits(average, clones[1])
    with pytest.raises(ExactError, match="does not strike"):
        crossplay(clones)
    with pytest.raises(ExactError, match="solve it alone"):
        solve(pair, pair.seats[1])
    # Another refit of the same pair is no obstacle: it has the same players.
    refit = pair.people.refits()[0]
    evaluate(clones[0], moved(clones[1], refit.seats[1]))


def test_policies_of_the_seats(pair: Game) -> None:
    solution = solve(pair)
    for seat, table in enumerate(seated(pair, "minimax", "minimax")):
        assert table.hash == solution.policy[seat].hash
    bc = seated(pair, "bc", "bc")
    first, second = seated(pair, "best-response:bc", "best-response:bc")
    assert first.hash == best_response(bc[1]).policy.hash != second.hash == best_response(bc[0]).policy.hash
