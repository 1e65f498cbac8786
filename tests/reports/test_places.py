"""Positions of a receiver in one state, against the solution of the whole game."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from shuttle_marl.exact import Solution, solve
from shuttle_marl.exact.profile import met
from shuttle_marl.game.recovery import CENTRE
from shuttle_marl.game.shipped import load_game
from shuttle_marl.game.tables import Game
from shuttle_marl.reports.rating import GOOD, Places, places_of
from shuttle_marl.reports.value import Value
from tests.reduced import reduced_model


@pytest.fixture(scope="module")
def game() -> Game:
    return dataclasses.replace(load_game(reduced_model(())), recovery=load_game("default:recovery").recovery)


@pytest.fixture(scope="module")
def solution(game: Game) -> Solution:
    return solve(game)


@pytest.fixture(scope="module")
def states(game: Game) -> list[int]:
    some = np.flatnonzero(game.playable & (game.waiting.choices[np.arange(game.n_states) % game.n_base_states] > 1))
    found: list[int] = np.random.default_rng(0).choice(some, 60, replace=False).tolist()
    return found


def test_the_matrix_of_a_state_has_the_value_of_the_game(game: Game, solution: Solution, states: list[int]) -> None:
    """Against perfect positions the best stroke has the value of the state, and no position of perfect play loses anything."""
    mixed = 0
    for state in states:
        for seat in (0, 1):
            places = places_of(game, state, seat, solution)
            assert places is not None
            value = (1 + solution.value[seat][state]) / 2
            assert (places.win @ places.perfect).max() == pytest.approx(value, abs=1e-4)
            assert (places.struck @ places.win).min() == pytest.approx(value, abs=1e-4)
            assert places.loss[places.perfect > 0.01].max() < 1e-3 < GOOD
            assert places.perfect.sum() == pytest.approx(1)
            mixed += (places.perfect > 0.01).sum() > 1
    assert mixed > 10


def test_against_people_strokes_are_worth_what_they_are_without_recovery(
    game: Game, solution: Solution, states: list[int]
) -> None:
    worth = Value(met(game, game.people_positions(np.arange(game.n_states))), solution.value, 0)
    for state in states[:20]:
        places = places_of(game, state, 0, solution)
        assert places is not None
        pairs = game.pairs_of(state)
        assert places.win @ places.people == pytest.approx(worth.win(np.arange(pairs.start, pairs.stop)), abs=1e-9)
        assert places.gain @ places.people == pytest.approx(0, abs=1e-12)


def test_a_receiver_without_a_choice_has_no_places(game: Game, solution: Solution) -> None:
    assert places_of(game, 0, 0, solution) is None, "of a serve"


@pytest.mark.parametrize(
    ("loss", "waited", "asked"),
    [
        ([0.0, 0.03, 0.04], 5, True),
        ([0.0, 0.03, 0.04], CENTRE, False),
        ([0.0, 0.001, 0.04], 5, False),
        ([0.02, 0.0, 0.04], 5, True),
        ([0.0, 0.03, 0.01], 5, False),
        ([0.0, 0.03, 0.04], 8, False),
    ],
)
def test_it_is_asked_where_it_matters(loss: list[float], waited: int, asked: bool) -> None:
    """Of the positions 4, 2 and 5."""
    third = np.full(3, 1 / 3)
    fields: Any = {"position": np.array([CENTRE, 2, 5]), "people": third, "perfect": third, "struck": np.ones(1)}
    assert Places(win=np.array([loss]), **fields).asks(waited) == asked


def test_places_lose_against_the_best_one() -> None:
    fields: dict[str, Any] = {"people": np.array([0.5, 0.25, 0.25]), "perfect": np.array([0, 1.0, 0]), "struck": np.full(2, 0.5)}
    win = np.array([[0.5, 0.25, 0.75], [0.5, 0.5, 0.5]])
    places = Places(position=np.array([1, CENTRE, 7]), win=win, **fields)
    assert places.loss.tolist() == [0.125, 0, 0.25]
    assert places.gain.tolist() == [[0, -0.25, 0.25], [0, 0, 0]]
