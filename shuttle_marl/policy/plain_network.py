"""User networks as policies: any function from observations to logits, and files of weights.

Files are those of :func:`save_network`; no code in them is run. They hold a chain of linear layers with one kind of activation,
and name it. Weights alone, such as a state dictionary, do not say what is computed between them, so they are refused. Other
networks are played through :func:`from_network` or ``module:attribute``.
"""

import dataclasses
import functools
import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt
from safetensors.numpy import save

from shuttle_marl.base.arrays import F64, I32, Bools
from shuttle_marl.base.errors import described
from shuttle_marl.base.files import parsed, problem, replace_file
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


def _network(arrays: Mapping[str, npt.NDArray[Any]], function: object) -> NetworkPolicy:
    """The policy of weights and biases by the numbers of their layers, and the name of an activation.

    Raises ValueError: they form no chain from an observation, the activation is unknown, or a number is not finite.
    """
    if not isinstance(function, str) or function not in FUNCTIONS:
        raise ValueError(f"unknown activation; expected one of {', '.join(FUNCTIONS)}")
    names = [str(i) for i in range(max(1, len(arrays) // 2))]
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
    return NetworkPolicy(functools.partial(_layers, layers, function), masked=width != RALLY_WIDTH)
