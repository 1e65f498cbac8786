"""Exact odds of games and matches, against enumeration, closed forms and simulation."""

import dataclasses
import functools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.game.scoring import (
    BWF,
    Rules,
    Score,
    ScoringError,
    count_rally,
    game_win_probability,
    match_win_probability,
)

probability = st.floats(0.0, 1.0)
short = st.sampled_from(
    [
        Rules(points=1, clear=1, cap=1, games=1),
        Rules(points=1, clear=1, cap=1, games=2),
        Rules(points=2, clear=2, cap=4, games=1),
        Rules(points=3, clear=2, cap=5, games=2),
        Rules(points=3, clear=1, cap=3, games=2),
        Rules(points=2, clear=2, cap=3, games=3),
    ]
)


@functools.cache
def after(score: Score, winner: int) -> Score:
    """The score after a rally, without the points of finished games: they do not matter to the match."""
    return dataclasses.replace(score.after(winner), finished=())


def enumerated(score: Score, p_serving: float, p_receiving: float) -> float:
    """Probability that player 0 wins the match, by playing out every sequence of rallies through the scoring itself."""

    @functools.cache
    def odds(now: Score) -> float:
        if now.over:
            return float(now.winner == 0)
        p = p_serving if now.server == 0 else p_receiving
        return p * odds(after(now, 0)) + (1 - p) * odds(after(now, 1))

    return odds(dataclasses.replace(score, finished=()))


@settings(max_examples=25, deadline=None)
@given(short, probability, probability, st.integers(0, 1))
def test_odds_equal_enumeration_of_all_rallies(rules: Rules, serving: float, receiving: float, server: int) -> None:
    exact = enumerated(Score(server=server, rules=rules), serving, receiving)
    found = match_win_probability(serving, receiving, first_server=server, rules=rules)
    assert found == pytest.approx(exact, abs=1e-12)


@settings(max_examples=25, deadline=None)
@given(short, probability, probability, st.lists(st.integers(0, 1), max_size=12))
def test_odds_from_any_score_equal_enumeration(rules: Rules, serving: float, receiving: float, past: list[int]) -> None:
    score = Score(server=1, rules=rules)
    for winner in past:
        if not score.after(winner).over:
            score = score.after(winner)
    found = match_win_probability(
        serving, receiving, first_server=score.server, games=score.games, points=score.points, rules=rules
    )
    assert found == pytest.approx(enumerated(score, serving, receiving), abs=1e-12)


def test_arrays_broadcast() -> None:
    serving, receiving = np.linspace(0, 1, 7)[:, None], np.linspace(0, 1, 5)
    table = match_win_probability(serving, receiving)
    assert table.shape == (7, 5)
    assert table[3, 2] == match_win_probability(serving[3, 0], receiving[2])
    assert match_win_probability(0.4, 0.5).shape == ()


def test_odds_equal_simulated_matches() -> None:
    serving, receiving, matches = 0.55, 0.49, 20_000
    rng = np.random.default_rng(3)
    points, games, server = np.zeros((matches, 2), int), np.zeros((matches, 2), int), np.zeros(matches, int)
    first_game = np.full(matches, -1)
    live = np.arange(matches)
    while len(live):
        winner = (rng.random(matches) >= np.where(server == 0, serving, receiving)).astype(int)[live]
        counted = count_rally(points[live, winner], points[live, 1 - winner], games[live, winner], BWF)
        points[live, winner], games[live, winner], server[live] = counted.points, counted.games, winner
        won = live[counted.game_won]
        points[won] = 0
        first_game[won] = np.where(first_game[won] < 0, server[won], first_game[won])
        live = live[~counted.match_won]
    exact = float(match_win_probability(serving, receiving, first_server=0))
    error = math.sqrt(exact * (1 - exact) / matches)
    assert abs((server == 0).mean() - exact) < 4 * error
    exact = float(game_win_probability(serving, receiving, server=0))
    assert abs((first_game == 0).mean() - exact) < 4 * math.sqrt(exact * (1 - exact) / matches)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"p_serving": 1.2}, "probability of winning a rally 1.2"),
        ({"p_receiving": [0.5, float("nan")]}, "probability of winning a rally nan"),
        ({"first_server": 2}, "server 2"),
        ({"games": (2, 0)}, "games"),
        ({"points": (21, 3)}, "points"),
        ({"points": (30, 30)}, "points"),
        ({"points": (-1, 3)}, "points"),
    ],
)
def test_impossible_questions_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(ScoringError, match=message):
        match_win_probability(**{"p_serving": 0.5, "p_receiving": 0.5, **options})  # type: ignore[arg-type]
