"""Matches in lock-step whose outcomes are certain: what players are shown, who serves, and what is noted."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from shuttle_marl.game import draws
from shuttle_marl.game.draws import ONE
from shuttle_marl.game.policy import PolicyError, States, UniformPolicy
from shuttle_marl.game.scoring import Rules
from shuttle_marl.kernel import Matches
from shuttle_marl.kernel.matches import ask, ask_position, asking, play
from tests.exact.exact_games import hand_made, tiring_game
from tests.lost_serves import SCORES
from tests.recovery import with_recovery

SERVE, SMASH, LIFT = range(3)
MADE = hand_made()
CERTAIN = np.array([[0, 0, 0], [0, ONE - 1, ONE - 1], [ONE - 1] * 3], np.uint16)
"""Of a serve that is always returned from above, a smash that always wins, and a lift that always fails."""
GAME = dataclasses.replace(MADE, threshold=CERTAIN[MADE.pair_stroke], hurry=np.zeros_like(MADE.hurry))
RULES = Rules(points=2, clear=1, cap=2, games=2)
HIDDEN = with_recovery(tiring_game(), 3, 3)


def matches(*first_servers: int) -> Matches:
    """Matches of entrants 2 m and 2 m + 1, and the m-th key."""
    count = len(first_servers)
    return Matches(
        entrant=np.arange(2 * count, dtype=np.int32).reshape(count, 2),
        first_server=np.array(first_servers, np.int8),
        key=np.arange(count, dtype=np.uint64) + np.uint64(70),
    )


class Seen:
    """Chooses the first legal stroke, and notes what it was shown."""

    def __init__(self) -> None:
        self.calls: list[list[list[int]]] = []
        self.draws: list[list[int]] = []

    def choose(self, entrant: Any, state: Any, draw: Any, striker: Any, score: Any, history: Any, number: Any) -> Any:
        self.calls.append([np.array(part).T.tolist() for part in (entrant, state, striker, score, history)])
        self.draws.append(draw.tolist())
        return np.zeros(len(entrant), np.intp)


def test_players_are_shown_the_score_and_the_rally_so_far() -> None:
    seen, n = Seen(), GAME.n_strokes
    played = play(GAME, matches(0), seen.choose, rules=RULES)
    assert played.games.tolist() == [[1, 2]]
    assert len(seen.calls) == 18
    for number, score in enumerate(SCORES):
        server = number % 2
        (entrant, state, striker, shown, history), (other, next_state, receiver, again, after) = seen.calls[2 * number :][:2]
        assert (entrant, state, striker, shown, history) == ([server], [0], [server], [list(score)], [[n, n, n, n]])
        arrival = int(GAME.arrivals(np.array([0]))[0, 1])
        assert (other, next_state, receiver, again, after) == (
            [1 - server], [arrival], [1 - server], [list(score)], [[SERVE, n, n, n]],
        )  # fmt: skip
        key = draws.extend(np.array([70], np.uint64), 2 * number + server)
        for t in (0, 1):
            assert seen.draws[2 * number + t] == draws.choice_draw(draws.draw(key, t)).tolist()


def test_rallies_are_noted_in_the_order_of_the_matches() -> None:
    played = play(GAME, matches(0, 1), Seen().choose, rules=RULES)
    assert played.games.tolist() == [[1, 2], [2, 1]]
    rallies = played.rallies
    assert rallies.match.tolist() == [0] * 9 + [1] * 9
    assert rallies.rally.tolist() == [*range(9), *range(9)]
    assert rallies.policy.tolist() == [[0, 1]] * 9 + [[2, 3]] * 9
    assert rallies.pairing.tolist() == [0] * 18
    assert rallies.server.tolist() == [0, 1] * 4 + [0] + [1, 0] * 4 + [1]
    assert rallies.winner.tolist() == [1, 0] * 4 + [1] + [0, 1] * 4 + [0]
    assert rallies.reason.tolist() == [1] * 18
    turned = [(b, a, d, c) for a, b, c, d in SCORES]
    assert rallies.score.tolist() == [list(score) for score in (*SCORES, *turned)]
    assert rallies.length.tolist() == [2] * 18
    assert rallies.stroke.tolist() == [SERVE, SMASH] * 18
    assert rallies.hurried.tolist() == [0] * 36
    assert rallies.waited is None
    empty = play(GAME, matches(0, 1), Seen().choose, rules=RULES, keep_strokes=False)
    assert (empty.rallies.stroke.tolist(), empty.rallies.length.tolist()) == ([], [2] * 18)


class Reader(UniformPolicy):
    """Plays the first legal stroke; notes state, score and history."""

    reads_score = True
    reads_history = True

    def __init__(self) -> None:
        self.asked: list[Any] = []

    def probabilities(self, states: States) -> Any:
        score = None if states.score is None else states.score.tolist()
        self.asked.append((states.state.tolist(), score, None if states.history is None else states.history.tolist()))
        return np.eye(states.game.n_strokes)[states.mask.argmax(axis=1)]

    def positions(self, states: States) -> Any:
        self.probabilities(states)
        people = states.game.people_positions(states.state)
        return np.eye(9)[(people > 0).argmax(axis=1)]


STATES = np.array([0, 4 * 3], np.int32)
SCORE = np.array([[7, 1], [3, 2], [1, 0], [0, 1]], np.int32)
"""Points of seat 0 and of seat 1, and their games, in two matches."""
HISTORY = np.array([[8, 1], [8, 0], [8, 8], [8, 8]], np.int32)


@pytest.mark.parametrize("asked", [ask, ask_position])
def test_policies_see_the_score_of_the_striker(asked: Callable[..., Any]) -> None:
    policy, striker = Reader(), np.array([0, 1], np.int32)
    seat = striker if asked is ask else 1 - striker
    found = asked(policy, HIDDEN, STATES, np.array([0, 65534], np.int32), seat, SCORE, HISTORY)
    # Own points, the other's, own games and the other's; the striker of the second match is at seat 1.
    assert policy.asked == [(STATES.tolist(), [[7, 3, 1, 0], [2, 1, 1, 0]], HISTORY.T.tolist())]
    if asked is ask:
        assert (found.tolist(), found.dtype) == ([0, 0], np.intp)
    else:
        assert found.tolist() == (HIDDEN.people_positions(STATES) > 0).argmax(axis=1).tolist()


def test_each_entrant_is_asked_for_its_own_decisions() -> None:
    policies, entrant = [Reader(), Reader()], np.array([1, 0, 1], np.int32)
    states = np.array([0, 12, 12], np.int32)
    draw, striker, score = np.zeros(3, np.int32), np.array([0, 1, 1], np.int32), np.tile(np.arange(3, dtype=np.int32), (4, 1))
    for positions in (False, True):
        for policy in policies:
            policy.asked.clear()
        history, number = np.tile(HISTORY[:, :1], 3), np.ones(3, np.int32)
        found = asking(HIDDEN, policies, positions=positions)(entrant, states, draw, striker, score, history, number)
        assert [policy.asked[0][0] for policy in policies] == [[12], [0, 12]]
        assert [policy.asked[0][1] for policy in policies] == [[[1] * 4], [[0] * 4, [2] * 4]]
        assert len(found) == 3


def test_policies_that_are_no_distribution_are_refused() -> None:
    class Wrong(UniformPolicy):
        def probabilities(self, states: States) -> Any:
            return super().probabilities(states) * 2

    with pytest.raises(PolicyError, match="policy 'Wrong' returned no distribution"):
        ask(Wrong(), HIDDEN, STATES, np.zeros(2, np.int32), np.zeros(2, np.int32), SCORE)
