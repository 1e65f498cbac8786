"""Turns of the rounds of a league, worked out by hand: opponents, shares of rallies, strokes and learning rates."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.policy.computed import StoredPolicies
from shuttle_marl.training.league.config import LeagueTrainingConfig
from shuttle_marl.training.league.population import TOLERANCE, Frozen, LeagueState, Member, Payoffs, Turn
from shuttle_marl.training.league.schedule import FLOOR, Schedule, chosen, meta_strategy, order, prioritised
from tests.exact.exact_games import tiring_game

NAMES = ["main-agent-0", "main-agent-1", "main-exploiter-0", "league-exploiter-0"]


def hash_of(letter: str) -> str:
    return letter * 64


def schedule(
    given: str = "ab", members: dict[str, Member] | None = None, won: dict[str, float] | None = None, **flags: Any
) -> Schedule:
    """Of a league with a population of one letter each; the first letter of a pair wins this share of its rallies."""
    population = [Frozen(name=letter, role="given", round=0, hash=hash_of(letter)) for letter in given]
    state = LeagueState(population=population, members=members or {})
    solved = {" ".join(map(hash_of, pair)): (share, 1 - share) for pair, share in (won or {}).items()}
    return Schedule(LeagueTrainingConfig(**flags), state, payoffs_of(solved))


def payoffs_of(solved: dict[str, tuple[float, float]]) -> Payoffs:
    return Payoffs(StoredPolicies(Path(), tiring_game()), solved)


def by_name(turns: Sequence[Turn]) -> dict[str, Turn]:
    return {turn.member: turn for turn in turns}


def test_strokes_are_divided_among_the_rounds_and_a_quarter_is_an_exploiters() -> None:
    plan = schedule(strokes=1000, rounds=3, main_agents=2)
    rounds = [by_name(plan.turns(number)) for number in (1, 2, 3)]
    assert [list(turns) for turns in rounds] == [NAMES] * 3
    # 1000 strokes end at 333, 666 and 1000.
    assert [turns["main-agent-1"].strokes for turns in rounds] == [333, 333, 334]
    assert [turns["league-exploiter-0"].strokes for turns in rounds] == [83, 83, 84]
    main = [turns["main-agent-0"].remaining for turns in rounds]
    assert np.allclose(main, [(1, 2 / 3), (2 / 3, 1 / 3), (1 / 3, 0)])
    assert rounds[0]["main-exploiter-0"].remaining == (1.0, 0.75)
    assert [turn.strokes for turn in schedule(strokes=2, rounds=3).turns(1)] == [1, 1, 1], "one at least"
    assert [turn.round for turn in plan.turns(2)] == [2] * 4


def test_shares_of_rallies_in_the_first_round() -> None:
    turns = by_name(schedule(strokes=1000, rounds=3, response_fraction=0.25, past_fraction=0.5).turns(1))
    assert list(turns) == ["main-agent-0", "main-exploiter-0", "league-exploiter-0"]
    for name, responses, share in (
        ("main-agent-0", 0.25, 0.25),
        ("main-exploiter-0", 0.0, 0.5),
        ("league-exploiter-0", 0.0, 0.5),
    ):
        turn = turns[name]
        assert (turn.opponents, turn.fractions) == ((hash_of("a"), hash_of("b")), (share, share))
        assert (turn.response_fraction, turn.fresh) == (responses, True)


def test_prioritised_opponents_are_those_who_win() -> None:
    members = {name: Member(turns=2, hash=hash_of(letter)) for name, letter in zip(NAMES, "mnxy", strict=True)}
    won = {"am": 1.0, "bm": 0.5, "an": 1.0, "bn": 0.5, "mn": 0.5, "ay": 1.0, "by": 0.5, "my": 0.0}
    turns = by_name(schedule("abm", members, won, strokes=900, rounds=3, main_agents=2).turns(2))
    # (1 - p)^2 of 0, 1/2 and 1 are 1, 1/4 and 0; main-agent-0 is even with its own past.
    for name, expected in (("main-agent-0", [4 / 6, 1 / 6, 1 / 6]), ("league-exploiter-0", [0.8, 0.2, 0])):
        share = (1 - FLOOR) * np.array(expected) + FLOOR / 3
        assert np.allclose(turns[name].fractions, (0.2 if name.startswith("main") else 1) * share)
    # The current policy of main-agent-0 is in the population, that of main-agent-1 is not.
    exploiter = turns["main-exploiter-0"]
    assert (exploiter.opponents, exploiter.fractions, exploiter.fresh) == ((hash_of("m"),), (1.0,), False)
    assert exploiter.remaining == (0.5, 0.25), "two of four turns are over"


def test_fictitious_play_meets_all_alike() -> None:
    members = {"main-agent-0": Member(turns=1, hash=hash_of("m"))}
    turns = by_name(schedule("abcd", members, variant="fictitious", strokes=900, rounds=3).turns(2))
    assert np.allclose(turns["main-agent-0"].fractions, [0.05] * 4)
    assert np.allclose(turns["league-exploiter-0"].fractions, [0.25] * 4)


def test_of_a_large_population_the_newest_and_some_others_are_considered() -> None:
    letters, members = "abcdefghijklmnopqrst", {"main-agent-0": Member(hash=hash_of("z"))}
    plan = schedule(letters, members, {f"{letter}z": 0.5 for letter in letters}, max_opponents=4, rounds=99, strokes=9900)
    drawn = [plan.turns(number)[0].opponents for number in range(1, 99)]
    met = Counter(other[0] for others in drawn for other in others)
    assert {len(others) for others in drawn} == {4}
    assert set(met) == set(letters)
    # The newest two and the last one are always among seven that are considered, of which four are drawn.
    assert min(met[letter] for letter in "rst") > 2 * max(met[letter] for letter in letters[:-3])


def test_a_learner_with_one_sign_of_gamma_plays_its_last_policy_instead_of_itself() -> None:
    flags: dict[str, Any] = {"learner": "sac", "strokes": 900, "rounds": 3, "variant": "fictitious"}
    fresh = by_name(schedule(**flags, past_fraction=0.25, response_fraction=0.25).turns(1))
    # Without a last policy the rest of a half goes to the others.
    assert fresh["main-agent-0"].fractions == (0.375, 0.375)
    assert fresh["main-exploiter-0"].fractions == (0.5, 0.5)
    members = {"main-agent-0": Member(turns=1, hash=hash_of("m"))}
    later = by_name(schedule(members=members, **flags, past_fraction=0.25, response_fraction=0.25).turns(2))["main-agent-0"]
    assert later.opponents == (hash_of("a"), hash_of("b"), hash_of("m"))
    assert (later.fractions, later.response_fraction) == ((0.125, 0.125, 0.5), 0.25)
    full = by_name(schedule(members=members, **flags, past_fraction=0.75, response_fraction=0.25).turns(2))["main-agent-0"]
    assert (full.opponents, full.fractions) == ((hash_of("a"), hash_of("b")), (0.375, 0.375))


def test_an_oracle_meets_the_meta_strategy() -> None:
    flags: dict[str, Any] = {"variant": "psro", "oracle": "ppo", "strokes": 900, "rounds": 3}
    (turn,) = schedule("abc", meta_solver="linear", **flags).turns(1)
    assert (turn.member, turn.strokes, turn.response_fraction) == ("oracle", 300, 0.0)
    assert turn.opponents == tuple(map(hash_of, "abc"))
    assert np.allclose(turn.fractions, [1 / 6, 2 / 6, 3 / 6])
    # The second beats the others.
    (turn,) = schedule("abc", won={"ab": 0.25, "ac": 0.55, "bc": 0.6}, meta_solver="nash", **flags).turns(1)
    assert (turn.opponents, turn.fractions) == ((hash_of("b"),), (1.0,))


def test_meta_strategies_of_rock_paper_scissors_and_of_the_linear_average() -> None:
    cycle = np.array([[0, -1, 1], [1, 0, -1], [-1, 1, 0]]) / 2
    assert np.allclose(meta_strategy("nash", cycle), 1 / 3)
    assert np.allclose(meta_strategy("linear", np.zeros((4, 4))), np.arange(1, 5) / 10)


def test_opponents_that_fit_keep_their_weights() -> None:
    drawn, shares = chosen(np.array([1.0, 0, 3]), 2, np.random.default_rng(0))
    assert (drawn.tolist(), shares.tolist()) == ([0, 2], [0.25, 0.75])
    drawn, shares = chosen(np.array([1.0, 0, 3, 4, 2]), 3, np.random.default_rng(1))
    assert sorted(set(drawn.tolist()) - {1}) == drawn.tolist()
    assert shares.tolist() == [1 / 3] * 3
    first = [chosen(np.array([0.0, 1, 9]), 1, np.random.default_rng(seed))[0][0] for seed in range(400)]
    assert np.mean(np.array(first) == 2) == pytest.approx(0.9, abs=0.05)


def test_the_order_of_opponents_is_the_one_that_is_owed_most() -> None:
    assert order([0.25], 4).tolist() == [-1, -1, 0, -1]
    assert order([0.5], 4).tolist() == [-1, 0, -1, 0]
    assert order([0.5, 0.5], 4).tolist() == [0, 1, 0, 1]
    assert order([1.0, 3.0], 4).tolist() == [1, 0, 1, 1]
    assert len(order([])) == 200
    assert np.allclose(prioritised([0.25, 1.0]), [0.99, 0.01])


def test_solved_payoffs_are_seen_from_both_sides() -> None:
    payoffs = payoffs_of({"a b": (0.6, 0.3), "b c": (0.5, 0.9)})
    (mine,), (theirs,), (itself,) = payoffs.odds("a", ["b"]), payoffs.odds("b", ["a"]), payoffs.odds("a", ["a"])
    # a wins 0.6 of the rallies that it serves, b 0.3 of its own.
    assert (mine.serving, mine.receiving) == (0.6, 0.7)
    assert (theirs.serving, theirs.receiving) == (0.3, 0.4)
    assert (itself.serving, itself.receiving, itself.error_bound) == (0.5, 0.5, TOLERANCE)
    assert mine.error_bound == theirs.error_bound == TOLERANCE / 2
    assert payoffs.match_wins("a", ["b", "a"]).tolist() == [mine.match(), 0.5]
    assert payoffs.as_json({"a", "b"}) == {"a b": (0.6, 0.3)}
    assert payoffs.as_json("abc") == {"a b": (0.6, 0.3), "b c": (0.5, 0.9)}
    assert payoffs.solved == 0
    assert np.allclose(payoffs_of({"a b": (0.6, 0.3)}).values(["b", "a"]), [[0, -0.3], [0.3, 0]])
