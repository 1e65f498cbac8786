"""Assessment of tournaments whose answers are known: cycles, games between entrants, ranks in refits."""

import json
import math

import numpy as np
import pytest

from shuttle_marl.league.assessment import as_json, assess, cycles, cyclic_share, meta_games, stability
from shuttle_marl.league.ranking import ExactOdds, rank
from shuttle_marl.league.tournament import COUNTS, PairResult, round_robin

ROCK = np.array([[0.5, 0.1, 0.8], [0.9, 0.5, 0.3], [0.2, 0.7, 0.5]])
NAMES = ("rock", "paper", "scissors")


def played(wins: dict[tuple[str, str], int], pool: tuple[str, ...], matches: int = 100) -> list[PairResult]:
    """Results in which the first of each pair won so many matches, in cells of equal ends as far as possible."""
    found = []
    for pairing in round_robin(pool):
        won = wins[pairing.names]
        half = dict.fromkeys(COUNTS, 0) | {"matches": matches // 2, "wins": won // 2, "rallies": matches}
        cells = ((matches - won) // 2, won % 2, won // 2)
        rest = {**half, "wins": won - won // 2}
        found.append(PairResult(pairing=pairing.number, names=pairing.names, seats=(half, rest), cells=cells))
    return found


def unknown(pool: tuple[str, ...]) -> ExactOdds:
    n = len(pool)
    nothing = np.full(n, np.nan)
    return ExactOdds(names=pool, match=np.full((n, n), np.nan), exploitability=nothing, normalised_score=nothing)


def test_a_circle_of_three_is_found_once_and_begins_with_the_first_in_the_pool() -> None:
    (cycle,) = cycles(NAMES, ROCK)
    assert cycle["players"] == ("rock", "scissors", "paper")
    assert cycle["match_win"] == (0.8, 0.7, 0.9)
    even = np.array([[0.5, 0.7, 0.3], [0.3, 0.5, 0.7], [0.7, 0.3, 0.5]])
    assert cyclic_share(even) == pytest.approx(1)
    theta = np.array([2.0, 0.5, -1.0, -1.5])
    transitive = 1 / (1 + np.exp(theta - theta[:, None]))
    assert cyclic_share(transitive) == pytest.approx(0, abs=1e-6)
    assert cycles("abcd", transitive) == []
    both = np.full((6, 6), 0.9)
    both[3:, :3] = 0.1
    both[:3, :3] = even
    both[3:, 3:] = ROCK
    assert [set(found["players"]) for found in cycles("abcdef", both)] == [{"a", "b", "c"}, {"d", "e", "f"}]


def test_games_between_entrants_with_and_without_perfect_play() -> None:
    names = [*NAMES, "minimax"]
    win = np.full((4, 4), 0.5)
    win[:3, :3], win[3, :3], win[:3, 3] = ROCK, 0.6, 0.4
    games = meta_games(names, names, win)
    assert list(games["all"]["nash_average"].values()) == pytest.approx([0, 0, 0, 1])
    rest = games["without minimax"]
    # The weights of a circle of three are the margins of the pairs that each is not part of.
    assert list(rest["nash_average"].values()) == pytest.approx(np.array([0.2, 0.3, 0.4]) / 0.9, abs=1e-5)
    assert list(rest["maximal_lottery"].values()) == pytest.approx([1 / 3] * 3, abs=1e-5)
    assert sum(rest["alpha_rank"].values()) == pytest.approx(1, abs=1e-5)
    assert set(meta_games(["minimax", "rock"], ["minimax", "rock"], np.full((2, 2), 0.5))) == {"all"}


def test_a_tournament_in_a_circle() -> None:
    wins = {("rock", "paper"): 10, ("rock", "scissors"): 80, ("paper", "scissors"): 30}
    results = played(wins, NAMES)
    exact = unknown(NAMES)
    standings = rank(NAMES, results, 0, exact)
    found = assess(standings, results, exact, {})
    assert found.win == pytest.approx(ROCK, abs=0.02)
    assert found.misfit.p < 1e-6
    assert [set(cycle["players"]) for cycle in found.cycles] == [set(NAMES)]
    assert found.stability is None
    text = json.dumps(as_json(found, standings), allow_nan=False)
    assert json.loads(text)["ranking"][0]["player"] == standings[0].player
    assert math.isnan(standings[0].rating_exact)


def test_exact_odds_come_before_sampled_ones() -> None:
    results = played({("rock", "paper"): 10, ("rock", "scissors"): 80, ("paper", "scissors"): 30}, NAMES)
    exact = unknown(NAMES)
    exact.match[:2, :2] = [[0.5, 0.25], [0.75, 0.5]]
    win = assess(rank(NAMES, results, 0, exact), results, exact, {}).win
    assert win[0, 1] == 0.25
    assert win[1, 0] == 0.75
    assert win[0, 2] == pytest.approx(0.8, abs=0.01)


def test_ranks_in_refits() -> None:
    match = np.array([[0.5, 0.6, 0.9], [0.4, 0.5, 0.7], [0.1, 0.3, 0.5]])
    nothing = np.full(3, np.nan)
    shares = np.array([[0.75, 0.55, 0.2], [0.6, 0.7, 0.2]])
    found = stability(ExactOdds(names=NAMES, match=match, exploitability=nothing, normalised_score=nothing, away_shares=shares))
    assert found is not None
    assert found["rank"] == [1, 2, 3]
    assert found["rank_in_refits"] == [[1, 2, 3], [2, 1, 3]]
    assert found["kendall_tau"] == pytest.approx([1, 1 / 3])
