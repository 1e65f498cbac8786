"""Points, games and matches, and their exact odds against enumeration."""

import dataclasses
import functools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.game.scoring import (
    BWF,
    RULES,
    Rules,
    RulesName,
    Score,
    ScoringError,
    is_over,
    match_win_probability,
    serves_from_right,
    wins_game,
)

SCORES = json.loads((Path(__file__).parent / "scores.json").read_text(encoding="utf-8"))
"""Scores that the page has to judge alike, see ``tests/watch/test_tagging.py``."""


@pytest.mark.parametrize(("own", "other", "won"), SCORES["games"])
def test_when_a_game_is_won(own: int, other: int, won: bool) -> None:
    assert wins_game(own, other) is won
    assert wins_game(np.array([own], np.int8), np.array([other], np.int8)).tolist() == [won]


@pytest.mark.parametrize(("serving", "receiving", "rules", "probability"), SCORES["matches"])
def test_how_likely_a_match_is_won(serving: float, receiving: float, rules: RulesName, probability: float) -> None:
    assert match_win_probability(serving, receiving, rules=RULES[rules]) == pytest.approx(probability, abs=1e-10)


@pytest.mark.parametrize(
    "wrong", [{"points": 0}, {"cap": 20}, {"clear": 0}, {"clear": 22}, {"cap": 128}, {"games": 0}, {"games": 64}]
)
def test_rules_are_checked(wrong: dict[str, int]) -> None:
    with pytest.raises(ScoringError, match=r"Rules\("):
        Rules(**wrong)
    assert Rules(cap=127, games=63).max_rallies == 125 * 253


rules_of_short_games = st.builds(
    lambda points, clear, more, games: Rules(points=points, clear=min(clear, points), cap=points + more, games=games),
    st.integers(1, 6),
    st.integers(1, 3),
    st.integers(0, 4),
    st.integers(1, 3),
)


@given(rules_of_short_games, st.integers(0, 1), st.lists(st.integers(0, 1), min_size=60, max_size=60))
def test_scores_follow_the_laws(rules: Rules, server: int, winners: list[int]) -> None:
    """The rules told again, one rally at a time, in the words of the Laws."""
    score, now, games, finished = Score(server=server, rules=rules), [0, 0], [0, 0], list[Any]()
    for winner in winners:
        score = score.after(winner)
        if max(games) < rules.games:
            server = winner
            now[winner] += 1
            own, other = now[winner], now[1 - winner]
            if own == rules.cap or (own >= rules.points and own - other >= rules.clear):
                finished.append(tuple(now))
                games[winner] += 1
                now = [0, 0]
        over = max(games) == rules.games
        assert (score.over, score.games, score.server, score.points) == (over, tuple(games), server, tuple(now))
        assert score.by_game == (*finished, *([] if over else [tuple(now)]))


FIVE = Rules(points=11, clear=2, cap=15, games=3)


@pytest.mark.parametrize(
    ("points", "games", "rules", "changed"),
    [
        *((points, (0, 0), BWF, False) for points in ((0, 0), (20, 19))),
        *((points, games, BWF, True) for points, games in (((0, 0), (1, 0)), ((15, 20), (0, 1)), ((11, 3), (1, 1)))),
        *(((points, other), (1, 1), BWF, points == 20) for points, other in ((10, 10), (20, 29))),
        *(((points, points + 1), (2, 2), FIVE, points == 5) for points in (0, 5)),
    ],
)
def test_players_change_ends(points: tuple[int, int], games: tuple[int, int], rules: Rules, changed: bool) -> None:
    assert Score(points=points, games=games, rules=rules).ends_changed is changed
    assert Score(points=points[::-1], games=games[::-1], rules=rules).ends_changed is changed


def test_an_even_score_serves_from_the_right() -> None:
    assert [serves_from_right(points) for points in (0, 1, 2, 21)] == [True, False, True, False]
    assert serves_from_right(np.array([4, 7])).tolist() == [True, False]


@pytest.mark.parametrize(
    ("points", "games", "server", "rules", "expected"),
    [
        *(((11, other), (0, 0), 0, BWF, "interval") for other in (0, 4, 10)),
        *((points, (0, 0), server, BWF, "") for points, server in (((0, 0), 0), ((11, 5), 1), ((11, 11), 1), ((12, 4), 0))),
        ((10, 11), (1, 0), 1, BWF, "interval"),
        *(((11, 10)[:: 1 - 2 * seat], (1, 1), seat, BWF, "interval and change of ends") for seat in (0, 1)),
        *(((0, 0), games, 1, BWF, "change of ends") for games in ((1, 0), (0, 1), (1, 1))),
        *(((0, 0), games, 0, BWF, "") for games in ((2, 0), (2, 1))),
        ((2, 1), (2, 2), 0, Rules(points=4, clear=2, cap=5, games=3), "interval and change of ends"),
    ],
)
def test_what_precedes_a_rally(points: tuple[int, int], games: tuple[int, int], server: int, rules: Rules, expected: str) -> None:
    assert Score(points=points, games=games, server=server, rules=rules).break_before == expected


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


@settings(max_examples=50, deadline=None)
@given(short, probability, probability, st.integers(0, 1), st.lists(st.integers(0, 1), max_size=12))
def test_odds_equal_enumeration_of_all_rallies(
    rules: Rules, serving: float, receiving: float, server: int, past: list[int]
) -> None:
    single = dataclasses.replace(rules, games=1)
    one_game = enumerated(Score(server=server, rules=single), serving, receiving)
    assert match_win_probability(serving, receiving, first_server=server, rules=single) == pytest.approx(one_game, abs=1e-12)
    score = Score(server=server, rules=rules)
    for winner in past:
        if not score.after(winner).over:
            score = score.after(winner)
    found = match_win_probability(
        serving, receiving, first_server=score.server, games=score.games, points=score.points, rules=rules
    )
    assert found == pytest.approx(enumerated(score, serving, receiving), abs=1e-12)


def test_a_server_drawn_at_random_is_the_mean_of_both() -> None:
    first, second, drawn = (match_win_probability(0.4, 0.7, first_server=server) for server in (0, 1, None))
    assert first != second
    assert drawn == pytest.approx((first + second) / 2, abs=1e-12)


def test_arrays_broadcast() -> None:
    serving, receiving = np.linspace(0, 1, 7)[:, None], np.linspace(0, 1, 5)
    table = match_win_probability(serving, receiving)
    assert table.shape == (7, 5)
    assert table[3, 2] == match_win_probability(serving[3, 0], receiving[2])
    assert match_win_probability(0.4, 0.5).shape == ()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        *(({"p_serving": p}, f"probability of winning a rally {p}") for p in (1.2, -0.001)),
        ({"p_receiving": [0.5, float("nan")]}, "probability of winning a rally nan"),
        *(({"first_server": server}, f"server {server}") for server in (2, -1)),
        *(({"games": games}, "games") for games in ((2, 0), (0, 2), (-1, 0), (0, -1))),
        *(({"points": points}, "points") for points in ((21, 3), (3, 21), (30, 30), (-1, 3), (3, -1), (0, 30))),
    ],
)
def test_impossible_questions_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(ScoringError, match=message):
        match_win_probability(**{"p_serving": 0.5, "p_receiving": 0.5, **options})  # type: ignore[arg-type]


@pytest.mark.parametrize("wrong", [{"points": 21.0}, {"games": "2"}, {"clear": None}])
def test_rules_are_whole_numbers(wrong: dict[str, Any]) -> None:
    with pytest.raises(ScoringError, match="expected whole numbers"):
        Rules(**wrong)
    fifteen: Any = np.int64(15)
    assert Rules(points=fifteen).as_tuple == (15, 2, 30, 2)


def test_matches_are_over_with_two_games_of_either_seat() -> None:
    games = np.array([[0, 0], [1, 1], [2, 0], [1, 2]])
    assert is_over(games).tolist() == [False, False, True, True]
    assert is_over(games, RULES["11"]).tolist() == [False] * 4
    assert is_over(games[None], Rules(games=1)).tolist() == [[False, True, True, True]]
