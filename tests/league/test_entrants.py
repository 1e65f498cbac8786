"""Entrants that fail, and entrants that read the score."""

import dataclasses

import numpy as np
import pytest

from shuttle_marl.dynamics import default_game
from shuttle_marl.game.policy import States
from shuttle_marl.game.table import tabulate
from shuttle_marl.kernel.lockstep import play
from shuttle_marl.league.entrants import Entrant, ForfeitError, Strikers, enter
from shuttle_marl.league.ranking import rank
from shuttle_marl.league.results import results_table
from shuttle_marl.league.schedule import matches_of, round_robin
from shuttle_marl.league.tournament import Tournament
from shuttle_marl.policy.modules import FunctionPolicy
from shuttle_marl.policy.registry import resolve

GAME = default_game()


def uniform(states: States) -> np.ndarray:
    return states.mask / states.mask.sum(axis=1, keepdims=True)


def raises(states: States) -> np.ndarray:
    raise RuntimeError("out of shuttles")


def nan(states: States) -> np.ndarray:
    return np.full((len(states), GAME.n_strokes), np.nan)


def illegal(states: States) -> np.ndarray:
    return np.full((len(states), GAME.n_strokes), 1 / GAME.n_strokes)


def no_distribution(states: States) -> np.ndarray:
    return uniform(states) / 2


def wrong_shape(states: States) -> np.ndarray:
    return np.ones(len(states))


def no_array(states: States) -> object:
    return "smash"


def tired(states: States) -> np.ndarray:
    """Gives up when it is behind in games; plays on as long as it is not."""
    assert states.score is not None
    if (states.score[:, 3] > 0).any():
        raise TimeoutError("legs")
    return uniform(states)


FAILURES = {
    raises: "raised RuntimeError: out of shuttles",
    nan: "NaN",
    illegal: "illegal stroke",
    no_distribution: "no distribution",
    wrong_shape: "returned shape",
    no_array: "returned str",
}


def entrant(name: str, function: object, *, reads_score: bool = False) -> Entrant:
    """What `enter` makes of a function, without a module to import it from."""

    class Own(FunctionPolicy):
        pass

    policy = Own(function)
    if reads_score:
        Own.reads_score = True
        return Entrant(name=name, policy=policy)
    return Entrant(name=name, policy=policy, table=tabulate(policy, GAME, name))


def tournament(entrants: list[Entrant], matches: int = 4, batch: int = 8192) -> Tournament:
    return Tournament(GAME, entrants, matches=matches, seed=0, batch=batch, keep_strokes=True)


@pytest.mark.parametrize("function", FAILURES, ids=lambda f: f.__name__)
def test_a_failing_entrant_enters_and_forfeits_every_match(function: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shuttle_marl.league.entrants.resolve", lambda name, game: FunctionPolicy(function))
    broken = enter("broken", GAME)
    assert FAILURES[function] in broken.failure
    assert broken.table is None
    assert broken.hash == ""
    monkeypatch.undo()
    good = [enter(name, GAME) for name in ("random", "safe")]
    pool = ["random", "broken", "safe"]
    blocks = [block for group in tournament([good[0], broken, good[1]]).play(round_robin(pool)) for block in group]
    results = [result for result, _ in blocks]
    assert [result.forfeit for result in results] == [("broken",), (), ("broken",)]
    assert all(FAILURES[function] in result.reason for result in results if result.forfeit)
    assert [bool(rallies) for _, rallies in blocks] == [False, True, False]
    standings = rank(pool, results, seed=0)
    assert [(s.player, s.forfeits, s.matches) for s in standings][-1] == ("broken", 2, 0)
    assert {s.matches for s in standings[:2]} == {4}
    table = results_table(results)
    assert table.column("forfeit").to_pylist() == ["broken"] * 2 + [""] * 2 + ["broken"] * 2
    assert table.column("mean_rally_length").null_count == 4


@pytest.mark.parametrize("function", [*FAILURES, tired], ids=lambda f: f.__name__)
def test_one_that_reads_the_score_forfeits_while_it_plays(function: object) -> None:
    pool = [entrant("a", uniform), entrant("broken", function, reads_score=True), enter("safe", GAME)]
    results = [r for group in tournament(pool).play(round_robin(["a", "broken", "safe"])) for r, _ in group]
    assert [result.forfeit for result in results] == [("broken",), (), ("broken",)]
    assert results[0].seats[0]["matches"] == 0
    assert FAILURES.get(function, "raised TimeoutError: legs") in results[0].reason


def test_both_fail() -> None:
    pool = [dataclasses.replace(entrant(name, uniform), table=None, failure=f"{name} is hurt") for name in "ab"]
    ((result, rallies),) = next(iter(tournament(pool).play(round_robin("ab"))))
    assert (result.forfeit, result.reason, rallies) == (("a", "b"), "a is hurt; b is hurt", [])


def test_a_policy_asked_at_every_stroke_plays_what_its_table_plays() -> None:
    """Tables round chances to 1/65535; a policy whose chances are such already is sampled alike."""
    table = tabulate(resolve("safe", GAME), GAME)
    asked = entrant("safe", table.probabilities, reads_score=True)
    pairing = round_robin(["random", "safe"])[0]
    other = enter("random", GAME)
    matches = matches_of(pairing, 3, 0, 6)
    played = [play(GAME, matches, Strikers(GAME, [other, it]).choose) for it in (asked, enter("safe", GAME))]
    for field in dataclasses.fields(played[0]):
        assert np.array_equal(*(getattr(p, field.name) for p in played)), field.name


def test_the_score_is_the_strikers_own_view() -> None:
    seen: list[np.ndarray] = []

    def watching(states: States) -> np.ndarray:
        assert states.score is not None
        serving = states.incoming == GAME.n_strokes
        seen.append(states.score[serving])
        return uniform(states)

    strikers = Strikers(GAME, [entrant("watching", watching, reads_score=True), enter("attacking", GAME)])
    matches = matches_of(round_robin(["watching", "attacking"])[0], 0, 0, 2)
    played = play(GAME, matches, strikers.choose)
    seat = (matches.entrant[played.match, 1] == 0).astype(int)
    serves = played.server == seat
    score, seat = played.score[serves].astype(int), seat[serves]
    rows = np.arange(len(score))
    expected = np.stack([score[rows, seat], score[rows, 1 - seat], score[rows, 2 + seat], score[rows, 3 - seat]], axis=1)
    assert sorted(map(tuple, np.concatenate(seen).tolist())) == sorted(map(tuple, expected.tolist()))


def test_who_uses_the_score_can_profit_from_it() -> None:
    """One that plays at random only while it leads wins less than one that never does."""
    safe = tabulate(resolve("safe", GAME), GAME)

    def careless(states: States) -> np.ndarray:
        assert states.score is not None
        leads = states.score[:, 0] > states.score[:, 1]
        return np.where(leads[:, None], uniform(states), safe.probabilities(states))

    pool = [entrant("careless", careless, reads_score=True), enter("safe", GAME)]
    ((result, _),) = next(iter(tournament(pool, matches=40).play(round_robin(["careless", "safe"]))))
    assert result.seen_by("careless")["wins"] < 15


@pytest.mark.parametrize("batch", [1, 6, 7, 20, 10_000])
def test_batches_change_nothing(batch: int) -> None:
    pool = [enter(name, GAME) for name in ("random", "safe", "attacking")]
    names = [e.name for e in pool]

    def blocks(batch: int) -> list[tuple[object, list[object]]]:
        found = [b for group in tournament(pool, matches=10, batch=batch).play(round_robin(names)) for b in group]
        return [
            (result, [np.concatenate([getattr(r, c) for r in rallies]).tolist() for c in ("match", "stroke", "policy")])
            for result, rallies in found
        ]

    assert blocks(batch) == blocks(8192)


def test_tables_of_an_entrant_have_a_hash() -> None:
    random, safe = enter("random", GAME), enter("safe", GAME)
    assert len(random.hash) == 64
    assert random.hash == enter("random", GAME).hash != safe.hash


def test_forfeits_while_playing_say_who_and_why() -> None:
    strikers = Strikers(GAME, [entrant("hurt", raises, reads_score=True), enter("random", GAME)])
    with pytest.raises(ForfeitError, match="out of shuttles") as caught:
        play(GAME, matches_of(round_robin(["hurt", "random"])[0], 0, 0, 2), strikers.choose)
    assert caught.value.name == "hurt"
