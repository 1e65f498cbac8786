"""Where a receiver waits is hidden: what the striker gets is the same whatever it is.

A position may show in what follows only by the outcome of the stroke that it decides. So two copies of an episode in which a
receiver waits at different places are told alike, up to a different outcome.
"""

import copy
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from shuttle_marl import match_v0, rally_v0
from shuttle_marl.env.single import SingleMatchEnv, SingleRallyEnv
from tests.recovery import Prefers, small_recovery_game

GAME = small_recovery_game()


def received(env: Any, *, picture: bool = False) -> list[Any]:
    """Everything that the environment of two agents gives to the agent to move, and to anybody who looks on."""
    raw = env.unwrapped
    found = [env.last(), [env.observe(agent) for agent in env.possible_agents], env.state(), env.infos, env.rewards]
    found += [raw.strokes, raw.state_number, raw.choice_draw(), raw.score_of(0), raw.chooses_position]
    snapshot = raw.snapshot()
    found += [[value for name, value in vars(snapshot).items() if name != "game"], raw.agents, raw.terminations]
    raw.render_mode = "rgb_array" if picture else "ansi"
    return [*found, env.render()]


def same(a: Any, b: Any) -> bool:
    """Whether nested containers have the same content."""
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b)
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return bool(a == b)


@pytest.mark.parametrize(
    "make",
    [
        rally_v0.raw_env,
        rally_v0.env,
        match_v0.env,
        lambda **options: match_v0.env(reward="rally", mask="info", info="full", **options),
        lambda **options: rally_v0.env(action="components", **options),
    ],
)
def test_what_is_received_does_not_depend_on_the_position(make: Callable[..., Any]) -> None:
    env, rng, told = make(game=GAME, render_mode="ansi"), np.random.default_rng(1), [0, 0]
    env.reset(seed=5)
    for count in range(200):
        raw = env.unwrapped
        if raw.terminations["player_0"]:
            env.reset()
            continue
        legal = np.flatnonzero(raw.observe(raw.agent_selection)["action_mask"])
        if not raw.chooses_position:
            raw.step(int(rng.choice(legal)))
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # exact copies have the luck of the original: here they must
            twin = copy.deepcopy(env)
        other = twin.unwrapped
        first, second = rng.choice(legal, 2, replace=False).tolist()
        raw.step(first)
        other.step(second)
        assert same(received(env, picture=count % 50 == 0), received(twin, picture=count % 50 == 0))
        assert same(received(env.fork(count)), received(twin.fork(count)))
        stroke = int(rng.choice(np.flatnonzero(raw.observe(raw.agent_selection)["action_mask"])))
        raw.step(stroke)
        other.step(stroke)
        alike = raw.infos["player_0"]["outcome"] == other.infos["player_0"]["outcome"]
        told[alike] += 1
        if alike and raw.snapshot().reason is None:
            assert same(received(env), received(twin))
    assert min(told) > 0


@pytest.mark.parametrize("make", [SingleRallyEnv, SingleMatchEnv])
def test_against_an_opponent_only_the_outcome_tells(make: Callable[..., Any]) -> None:
    envs = [make(opponent=Prefers(weights), game=GAME) for weights in ((9, 1, 1) * 3, (1, 1, 9) * 3)]
    rng, differ = np.random.default_rng(2), 0
    for seed in range(120):
        told = [env.reset(seed=seed) for env in envs]
        for _ in range(40):
            raws = [env.unwrapped.raw for env in envs]
            assert same(*told)
            if raws[0].terminations["player_0"]:
                break
            legal = np.flatnonzero(raws[0].observe(raws[0].agent_selection)["action_mask"])
            action = int(rng.choice(legal))
            told = [env.step(action) for env in envs]
            first, second = ([(one.stroke, one.outcome) for one in raw.snapshot().strokes] for raw in raws)
            if first != second:
                differ += 1
                break
    assert differ > 5
