"""Networks of one's own: any function as a policy, and files of weights that never run anything."""

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import hypothesis
import numpy as np
import pytest
import torch
from hypothesis import strategies as st
from safetensors.torch import save_file
from sb3_contrib import MaskablePPO
from stable_baselines3 import A2C, DQN, PPO
from torch import nn

from shuttle_marl.game import default_game, observations
from shuttle_marl.game.policy import PolicyError, States, checked_probabilities, tabulate
from shuttle_marl.policy import from_network, plain_network, registry, resolve, save_network
from shuttle_marl.policy.registry import resolve_recorded
from tests.exact.exact_games import tiring_game

GAME = default_game()
TIRING = tiring_game()
STATES = States(game=GAME, state=np.flatnonzero(GAME.playable)[::97].astype(np.int32))


def network(game: Any = GAME, hidden: int = 16, function: Callable[[], nn.Module] = nn.ReLU, inputs: int = 60) -> nn.Sequential:
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
    p = checked_probabilities(from_network(module), STATES)
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


def test_weights_alone_do_not_say_what_is_between_them(tmp_path: Path) -> None:
    state = network(function=nn.Tanh).state_dict()
    torch.save(state, tmp_path / "mine.pt")
    save_file(state, tmp_path / "mine.safetensors")
    for file, says in (("mine.pt", "not a safetensors file"), ("mine.safetensors", "without the name of their activation")):
        with pytest.raises(PolicyError, match=f"{says}.*save_network writes one from a module"):
            resolve(f"torch:{tmp_path / file}", GAME)


def test_modules_are_left_as_they_were(tmp_path: Path) -> None:
    module = network().train()
    module[1].eval()
    state = torch.get_rng_state()
    save_network(module, tmp_path / "mine.safetensors")
    assert [part.training for part in module] == [True, False, True, True, True]
    assert not any(part._forward_hooks for part in module.modules())
    assert torch.equal(torch.get_rng_state(), state)


@pytest.mark.parametrize("scale", [1, 100])
def test_networks_in_double_precision(scale: float, tmp_path: Path) -> None:
    module = network().double()
    with torch.no_grad():
        [*module.parameters()][-2].mul_(scale)
    save_network(module, tmp_path / "mine.safetensors")
    p = resolve(f"torch:{tmp_path}/mine.safetensors", GAME).probabilities(STATES)
    assert np.allclose(p, from_network(module).probabilities(STATES), atol=1e-5)


class Computed(nn.Module):
    """Layers and what is computed around them."""

    def __init__(self, forward: Callable[[Any, torch.Tensor], Any], **parts: nn.Module) -> None:
        super().__init__()
        self.computed = forward
        for name, part in parts.items():
            setattr(self, name, part)

    def forward(self, x: torch.Tensor) -> Any:
        return self.computed(self, x)


N = GAME.n_strokes
REFUSED: dict[str, tuple[nn.Module, str]] = {
    "slope": (network(function=lambda: nn.LeakyReLU(0.2)), "play another policy, with a difference of"),
    "scaled input": (Computed(lambda s, x: s.fc((x - 0.5) * 10), fc=nn.Linear(60, N)), "play another policy, with a difference"),
    "temperature": (Computed(lambda s, x: s.fc(x) / 0.05, fc=nn.Linear(60, N)), "play another policy, with a difference of"),
    "rule for the serve": (
        Computed(lambda s, x: s.fc(x) + 9 * (x[:, 55:56] == 1) * torch.eye(N)[0], fc=nn.Linear(60, N)),
        "play another policy, with a difference of",
    ),
    "in place": (
        Computed(lambda s, x: s.fc2(s.act(s.fc1(x).mul_(3))), fc1=nn.Linear(60, 8), act=nn.Tanh(), fc2=nn.Linear(8, N)),
        "play another policy, with a difference of",
    ),
    "two": (Computed(lambda s, x: (s.fc(x), x), fc=nn.Linear(60, N)), "called with its observations, it raised AttributeError"),
    "width": (nn.Sequential(nn.Linear(59, N)), "it reads 59 numbers; expected the 60 of an observation"),
    "activation last": (nn.Sequential(nn.Linear(60, 8), nn.ReLU()), "play another policy"),
    "mixed": (nn.Sequential(nn.Linear(60, 8), nn.ReLU(), nn.Linear(8, 8), nn.Tanh(), nn.Linear(8, N)), "play another policy"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_networks_without_a_file_format(name: str, tmp_path: Path) -> None:
    module, says = REFUSED[name]
    with pytest.raises(PolicyError, match=f"{says}.*module:attribute"):
        save_network(module, tmp_path / "mine.safetensors")
    assert not list(tmp_path.iterdir())


class Runs:
    """Something that runs when it is unpickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (Path("ran"),)


@pytest.mark.parametrize(
    ("file", "content", "says"),
    [("mine.pt", pickle.dumps(Runs()), "not a safetensors file"), ("nowhere.pt", None, "No such file")],
    ids=range(2),
)
def test_files_of_others_never_run(
    file: str, content: bytes | None, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if content is not None:
        Path(file).write_bytes(content)
    name = f"torch:{file}"
    with pytest.raises(PolicyError, match=says):
        resolve(name, GAME)
    assert not Path("ran").exists()
    with pytest.raises(PolicyError, match="not resolved because a file named it"):
        resolve_recorded(name, GAME)


WEIGHTS = {"0.weight": torch.zeros(4, 60), "0.bias": torch.zeros(4), "1.weight": torch.zeros(N, 4), "1.bias": torch.zeros(N)}


@pytest.mark.parametrize(
    ("arrays", "about", "says"),
    [
        (
            {**WEIGHTS, "norm": torch.zeros(1)},
            '{"function": "relu"}',
            "'norm' is missing in a chain of linear layers, or is no part",
        ),
        ({"0.weight": torch.zeros(N, 60), "0.bias": torch.zeros(3)}, '{"function": "relu"}', "does not fit the layer before"),
        (
            {"0.weight": torch.zeros(N, 7), "0.bias": torch.zeros(N)},
            '{"function": "relu"}',
            "it reads 7 numbers; expected the 60",
        ),
        ({"0.weight": torch.full((N, 60), torch.nan), "0.bias": torch.zeros(N)}, '{"function": "relu"}', "not finite"),
        (WEIGHTS, '{"function": ["relu"]}', "unknown activation; expected one of relu"),
        (WEIGHTS, '["relu"]', "without the name of their activation"),
        ({}, '{"function": "relu"}', "'0.bias' is missing"),
    ],
)
def test_weights_that_are_no_network(arrays: dict[str, torch.Tensor], about: str, says: str, tmp_path: Path) -> None:
    save_file(arrays, tmp_path / "mine.safetensors", metadata={"network": about})
    with pytest.raises(PolicyError, match=says):
        resolve(f"torch:{tmp_path}/mine.safetensors", GAME)


def test_softmax_is_over_legal_strokes() -> None:
    """Weights 1, 2 and 4 without the last, and 2 and 6 with the largest logit beyond the range of exponentials."""
    logits = np.log([[1.0, 2.0, 4.0, 9.0], [2.0, 6.0, 5.0, 1.0]]) + np.array([[0.0], [5000.0]])
    found = plain_network.legal_softmax(logits, np.array([[True, True, True, False], [True, True, False, False]]))
    np.testing.assert_allclose(found, [[1 / 7, 2 / 7, 4 / 7, 0], [0.25, 0.75, 0, 0]], rtol=1e-9)


def test_names_want_a_file() -> None:
    with pytest.raises(PolicyError, match="behind the colon"):
        resolve("torch", GAME)
    assert "torch:FILE" in registry.forms()


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
    actor = (
        model.q_net.q_net if algorithm is DQN else nn.Sequential(model.policy.mlp_extractor.policy_net, model.policy.action_net)
    )
    save_network(actor, tmp_path / "mine.safetensors")
    policy = resolve(f"torch:{tmp_path}/mine.safetensors", TIRING)
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


KINDS: dict[str, Callable[[int], nn.Module]] = {
    **{kind.__name__: lambda _, kind=kind: kind() for kind in FUNCTIONS},  # type: ignore[misc]
    "Linear without bias": lambda width: nn.Linear(width, width, bias=False),
    "ReLU in place": lambda _: nn.ReLU(inplace=True),
    "ELU in place": lambda _: nn.ELU(inplace=True),
    **{f"LeakyReLU({slope})": lambda _, slope=slope: nn.LeakyReLU(slope) for slope in (-0.5, 0.2)},  # type: ignore[misc]
    "ELU(2)": lambda _: nn.ELU(2.0),
    **{
        kind: lambda _, kind=kind: getattr(nn, kind)()  # type: ignore[misc]
        for kind in ("GELU", "Softplus", "RReLU", "PReLU", "Dropout", "AlphaDropout", "Identity", "Flatten")
    },
    "Softmax": lambda _: nn.Softmax(-1),
    "LayerNorm": nn.LayerNorm,
    "BatchNorm1d": lambda width: nn.BatchNorm1d(width).eval(),
    "weight_norm": lambda width: nn.utils.parametrizations.weight_norm(nn.Linear(width, width)),
    "residual": lambda width: Computed(lambda s, x: x + s.fc(x), fc=nn.Linear(width, width)),
    "shift": lambda _: Computed(lambda _, x: x - 0.5),
    "scale in place": lambda _: Computed(lambda _, x: x.mul_(3)),
    "function": lambda _: Computed(lambda _, x: torch.relu(x)),
    "unused head": lambda width: Computed(
        lambda s, x: [s.fc(x), s.value(x)][0], value=nn.Linear(width, 1), fc=nn.Linear(width, width)
    ),
    "size of the batch": lambda _: Computed(lambda _, x: x if len(x) > 1 else -x),
    "branch": lambda _: Computed(lambda _, x: x if x.mean() > 0.1 else -x),
    "centred over the batch": lambda _: Computed(lambda _, x: x - x.mean(0)),
    "noise": lambda _: Computed(lambda _, x: x + torch.randn_like(x)),
    "ReLU of another class": lambda _: type("ReLU", (nn.ReLU,), {"forward": lambda _, x: x.abs()})(),
}
ACTIVATIONS = (*(kind.__name__ for kind in FUNCTIONS), "ReLU in place", "ELU in place")


@hypothesis.given(
    function=st.sampled_from(ACTIVATIONS) | st.sampled_from(sorted(KINDS)),
    layers=st.lists(st.sampled_from(("Linear without bias", "unused head")), max_size=2),
    inserted=st.lists(st.tuples(st.integers(0, 6), st.sampled_from(sorted(KINDS))), max_size=2),
    reused=st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), max_size=1),
    scale=st.sampled_from([1.0, 6.0]),
)
@hypothesis.settings(max_examples=150)
def test_any_network_is_saved_as_it_plays_or_refused(
    function: str,
    layers: list[str],
    inserted: list[tuple[int, str]],
    reused: list[tuple[int, int]],
    scale: float,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    torch.manual_seed(0)
    width, path = 12, tmp_path_factory.getbasetemp() / "any.safetensors"
    parts = [nn.Linear(60, width), KINDS[function](width)]
    for layer in layers:
        parts += [KINDS[layer](width), KINDS[function](width)]
    for place, kind in inserted:
        parts.insert(1 + place, KINDS[kind](width))
    for place, part in reused:
        parts.insert(1 + place, parts[1 + part % (len(parts) - 1)])
    module = nn.Sequential(*parts, nn.Linear(width, TIRING.n_strokes))
    with torch.no_grad():
        for weight in module.parameters():
            weight.mul_(scale)
    try:
        save_network(module, path)
    except PolicyError:
        hypothesis.event("refused")
        return
    hypothesis.event("saved")
    states = States(game=TIRING, state=np.flatnonzero(TIRING.playable).astype(np.int32))
    p = resolve(f"torch:{path}", TIRING).probabilities(states)
    assert np.abs(p - from_network(module).probabilities(states)).max() <= 1e-5
