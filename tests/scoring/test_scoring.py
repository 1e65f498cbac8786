"""Points, games and matches."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shuttle_marl.game.scoring import BWF, Rules, Score, ScoringError, ends_changed, new, step, wins_game


def play(score: Score, winners: str) -> Score:
    """Play rallies of a batch of one, given who wins them."""
    for winner in winners:
        score = step(score, np.array([int(winner)]))
    return score


def line(score: Score) -> str:
    played = int(score.game[0]) + 1
    return " ".join(f"{a}-{b}" for a, b in score.by_game[0, :played])


@pytest.mark.parametrize(
    ("own", "other", "won"),
    [
        *[(20, 0, False), (21, 0, True), (21, 19, True), (21, 20, False), (22, 20, True), (23, 22, False)],
        *[(29, 28, False), (29, 27, True), (30, 29, True), (30, 28, True), (19, 21, False), (29, 30, False)],
    ],
)
def test_when_a_game_is_won(own: int, other: int, won: bool) -> None:
    assert wins_game(own, other) is won
    assert wins_game(np.array([own], np.int8), np.array([other], np.int8)).tolist() == [won]


def test_a_match_in_two_games() -> None:
    score = play(new([1]), "0" * 21)
    assert line(score) == "21-0 0-0"
    assert score.games.tolist() == [[1, 0]]
    assert score.points.tolist() == [[0, 0]]
    assert score.server.tolist() == [0], "the winner of a game serves first in the next"
    score = play(score, "1" * 19 + "0" * 20)
    assert line(score) == "21-0 20-19"
    assert not score.over[0]
    assert score.winner.tolist() == [-1]
    score = play(score, "0")
    assert score.over[0]
    assert score.winner.tolist() == [0]
    assert line(score) == "21-0 21-19"
    assert score.points.tolist() == [[21, 19]]


def test_a_match_that_is_over_does_not_change() -> None:
    over = play(new([0]), "1" * 42)
    after = play(over, "0" * 30)
    assert line(after) == line(over) == "0-21 0-21"
    assert (after.server == over.server).all()
    assert (after.games == over.games).all()


def test_setting_up_to_the_cap() -> None:
    score = play(new([0]), "01" * 29)
    assert line(score) == "29-29"
    score = play(score, "1")
    assert line(score) == "29-30 0-0"


def test_a_third_game_decides() -> None:
    score = play(new([0]), "0" * 21 + "1" * 21 + "0" * 20 + "1" * 22)
    assert line(score) == "21-0 0-21 20-22"
    assert score.winner.tolist() == [1]
    assert score.seen_by(1).tolist() == [[22, 20, 2, 1]]
    assert score.seen_by(np.array([0])).tolist() == [[20, 22, 1, 2]]


def test_rallies_without_result_change_nothing() -> None:
    before = play(new([1]), "0")
    after = step(before, np.array([-1]))
    assert (after.by_game == before.by_game).all()
    assert (after.server == before.server).all()


def test_the_score_before_a_rally_is_kept() -> None:
    before = new([0, 1])
    step(before, np.array([1, 0]))
    assert not before.by_game.any()
    assert before.server.tolist() == [0, 1]


@pytest.mark.parametrize("server", [2, [0, 2], [[0, 1]], [0.5]])
def test_first_servers_are_checked(server: object) -> None:
    with pytest.raises(ScoringError, match="expected a one-dimensional array of 0 and 1"):
        new(server)  # type: ignore[arg-type]


@pytest.mark.parametrize("wrong", [{"points": 0}, {"cap": 20}, {"clear": 0}, {"clear": 22}, {"cap": 200}, {"games": 0}])
def test_rules_are_checked(wrong: dict[str, int]) -> None:
    with pytest.raises(ScoringError, match=r"Rules\("):
        Rules(**wrong)


class OneMatch:
    """The rules told again, one rally at a time, in the words of the Laws."""

    def __init__(self, server: int, rules: Rules) -> None:
        self.rules, self.server, self.games = rules, server, [0, 0]
        self.done: list[Any] = []
        self.now = [0, 0]

    def rally(self, winner: int) -> None:
        if max(self.games) == self.rules.games:
            return
        self.now[winner] += 1
        self.server = winner
        own, other = self.now[winner], self.now[1 - winner]
        leads = own - other >= self.rules.clear
        if own == self.rules.cap or (own >= self.rules.points and leads):
            self.done.append(tuple(self.now))
            self.games[winner] += 1
            self.now = [0, 0]


rules_of_short_games = st.builds(
    lambda points, clear, more, games: Rules(points=points, clear=min(clear, points), cap=points + more, games=games),
    st.integers(1, 6),
    st.integers(1, 3),
    st.integers(0, 4),
    st.integers(1, 3),
)


@given(rules_of_short_games, st.lists(st.lists(st.integers(0, 1), min_size=60, max_size=60), min_size=1, max_size=5))
def test_a_batch_is_scored_like_single_matches(rules: Rules, winners: list[list[int]]) -> None:
    rallies = np.array(winners)
    batch = len(rallies)
    score = new(np.arange(batch) % 2, rules)
    told = [OneMatch(i % 2, rules) for i in range(batch)]
    for winner in rallies.T:
        score = step(score, winner)
        for i in range(batch):
            told[i].rally(winner[i])
            assert score.games[i].tolist() == told[i].games
            assert score.server[i] == told[i].server
            games = [*told[i].done, *([] if max(told[i].games) == rules.games else [tuple(told[i].now)])]
            assert [tuple(g) for g in score.by_game[i, : len(games)].tolist()] == games
            assert not score.by_game[i, len(games) :].any()
            assert score.points[i].tolist() == list(games[-1])
            assert score.over[i] == (max(told[i].games) == rules.games)


def test_matches_to_21_last_between_42_and_177_rallies() -> None:
    score = new(np.arange(4000) % 2)
    rng = np.random.default_rng(0)
    length = np.zeros(4000, int)
    while not score.over.all():
        length += ~score.over
        score = step(score, rng.integers(0, 2, 4000))
    assert length.min() >= 42
    assert length.max() <= 3 * 59
    for game in range(3):
        a, b = np.sort(score.by_game[:, game].astype(int), axis=1).T
        played = b > 0
        legal = ((b == 21) & (a <= 19)) | ((b > 21) & (b < 30) & (b - a == 2)) | ((b == 30) & (a >= 28))
        assert legal[played].all()


@pytest.mark.parametrize(
    ("points", "games", "rules", "changed"),
    [
        ((0, 0), (0, 0), BWF, False),
        ((20, 19), (0, 0), BWF, False),
        ((0, 0), (1, 0), BWF, True),
        ((15, 20), (0, 1), BWF, True),
        ((10, 10), (1, 1), BWF, False),
        ((11, 3), (1, 1), BWF, True),
        ((20, 29), (1, 1), BWF, True),
        ((0, 1), (2, 2), Rules(points=11, clear=2, cap=15, games=3), False),
        ((5, 6), (2, 2), Rules(points=11, clear=2, cap=15, games=3), True),
        ((0, 0), (0, 0), Rules(points=1, clear=1, cap=1, games=1), False),
    ],
)
def test_players_change_ends(points: tuple[int, int], games: tuple[int, int], rules: Rules, changed: bool) -> None:
    assert ends_changed(points, games, rules) is changed
    assert ends_changed(points[::-1], games[::-1], rules) is changed
