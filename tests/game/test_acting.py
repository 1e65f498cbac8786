"""Actions for observations: whose state is seen, which score, and which action a draw chooses."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from shuttle_marl.game.observation import RALLY_WIDTH, SWAP, observations
from shuttle_marl.game.policy import GamePolicy, PolicyError, States, UniformPolicy, act, drawn_strokes
from shuttle_marl.game.tables import ROOT, Game
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


def test_a_draw_chooses_the_stroke_in_whose_share_it_lies() -> None:
    rows = np.tile(SEEN, (8, 1))
    found = act(Fixed(0.25, 0.5, 0.25), GAME, rows, None, drawing(0.0, 0.2499, 0.25, 0.5, 0.7499, 0.75, 0.8, 0.9999))
    assert np.asarray(found).tolist() == [LEFT, LEFT, MIDDLE, MIDDLE, MIDDLE, RIGHT, RIGHT, RIGHT]
    # A draw of 0 does not choose a stroke that is never played.
    assert act(Fixed(0.0, 0.5, 0.5), GAME, SEEN, None, drawing(0.0)) == MIDDLE


def test_the_last_stroke_may_be_the_only_one() -> None:
    assert act(UniformPolicy(), GAME, observations(GAME, [STATE + 1])[0], None, drawing(0.5)) == GAME.n_strokes - 1


def test_one_observation_has_one_action_and_a_batch_an_array() -> None:
    one = act(Fixed(0.0, 1.0, 0.0), GAME, SEEN, None, drawing(0.5))
    assert (type(one), one) == (int, MIDDLE)
    batch = act(Fixed(0.0, 1.0, 0.0), GAME, SEEN[None], None, drawing(0.5))
    assert np.asarray(batch).tolist() == [MIDDLE]


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


def test_strikers_and_receivers_may_stand_in_one_batch() -> None:
    game, n = RECOVERY, RECOVERY.n_strokes
    state = int(np.flatnonzero(game.playable)[-1])
    rows = np.stack([seen_of(game, state, waits=waits) for waits in (False, True, False)])
    found = act(UniformPolicy(), game, rows, None, drawing(0.999, 0.999, 0.0))
    legal = game.legal_strokes(state)
    people = game.people_positions(np.array([state]))[0]
    assert np.asarray(found).tolist() == [legal[-1], n + int(np.flatnonzero(people)[-1]), legal[0]]
    mask = np.zeros((3, game.n_actions))
    mask[:, [legal[0], n + int(np.flatnonzero(people)[0])]] = 1
    found = act(UniformPolicy(), game, rows, mask, drawing(0.999, 0.999, 0.5))
    assert np.asarray(found).tolist() == [legal[0], n + int(np.flatnonzero(people)[0]), legal[0]]


def test_a_policy_of_a_game_acts_as_the_policy_and_has_its_attributes() -> None:
    fixed = Fixed(0.0, 0.0, 1.0)
    policy = GamePolicy(policy=fixed, game=GAME, name="right")
    assert policy.act(SEEN) == RIGHT
    assert policy.asked is fixed.asked
    assert policy.probabilities(States(game=GAME, state=np.array([STATE]))).tolist() == [[0, 0, 0, 1, 0]]
    with pytest.raises(PolicyError, match="policy 'right' plays none of the allowed strokes"):
        act(policy, GAME, SEEN, np.array([1, 1, 1, 0, 0]), drawing(0.5))
    waiting = GamePolicy(policy=UniformPolicy(), game=RECOVERY)
    states = States(game=RECOVERY, state=np.array([ROOT]))
    assert waiting.positions(states).tolist() == RECOVERY.people_positions(states.state).tolist()


def test_drawn_strokes_are_those_of_rounded_cumulative_probabilities() -> None:
    # Shares of 1/4 and 3/4 are 16384 and 49151 of 65535 draws: 0.25 * 65535 = 16383.75 is rounded up.
    p = np.array([[0.25, 0.75, 0.0], [0.0, 0.5, 1.5]])
    for draw, expected in ((0, [0, 1]), (16383, [0, 1]), (16384, [1, 2]), (65534, [1, 2])):
        assert drawn_strokes(p, np.full(2, draw)).tolist() == expected


def test_efforts_of_a_receiver_are_seen_from_the_other_side() -> None:
    plain = dataclasses.replace(RECOVERY, recovery=None)
    rows = observations(plain, [plain.state_of(plain.n_strokes, 0, 0, 0, 2, 1)])
    assert rows.shape == (1, RALLY_WIDTH)
    assert rows[0, 57:59].tolist() == [1.0, 0.5]
    assert rows[0, SWAP][57:59].tolist() == [0.5, 1.0]
