"""Modules that importing and playing load."""

import subprocess
import sys

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


def test_importing_the_package_loads_nothing_else():
    loaded = modules_after("import sys, shuttle_marl; print(*sys.modules)")
    assert not {"pettingzoo", "gymnasium", "numpy", "torch"} & loaded


def test_the_environments_are_attributes_of_the_package():
    assert shuttle_marl.rally_v0.__name__ == "shuttle_marl.env.rally_v0"
    assert {"rally_v0", "match_v0", "__version__"} <= set(dir(shuttle_marl))
    with pytest.raises(AttributeError, match="rally_v1"):
        _ = shuttle_marl.rally_v1
