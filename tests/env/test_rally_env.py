"""``rally_v0``: the rules of the rally module, one stroke at a time."""

import copy

import numpy as np
import pytest

from shuttle_marl import rally_v0
from shuttle_marl.base.errors import ActionError
from shuttle_marl.game import default_game
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.draws import draw, outcome_draw, stream
from shuttle_marl.game.rules import FAULT, OUTCOMES, WINNER, IllegalStrokeError, strike
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES
from shuttle_marl.game.tables import ROOT
from tests.exact.exact_games import tiring_game

AGENTS = ("player_0", "player_1")


def decode(part):
    """Name of the stroke behind 27 numbers, None for zeros."""
    if not part.any():
        return None
    assert part.sum() == 4
    words = []
    for vocabulary in (SHOTS, AREAS, HEIGHTS, TECHNIQUES):
        one_hot, part = part[: len(vocabulary)], part[len(vocabulary) :]
        words.append(vocabulary[int(one_hot.argmax())])
    return ":".join(words)


@pytest.mark.parametrize("game", [default_game(), tiring_game()], ids=["default", "tiring"])
@pytest.mark.parametrize("seed", range(4))
def test_outcomes_equal_the_batched_rules_on_the_same_draws(play, seed, game):
    env = rally_v0.env(game=game)
    good, returned, _ = game.stroke_probabilities()
    for episode in range(9):
        key = stream(seed, episode)
        striker = int(draw(key, 0)[0] >> np.uint64(24)) & 1
        state, count, own, other = ROOT, 0, None, None
        expected_reward = 0.0
        for agent, seen, reward, terminated, truncated, info, action in play(
            env, seed if episode == 0 else None, policy_seed=seed
        ):
            assert not truncated
            assert info == env.infos[agent]
            if terminated:
                assert reward == (expected_reward if agent == AGENTS[striker] else -expected_reward)
                continue
            assert agent == AGENTS[striker]
            assert reward == 0
            vector = seen["observation"]
            assert (decode(vector[:27]), decode(vector[27:54])) == (own, other)
            highest = max(1, game.levels - 1)
            efforts = game.effort(state) / highest, game.opponent_effort(state) / highest
            rest = [state & 1, state == ROOT, game.duel(state) / 3, *efforts, state >> 1 & 1]
            np.testing.assert_allclose(vector[54:], rest, rtol=1e-6)
            assert (seen["action_mask"] == game.mask(np.array(state))).all()
            pair = game.pair(np.array([state]), np.array([action]))
            u = outcome_draw(draw(key, count))
            outcome, following = strike(game, np.array([state]), pair - game.pair_start[state], u)
            facts = {
                "striker": agent,
                "stroke": game.catalogue.names[action],
                "hurried": bool(state >> 1 & 1),
                "p_succ": good[pair][0],
                "p_ret": returned[pair][0],
                "outcome": OUTCOMES[outcome[0]],
                "reason": OUTCOMES[outcome[0]] if following[0] < 0 else None,
            }
            own, other = other, facts["stroke"]
            state, count, striker = int(following[0]), count + 1, 1 - striker
            # The reward of who would be next, where the rally ends here.
            expected_reward = {FAULT: 1.0, WINNER: -1.0}.get(int(outcome[0]), 0.0)
            last = facts
        assert env.unwrapped.infos == {}
        assert info == last


def test_observations_are_copies(play):
    env = rally_v0.env()
    for agent, seen, *_ in play(env, 1):
        before = copy.deepcopy(seen)
        seen["observation"][:] = 7
        seen["action_mask"][:] = 7
        again = env.observe(agent)
        assert (again["observation"] == before["observation"]).all()
        assert (again["action_mask"] == before["action_mask"]).all()
        seen["action_mask"][:] = before["action_mask"]


def test_without_a_seed_one_is_drawn_and_kept(play):
    env, again = rally_v0.env(), rally_v0.env()
    strokes = [s[-1] for s in play(env)]
    assert [s[-1] for s in play(again, env.unwrapped.last_seed)] == strokes
    assert rally_v0.raw_env().last_seed is None
    env.reset()
    assert env.unwrapped.episode == 1


def test_the_refusal_of_a_stroke_lists_legal_ones():
    env = rally_v0.raw_env()
    env.reset(seed=3)
    names = env.game.catalogue.names
    with pytest.raises(IllegalStrokeError) as caught:
        env.step(len(names) - 1)
    message = str(caught.value)
    assert caught.value.stroke == len(names) - 1
    for part in (env.agent_selection, names[-1], env.game.describe(ROOT), names[0], "action_mask"):
        assert part in message
    assert "more" not in message
    env.step(0)
    while not any(env.terminations.values()):
        legal = env.game.legal_strokes(env.state_number)
        with pytest.raises(IllegalStrokeError, match=f"and {len(legal) - 20} more" if len(legal) > 20 else "Legal"):
            env.step(0)
        env.step(legal[0])


@pytest.mark.parametrize("action", [None, "smash", 1.0, -1, 10_000, np.array([1, 2])])
@pytest.mark.parametrize("make", [rally_v0.env, rally_v0.raw_env])
def test_actions_outside_the_space_are_refused(make, action):
    env = make()
    env.reset(seed=0)
    with pytest.raises(ActionError, match=r"is not a stroke; expected an integer from 0 to \d+") as caught:
        env.step(action)
    assert not isinstance(caught.value, IllegalStrokeError)


@pytest.mark.parametrize("kind", [int, np.int8, np.int64, np.uint8, np.array])
def test_all_kinds_of_integers_are_actions(kind):
    env = rally_v0.env()
    env.reset(seed=0)
    env.step(kind(1))
    assert env.infos["player_0"]["stroke"] == env.unwrapped.game.catalogue.names[1]


def test_the_order_of_calls_is_checked():
    env = rally_v0.env()
    for early in (env.last, env.agent_iter, env.render, lambda: env.step(0), lambda: env.observe("player_0")):
        with pytest.raises(AssertionError, match="before"):
            early()
    env.reset(seed=0)
    with pytest.raises(AssertionError, match="need to call step"):
        list(env.agent_iter())
