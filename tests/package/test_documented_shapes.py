"""Shapes in docstrings are those of what the documented functions return and of what the documented attributes hold."""

import functools
import inspect
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
import torch

from shuttle_marl.game import load_game
from shuttle_marl.game.layout import features, observations, stroke_features
from shuttle_marl.game.policy import States, tabulate
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel import RallyBatch
from shuttle_marl.policy.registry import resolve
from shuttle_marl.training import PPOConfig
from shuttle_marl.training.learner import Learner, RallyCollector
from shuttle_marl.training.networks import Observer, decision_masks, decision_observations
from shuttle_marl.training.ppo import PPO

SHAPE = re.compile(r"``\[([^`]*)\]``")
Sizes = dict[str, int]
GAMES = ("default", "default:recovery")


@functools.cache
def game_of(name: str) -> Game:
    return load_game(name)


def sizes_of(game: Game) -> Sizes:
    """Sizes whose names the docstrings share; all others are equal within one docstring."""
    sizes = {"n": game.n_strokes, "E": len(game.edge_own), "V": len(game.reply_edge), "L": game.levels, "S": game.n_states}
    return sizes | {"P": game.n_pairs, "base pairs": game.n_base_pairs, "base states": game.n_base_states}


def check(text: str, value: Any, sizes: Sizes, what: str, free: Sizes | None = None) -> None:
    """Check the shape of a value against the content of its brackets."""
    free, shape = {} if free is None else free, tuple(value.shape)
    dimensions = [part.strip() for part in text.split(",")]
    if dimensions[0] == "...":
        dimensions = dimensions[1:]
        shape = shape[len(shape) - len(dimensions) :]
    assert len(shape) == len(dimensions), f"{what}: [{text}] of shape {shape}"
    for dimension, size in zip(dimensions, shape, strict=True):
        name, _, more = dimension.partition(" + ")
        known = int(name) if name.isdecimal() else sizes.get(name, None)
        expected = (free.setdefault(name, size - int(more or 0)) if known is None else known) + int(more or 0)
        assert size == expected, f"{what}: [{text}] of shape {shape}, {dimension} is {expected}"


def of_game(documentation: str, game: Game) -> str:
    """The first shape of a docstring, or the one that it has with recovery."""
    found = SHAPE.search(documentation)
    assert found, documentation
    with_recovery = re.search(r"with recovery[^`]*``\[([^`]*)\]``", documentation, re.IGNORECASE)
    return with_recovery[1] if with_recovery and game.hides else found[1]


def entries(documentation: str) -> Iterator[tuple[str, str]]:
    """Name and text of each attribute in a docstring."""
    section = inspect.cleandoc(documentation).partition("Attributes:\n")[2].partition("\n\n")[0]
    for name, text in re.findall(r"^    (\w+): (.*(?:\n {5,}.*)*)", section, re.MULTILINE):
        if SHAPE.match(text):
            yield name, text


def check_attributes(value: Any, game: Game, without: str | None = None) -> int:
    """Check the attributes and the properties of an object that are documented with a shape; their number."""
    checked, sizes = 0, sizes_of(game)
    for kind in type(value).__mro__:
        free: Sizes = {}
        for name, text in entries(kind.__dict__.get("__doc__") or ""):
            if getattr(value, name) is not None:
                check(of_game(text, game), getattr(value, name), sizes, f"{kind.__name__}.{name}", free)
                checked += 1
        properties = {name: of for name, of in vars(kind).items() if isinstance(of, property | functools.cached_property)}
        for name, member in properties.items():
            found = SHAPE.match(member.__doc__ or "")
            if found and name != without and (size := getattr(value, name)) is not None:
                check(found[1], size, sizes, f"{kind.__name__}.{name}")
                checked += 1
    return checked


def check_returned(function: Any, arguments: Sequence[Any], game: Game, owner: Any = None) -> None:
    call = getattr(owner, function) if owner is not None else function
    check(of_game(call.__doc__, game), call(*arguments), sizes_of(game), getattr(call, "__qualname__", str(function)))


@pytest.mark.parametrize("name", GAMES)
def test_tables_of_a_game_have_the_documented_shapes(name: str) -> None:
    game = game_of(name)
    states, pairs = np.array([0, 4, 6, 9, 10]), np.array([0, 1, 2, 3])
    assert check_attributes(game, game) >= 20
    assert check_attributes(game.catalogue, game) >= 8
    for function in ("observation", "mask"):
        check_returned(function, [states], game, game)
    for function in ("limits_of", "limit_row", "outcome_probabilities", "hurry_of", "arrivals"):
        check_returned(function, [pairs], game, game)
    for function in ("sum_by_state", "normalized"):
        check_returned(function, [np.ones(game.n_pairs)], game, game)
    check_returned("of_pairs", [np.ones(game.n_states)], game, game)
    if game.hides:
        assert check_attributes(game.recovery, game) == 2
        check_returned("people_positions", [states], game, game)


@pytest.mark.parametrize("name", GAMES)
def test_policies_and_observations_have_the_documented_shapes(name: str) -> None:
    game = game_of(name)
    policy, states = tabulate(resolve("bc", game), game), np.array([0, 4, 6, 9, 10])
    assert check_attributes(policy, game, None if game.hides else "waiting_table") >= 2
    check_returned("probabilities", [States(game=game, state=states)], game, policy)
    check_returned("pair_probabilities", [], game, policy)
    check_returned(stroke_features, [game], game)
    check_returned(features, [game], game)
    check_returned(observations, [game, states], game)
    for function in (decision_observations, decision_masks):
        check_returned(function, [game, states], game)


@pytest.mark.parametrize("name", GAMES)
def test_batches_have_the_documented_shapes(name: str) -> None:
    game = game_of(name)
    rallies = RallyBatch(game, batch=5, seed=1)
    seen = rallies.new_observations()
    stroke, position = rallies.random_actions()
    rallies.step(stroke, position if game.hides else None, observed=seen)
    assert check_attributes(seen, game) == 2


@pytest.mark.parametrize("name", GAMES)
def test_strokes_of_training_have_the_documented_shapes(name: str) -> None:
    game, calls = game_of(name), list[Mapping[str, Any]]()
    config = PPOConfig(opponent=("self",), batch=64, width=4, game=name)
    learner = PPO(config, game)

    def predict(observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        logits, values = learner.predict(observation)
        calls.append({"observation": observation, "logits": logits, "values": values})
        return logits, values

    data = RallyCollector(config, game, (), predict, distinct=True).collect()
    free, sizes = dict[str, int](), sizes_of(game)
    documented = re.findall(r"``(\w+)``,? ``\[([^`]*)\]``", RallyCollector.collect.__doc__ or "")
    with_recovery = re.search(r"positions, ``\[([^`]*)\]`` and ``\[([^`]*)\]``", RallyCollector.collect.__doc__ or "")
    assert with_recovery
    replaced = dict(zip(("observation", "action_mask"), with_recovery.groups(), strict=True)) if game.hides else {}
    assert {entry for entry, _ in documented} <= {*data.keys()}
    for entry, text in documented:
        check(replaced.get(entry, text), data[entry], sizes, f"RallyCollector.collect: {entry}", free)
    states = torch.tensor([0, 4, 6])
    observer = Observer(game, "cpu")
    check_returned("observations", [states], game, observer)
    logits, values, observation, *recovered = SHAPE.findall(Learner.predict.__doc__ or "")
    if game.hides:
        logits, observation = recovered
    for call in calls:
        free = {}
        check(observation, call["observation"], sizes, "observation", free)
        check(logits, call["logits"], sizes, "logits", free)
        check(values, call["values"], sizes, "values", free)
    assert calls
