"""Actions for observations: whose state is seen, which score, and which action a draw chooses."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from shuttle_marl.game.layout import RALLY_WIDTH, SWAP, observations
from shuttle_marl.game.policy import PolicyError, States, act
from shuttle_marl.game.recovery import NO_CHOICE
from shuttle_marl.game.tables import Game
from tests.exact.exact_games import hand_made, tiring_game
from tests.recovery import Prefers, with_recovery

GAME = hand_made(
    (
        "short-serve:front-centre:below:backhand",
        "lift:back-left:below:forehand",
        "lift:back-centre:below:forehand",
        "lift:back-right:below:forehand",
        "clear:back-left:above:forehand",
    )
)
STATE = int(next(s for s in range(GAME.n_states) if GAME.legal_count(s) == 3 and s & 1 == 0))
"""Of a player who is offered a contact below: three lifts are legal."""
RECOVERY = with_recovery(tiring_game(), 3, 3)


class Draws:
    """Uniform numbers that are known beforehand."""

    def __init__(self, *numbers: float) -> None:
        self.numbers = numbers

    def random(self, shape: tuple[int, ...]) -> np.ndarray:
        return np.reshape(self.numbers, shape)


def drawing(*numbers: float) -> Any:
    return Draws(*numbers)


class Fixed:
    """The same probabilities of the three lifts everywhere; notes the states that it was asked for."""

    reads_score = True

    def __init__(self, *p: float) -> None:
        self.p = p
        self.asked: list[States] = []

    def probabilities(self, states: States) -> np.ndarray:
        self.asked.append(states)
        return np.tile([0.0, *self.p, 0.0], (len(states), 1))


SEEN = observations(GAME, [STATE])[0]
LEFT, MIDDLE, RIGHT = 1, 2, 3


def test_a_mask_scales_what_it_leaves_and_comes_before_that_of_the_dictionary() -> None:
    policy, allowed = Fixed(0.2, 0.2, 0.6), np.array([1, 1, 1, 0, 0])
    # Without the third lift the others are played equally often.
    for observation, mask in ((SEEN, allowed), ({"observation": SEEN, "action_mask": allowed}, None)):
        found = [act(policy, GAME, observation, mask, drawing(u)) for u in (0.0, 0.49, 0.51, 0.99)]
        assert found == [LEFT, LEFT, MIDDLE, MIDDLE]
    both = {"observation": SEEN, "action_mask": np.array([1, 0, 0, 1, 0])}
    assert [act(policy, GAME, both, allowed, drawing(u)) for u in (0.4, 0.9)] == [LEFT, MIDDLE]
    assert [act(policy, GAME, both, None, drawing(u)) for u in (0.4, 0.9)] == [RIGHT, RIGHT]
    for mask in (np.zeros(5), np.array([1, 0, 0, 0, 1])):
        with pytest.raises(PolicyError, match="policy 'Fixed' plays none of the allowed strokes"):
            act(policy, GAME, SEEN, mask, drawing(0.5))


def test_policies_see_the_score_of_a_match_in_points_and_games() -> None:
    policy = Fixed(1.0, 0.0, 0.0)
    score = [7 / 30, 20 / 30, 1 / 2, 0.0, 1.0, 0.0]  # as match_v0 shows it: shares of 30 points and 2 games, and who serves
    act(policy, GAME, np.append(SEEN, score), None, drawing(0.5))
    act(policy, GAME, SEEN, None, drawing(0.5))
    in_match, alone = policy.asked
    assert in_match.score is not None
    assert in_match.score.tolist() == [[7, 20, 1, 0]]
    assert alone.score is None
    assert [states.state.tolist() for states in policy.asked] == [[STATE], [STATE]]


class Noting(Prefers):
    """Notes the state and the score for which it was asked."""

    reads_score = True

    def probabilities(self, states: States) -> Any:
        ASKED.append((states.state.tolist(), None if states.score is None else states.score.tolist()))
        return super().probabilities(states)


ASKED: list[Any] = []


def seen_of(game: Game, state: int, *, waits: bool, score: tuple[float, ...] = ()) -> np.ndarray:
    """Observation of the striker, or of the receiver who is to choose a position; score as the player who looks sees it."""
    row = observations(game, [state])[0]
    return np.r_[row[SWAP] if waits else row, score, float(waits)]


def test_who_chooses_a_position_is_asked_for_the_state_of_the_striker() -> None:
    game, n = RECOVERY, RECOVERY.n_strokes
    states = np.flatnonzero(
        game.playable & (game.effort(np.arange(game.n_states)) > game.opponent_effort(np.arange(game.n_states)))
    )
    state = int(states[len(states) // 2])
    feasible = np.flatnonzero(game.waiting.mask(np.array([state % game.n_base_states]))[0])
    assert len(feasible) == 3
    last = tuple(float(position == feasible[-1]) + 1e-9 for position in range(9))
    score = (6 / 30, 12 / 30, 0.0, 1 / 2, 1.0, 0.0)
    ASKED.clear()
    for width in ((), score):
        action = act(Noting(last), game, seen_of(game, state, waits=True, score=width), None, drawing(0.5))
        assert action == n + feasible[-1]
        stroke = act(Noting(last), game, seen_of(game, state, waits=False, score=width), None, drawing(0.0))
        assert stroke == game.legal_strokes(state)[0]
    # The receiver sees its own points first, the striker of the state has the others.
    assert [([state], None), ([state], None), ([state], [[12, 6, 1, 0]]), ([state], [[6, 12, 0, 1]])] == ASKED


def test_efforts_of_a_receiver_are_seen_from_the_other_side() -> None:
    plain = dataclasses.replace(RECOVERY, recovery=NO_CHOICE)
    rows = observations(plain, [plain.state_of(plain.n_strokes, 0, 0, 0, 2, 1)])
    assert rows.shape == (1, RALLY_WIDTH)
    assert rows[0, 57:59].tolist() == [1.0, 0.5]
    assert rows[0, SWAP][57:59].tolist() == [0.5, 1.0]
