"""Policies must not reach the game: what they are given is read-only, and what they return is checked as it is."""

import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from shuttle_marl.game import default_game
from shuttle_marl.game.policy import PolicyError, States, UniformPolicy, checked_probabilities
from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.kernel import Matches
from shuttle_marl.kernel.matches import ask, play

GAME = default_game()
TABLES = (
    "edge_own", "edge_incoming", "edge_duel", "reply_start", "reply_count", "reply_edge", "threshold", "hurry", "fault_odds",
)  # fmt: skip
DERIVED = (
    "pair_start", "pair_state", "pair_stroke", "base_pair_start", "base_pair_state", "base_pair_rank",
    "base_pair_edge", "base_pair_stroke", "first_reply", "last_pairs", "playable", "reply_mask", "reply_rank",
    "edge_attack", "limits",
)  # fmt: skip


class Vandal:
    """Plays uniformly at random after it has tried to change something."""

    reads_score = True

    def __init__(self, act: Callable[[States], Any]) -> None:
        self.act = act

    def probabilities(self, states: States) -> np.ndarray:
        self.act(states)
        return UniformPolicy().probabilities(states)


def write(array: np.ndarray) -> None:
    array[...] = 0


def force(array: np.ndarray) -> None:
    array.setflags(write=True)
    array[...] = 0


def unlock_base(array: np.ndarray) -> None:
    assert isinstance(array.base, bytes)
    np.frombuffer(array.base, np.uint8)[...] = 0


WAYS = [write, force, unlock_base]


def some_states() -> States:
    return States(game=GAME, state=np.array([ROOT, 8, 17], np.int32), score=np.zeros((3, 4), np.int16))


@pytest.mark.parametrize("way", WAYS)
def test_no_table_of_a_game_can_be_written(way: Callable[[np.ndarray], None]) -> None:
    for game in (GAME, pickle.loads(pickle.dumps(GAME))):
        parts = [(game, name) for name in (*TABLES, *DERIVED)]
        parts += [(game.catalogue, name) for name in ("shot", "area", "height", "technique", "is_serve", "by_parts")]
        for owner, name in parts:
            before = getattr(owner, name).copy()
            with pytest.raises((ValueError, TypeError)):
                way(getattr(owner, name))
            assert np.array_equal(getattr(owner, name), before), name
        assert game.hash == GAME.hash


def test_a_game_does_not_change_with_the_arrays_it_was_made_from() -> None:
    tables = {name: getattr(GAME, name).copy() for name in TABLES}
    game = Game(catalogue=GAME.catalogue, **tables)
    tables["threshold"][:] = 0
    assert game.hash == GAME.hash
    assert game.threshold.any()


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    "name", ["state", "score", "own", "incoming", "contact", "duel", "effort", "opponent_effort", "hurried", "mask"]
)
def test_a_policy_that_writes_into_its_states_has_failed(name: str, way: Callable[[np.ndarray], None]) -> None:
    states = some_states()
    with pytest.raises(PolicyError, match=r"policy 'Vandal' raised (ValueError|TypeError)"):
        checked_probabilities(Vandal(lambda seen: way(getattr(seen, name))), states)
    assert states.state.tolist() == [ROOT, 8, 17]


def test_a_policy_that_widens_its_mask_does_not_get_an_illegal_stroke_through() -> None:
    class Cheat:
        def probabilities(self, states: States) -> np.ndarray:
            states.__dict__["mask"] = np.ones((len(states), GAME.n_strokes), bool)
            return np.full((len(states), GAME.n_strokes), 1 / GAME.n_strokes)

    with pytest.raises(PolicyError, match="plays the illegal stroke"):
        checked_probabilities(Cheat(), some_states())


@pytest.mark.parametrize("name", ["state", "score", "threshold"])
def test_matches_of_a_vandal_end_in_its_failure(name: str) -> None:
    vandal = Vandal(lambda seen: force(getattr(seen.game if name == "threshold" else seen, name)))

    def choose(entrant: Any, *seen: Any) -> Any:
        return ask(vandal, GAME, *seen)

    number = np.arange(5)
    matches = Matches(entrant=np.zeros((5, 2), np.int32), first_server=(number % 2).astype(np.int8), key=number.astype(np.uint64))
    with pytest.raises(PolicyError, match="policy 'Vandal' raised"):
        play(GAME, matches, choose)


class Returns:
    def __init__(self, change: Callable[[np.ndarray], Any]) -> None:
        self.change = change

    def probabilities(self, states: States) -> Any:
        return self.change(UniformPolicy().probabilities(states))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda p: p + 0j, "no array of real numbers"),
        (lambda p: p.astype(str), "no array of real numbers"),
        (lambda p: p.astype(object), "no array of real numbers"),
        (lambda p: "smash", "returned str, no array"),
        (lambda p: p[0], "returned shape"),
        (lambda p: p * np.nan, "NaN or infinity"),
        (lambda p: p.astype(np.longdouble) * np.longdouble("1e4000"), "NaN or infinity"),
        (lambda p: np.full_like(p, 1 / p.shape[1]), "plays the illegal stroke"),
        (lambda p: p / 2, "no distribution"),
        (lambda p: np.where(p > 0, -p, 0), "no distribution"),
    ],
)
def test_what_is_no_distribution_over_the_legal_strokes(change: Callable[[np.ndarray], Any], says: str) -> None:
    with pytest.raises(PolicyError, match=f"policy 'Returns' .*({says})"):
        checked_probabilities(Returns(change), some_states())
