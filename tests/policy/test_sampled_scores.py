"""Scores that are sampled, from matches whose results are given, and what a scorecard says of its figures."""

import dataclasses
import math
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from shuttle_marl.exact.away import Spread
from shuttle_marl.exact.match import Odds
from shuttle_marl.game import draws
from shuttle_marl.game.policy import States
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.kernel import lockstep
from shuttle_marl.policy import scorecard
from shuttle_marl.policy.scorecard import Scorecard, Scorer, sample
from tests.exact.exact_games import random_game, tiring_game, with_probabilities
from tests.exact.test_hidden_positions_solved import with_recovery

GAME = tiring_game()


class First:
    """Plays the first legal stroke and waits in the first feasible position."""

    reads_score = True

    def probabilities(self, states: States) -> np.ndarray:
        return np.eye(states.game.n_strokes)[states.mask.argmax(axis=1)]

    def positions(self, states: States) -> np.ndarray:
        return np.eye(N_POSITIONS)[states.game.waiting.mask(states.game.base(states.state)).argmax(axis=1)]


def last(game: Any) -> TabulatedPolicy:
    """The table of who always plays the last legal stroke, waiting as people do."""
    ends = game.base_pair_rank == (np.diff(game.base_pair_start) - 1)[game.base_pair_state]
    return TabulatedPolicy(game=game, cumulative=np.tile(np.where(ends, 65535, 0).astype(np.uint16), game.n_blocks))


@dataclasses.dataclass
class Played:
    """Rallies by match, winner and number of strokes."""

    match: np.ndarray
    winner: np.ndarray
    length: np.ndarray


RALLIES = {0: "0010", 1: "10", 2: "000", 3: "001", 4: "1"}
"""Winners of the rallies of each match: the policy has seat 0 in matches of even number, so it wins 3, 1, 3, 1 and 0 of them."""
GAMES = {0: (2, 1), 1: (2, 0), 2: (2, 0), 3: (0, 2), 4: (1, 2)}
"""Games won: the policy wins matches 0, 2 and 3."""


def test_shares_of_matches_and_rallies_with_their_intervals(monkeypatch: pytest.MonkeyPatch) -> None:
    seats: list[Any] = []
    kept: list[bool] = []

    def play(game: Any, seated: Any, choose: Any, wait: Any, *, keep_strokes: bool) -> Any:
        first = sum(len(each.key) for each in seats)
        seats.append(seated)
        kept.append(keep_strokes)
        numbers = range(first, first + len(seated.key))
        winner = [int(each) for number in numbers for each in RALLIES[number]]
        match = [number - first for number in numbers for _ in RALLIES[number]]
        return np.array([GAMES[number] for number in numbers]), Played(*map(np.array, (match, winner, [3] * len(match))))

    monkeypatch.setattr(scorecard, "_BATCH", 2)
    monkeypatch.setattr(lockstep, "play", play)
    seen: list[Any] = []
    found = sample(First(), last(GAME), matches=5, seed=7, key=9, watch=seen.append)
    assert [each.entrant.tolist() for each in seats] == [[[0, 1], [1, 0]], [[0, 1], [1, 0]], [[0, 1]]]
    assert [each.first_server.tolist() for each in seats] == [[0, 0], [1, 1], [0]]
    assert np.array_equal(np.concatenate([each.key for each in seats]), draws.stream(7, 9, np.arange(5)))
    assert [each.match.tolist() for each in seen] == [[0, 0, 0, 0, 1, 1], [2, 2, 2, 3, 3, 3], [4]]
    assert kept == [True] * 3
    assert (found.matches, found.rallies, found.strokes) == (5, 13, 39)
    assert (found.match, found.rally) == (3 / 5, 8 / 13)
    # Won less 8/13 of the rallies of each match, and a sum of their squares.
    deviation = sum((won - 8 / 13 * rallies) ** 2 for won, rallies in ((3, 4), (1, 2), (3, 3), (1, 3), (0, 1)))
    half = 1.959964 * math.sqrt(deviation) / 13
    assert found.rally_interval == pytest.approx((8 / 13 - half, 8 / 13 + half), abs=1e-6)
    # Wilson's interval of 3 in 5.
    z2 = 1.959964**2
    centre, half = (3 + z2 / 2) / (5 + z2), math.sqrt(z2) / (5 + z2) * math.sqrt(3 * 2 / 5 + z2 / 4)
    assert found.match_interval == pytest.approx((centre - half, centre + half), abs=1e-6)
    seats.clear()
    monkeypatch.setattr(scorecard, "_BATCH", 100)
    monkeypatch.setitem(RALLIES, 1, "11")
    for winners, share in (("0000", 1.0), ("1111", 0.0)):
        monkeypatch.setitem(RALLIES, 0, winners)
        seats.clear()
        kept.clear()
        low, high = sample(First(), last(GAME), matches=1).rally_interval
        assert (low, high) == (share, share)
        assert kept == [False]


@pytest.mark.parametrize("recovery", [False, True])
def test_the_policy_and_the_table_are_asked_for_their_own_strokes(recovery: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    game = with_recovery(random_game(2), 2) if recovery else GAME
    table, asked = last(game), list[Any]()

    def play(*arguments: Any, **_: Any) -> Any:
        asked.extend(arguments[2:4])
        return np.array([[2, 0]]), Played(np.zeros(1, np.int64), np.zeros(1, np.int64), np.ones(1, np.int64))

    monkeypatch.setattr(lockstep, "play", play)
    sample(First(), table, matches=1)
    choose, wait = asked
    state = np.flatnonzero(game.playable)[:60:7].astype(np.int32)
    entrant, draw = np.arange(len(state)) % 3, np.arange(len(state), dtype=np.int32) * 1000
    rest = np.zeros(len(state), np.int32), np.arange(4 * len(state), dtype=np.int32).reshape(4, -1) % 7
    strokes = choose(entrant, state, draw, *rest)
    assert strokes.tolist() == np.where(entrant == 0, 0, game.legal_count(state) - 1).tolist()
    assert choose(entrant[1:3], state[1:3], draw[1:3], rest[0][1:3], rest[1][:, 1:3]).tolist() == strokes[1:3].tolist()
    if recovery:
        feasible = game.waiting.mask(game.base(state))
        expected = np.where(entrant == 0, feasible.argmax(axis=1), table.choose_position(state, draw))
        assert wait(entrant, state, draw, *rest).tolist() == expected.tolist()


def test_a_sampled_card_has_the_figures_of_its_matches(monkeypatch: pytest.MonkeyPatch) -> None:
    scorer = Scorer.__new__(Scorer)
    scorer.game, scorer.reference = GAME, last(GAME)
    scorer.__dict__["reference_best"] = Odds(serving=0.6, receiving=0.8, error_bound=1e-9)
    given: list[Any] = []
    odds = scorecard.SampledOdds(
        matches=8, rallies=50, strokes=400, rally=0.55, rally_interval=(0.5, 0.6), match=0.75, match_interval=(0.4, 0.9)
    )

    def sampled(*players: Any, **named: Any) -> scorecard.SampledOdds:
        given.append((players, named))
        return odds

    monkeypatch.setattr(scorecard, "sample", sampled)
    policy = First()
    card = scorer.score(policy, "moody", matches=8, seed=3, watch=given.append)
    ((players, named),) = given
    assert players == (policy, scorer.reference)
    key = draws.pairing_key("moody", "bc")
    assert {name: named[name] for name in ("matches", "seed", "key")} == {"matches": 8, "seed": 3, "key": key}
    assert card.sampled
    assert (card.policy, card.matches, card.rally_length_vs_bc) == ("moody", 8, 8.0)
    assert (card.rally_win_vs_bc, card.match_win_vs_bc) == (0.55, 0.75)
    assert (card.rally_interval, card.match_interval) == ((0.5, 0.6), (0.4, 0.9))
    assert card.normalised_score == pytest.approx(0.05 / 0.2)
    assert card.home == {"rally_win_vs_bc": 0.55, "match_win_vs_bc": 0.75, "exploitability": None}
    away = {"rally_win_vs_bc": Spread(value=0.5, low=0.25, high=0.75)}
    told = dataclasses.replace(card, away=away).as_json()
    assert told["away"] == {"rally_win_vs_bc": {"value": 0.5, "low": 0.25, "high": 0.75}}
    assert told["home"] == card.home
    assert {**told, "away": None} == card.as_json()
    assert set(told) == {field.name for field in dataclasses.fields(Scorecard)} | {"home"}


def stub_scorer(monkeypatch: pytest.MonkeyPatch, bounds: dict[str, float], best: float = 0.75) -> Scorer:
    """A scorer of a policy that wins 0.625 serving and 0.5 receiving, whose figures have given bounds of errors."""
    striking = (np.zeros(GAME.n_states), np.full(GAME.n_states, 0.125))
    answer = Mock(error_bound=bounds.get("answer", 0.0), striking=striking)
    answer.odds.return_value = Odds(serving=0.7, receiving=0.6, error_bound=0.0)
    seen = Mock(error_bound=bounds.get("visits", 0.0), rally_length=6.5)
    seen.endings.return_value = {"a": 0.4, "b": 0.3, "c": 0.2, "d": 0.1}
    seen.shot_mix.return_value = np.arange(len(SHOTS)) / 100
    seen.base_pairs.return_value = np.stack([np.full(GAME.n_base_pairs, 1.0), np.arange(GAME.n_base_pairs)])
    odds = Odds(serving=0.625, receiving=0.5, error_bound=bounds.get("odds", 0.0))
    monkeypatch.setattr(scorecard, "evaluate", lambda *_, **__: Mock(odds=lambda: odds))
    monkeypatch.setattr(scorecard, "best_response", lambda *_, **__: Mock(value=answer))
    monkeypatch.setattr(scorecard, "policy_regret", lambda *_, **__: Mock(per_rally=0.05, error_bound=bounds.get("regret", 0.0)))
    monkeypatch.setattr(scorecard, "visits", lambda *_, **__: seen)
    scorer = Scorer.__new__(Scorer)
    scorer.game, scorer.refits, scorer.tolerance, scorer.reference = GAME, (), 1e-9, last(GAME)
    scorer.__dict__["solution"] = Mock(value_at_serve=0.5, error_bound=bounds.get("solution", 0.0))
    scorer.__dict__["reference_best"] = Odds(serving=best, receiving=best, error_bound=bounds.get("best", 0.0))
    return scorer


@pytest.mark.parametrize(
    ("bounds", "largest"),
    [
        ({"odds": 0.01}, 0.04),  # over what the best response wins more than half
        ({"odds": 0.01, "answer": 0.1}, 0.1),
        ({"solution": 0.2, "answer": 0.1}, 0.3),
        ({"regret": 0.2, "odds": 0.01}, 0.2),
        ({"visits": 0.3, "solution": 0.1}, 0.3),
        ({"best": 0.05}, 0.25 * 0.05 / 0.2),  # for a normalised score of 1/4
        ({"best": 0.05, "odds": 0.02}, (0.02 + 0.25 * 0.05) / 0.2),
    ],
)
def test_the_bound_of_a_card_is_the_largest(bounds: dict[str, float], largest: float, monkeypatch: pytest.MonkeyPatch) -> None:
    card = stub_scorer(monkeypatch, bounds).score(last(GAME), "some")
    assert card.error_bound == pytest.approx(largest)
    assert card.normalised_score == pytest.approx(0.25)


def test_figures_of_a_card_are_where_they_belong(monkeypatch: pytest.MonkeyPatch) -> None:
    behind = np.arange(len(GAME.edge_own)) % 7
    monkeypatch.setattr(scorecard, "real_strokes", lambda _: behind)
    card = stub_scorer(monkeypatch, {}).score(last(GAME), "some")
    assert (card.rally_win_vs_bc, card.rally_win_serving, card.rally_win_receiving) == (0.5625, 0.625, 0.5)
    assert card.match_win_vs_bc == Odds(serving=0.625, receiving=0.5, error_bound=0.0).match()
    assert (card.exploitability, card.gap_at_serve) == (pytest.approx(0.3), 0.375)
    assert (card.regret_per_rally, card.rally_length_vs_bc, card.sampled, card.matches) == (0.05, 6.5, False, None)
    assert card.endings_vs_bc == {
        "own winner": 0.4, "fault of the opponent": 0.3, "winner of the opponent": 0.2, "own fault": 0.1,
    }  # fmt: skip
    assert card.shot_mix_vs_bc == {name: i / 100 for i, name in enumerate(SHOTS)}
    played = 1.0 + np.arange(GAME.n_base_pairs)
    assert card.thin_vs_bc == pytest.approx(played[behind[GAME.base_pair_edge] < 5].sum() / played.sum())
    assert card.away is None
    nothing = stub_scorer(monkeypatch, {}, best=0.5).score(last(GAME), "some")
    assert (nothing.normalised_score, nothing.error_bound) == (None, 0.0)
    monkeypatch.setattr(scorecard, "real_strokes", lambda _: None)
    assert stub_scorer(monkeypatch, {}).score(last(GAME), "some").thin_vs_bc is None


def test_figures_away_are_of_the_policy_moved(monkeypatch: pytest.MonkeyPatch) -> None:
    scorer, refit = stub_scorer(monkeypatch, {}), with_probabilities(GAME, 2)
    scorer.refits = (refit, refit)
    asked: list[Any] = []
    monkeypatch.setattr(scorecard, "over", lambda refits, figure: asked.append((refits, figure(refit))))
    scorer.score(last(GAME), "some")
    ((refits, figures),) = asked
    assert refits == scorer.refits
    match = Odds(serving=0.625, receiving=0.5, error_bound=0.0).match()
    assert figures == {"rally_win_vs_bc": 0.5625, "match_win_vs_bc": match, "exploitability": pytest.approx(0.3)}
