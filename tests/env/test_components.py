"""The view of a stroke as four components."""

import numpy as np
import pytest

from shuttle_marl import match_v0, rally_v0
from shuttle_marl.base.errors import ActionError
from shuttle_marl.env.wrappers import component_masks
from shuttle_marl.game.rules import IllegalStrokeError

SIZES = [13, 9, 2, 3]


def parts_of(game, stroke):
    c = game.catalogue
    return np.array([c.shot[stroke], c.area[stroke], c.height[stroke], c.technique[stroke]])


@pytest.mark.parametrize("module", [rally_v0, match_v0])
def test_the_game_is_the_same_as_with_catalogue_indices(module):
    flat, components = module.env(), module.env(action="components")
    game = flat.unwrapped.game
    flat.reset(seed=6)
    components.reset(seed=6)
    rng = np.random.default_rng(0)
    for agent, other in zip(flat.agent_iter(300), components.agent_iter(300), strict=True):
        assert agent == other
        seen, seen_in_parts = flat.last(), components.last()
        assert seen[1:] == seen_in_parts[1:]
        assert (seen[0]["observation"] == seen_in_parts[0]["observation"]).all()
        assert components.observation_space(agent).contains(seen_in_parts[0])
        legal = np.flatnonzero(seen[0]["action_mask"])
        masks = component_masks(seen_in_parts[0]["action_mask"])
        assert [len(m) for m in masks] == SIZES
        allowed = [set(np.flatnonzero(m)) for m in masks]
        occurring = [set(column) for column in np.array([parts_of(game, s) for s in legal]).reshape(-1, 4).T]
        assert allowed == occurring
        if seen[2] or seen[3]:
            flat.step(None)
            components.step(None)
            if not flat.agents:
                flat.reset()
                components.reset()
        else:
            stroke = int(rng.choice(legal))
            flat.step(stroke)
            components.step(parts_of(game, stroke))


@pytest.mark.parametrize("in_catalogue", [False, True])
def test_an_illegal_combination_loses(in_catalogue):
    env = rally_v0.env(action="components")
    env.reset(seed=0)
    game = env.unwrapped.game
    loser = env.agent_selection
    action = tuple(parts_of(game, game.n_strokes - 1)) if in_catalogue else np.argwhere(game.catalogue.by_parts < 0)[0]
    env.step(action)
    assert env.rewards[loser] == -1
    assert sum(env.rewards.values()) == 0
    assert env.infos[loser]["reason"] == "illegal stroke"
    assert env.infos[loser]["stroke"] == (game.catalogue.names[-1] if in_catalogue else None)
    for _ in env.agent_iter():
        assert env.last()[2]
        with pytest.raises(ValueError, match="None"):
            env.step(action)
        env.step(None)
    assert not env.agents


@pytest.mark.parametrize("action", [[13, 0, 0, 0], [0, 0, 0], 3, [0.0, 1.0, 0.0, 0.0], [-1, 0, 0, 0], "push"])
def test_actions_outside_the_space_are_refused(action):
    env = rally_v0.env(action="components")
    env.reset(seed=0)
    with pytest.raises(ActionError, match="expected shot type, area, height and technique") as caught:
        env.step(action)
    assert not isinstance(caught.value, IllegalStrokeError)
