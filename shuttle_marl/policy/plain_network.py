"""User networks as policies: any function from observations to logits, and files of weights.

Files are those of :func:`save_network`, or archives of Stable-Baselines3, whose pickled parts are never opened; no code in them
is run. They hold a chain of linear layers with one kind of activation, and name it. Weights alone, such as a state dictionary, do
not say what is computed between them, so they are refused. Other networks are played through :func:`from_network` or
``module:attribute``.
"""

import dataclasses
import functools
import importlib
import io
import json
import math
import re
import sys
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt
from safetensors.numpy import save

from shuttle_marl.base.arrays import F64, I32, Bools
from shuttle_marl.base.errors import described
from shuttle_marl.base.extras import install_hint
from shuttle_marl.base.files import parsed, problem, read_file, replace_file
from shuttle_marl.base.tensor_files import read_tensors
from shuttle_marl.game.layout import RALLY_WIDTH, features, with_efforts
from shuttle_marl.game.policy import Policy, PolicyError, States
from shuttle_marl.game.shipped import default_game
from shuttle_marl.game.tables import Game

Inputs = Literal["observation", "tokens"]
"""Input of a network: the vector of ``rally_v0``, or the seven integers of the batched environments."""

FUNCTIONS: Final[dict[str, Callable[[F64], F64]]] = {
    "relu": lambda x: np.maximum(x, 0.0),
    "tanh": np.tanh,
    "sigmoid": lambda x: 0.5 * (1 + np.tanh(0.5 * x)),
    "leaky_relu": lambda x: np.where(x > 0, x, 0.01 * x),
    "elu": lambda x: np.where(x > 0, x, np.expm1(np.minimum(x, 0.0))),
    "silu": lambda x: x * 0.5 * (1 + np.tanh(0.5 * x)),
}
"""Activations between the layers of a file."""
_TORCH_NAMES: Final = dict(zip(("ReLU", "Tanh", "Sigmoid", "LeakyReLU", "ELU", "SiLU"), FUNCTIONS, strict=True))
_REMEDY: Final = (
    f"a file holds Linear modules with one of {', '.join(_TORCH_NAMES)} between them, the same everywhere and with its default "
    "settings; play other networks through from_network and module:attribute"
)
_TOLERANCE: Final = 1e-5  # largest difference between a network and its file
_COMPARED: Final = 512  # number of observations on which they are compared, half of them of the shipped game, half random
_SB3_POLICIES: Final = (
    "stable_baselines3.common.policies",
    "stable_baselines3.dqn.policies",
    "sb3_contrib.common.maskable.policies",
)
"""Modules of the policies of Stable-Baselines3 whose architecture is known."""
_SB3_SETTINGS: Final = ("net_arch", "activation_fn", "ortho_init", "optimizer_class", "optimizer_kwargs")
"""Settings of these policies that are understood here, or have no effect on the trained policy."""
_LARGEST: Final = 1 << 27  # largest size of the weights in an archive [bytes]
_ROWS: Final = 4096  # batch size of the network
_features: Final = functools.lru_cache(maxsize=4)(features)


@dataclasses.dataclass(frozen=True, eq=False)
class NetworkPolicy:
    """Softmax, or argmax, of the logits of the legal strokes.

    Attributes:
        function: from ``[B, 60]`` float32 observations, or ``[B, 7]`` int32 tokens, to ``[B, n]`` logits.
        greedy: always play the legal stroke with the highest output, as for action values.
        masked: whether the mask of the legal strokes precedes the observation in the input.
    """

    function: Callable[[npt.NDArray[Any]], Any]
    inputs: Inputs = "observation"
    greedy: bool = False
    masked: bool = False

    def probabilities(self, states: States) -> F64:
        """``[B, n]`` probabilities of the legal strokes.

        Raises:
            PolicyError: outputs are not finite, or not one for each stroke.
        """
        parts = [self._logits(states.game, states.state[i : i + _ROWS]) for i in range(0, len(states), _ROWS)]
        logits = np.concatenate(parts) if parts else np.empty((0, states.game.n_strokes))
        if self.greedy:
            return np.asarray(np.eye(states.game.n_strokes)[np.where(states.mask, logits, -np.inf).argmax(axis=1)])
        return legal_softmax(logits, states.mask)

    def _logits(self, game: Game, state: I32) -> F64:
        seen: npt.NDArray[Any]
        seen = game.observation(state).astype(np.int32) if self.inputs == "tokens" else with_efforts(game, _features(game), state)
        if self.masked:
            seen = np.concatenate([game.mask(state), seen], axis=1, dtype=np.float32)
        logits = np.asarray(self.function(seen), dtype=np.float64)
        if logits.shape != (len(state), game.n_strokes):
            expected = (len(state), game.n_strokes)
            raise PolicyError(f"the network gave shape {logits.shape}, expected {expected}: a number for each stroke")
        if not np.isfinite(logits).all():
            raise PolicyError(f"the network gives no finite numbers in state: {game.describe(int(state[0]))}")
        return logits


def legal_softmax(logits: F64, mask: Bools) -> F64:
    """``[B, n]`` softmax of ``[B, n]`` logits over the legal strokes."""
    legal = np.where(mask, logits, -np.inf)
    weight = np.exp(legal - legal.max(axis=1, keepdims=True))
    return np.asarray(weight / weight.sum(axis=1, keepdims=True))


def from_network(module: Any, *, inputs: Inputs = "observation", greedy: bool = False) -> Policy:
    """A network as a policy, which can enter the league, be evaluated exactly, and be an opponent.

    Args:
        module: a PyTorch module, or any function on arrays, from a batch of observations to an output for each stroke.
        inputs: ``observation``: ``[B, 60]`` float32, the vector of ``rally_v0``; ``tokens``: ``[B, 7]`` int32.
        greedy: play the legal stroke with the highest output, as for action values; else the softmax over the legal strokes.

    Raises:
        PolicyError: ``inputs`` is neither.
    """
    if inputs not in ("observation", "tokens"):
        raise PolicyError(f"inputs {inputs!r}: expected 'observation' or 'tokens'")
    return NetworkPolicy(_called(module), inputs, greedy)


def _called(module: Any) -> Callable[[npt.NDArray[Any]], Any]:
    """A PyTorch module as a function on arrays; any other function unchanged."""
    torch: Any = sys.modules.get("torch")
    if torch is None or not isinstance(module, torch.nn.Module):
        return module
    parameter = next(iter(module.parameters()), None)

    def call(seen: npt.NDArray[Any]) -> Any:
        given = torch.from_numpy(seen)
        if parameter is not None:
            given = given.to(parameter.device, parameter.dtype if given.is_floating_point() else None)
        training = {part: part.training for part in module.modules()}
        module.eval()
        try:
            with torch.no_grad():
                return module(given).double().cpu().numpy()
        finally:
            for part, before in training.items():
                part.training = before

    return call


def _layers(linear: Sequence[tuple[F64, F64]], function: str, seen: npt.NDArray[Any]) -> F64:
    x = seen.astype(np.float64)
    for i, (weight, bias) in enumerate(linear):
        x = (FUNCTIONS[function](x) if i else x) @ weight.T + bias
    return x


def save_network(module: Any, path: Path | str) -> None:
    """Write a network to a safetensors file, which is played as ``torch:FILE``.

    The policy of the file is compared with that of the network on observations.

    Args:
        module: PyTorch module whose ``Linear`` modules are called in the order in which it holds them, with one kind of module
            between them: ReLU, Tanh, Sigmoid, LeakyReLU, ELU or SiLU with its default settings.

    Raises:
        PolicyError: the network computes something else, which the message names.
        FileWriteError: the file cannot be written.
    """
    linear = [part for part in module.modules() if type(part).__name__ == "Linear"]
    function = next((_TORCH_NAMES[name] for part in module.modules() if (name := type(part).__name__) in _TORCH_NAMES), "relu")
    try:
        arrays: dict[str, npt.NDArray[Any]] = {}
        for i, part in enumerate(linear):
            arrays[f"{i}.weight"] = part.weight.detach().float().cpu().numpy()
            bias = np.zeros(part.out_features) if part.bias is None else part.bias.detach().float().cpu().numpy()
            arrays[f"{i}.bias"] = bias.astype(np.float32)
        saved, width, rng = _network(arrays, function), linear[0].in_features, np.random.default_rng(0)
        seen = (rng.random((_COMPARED, width)) * rng.integers(0, 2, (_COMPARED, width))).astype(np.float32)
        # A rule beside the modules may look at numbers that random ones never are, such as those of a serve, the first state.
        real = features(default_game())
        seen[::2, -RALLY_WIDTH:] = real[np.r_[0, rng.integers(0, len(real), _COMPARED // 2 - 1)]]
        # Several batches, because a network may look at their size or at the number of its calls.
        played = np.concatenate([_called(module)(rows.copy()) for rows in np.split(seen, [1, 8])])
        if not (difference := _difference(saved.function(seen), played)) <= _TOLERANCE:
            raise ValueError(
                f"its Linear modules and activations alone play another policy, with a difference of {difference:.2g}"
            )
    except Exception as error:  # of any type, from a network that does not take such a batch
        reason = error if type(error) is ValueError else f"called with its observations, it raised {described(error)}"
        raise PolicyError(f"no file of this network plays the same: {reason}; {_REMEDY}") from error
    replace_file(Path(path), save(arrays, metadata={"network": json.dumps({"function": function})}))


def _difference(a: F64, b: F64) -> float:
    """Largest difference between two policies, of a probability or of a logit relative to the largest one.

    Args:
        a, b: their ``[B, n]`` logits; a number that is the same for all strokes makes no difference.
    """
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        return math.inf
    a, b = (logits - logits.max(axis=1, keepdims=True) for logits in (a, b))
    legal = np.ones(a.shape, dtype=np.bool_)
    probability = np.abs(legal_softmax(a, legal) - legal_softmax(b, legal)).max()
    return float(max(probability, np.abs(a - b).max() / max(1.0, np.abs(a).max())))


def load_weights(path: Path) -> Policy:
    """The policy in a file of :func:`save_network`.

    Raises:
        PolicyError: the file does not exist, or is no such file; weights alone do not say what is computed between them.
    """
    try:
        metadata, arrays = read_tensors(path)
        about = parsed(metadata.get("network", "null"))
        if not isinstance(about, dict):
            raise ValueError("weights alone, without the name of their activation function")
        return _network(arrays, about.get("function"))
    except (OSError, ValueError) as error:
        raise PolicyError(
            f"{path}: no network that can be played ({problem(error)}); save_network writes one from a module, into which "
            "weights such as a state dictionary are loaded"
        ) from error


def from_sb3(path: Path | str) -> Policy:
    """The policy in an archive that Stable-Baselines3 or sb3-contrib saved: PPO, MaskablePPO, A2C or DQN on ``Rally-v0``.

    Only the weights and the settings stored as text are read. The activation is the one that the archive names, or the default of
    the library. DQN plays the stroke with the highest value. The agent must have seen the observations of the environment: those
    that a wrapper changed within the same bounds leave no trace in the archive.

    Args:
        path: the archive, as ``model.save(path)`` writes it.

    Raises:
        PolicyError: the file does not exist, the policy is not a chain of layers of the library, or ``VecNormalize`` or another
            wrapper changed the observations.
    """
    path = Path(path)
    try:
        with zipfile.ZipFile(io.BytesIO(read_file(path, _LARGEST))) as archive:
            for name in ("policy.pth", "data"):
                if (size := archive.getinfo(name).file_size) > _LARGEST:
                    raise ValueError(f"{size:,} bytes in {name}")
            arrays = _state_dictionary(archive.read("policy.pth"))
            settings = parsed(archive.read("data").decode())
        values = settings["policy_class"]["__module__"] == "stable_baselines3.dqn.policies"
        prefix, rest = (
            ("q_net.q_net.", ["q_net_target."]) if values else ("mlp_extractor.policy_net.", ["mlp_extractor.value_net."])
        )
        names = [f"{prefix}{2 * i}" for i in range(sum(f"{prefix}{2 * i}.weight" in arrays for i in range(len(arrays))))]
        if not values:
            names, rest = [*names, "action_net"], [*rest, "value_net."]
        chain = {name: array for name, array in arrays.items() if not name.startswith(tuple(rest))}
        return _network(chain, _sb3_function(settings, "relu" if values else "tanh"), names, greedy=values)
    except (OSError, ValueError, LookupError, TypeError, AttributeError, zipfile.BadZipFile, zlib.error, RuntimeError) as error:
        raise PolicyError(
            f"{path}: no archive of Stable-Baselines3 that can be played ({problem(error)}); play others through module:attribute"
        ) from error


def _sb3_function(settings: Any, default: str) -> str:
    """The activation in the settings of an archive."""
    if (module := settings["policy_class"]["__module__"]) not in _SB3_POLICIES:
        raise ValueError(f"a policy class of {module!r:.100}, expected one of {', '.join(_SB3_POLICIES)}")
    chosen = {name: value for name, value in settings["policy_kwargs"].items() if not name.startswith(":")}
    if unknown := set(chosen) - set(_SB3_SETTINGS):
        raise ValueError(f"policy_kwargs {min(unknown)!r:.100}, expected {', '.join(_SB3_SETTINGS)} alone")
    space = settings["observation_space"]
    both = rf"\{{'action_mask': Box\(0, 1, \(\d+,\), int8\), 'observation': Box\(0\.0, 1\.0, \({RALLY_WIDTH},\), float32\)\}}"
    plain = "spaces" not in space and set(space["low"]) <= set("[0. \n]") and set(space["high"]) <= set("[1. \n]")
    if not (plain or re.fullmatch(both, space.get("spaces", ""))) or settings.get("_last_original_obs") is not None:
        raise ValueError("trained on observations that VecNormalize or another wrapper changed")
    if "activation_fn" not in chosen:
        return default
    named = re.fullmatch(r"<class 'torch\.nn\.modules\.activation\.(\w+)'>", chosen["activation_fn"])
    if named is None or named[1] not in _TORCH_NAMES:
        raise ValueError(f"activation_fn {chosen['activation_fn']!r:.100}, expected one of {', '.join(_TORCH_NAMES)}")
    return _TORCH_NAMES[named[1]]


def _state_dictionary(content: bytes) -> dict[str, npt.NDArray[Any]]:
    """Weights by name, read without running code from the file."""
    try:
        torch: Any = importlib.import_module("torch")  # only such files need it
    except ImportError as error:
        raise ValueError(f"reading it needs PyTorch; {install_hint('train')}") from error
    try:
        found = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    except Exception as error:  # of many types, for damaged or hostile files
        raise ValueError(f"not weights alone: {str(error).partition(chr(10))[0]}") from error
    if not isinstance(found, Mapping) or not all(isinstance(value, torch.Tensor) for value in found.values()):
        raise ValueError("no state dictionary")
    for name, value in found.items():
        # A view may repeat the numbers of the file and be much larger.
        if not value.is_floating_point() or value.numel() * value.element_size() > value.untyped_storage().nbytes():
            raise ValueError(f"{str(name)[:100]}: {value.numel():,} {value.dtype} numbers, expected floats that the file holds")
    return {str(name): value.detach().float().numpy() for name, value in found.items()}


def _network(
    arrays: Mapping[str, npt.NDArray[Any]], function: Any, names: Sequence[str] = (), *, greedy: bool = False
) -> NetworkPolicy:
    """The policy of a chain of linear layers.

    Args:
        arrays: weights and biases, of these layers alone.
        function: name of the activation.
        names: names of the layers, from the first to the last; default: their numbers.

    Raises:
        ValueError: the weights form no chain from an observation, the activation is unknown, or a number is not finite.
    """
    if not isinstance(function, str) or function not in FUNCTIONS:
        raise ValueError(f"unknown activation; expected one of {', '.join(FUNCTIONS)}")
    names = names or [str(i) for i in range(max(1, len(arrays) // 2))]
    if wrong := {f"{name}.{part}" for name in names for part in ("weight", "bias")} ^ set(arrays):
        raise ValueError(f"{min(wrong)!r:.100} is missing in a chain of linear layers, or is no part of it")
    layers: list[tuple[F64, F64]] = []
    for name in names:
        weight, bias = (arrays[f"{name}.{part}"].astype(np.float64) for part in ("weight", "bias"))
        if weight.ndim != 2 or bias.shape != weight.shape[:1] or (layers and len(layers[-1][1]) != weight.shape[1]):
            raise ValueError(f"{name} does not fit the layer before")
        if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
            raise ValueError("a weight that is not finite")
        layers.append((weight, bias))
    width, strokes = layers[0][0].shape[1], len(layers[-1][1])
    if width not in (RALLY_WIDTH, RALLY_WIDTH + strokes):
        raise ValueError(
            f"it reads {width} numbers; expected the {RALLY_WIDTH} of an observation, alone or behind a mask of {strokes} strokes"
        )
    return NetworkPolicy(functools.partial(_layers, layers, function), "observation", greedy, masked=width != RALLY_WIDTH)
