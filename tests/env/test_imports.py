"""Modules that importing and playing load."""

import functools
import inspect
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium
import pytest

import shuttle_marl

PLAY = """
import sys
import numpy as np
from shuttle_marl import match_v0, rally_v0
for module in (rally_v0, match_v0):
    env = module.env(render_mode="ansi")
    env.reset(seed=0)
    for agent in env.agent_iter(50):
        seen, _, terminated, truncated, _ = env.last()
        env.step(None if terminated or truncated else int(np.flatnonzero(seen["action_mask"])[0]))
    env.render()
print(*sys.modules)
"""


def modules_after(code: str) -> set[str]:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return {name.split(".")[0] for name in done.stdout.split()}


def test_playing_needs_neither_torch_nor_pygame():
    loaded = modules_after(PLAY)
    assert {"pettingzoo", "numpy", "shuttle_marl"} <= loaded
    assert not {"torch", "torchrl", "tensordict", "pygame", "numba", "pyarrow"} & loaded


def test_slips_are_answered_with_what_was_meant():
    slip: dict[str, Any] = {"oponent": "bc"}
    with pytest.raises(AttributeError, match="'resovle'; did you mean resolve"):
        _ = shuttle_marl.resovle
    for module in (shuttle_marl.rally_v0, shuttle_marl.match_v0):
        with pytest.raises(AttributeError, match="strike in turn"):
            _ = module.parallel_env
    vector = functools.partial(gymnasium.make_vec, "shuttle_marl/Match-v0", num_envs=2)
    for make in (functools.partial(gymnasium.make, "shuttle_marl/Rally-v0"), vector, shuttle_marl.PPOConfig):
        with pytest.raises(TypeError, match="'oponent'; did you mean opponent"):
            make(**slip)
    with pytest.raises(TypeError, match="there are server, game"):
        shuttle_marl.rally_v0.env(opponent="bc")
    assert "server" in inspect.signature(shuttle_marl.rally_v0.raw_env).parameters


WITHOUT_TORCH = """
import sys
sys.modules["torch"] = None
for statement in sys.argv[1:]:
    try:
        exec(statement)
    except ModuleNotFoundError as error:
        print(error)
"""


def test_without_torch_the_extra_is_named():
    statements = [
        "from shuttle_marl import RallyEnv",
        "from shuttle_marl import train",
        "import shuttle_marl.env.batched",
        "from shuttle_marl.training import train",
    ]
    done = subprocess.run([sys.executable, "-c", WITHOUT_TORCH, *statements], capture_output=True, text=True, check=True)
    assert done.stdout.count("this needs torch, which is not installed; `make install`") == len(statements)


def test_the_api_page_lists_every_public_name():
    page = (Path(__file__).parents[2] / "docs" / "api.md").read_text(encoding="utf-8")
    cells = [line.split("|")[1] for line in page.splitlines() if line.startswith("| `")]
    assert {name for cell in cells for name in re.findall(r"`(\w+)`", cell)} == set(shuttle_marl.__all__) - {"__version__"}
