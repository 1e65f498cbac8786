"""The recipes for other libraries run as they stand on their page."""

import ast
import importlib.util

import pytest

from docs.tools import recipes

NEEDED = {
    "agilerl": ("agilerl", "peft"),
    "jax": ("jax", "optax"),
    "mcts": (),
    "minari": ("minari", "h5py"),
    "open_spiel": ("pyspiel", "tree"),
    "optuna": ("optuna",),
    "own_loop": ("torch",),
    "rllib": ("ray", "tree"),
    "sb3": ("sb3_contrib",),
    "sb3_two": ("sb3_contrib",),
    "supersuit": ("supersuit",),
    "tianshou": ("tianshou",),
    "torchrl": ("torchrl",),
    "wandb": ("wandb",),
}


def test_every_recipe_is_a_program_that_says_what_it_reached() -> None:
    found = recipes.recipes()
    assert set(found) == set(NEEDED)
    for name, code in found.items():
        assert ast.parse(code).body, name
        assert "print(f" in "".join(code.strip().splitlines()[-2:])


@pytest.mark.slow(minutes=True)
# The page of the own loop runs as a whole among the tutorials.
@pytest.mark.parametrize("name", sorted(set(NEEDED) - {"own_loop"}))
def test_a_recipe_runs(name: str) -> None:
    if missing := [library for library in NEEDED[name] if importlib.util.find_spec(library) is None]:
        pytest.skip(f"{', '.join(missing)} is not installed")
    won = recipes.run(name)["rally_win_vs_bc"]
    assert won is None or won > 0.4
