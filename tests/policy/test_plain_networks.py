"""Networks of one's own: any function as a policy, and files of weights that never run anything."""

import io
import json
import pickle
import zipfile
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from sb3_contrib import MaskablePPO
from stable_baselines3 import A2C, DQN, PPO
from torch import nn

from shuttle_marl.game import default_game, observations
from shuttle_marl.game.policy import PolicyError, States, checked_probabilities
from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.policy import from_network, from_sb3, registry, resolve, save_network
from shuttle_marl.policy.registry import resolve_recorded
from tests.exact.exact_games import tiring_game

GAME = default_game()
TIRING = tiring_game()
STATES = States(game=GAME, state=np.flatnonzero(GAME.playable)[::97].astype(np.int32))


def network(game: Any = GAME, hidden: int = 16, function: type[nn.Module] = nn.ReLU, inputs: int = 60) -> nn.Sequential:
    torch.manual_seed(0)
    return nn.Sequential(
        nn.Linear(inputs, hidden), function(), nn.Linear(hidden, hidden), function(), nn.Linear(hidden, game.n_strokes)
    )


def softmax_of(module: nn.Module, states: States) -> np.ndarray:
    with torch.no_grad():
        logits = module(torch.from_numpy(observations(states.game, states.state))).double().numpy()
    weight = np.where(states.mask, np.exp(logits), 0)
    return weight / weight.sum(axis=1, keepdims=True)


def test_a_module_is_a_policy() -> None:
    module = network().train()
    p = checked_probabilities(from_network(module), STATES, "mine")
    assert np.allclose(p, softmax_of(module, STATES), atol=1e-6)
    assert module.training, "its mode is left as it was"
    best = from_network(module, greedy=True).probabilities(STATES)
    assert np.array_equal(best.argmax(axis=1), p.argmax(axis=1))
    assert (best.max(axis=1) == 1).all()


def test_any_function_of_observations_or_tokens() -> None:
    states = States(game=TIRING, state=np.flatnonzero(TIRING.playable).astype(np.int32))
    seen = []

    def function(rows: np.ndarray) -> np.ndarray:
        seen.append(rows)
        return np.zeros((len(rows), TIRING.n_strokes))

    for inputs in ("observation", "tokens"):
        p = from_network(function, inputs=inputs).probabilities(states)
        assert np.array_equal(p, resolve("random", TIRING).probabilities(states))
    assert np.array_equal(np.concatenate(seen[: len(seen) // 2]), observations(TIRING, states.state))
    assert np.array_equal(np.concatenate(seen[len(seen) // 2 :]), TIRING.observation(states.state))
    assert set(observations(TIRING, states.state)[:, -2:].ravel().tolist()) == {0, 0.5, 1}
    with pytest.raises(PolicyError, match="expected 'observation' or 'tokens'"):
        from_network(function, inputs="pixels")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("function", "says"),
    [
        (lambda seen: np.zeros((len(seen), 3)), "a number for each stroke"),
        (lambda seen: np.full((len(seen), GAME.n_strokes), np.nan), "no finite numbers"),
        (lambda seen: 1 / 0, "ZeroDivisionError"),
    ],
)
def test_functions_that_are_no_policy(function: Any, says: str) -> None:
    with pytest.raises(PolicyError, match=says):
        tabulate(from_network(function), GAME)


FUNCTIONS = [nn.ReLU, nn.Tanh, nn.Sigmoid, nn.LeakyReLU, nn.ELU, nn.SiLU]


@pytest.mark.parametrize("function", FUNCTIONS)
def test_a_saved_network_plays_the_same(function: type[nn.Module], tmp_path: Path) -> None:
    module = nn.Sequential(network(function=function), nn.Identity())
    save_network(module, tmp_path / "mine.safetensors")
    p = resolve(f"torch:{tmp_path}/mine.safetensors", GAME).probabilities(STATES)
    assert np.allclose(p, softmax_of(module, STATES), atol=1e-6)
    greedy = resolve(f"torch:{tmp_path}/mine.safetensors@greedy", GAME).probabilities(STATES)
    assert np.array_equal(greedy.argmax(axis=1), p.argmax(axis=1))


def test_a_state_dictionary_plays_the_same(tmp_path: Path) -> None:
    module = network()
    torch.save(module.state_dict(), tmp_path / "mine.pt")
    assert np.allclose(resolve(f"torch:{tmp_path}/mine.pt", GAME).probabilities(STATES), softmax_of(module, STATES), atol=1e-6)


@pytest.mark.parametrize(
    "module",
    [
        nn.Sequential(nn.Conv1d(1, 1, 1)),
        nn.Sequential(nn.Linear(60, 8), nn.Linear(8, 8)),
        nn.Sequential(nn.Linear(60, 8), nn.ReLU()),
        nn.Sequential(nn.Linear(60, 8), nn.ReLU(), nn.Linear(8, 8), nn.Tanh(), nn.Linear(8, 8)),
        nn.Sequential(),
    ],
)
def test_networks_without_a_file_format(module: nn.Module, tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match="has no file format here: expected Linear layers"):
        save_network(module, tmp_path / "mine.safetensors")
    assert not list(tmp_path.iterdir())


class Runs:
    """Something that runs when it is unpickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (Path("ran"),)


def hostile_archive() -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr("policy.pth", pickle.dumps(Runs()))
        archive.writestr(
            "data", json.dumps({"policy_class": {":serialized:": "gASVHgAAAAAAAACMBXBvc2l4lIwGc3lzdGVtlJOUjAR0cnVllIWUUpQu"}})
        )
    return content.getvalue()


@pytest.mark.parametrize(
    ("file", "content", "says"),
    [
        ("mine.pt", pickle.dumps(Runs()), "not weights alone"),
        ("mine.pt", b"", "not weights alone"),
        ("mine.safetensors", b"x" * 100, "not a safetensors file"),
        ("mine.zip", hostile_archive(), "not weights alone"),
        ("mine.zip", b"PK", "no archive of Stable-Baselines3"),
        ("nowhere.pt", None, "No such file"),
        ("nowhere.zip", None, "No such file"),
    ],
    ids=range(7),
)
def test_files_of_others_never_run(
    file: str, content: bytes | None, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if content is not None:
        Path(file).write_bytes(content)
    name = f"{'sb3' if file.endswith('.zip') else 'torch'}:{file}"
    with pytest.raises(PolicyError, match=says):
        resolve(name, GAME)
    assert not Path("ran").exists()
    with pytest.raises(PolicyError, match="not resolved because a file named it"):
        resolve_recorded(name, GAME)


@pytest.mark.parametrize(
    ("state", "says"),
    [
        ({"0.weight": torch.zeros(4, 60), "2.weight": torch.zeros(GAME.n_strokes, 5)}, "does not fit the layer before"),
        ({"0.weight": torch.zeros(GAME.n_strokes, 7)}, "it reads 7 numbers; expected the 60"),
        ({"0.weight": torch.full((GAME.n_strokes, 60), torch.nan)}, "not finite"),
        ({"0.weight": torch.zeros(GAME.n_strokes, 60), "norm": torch.zeros(3)}, "norm is no part of a chain"),
        ({}, "nothing is no part"),
        ([1], "no state dictionary"),
    ],
)
def test_weights_that_are_no_network(state: Any, says: str, tmp_path: Path) -> None:
    torch.save(state, tmp_path / "mine.pt")
    with pytest.raises(PolicyError, match=says):
        resolve(f"torch:{tmp_path}/mine.pt", GAME)


def test_names_want_a_file() -> None:
    for key in ("torch", "sb3"):
        with pytest.raises(PolicyError, match="behind the colon"):
            resolve(key, GAME)
        assert f"{key}:FILE" in registry.forms()


def test_a_network_for_another_game_says_so(tmp_path: Path) -> None:
    save_network(network(TIRING), tmp_path / "mine.safetensors")
    with pytest.raises(PolicyError, match="a number for each stroke"):
        tabulate(resolve(f"torch:{tmp_path}/mine.safetensors", GAME), GAME)


@pytest.mark.parametrize(
    ("algorithm", "mask", "settings"),
    [
        (PPO, "info", {}),
        (A2C, "none", {"policy_kwargs": {"activation_fn": nn.ReLU, "net_arch": [24]}}),
        (DQN, "none", {"policy_kwargs": {"net_arch": [24]}}),
        (MaskablePPO, "observation", {"policy_kwargs": {"activation_fn": nn.ELU}}),
    ],
)
def test_agents_of_stable_baselines_play_as_they_do_there(
    algorithm: Any, mask: str, settings: dict[str, Any], tmp_path: Path
) -> None:
    env = gymnasium.make("shuttle_marl/Rally-v0", opponent="random", game=TIRING, mask=mask)
    kind = "MultiInputPolicy" if mask == "observation" else "MlpPolicy"
    model = algorithm(kind, env, seed=1, device="cpu", **settings)
    model.save(tmp_path / "mine")
    policy = resolve(f"sb3:{tmp_path}/mine.zip", TIRING)
    states = States(game=TIRING, state=np.flatnonzero(TIRING.playable).astype(np.int32))
    seen: Any = torch.from_numpy(observations(TIRING, states.state))
    if mask == "observation":
        seen = {"observation": seen, "action_mask": torch.from_numpy(states.mask.astype(np.int8))}
    with torch.no_grad():
        if algorithm is DQN:
            expected = np.where(states.mask, model.q_net(seen).numpy(), -np.inf)
            assert np.array_equal(policy.probabilities(states).argmax(axis=1), expected.argmax(axis=1))
            return
        p = np.where(states.mask, model.policy.get_distribution(seen).distribution.probs.numpy(), 0)
    assert np.allclose(policy.probabilities(states), p / p.sum(axis=1, keepdims=True), atol=1e-5)
    assert np.array_equal(from_sb3(str(tmp_path / "mine.zip")).probabilities(states), policy.probabilities(states))
