"""Ratings, intervals, and assessments against closed forms, other libraries, and simulated leagues."""

import itertools
import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from shuttle_marl.league.assessment import as_json, assess, cycles, meta_games
from shuttle_marl.league.ranking import (
    ELO,
    ExactOdds,
    bradley_terry,
    exact_ratings,
    prior_wins,
    rank,
    rank_intervals,
    ratings,
    unknown,
    wins_of,
)
from shuttle_marl.league.tournament import COUNTS, PairResult, forfeited, round_robin


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.integers(3, 9))
def test_another_library_finds_the_same(seed: int, n: int) -> None:
    choix = pytest.importorskip("choix")
    rng = np.random.default_rng(seed)
    wins = rng.integers(1, 2000, (n, n)).astype(float) ** rng.uniform(0.2, 1.0, (n, n))
    np.fill_diagonal(wins, 0)
    assert bradley_terry(wins) == pytest.approx(choix.ilsr_pairwise_dense(wins, tol=1e-12), abs=1e-6)


def test_the_prior_is_that_of_jeffreys() -> None:
    """The ratings make the likelihood times the root of the determinant of its information largest."""
    cells, pairs = np.array([[0, 0, 20], [1, 4, 5], [0, 3, 17.0]]), np.array([[0, 1], [0, 2], [1, 2]])
    wins = wins_of(cells, pairs, 3)

    def loss(free: np.ndarray) -> float:
        theta = np.array([*free, 0.0])
        p = 1 / (1 + np.exp(theta - theta[:, None]))
        curvature = (wins + wins.T) * p * (1 - p)
        information = np.diag(curvature.sum(axis=1)) - curvature
        return -float((wins * np.log(p)).sum() + np.linalg.slogdet(information[:2, :2])[1] / 2)

    free = minimize(loss, np.zeros(2), tol=1e-12).x
    expected = np.array([*free, 0.0])
    assert ratings(cells, pairs, 3, np.random.default_rng(0), replicates=1)[0] == pytest.approx(
        expected - expected.mean(), abs=1e-4
    )
    assert prior_wins(wins).sum() == pytest.approx(2)
    for lost in (0.0, 1.0, 3.0):
        assert prior_wins(np.array([[0.0, 120 - lost], [lost, 0]])) == pytest.approx(np.array([[0, 0.5], [0.5, 0]]))


def league(theta: np.ndarray, cells: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Cells whose two matches are negatively correlated: half of them share one draw, as swapped seats do in part."""
    n = len(theta)
    pairs = np.array([(a, b) for a in range(n) for b in range(a + 1, n)])
    p = 1 / (1 + np.exp(theta[pairs[:, 1]] - theta[pairs[:, 0]]))
    u = rng.random((len(pairs), cells))
    twin = np.where(rng.random(u.shape) < 0.5, 1 - u, rng.random(u.shape))
    won = (u < p[:, None]).astype(int) + (twin < p[:, None])
    return np.stack([(won == k).sum(axis=1) for k in range(3)], axis=1).astype(float), pairs


def test_negatively_correlated_cells_give_shorter_intervals() -> None:
    """Independent matches with the same shares, as clusters of two, would be more uncertain."""
    pairs = np.array([[0, 1]])
    spread = [
        np.ptp(np.percentile(ratings(np.array([cells]), pairs, 2, np.random.default_rng(0))[1][:, 0], [2.5, 97.5]))
        for cells in ([10.0, 480.0, 10.0], [125.0, 250.0, 125.0])
    ]
    assert spread[0] < spread[1] / 2


def test_unbeaten_is_not_certain() -> None:
    found, drawn = ratings(np.array([[0.0, 0.0, 50.0]]), np.array([[0, 1]]), 2, np.random.default_rng(0))
    assert np.isfinite(found).all()
    assert np.ptp(np.percentile(ELO * drawn[:, 0], [2.5, 97.5])) > 50


def test_no_one_played() -> None:
    found, drawn = ratings(np.empty((0, 3)), np.empty((0, 2), dtype=np.intp), 3, np.random.default_rng(0), replicates=10)
    assert np.array_equal(found, np.zeros(3))
    assert np.array_equal(drawn, np.zeros((10, 3)))


def test_entrants_in_two_separate_groups_are_rated_within_them() -> None:
    wins = np.zeros((5, 5))
    wins[0, 1], wins[1, 0], wins[2, 3], wins[3, 2] = 30, 10, 10, 30
    theta = bradley_terry(wins)
    assert theta == pytest.approx(np.array([1, -1, -1, 1, 0]) * math.log(3) / 2)
    assert ELO * math.log(10) == pytest.approx(400)


def test_exact_ratings_are_the_limit_of_the_sampled_ones() -> None:
    rng = np.random.default_rng(0)
    theta = np.array([1.5, 0.4, 0.0, -0.7])
    cells, pairs = league(theta, 200_000, rng)
    match = 1 / (1 + np.exp(theta - theta[:, None]))
    match[:, 3] = match[3] = np.nan
    exact = exact_ratings(match)
    assert np.isnan(exact[3])
    assert exact[:3] == pytest.approx(theta[:3] - theta[:3].mean(), abs=1e-9)
    sampled = ratings(cells, pairs, 4, np.random.default_rng(0), replicates=2)[0]
    assert sampled[:3] - sampled[:3].mean() == pytest.approx(exact[:3], abs=0.01)
    certain = np.array([[0.5, 1.0], [0.0, 0.5]])
    assert np.isfinite(exact_ratings(certain)).all()


THETAS = ([1.0, 0.3, 0.2, -1.5], [0.0, 0.0, 0.0, 0.0], [5.0, 2.0, 0.0, -2.0, -5.0], [4.0, 0.0])
"""Entrants that are close, equal, so far from each other that they win all matches, and only two."""


@pytest.mark.parametrize("theta", THETAS)
def test_intervals_of_ratings_and_ranks_hold(theta: list[float]) -> None:
    rng = np.random.default_rng(2)
    true = np.array(theta) - np.mean(theta)
    best, worst = 1 + (true[:, None] < true).sum(axis=1), len(true) - (true[:, None] > true).sum(axis=1)
    rated, ranked = [], []
    for _ in range(60):
        cells, pairs = league(true, 60, rng)
        found, drawn = ratings(cells, pairs, len(true), np.random.default_rng(int(rng.integers(1 << 30))), replicates=300)
        low, high = np.percentile(drawn, [2.5, 97.5], axis=0)
        rated.extend(((low <= true) & (true <= high)).tolist())
        ranks = rank_intervals(found, drawn)
        ranked.extend(((ranks[:, 0] <= best) & (worst <= ranks[:, 1])).tolist())
    assert 0.90 <= np.mean(rated) <= 0.99
    assert np.mean(ranked) >= 0.88


def test_exact_ratings_of_two_are_their_odds_and_finite() -> None:
    assert exact_ratings(np.array([[0.5, 0.8], [0.2, 0.5]])) == pytest.approx(np.array([1, -1]) * math.log(4) / 2)
    sure = math.log((1 - 5e-7) / 5e-7) / 2
    assert exact_ratings(np.array([[0.5, 1.0], [0.0, 0.5]])) == pytest.approx([sure, -sure], rel=1e-6)
    assert np.isnan(exact_ratings(np.full((2, 2), np.nan))).all()


def test_a_rank_is_sure_if_the_lead_is_above_the_margin() -> None:
    """With samples one unit above and below, the margin of a difference of two is one unit."""
    for size, ranks in ((0.5, [[2, 2], [1, 1]]), (1.0, [[1, 2], [1, 2]]), (1.5, [[1, 2], [1, 2]])):
        drawn = np.array([[0.0, 1 + size], [0.0, 1 - size]] * 20)
        assert rank_intervals(np.array([0.0, 1.0]), drawn).tolist() == ranks
    still = np.tile([0.0, 1.0], (10, 1))
    assert rank_intervals(np.array([0.0, 1.0]), still).tolist() == [[1, 2], [1, 2]], (
        "nothing is known about a constant difference"
    )


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


def test_a_circle_of_three_is_found_once_and_begins_with_the_first_in_the_pool() -> None:
    (cycle,) = cycles(NAMES, ROCK)
    assert cycle["players"] == ("rock", "scissors", "paper")
    assert cycle["match_win"] == (0.8, 0.7, 0.9)
    even = np.array([[0.5, 0.7, 0.3], [0.3, 0.5, 0.7], [0.7, 0.3, 0.5]])
    theta = np.array([2.0, 0.5, -1.0, -1.5])
    transitive = 1 / (1 + np.exp(theta - theta[:, None]))
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
    assert list(games["all"].values()) == pytest.approx([0, 0, 0, 1])
    rest = games["without minimax"]
    # The weights of a circle of three are the margins of the pairs that each is not part of.
    assert list(rest.values()) == pytest.approx(np.array([0.2, 0.3, 0.4]) / 0.9, abs=1e-5)
    assert set(meta_games(["minimax", "rock"], ["minimax", "rock"], np.full((2, 2), 0.5))) == {"all"}


def test_a_tournament_in_a_circle() -> None:
    wins = {("rock", "paper"): 10, ("rock", "scissors"): 80, ("paper", "scissors"): 30}
    results = played(wins, NAMES)
    exact = unknown(NAMES)
    standings = rank(NAMES, results, 0, exact)
    found = assess(standings, results, exact)
    assert found.win == pytest.approx(ROCK, abs=0.02)
    assert [set(cycle["players"]) for cycle in found.cycles] == [set(NAMES)]
    text = json.dumps(as_json(found, standings), allow_nan=False)
    assert json.loads(text)["ranking"][0]["player"] == standings[0].player
    assert math.isnan(standings[0].rating_exact)


def test_exact_odds_come_before_sampled_ones() -> None:
    results = played({("rock", "paper"): 10, ("rock", "scissors"): 80, ("paper", "scissors"): 30}, NAMES)
    exact = unknown(NAMES)
    exact.match[:2, :2] = [[0.5, 0.25], [0.75, 0.5]]
    win = assess(rank(NAMES, results, 0, exact), results, exact).win
    assert win[0, 1] == 0.25
    assert win[1, 0] == 0.75
    assert win[0, 2] == pytest.approx(0.8, abs=0.01)


def counts(**given: int) -> dict[str, int]:
    return dict.fromkeys(COUNTS, 0) | given


def test_standings_are_ratios_of_the_counts() -> None:
    """From both sides of a pairing, and nothing of one that was forfeited."""
    at_0 = counts(matches=10, wins=7, points_won=150, points_lost=100, served=140, served_won=90, rallies=250, strokes=2000)
    at_1 = counts(matches=10, wins=4, points_won=90, points_lost=110, served=80, served_won=30, rallies=200, strokes=1500)
    pool, pairings = ("a", "b", "c"), round_robin("abc")
    results = [PairResult(pairing=0, names=("a", "b"), seats=(at_0, at_1), cells=(3, 3, 4))]
    results += [forfeited(pairing, ["c"], "hurt") for pairing in pairings[1:]]
    standings = rank(pool, results, 0, unknown(pool))
    assert [(s.rank, s.player, s.forfeits, s.matches, s.wins) for s in standings] == [
        *((1, "a", 0, 20, 11), (2, "b", 0, 20, 9), (3, "c", 2, 0, 0))
    ]
    a, b, c = standings
    assert (a.share, a.rally_share, a.serving, a.receiving) == (0.55, 240 / 450, 120 / 220, 120 / 230)
    assert (b.share, b.rally_share, b.serving, b.receiving) == (0.45, 210 / 450, 110 / 230, 100 / 220)
    half, middle = 1.959964 * math.sqrt(0.55 * 0.45 / 20 + 1.959964**2 / 1600), 0.55 + 1.959964**2 / 40
    assert (a.share_low, a.share_high) == pytest.approx(
        ((middle - half) / (1 + 1.959964**2 / 20), (middle + half) / (1 + 1.959964**2 / 20)), abs=1e-6
    )
    assert a.rating == pytest.approx(200 * math.log10(11.5 / 9.5), abs=1e-6)
    assert b.rating == pytest.approx(-a.rating)
    assert a.rating_low < a.rating < a.rating_high
    assert (a.rank_low, a.rank_high, c.rank_low, c.rank_high) == (1, 2, 0, 0)
    assert all(math.isnan(getattr(c, name)) for name in ("rating", "rating_low", "share", "share_low", "rally_share", "serving"))


def test_exact_figures_of_a_standing() -> None:
    match = np.array([[0.5, 0.8, np.nan], [0.2, 0.5, np.nan], [np.nan] * 3])
    exact = ExactOdds(
        names=NAMES, match=match,
        exploitability=np.array([0.25, 0.5, np.nan]), normalised_score=np.array([1.5, -0.5, np.nan]),
    )  # fmt: skip
    wins = {("rock", "paper"): 60, ("rock", "scissors"): 80, ("paper", "scissors"): 30}
    found = {standing.player: standing for standing in rank(NAMES, played(wins, NAMES), 0, exact)}
    rock, paper = found["rock"], found["paper"]
    assert (paper.exact_share, paper.exploitability, paper.normalised_score) == (pytest.approx(0.2), 0.5, -0.5)
    assert (rock.exact_share, rock.rating_exact) == (pytest.approx(0.8), pytest.approx(200 * math.log10(4), abs=1e-6))
    assert math.isnan(found["scissors"].exact_share)
    assert exact.pair(("paper", "rock")) == 0.2


def test_probabilities_are_exact_or_sampled_or_by_the_ratings() -> None:
    """Rock won 8 of 10 matches against paper; scissors has no matches."""
    (first, *_) = played({("rock", "paper"): 8, ("rock", "scissors"): 0, ("paper", "scissors"): 0}, NAMES, matches=10)
    found = assess(rank(NAMES, [first], 0), [first], unknown(NAMES))
    assert found.win[0, 1] == pytest.approx(8.5 / 11, abs=1e-7)
    assert found.win[1, 0] == pytest.approx(2.5 / 11, abs=1e-7)
    theta = math.log(8.5 / 2.5) / 2
    assert found.win[0, 2] == pytest.approx(1 / (1 + math.exp(-theta)), abs=1e-7)
    assert found.win.diagonal().tolist() == [0.5] * 3
    assert set(found.games["all"]) == {"rock", "paper"}


def test_the_clearest_cycles_are_listed_first_and_twenty_at_most() -> None:
    n = 9
    win = np.full((n, n), 0.5)
    for i, j in itertools.combinations(range(n), 2):  # a regular tournament: each beats the next four
        win[i, j] = 0.5 + (0.1 + 0.01 * i) * (1 if j - i <= n // 2 else -1)
        win[j, i] = 1 - win[i, j]
    found = cycles([str(i) for i in range(n)], win)
    closest = [min(cycle["match_win"]) for cycle in found]
    assert len(found) == 20
    assert closest == sorted(closest, reverse=True)
    every = [
        min(win[i, j], win[j, k], win[k, i])
        for i, j, k in itertools.permutations(range(n), 3)
        if i < min(j, k) and min(win[i, j], win[j, k], win[k, i]) > 0.5
    ]
    assert len(every) == 30
    assert closest == pytest.approx(sorted(every, reverse=True)[:20])
