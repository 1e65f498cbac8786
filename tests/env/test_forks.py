"""Copies for planning: fresh luck in the same position; exact copies warn."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from shuttle_marl import match_v0, rally_v0
from shuttle_marl.base.errors import OptionError
from shuttle_marl.env.single import SingleMatchEnv

MAKERS: list[Callable[[], Any]] = [
    rally_v0.raw_env,
    rally_v0.env,
    match_v0.env,
    lambda: match_v0.env(mask="info"),
    lambda: rally_v0.env(action="components"),
]


def some_stroke(env: Any) -> int:
    raw = env.unwrapped
    return int(raw.game.legal_strokes(raw.state_number)[0])


def luck(env: Any, strokes: int = 60) -> list[tuple[Any, ...]]:
    """What happens if both players play the first legal stroke again and again, over episodes."""
    raw, seen = env.unwrapped, []
    for _ in range(strokes):
        raw.step(some_stroke(raw))
        seen.append((raw.infos["player_0"]["outcome"], raw.agent_selection))
        if raw.terminations["player_0"]:
            raw.reset()
    return seen


def in_a_rally(make: Callable[[], Any], seed: int = 3) -> Any:
    env = make()
    env.reset(seed=seed)
    env.unwrapped.step(some_stroke(env))
    return env


@pytest.mark.parametrize("make", MAKERS)
def test_a_fork_is_the_same_position_with_other_luck(make: Callable[[], Any]) -> None:
    env = in_a_rally(make)
    forks = [env.fork(seed) for seed in (0, 0, 1, 3)]  # 3 is the seed of the episode too
    for fork in forks:
        assert type(fork) is type(env)
        assert fork.agent_selection == env.agent_selection
        assert np.array_equal(fork.state(), env.state())
        assert fork.infos.keys() == env.infos.keys()
    assert forks[0].unwrapped.choice_draw() == forks[1].unwrapped.choice_draw() != env.unwrapped.choice_draw()
    before = env.state()
    of_forks = [luck(fork) for fork in forks]
    assert np.array_equal(env.state(), before), "forks are played alone"
    of_env = luck(in_a_rally(make))
    assert of_forks[0] == of_forks[1]
    assert all(a != b for a, b in zip([of_env, *of_forks[1:]], [*of_forks[1:], of_env], strict=True))
    of_forks_of_a_fork = luck(env.fork(0).fork(0))
    assert of_forks_of_a_fork not in (of_forks[0], of_env)
    assert luck(env.fork()) != luck(env.fork()), "without a seed it is random"


def test_a_fork_of_an_opponent_has_other_luck_too() -> None:
    env = SingleMatchEnv(opponent="bc", reward="rally")
    seen, _ = env.reset(seed=5)
    histories = []
    for seed in (0, 0, 1):
        fork, told = env.fork(seed), seen
        history = []
        for _ in range(30):
            told, reward, over, _, info = fork.step(int(told["action_mask"].argmax()))
            history.append((reward, info["stroke"], info["points"]))
            if over:
                break
        histories.append(history)
    assert histories[0] == histories[1] != histories[2]
    assert np.array_equal(env.raw.observe("player_0")["action_mask"], seen["action_mask"])
    assert fork.opponent is env.opponent, "a table takes longer than a rally"


def test_what_a_fork_needs() -> None:
    with pytest.raises(ResetNeeded, match="reset"):
        rally_v0.env().fork(1)
    with pytest.raises(OptionError, match="seed"):
        in_a_rally(rally_v0.env).fork("1")
