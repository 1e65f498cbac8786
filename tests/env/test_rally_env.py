"""``rally_v0``: the rules of the rally module, one stroke at a time."""

import copy
from typing import Any

import numpy as np
import pytest

from shuttle_marl import rally_v0
from shuttle_marl.base.errors import ActionError
from shuttle_marl.game import default_game
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.rules import OUTCOMES, IllegalStrokeError
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
@pytest.mark.parametrize("seed", range(12))
def test_strokes_are_seen_by_name_and_told_with_their_probabilities(play, seed, game):
    env, own, other = rally_v0.env(game=game), None, None
    told: dict[str, Any] = {}
    good, returned, _ = game.stroke_probabilities()
    for agent, seen, _, over, _, info, action in play(env, seed, policy_seed=seed):
        raw = env.unwrapped
        if told:
            outcome = OUTCOMES[raw.snapshot().strokes[-1].outcome]
            assert info == {**told, "outcome": outcome, "reason": outcome if over else None}
        if not over:
            vector, state = seen["observation"], raw.state_number
            assert (decode(vector[:27]), decode(vector[27:54])) == (own, other)
            efforts = np.array([game.effort(state), game.opponent_effort(state)]) / max(1, game.levels - 1)
            np.testing.assert_allclose(
                vector[54:], [state & 1, state == ROOT, game.duel(state) / 3, *efforts, state >> 1 & 1], 1e-6
            )
            pair, name = game.pair(state, action), game.catalogue.names[action]
            told = {"striker": agent, "stroke": name, "hurried": bool(state >> 1 & 1)}
            told |= {"p_succ": good[pair], "p_ret": returned[pair]}
            own, other = other, name


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
    assert caught.value.stroke == len(names) - 1
    for part in (env.agent_selection, names[-1], env.game.describe(ROOT), names[0]):
        assert part in str(caught.value)


@pytest.mark.parametrize("action", [None, "smash", 1.0, -1, 10_000, np.array([1, 2])])
@pytest.mark.parametrize("make", [rally_v0.env, rally_v0.raw_env])
def test_actions_outside_the_space_are_refused(make, action):
    env = make()
    env.reset(seed=0)
    with pytest.raises(ActionError, match=r"no action .*; expected an integer from 0 to \d+") as caught:
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
