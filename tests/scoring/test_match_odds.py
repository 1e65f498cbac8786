"""Exact odds of games and matches, against enumeration, closed forms and simulation."""

import functools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.game.scoring import (
    Rules,
    Score,
    ScoringError,
    game_win_probability,
    match_win_probability,
    new,
    step,
)

State = tuple[bytes, bytes, int]
"""Points by game, games, and server of one match."""
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
def followed(by_game: bytes, games: bytes, server: int, rules: Rules, shape: tuple[int, ...]) -> float | tuple[State, State]:
    """The scores after a rally won by either player, by the scoring itself; or 1 or 0 if player 0 has won or lost the match."""
    here = Score(
        by_game=np.frombuffer(by_game, np.int8).reshape(shape),
        games=np.frombuffer(games, np.int8).reshape(1, 2),
        server=np.array([server], np.int8),
        rules=rules,
    )
    if here.over[0]:
        return float(here.winner[0] == 0)
    won, lost = (state_of(step(here, np.array([winner]))) for winner in (0, 1))
    return won, lost


def state_of(score: Score) -> State:
    return score.by_game.tobytes(), score.games.tobytes(), int(score.server[0])


def enumerated(score: Score, p_serving: float, p_receiving: float) -> float:
    """Probability that player 0 wins the match, by playing out every sequence of rallies through the scoring itself."""

    @functools.cache
    def odds(state: State) -> float:
        after = followed(*state, score.rules, score.by_game.shape)
        if isinstance(after, float):
            return after
        p = p_serving if state[2] == 0 else p_receiving
        return p * odds(after[0]) + (1 - p) * odds(after[1])

    return odds(state_of(score))


@settings(max_examples=25, deadline=None)
@given(short, probability, probability, st.integers(0, 1))
def test_odds_equal_enumeration_of_all_rallies(rules: Rules, serving: float, receiving: float, server: int) -> None:
    exact = enumerated(new([server], rules), serving, receiving)
    found = match_win_probability(serving, receiving, first_server=server, rules=rules)
    assert found == pytest.approx(exact, abs=1e-12)


@settings(max_examples=25, deadline=None)
@given(short, probability, probability, st.lists(st.integers(0, 1), max_size=12))
def test_odds_from_any_score_equal_enumeration(rules: Rules, serving: float, receiving: float, past: list[int]) -> None:
    score = new([1], rules)
    for winner in past:
        if not step(score, np.array([winner])).over[0]:
            score = step(score, np.array([winner]))
    games, points = score.games[0].tolist(), score.points[0].tolist()
    found = match_win_probability(
        serving, receiving, first_server=int(score.server[0]), games=tuple(games), points=tuple(points), rules=rules
    )
    assert found == pytest.approx(enumerated(score, serving, receiving), abs=1e-12)


@pytest.mark.parametrize("p", [0.1, 0.45, 0.5, 0.62, 0.97])
def test_a_game_without_advantage_of_serve_has_the_closed_form(p: float) -> None:
    # First to 21, two clear up to 29 all: negative binomial up to 20 all, then pairs of rallies, then one at 29 all.
    q = 1 - p
    before_setting = sum(math.comb(20 + k, k) * p**21 * q**k for k in range(20))
    twenty_all = math.comb(40, 20) * (p * q) ** 20
    setting = sum((2 * p * q) ** k * p**2 for k in range(9)) + (2 * p * q) ** 9 * p
    expected = before_setting + twenty_all * setting
    game = game_win_probability(p, p)
    assert game == pytest.approx(expected, abs=1e-13)
    assert match_win_probability(p, p) == pytest.approx(expected**2 * (3 - 2 * expected), abs=1e-13)


@given(st.floats(0.01, 0.99), st.floats(0.01, 0.99))
def test_single_rallies_that_the_winner_serves_next(serving: float, receiving: float) -> None:
    # Best of three games of one point: 00 / 010 / 100 with the server of each rally the winner of the one before.
    rules = Rules(points=1, clear=1, cap=1)
    expected = serving**2 + serving * (1 - serving) * receiving + (1 - serving) * receiving * serving
    assert match_win_probability(serving, receiving, first_server=0, rules=rules) == pytest.approx(expected, abs=1e-14)


@given(probability, probability)
def test_the_players_can_change_names(serving: float, receiving: float) -> None:
    for server in (0, 1):
        one = match_win_probability(serving, receiving, first_server=server)
        other = match_win_probability(1 - receiving, 1 - serving, first_server=1 - server)
        assert one + other == pytest.approx(1.0, abs=1e-12)


def test_even_probabilities_of_symmetric_players() -> None:
    for serving in (0.2, 0.5, 0.8):
        assert match_win_probability(serving, 1 - serving) == pytest.approx(0.5, abs=1e-13)


@given(probability, probability, st.floats(0, 1), st.sampled_from([None, 0, 1]))
def test_winning_more_rallies_never_hurts(serving: float, receiving: float, share: float, server: int | None) -> None:
    odds = match_win_probability(serving, receiving, first_server=server)
    better = serving + share * (1 - serving)
    assert match_win_probability(better, receiving, first_server=server) >= odds - 1e-12
    better = receiving + share * (1 - receiving)
    assert match_win_probability(serving, better, first_server=server) >= odds - 1e-12


def test_a_point_and_a_game_help() -> None:
    start = match_win_probability(0.5, 0.48, first_server=0)
    assert match_win_probability(0.5, 0.48, first_server=0, points=(1, 0)) > start
    assert match_win_probability(0.5, 0.48, first_server=0, games=(1, 0)) > start
    assert match_win_probability(0.5, 0.48, first_server=0, games=(1, 1), points=(29, 29)) == pytest.approx(0.5)
    assert match_win_probability(0.5, 0.48, first_server=1, games=(1, 1), points=(29, 29)) == pytest.approx(0.48)


def test_certain_rallies() -> None:
    assert match_win_probability(1.0, 1.0) == 1.0
    assert match_win_probability(0.0, 0.0) == 0.0
    assert match_win_probability(1.0, 0.0, first_server=0) == 1.0, "the server keeps the serve"
    assert match_win_probability(1.0, 0.0, first_server=1) == 0.0
    assert match_win_probability(1.0, 0.0) == 0.5


def test_arrays_broadcast() -> None:
    serving, receiving = np.linspace(0, 1, 7)[:, None], np.linspace(0, 1, 5)
    table = match_win_probability(serving, receiving)
    assert table.shape == (7, 5)
    assert table[3, 2] == match_win_probability(serving[3, 0], receiving[2])
    assert match_win_probability(0.4, 0.5).shape == ()


def test_odds_equal_simulated_matches() -> None:
    serving, receiving, matches = 0.55, 0.49, 20_000
    rng = np.random.default_rng(3)
    score = new(np.zeros(matches, int))
    while not score.over.all():
        p = np.where(score.server == 0, serving, receiving)
        score = step(score, (rng.random(matches) >= p).astype(int))
    exact = float(match_win_probability(serving, receiving, first_server=0))
    error = math.sqrt(exact * (1 - exact) / matches)
    assert abs((score.winner == 0).mean() - exact) < 4 * error
    first = score.by_game[:, 0, 0] > score.by_game[:, 0, 1]
    exact = float(game_win_probability(serving, receiving, server=0))
    assert abs(first.mean() - exact) < 4 * math.sqrt(exact * (1 - exact) / matches)


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
