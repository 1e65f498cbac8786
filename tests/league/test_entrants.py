"""Entrants that fail, and entrants that read the score."""

import dataclasses
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from shuttle_marl.game.policy import States, tabulate
from shuttle_marl.kernel.matches import play
from shuttle_marl.league.entrants import Entrant, Strikers, enter
from shuttle_marl.league.ranking import rank, results_table
from shuttle_marl.league.tournament import Tournament, matches_of, round_robin
from shuttle_marl.policy.foreign import FunctionPolicy
from shuttle_marl.policy.registry import resolve
from tests.reduced import reduced_game

GAME = reduced_game()


def uniform(states: States) -> np.ndarray:
    return states.mask / states.mask.sum(axis=1, keepdims=True)


def raises(states: States) -> np.ndarray:
    raise RuntimeError("out of shuttles")


def exits(states: States) -> np.ndarray:
    sys.exit(0)


def unreadable(states: States) -> np.ndarray:
    class Unreadable(Exception):
        def __str__(self) -> str:
            raise RuntimeError("no message either")

    raise Unreadable


def tired(states: States) -> np.ndarray:
    """Gives up when it is behind in games; plays as long as it is not."""
    if (states.score[:, 3] > 0).any():
        raise TimeoutError("legs")
    return uniform(states)


FAILURES: dict[Callable[[States], Any], str] = {
    raises: "raised RuntimeError: out of shuttles",
    exits: "raised SystemExit: 0",
    unreadable: "raised Unreadable: (its message cannot be read)",
}


def entrant(name: str, function: Callable[[States], Any], *, reads_score: bool = False) -> Entrant:
    """The entrant that `enter` makes of a function, without a module to import it from."""

    class ReadsScore(FunctionPolicy):
        reads_score = True

    if reads_score:
        return Entrant(name=name, policy=ReadsScore(function))
    policy = FunctionPolicy(function)
    return Entrant(name=name, policy=policy, table=tabulate(policy, GAME))


def tournament(entrants: list[Entrant], matches: int = 4, batch: int = 8192) -> Tournament:
    return Tournament(GAME, entrants, matches=matches, seed=0, batch=batch, keep_strokes=True)


@pytest.mark.parametrize("function", FAILURES, ids=lambda f: f.__name__)
def test_a_failing_entrant_enters_and_forfeits_every_match(function: Callable[[States], Any]) -> None:
    name = f"{__name__}:{function.__name__}"
    broken = enter(name, GAME)
    assert FAILURES[function] in broken.failure
    assert broken.table is None
    assert broken.hash == ""
    good = [enter(name, GAME) for name in ("random", "safe")]
    pool = ["random", name, "safe"]
    blocks = [block for group in tournament([good[0], broken, good[1]]).play(round_robin(pool)) for block in group]
    results = [result for result, _ in blocks]
    assert [result.forfeit for result in results] == [(name,), (), (name,)]
    assert all(FAILURES[function] in result.reason for result in results if result.forfeit)
    assert [bool(rallies) for _, rallies in blocks] == [False, True, False]
    standings = rank(pool, results, seed=0)
    assert [(s.player, s.forfeits, s.matches) for s in standings][-1] == (name, 2, 0)
    assert {s.matches for s in standings[:2]} == {4}
    table = results_table(results)
    assert table.column("forfeit").to_pylist() == [name] * 2 + [""] * 2 + [name] * 2
    assert table.column("mean_rally_length").null_count == 4


@pytest.mark.parametrize("function", [raises, exits, tired], ids=lambda f: f.__name__)
def test_one_that_reads_the_score_forfeits_while_it_plays(function: Callable[[States], Any]) -> None:
    pool = [entrant("a", uniform), entrant("broken", function, reads_score=True), enter("safe", GAME)]
    results = [r for group in tournament(pool).play(round_robin(["a", "broken", "safe"])) for r, _ in group]
    assert [result.forfeit for result in results] == [("broken",), (), ("broken",)]
    assert results[0].seats[0]["matches"] == 0
    assert FAILURES.get(function, "raised TimeoutError: legs") in results[0].reason


@pytest.mark.parametrize(("batch", "sizes"), [(12, [3]), (9, [2, 1]), (8, [2, 1]), (7, [1, 1, 1]), (1, [1, 1, 1])])
def test_pairings_share_batches_of_an_even_number_of_matches(batch: int, sizes: list[int]) -> None:
    pool = [entrant(name, uniform) for name in "abc"]
    found = [len(group) for group in tournament(pool, matches=4, batch=batch).play(round_robin("abc"))]
    assert found == sizes


def test_both_fail() -> None:
    pool = [dataclasses.replace(entrant(name, uniform), table=None, failure=f"{name} is hurt") for name in "ab"]
    ((result, rallies),) = next(iter(tournament(pool).play(round_robin("ab"))))
    assert (result.forfeit, result.reason, rallies) == (("a", "b"), "a is hurt; b is hurt", [])


def test_a_policy_asked_at_every_stroke_plays_what_its_table_plays() -> None:
    """Tables round probabilities to 1/65535; a policy whose probabilities are such already is sampled alike."""
    table = tabulate(resolve("safe", GAME), GAME)
    asked = entrant("safe", table.probabilities, reads_score=True)
    pairing = round_robin(["random", "safe"])[0]
    other = enter("random", GAME)
    matches = matches_of(pairing, 3, 0, 6)
    played = [play(GAME, matches, Strikers(GAME, [other, it]).choose) for it in (asked, enter("safe", GAME))]
    assert np.array_equal(played[0].games, played[1].games)
    for name, column in played[0].rallies.columns():
        assert np.array_equal(column, getattr(played[1].rallies, name)), name


def test_the_score_is_the_strikers_own_view() -> None:
    seen: list[np.ndarray] = []

    def watching(states: States) -> np.ndarray:
        serving = states.incoming == GAME.n_strokes
        seen.append(states.score[serving])
        return uniform(states)

    strikers = Strikers(GAME, [entrant("watching", watching, reads_score=True), enter("attacking", GAME)])
    matches = matches_of(round_robin(["watching", "attacking"])[0], 0, 0, 2)
    played = play(GAME, matches, strikers.choose).rallies
    seat = (matches.entrant[played.match, 1] == 0).astype(int)
    serves = played.server == seat
    score, seat = played.score[serves].astype(int), seat[serves]
    rows = np.arange(len(score))
    expected = np.stack([score[rows, seat], score[rows, 1 - seat], score[rows, 2 + seat], score[rows, 3 - seat]], axis=1)
    assert sorted(map(tuple, np.concatenate(seen).tolist())) == sorted(map(tuple, expected.tolist()))
