"""User networks as policies: any function from observations to logits, and files of weights.

Files are safetensors, state dictionaries of PyTorch (read with ``weights_only``), or archives of Stable-Baselines3, whose pickled
parts are never opened; no code in them is run. They must hold a chain of linear layers with one kind of activation. Other
networks are played through :func:`from_network` or ``module:attribute``.
"""

import dataclasses
import functools
import importlib
import io
import json
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
from shuttle_marl.base.extras import install_hint
from shuttle_marl.base.files import problem, read_file, replace_file
from shuttle_marl.base.tensor_files import parsed, read_tensors
from shuttle_marl.game.observation import RALLY_WIDTH, features, with_efforts
from shuttle_marl.game.policy import Policy, PolicyError, States
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
_NO_EFFECT: Final = ("Dropout", "Identity", "Flatten")
"""Modules without effect in evaluation mode."""
_LARGEST: Final = 1 << 27
"""Largest size of the weights in an archive [bytes]."""
_ROWS: Final = 4096
"""Batch size of the network."""
_features: Final = functools.lru_cache(maxsize=4)(features)


@dataclasses.dataclass(frozen=True, eq=False)
class NetworkPolicy:
    """Softmax, or argmax, of the logits of the legal strokes.

    Attributes:
        function: from ``[B, 60]`` float32 observations, or ``[B, 7]`` int32 tokens, to ``[B, n]`` logits.
        inputs: which of the two.
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
        training = module.training
        module.eval()
        try:
            with torch.no_grad():
                return module(given if parameter is None else given.to(parameter.device)).double().cpu().numpy()
        finally:
            module.train(training)

    return call


@dataclasses.dataclass(frozen=True, eq=False)
class Layers:
    """A chain of linear layers.

    Attributes:
        linear: weights ``[out, in]`` and biases ``[out]``.
        function: name of the activation, see :data:`FUNCTIONS`.
    """

    linear: tuple[tuple[F64, F64], ...]
    function: str

    def __call__(self, seen: npt.NDArray[Any]) -> F64:
        """``[B, out]`` of the last layer."""
        x = seen.astype(np.float64)
        for i, (weight, bias) in enumerate(self.linear):
            x = (FUNCTIONS[self.function](x) if i else x) @ weight.T + bias
        return x


def save_network(module: Any, path: Path) -> None:
    """Write a network to a safetensors file, which is played as ``torch:FILE``.

    Args:
        module: ``torch.nn.Sequential`` of ``Linear`` with one kind of function between them: ReLU, Tanh, Sigmoid, LeakyReLU, ELU
            or SiLU.
        path: the file.

    Raises:
        PolicyError: the network has other modules.
        FileWriteError: the file cannot be written.
    """
    parts = [part for part in module.modules() if not next(part.children(), None) and type(part).__name__ not in _NO_EFFECT]
    kinds = [type(part).__name__ for part in parts]
    functions = set(kinds[1::2])
    alternate = len(parts) % 2 == 1 and set(kinds[::2]) == {"Linear"}
    if not alternate or not functions <= set(_TORCH_NAMES) or len(functions) > 1:
        raise PolicyError(
            f"a network of {', '.join(kinds) or 'nothing'} has no file format here: expected Linear layers with one of "
            f"{', '.join(_TORCH_NAMES)} between them; play others through from_network and module:attribute"
        )
    arrays = {}
    for i, part in enumerate(parts[::2]):
        weight = part.weight.detach().cpu().numpy()
        arrays[f"{i}.weight"] = weight
        arrays[f"{i}.bias"] = part.bias.detach().cpu().numpy() if part.bias is not None else np.zeros(len(weight), weight.dtype)
    function = _TORCH_NAMES[functions.pop()] if functions else "relu"
    replace_file(path, save(arrays, metadata={"network": json.dumps({"function": function, "layers": len(parts[::2])})}))


def load_weights(path: Path) -> Policy:
    """The policy in a file of weights, safetensors or a state dictionary of PyTorch.

    Raises:
        PolicyError: the file does not exist, or it holds no chain of linear layers.
    """
    try:
        if path.suffix == ".safetensors":
            metadata, arrays = read_tensors(path)
            described = parsed(metadata.get("network", "{}"))
            function = described.get("function", "relu") if isinstance(described, dict) else ""
        else:
            arrays, function = _state_dictionary(read_file(path, _LARGEST)), "relu"
        return _policy(_chain(arrays, function))
    except (OSError, ValueError) as error:
        raise PolicyError(
            f"{path}: no network that can be played ({problem(error)}); save_network writes one, and a state dictionary of "
            "linear layers with ReLU between them will do"
        ) from error


def from_sb3(path: Path | str) -> Policy:
    """The policy in an archive that Stable-Baselines3 or sb3-contrib saved: PPO, MaskablePPO, A2C or DQN on ``Rally-v0``.

    Only the weights and the settings stored as text are read. The activation is the one that the archive names, or the default of
    the library. DQN plays the stroke with the highest value.

    Args:
        path: the archive, as ``model.save(path)`` writes it.

    Raises:
        PolicyError: the file does not exist, or the policy is not the default architecture for vectors.
    """
    path = Path(path)
    try:
        with zipfile.ZipFile(io.BytesIO(read_file(path, _LARGEST))) as archive:
            if (size := archive.getinfo("policy.pth").file_size) > _LARGEST:
                raise ValueError(f"{size:,} bytes of weights")
            arrays = _state_dictionary(archive.read("policy.pth"))
            settings = archive.read("data").decode() if archive.getinfo("data").file_size < _LARGEST else ""
        named = re.search(r"torch\.nn\.modules\.activation\.(\w+)", settings)
        values = "q_net.q_net.0.weight" in arrays
        function = _TORCH_NAMES.get(named[1], "") if named else ("relu" if values else "tanh")
        prefixes = ("q_net.q_net.",) if values else ("mlp_extractor.policy_net.", "action_net.")
        chain = {name: array for name, array in arrays.items() if name.startswith(prefixes)}
        return _policy(_chain(chain, function), greedy=values)
    except (OSError, ValueError, KeyError, zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError) as error:
        raise PolicyError(f"{path}: no archive of Stable-Baselines3 that can be played ({problem(error)})") from error


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
        dense = not value.is_nested and value.layout is torch.strided and not value.is_quantized and value.device.type == "cpu"
        if not (dense and value.is_floating_point()):
            raise ValueError(f"{str(name)[:100]}: expected a dense tensor of floating-point numbers")
        # A view may repeat the numbers of the file and be much larger.
        if value.numel() * value.element_size() > value.untyped_storage().nbytes():
            raise ValueError(f"{str(name)[:100]}: {value.numel():,} numbers, more than the file holds")
    return {str(name): value.detach().float().numpy() for name, value in found.items()}


def _chain(arrays: Mapping[str, npt.NDArray[Any]], function: str) -> Layers:
    """Linear layers from weights by name, in the order of the names.

    Raises:
        ValueError: the weights form no chain, the activation is unknown, or a number is not finite.
    """
    if function not in FUNCTIONS:
        raise ValueError(f"unknown activation; expected one of {', '.join(FUNCTIONS)}")
    names = [name.removesuffix(".weight") for name in arrays if name.endswith(".weight")]
    if all(name.isdigit() for name in names):
        names.sort(key=int)  # safetensors keeps no order
    layers: list[tuple[F64, F64]] = []
    for name in names:
        weight = arrays[f"{name}.weight"].astype(np.float64)
        bias = arrays.get(f"{name}.bias", np.zeros(weight.shape[:1])).astype(np.float64)
        fits = weight.ndim == 2 and bias.shape == weight.shape[:1] and (not layers or layers[-1][0].shape[0] == weight.shape[1])
        if not fits:
            raise ValueError(f"{name} does not fit the layer before")
        layers.append((weight, bias))
    known: Sequence[str] = [f"{name}.{part}" for name in names for part in ("weight", "bias")]
    if not layers or set(arrays) - set(known):
        raise ValueError(f"{next(iter(set(arrays) - set(known)), 'nothing')} is no part of a chain of linear layers")
    if not all(np.isfinite(part).all() for layer in layers for part in layer):
        raise ValueError("a weight that is not finite")
    return Layers(tuple(layers), function)


def _policy(layers: Layers, *, greedy: bool = False) -> Policy:
    width, strokes = layers.linear[0][0].shape[1], layers.linear[-1][0].shape[0]
    if width not in (RALLY_WIDTH, RALLY_WIDTH + strokes):
        raise ValueError(
            f"it reads {width} numbers; expected the {RALLY_WIDTH} of an observation, alone or behind a mask of {strokes} strokes"
        )
    return NetworkPolicy(layers, "observation", greedy, masked=width != RALLY_WIDTH)
