"""Policy networks, evaluated on every state without PyTorch and with the same bits on every machine.

Rounding in a matrix product depends on the order of its terms, and therefore on the machine. Here both factors are rounded to
integers of so few bits (22, and 24 for a layer of 128 numbers: as many as a float32 has) that every sum of products is an integer
below 2^53, which is exact in any order. The remaining operations are additions of two numbers, and an exponential made of those;
they run in compiled loops that perform the operations of IEEE 754 one by one.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any, Final, TypeVar

import numpy as np
import numpy.typing as npt

from shuttle_marl.base.arrays import F64, I64, U16
from shuttle_marl.base.compiling import cached
from shuttle_marl.base.tensor_files import checked
from shuttle_marl.game.draws import CHOICE_ONE
from shuttle_marl.game.layout import LONGEST_DUEL
from shuttle_marl.game.policy import PolicyError, TabulatedPolicy
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.stroke import Catalogue
from shuttle_marl.game.tables import Game

_WEIGHT_BITS: Final = 22
_EXACT_BITS: Final = 53  # number of bits of the integers that are exact in float64
_LEAST_EXPONENT: Final = -900  # least exponent of the largest number of a factor, so that its unit is a float64
_HIGHEST: Final = float(np.finfo(np.float32).max)
_PARTS: Final = 8

F = TypeVar("F", bound=Callable[..., Any])

_LOG2E: Final = 1.4426950408889634
_LN2_HIGH: Final = 0.693147180369123816490
_LN2_LOW: Final = 1.90821492927058770002e-10  # ln 2 as a number of 33 bits, whose small multiples are exact, and the remainder
_TERMS: Final = 14
_INVERSE: Final = tuple(1.0 / n for n in range(1, _TERMS + 1))
_SMALLEST: Final = -700.0  # least difference of a logit to the highest one: a probability of 10^-304
_BIAS: Final = 1023
_FRACTION_BITS: Final = 52  # bias of the exponent of a float64, and the number of bits below it


def _compiled(function: F) -> F:
    """Compile code without NaN in which the sign of zero does not matter, so that maxima are vectorised."""
    return cached(function, nogil=True, error_model="numpy", fastmath={"nnan", "nsz"})


def attribute_rows(catalogue: Catalogue) -> I64:
    """``[n + 1, 5]`` rows of an embedding that describe each stroke: its four attributes and itself; at the end "none yet".

    "None yet" is a row of the embedding, repeated five times; its index plus one is the length of the embedding.
    """
    parts = (catalogue.shot, catalogue.area, catalogue.height, catalogue.technique)
    offsets = np.cumsum([0, *(int(part.max()) + 1 for part in parts)])
    n = len(catalogue)
    columns = [part.astype(np.int64) + offset for part, offset in zip(parts, offsets, strict=False)]
    rows = np.stack([*columns, offsets[-1] + np.arange(n)], axis=1)
    return np.concatenate([rows, np.full((1, rows.shape[1]), offsets[-1] + n)])


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PolicyNetwork:
    """Weights of a network from observations to logits, whose first layer is a sum of embeddings; width W.

    Attributes:
        own, incoming: ``[n + 1, W]`` vector of the own last stroke and of the incoming one.
        contact, duel, effort, opponent_effort, hurried: ``[numbers, W]`` vectors of the other parts of an observation.
        position: ``[2, W]`` vectors of whether the player is to choose a position; zeros without recovery.
        layers: weights ``[W', W]`` and biases ``[W']`` of the next layers, each after a ReLU; the last one returns n logits, with
            recovery n + 9.
    """

    own: F64
    incoming: F64
    contact: F64
    duel: F64
    effort: F64
    opponent_effort: F64
    hurried: F64
    position: F64
    layers: tuple[tuple[F64, F64], ...]

    @classmethod
    def of_tensors(cls, tensors: Mapping[str, npt.NDArray[Any]], game: Game) -> "PolicyNetwork":
        """The network from the tensors that :mod:`shuttle_marl.training` saves, by name.

        Raises:
            PolicyError: the tensors do not fit the game, or hold a number that is not finite.
        """
        known = dict(tensors)
        try:
            width = known["0.own.weight"].shape[-1]

            def take(name: str, *shape: int) -> F64:
                return checked(known.pop(name), np.float32, shape).astype(np.float64)

            rows = attribute_rows(game.catalogue)
            strokes = []
            for name in ("own", "incoming"):
                embedding = take(f"0.{name}.weight", int(rows.max()) + 1, width)
                # A loop, because the order of the terms of `sum` is not specified.
                total = embedding[rows[:, 0]]
                for column in rows.T[1:]:
                    total = total + embedding[column]
                strokes.append(total)
            levels = game.levels
            sizes = {"contact": 2, "duel": LONGEST_DUEL + 1, "effort": levels, "opponent_effort": levels, "hurried": 2}
            if game.hides:
                sizes["position"] = 2
            parts = {"position": np.zeros((2, width))}
            parts |= {name: take(f"0.{name}.weight", size, width) for name, size in sizes.items()}
            hidden = sorted({name.rpartition(".")[0] for name in known if name.startswith("0.layers.")}, key=_number)
            layers = [(take(f"{name}.weight", width, width), take(f"{name}.bias", width)) for name in hidden]
            layers.append((take("1.weight", game.n_actions, width), take("1.bias", game.n_actions)))
            if known:
                raise ValueError(f"{next(iter(known))} belongs to no layer")
        except (KeyError, IndexError, ValueError) as error:
            raise PolicyError(f"no network of a policy for this game ({error}); train the agent again") from error
        return cls(own=strokes[0], incoming=strokes[1], layers=tuple(layers), **parts)

    def table(self, game: Game) -> TabulatedPolicy:
        """Tabulate the policy: the softmax of the logits of the legal strokes in every state.

        Raises:
            PolicyError: a number in the network exceeds the range of float32.
        """
        base = np.flatnonzero(game.playable[: game.n_base_states])
        own, incoming, contact, duel, *_, hurried = game.observation(base).T
        efforts = (self.effort[:, None] + self.opponent_effort).reshape(game.n_blocks, -1)
        hidden, (last, last_bias) = [(_rounded(weight), bias) for weight, bias in self.layers[:-1]], self.layers[-1]
        kind = 2 * incoming + contact
        cumulative = np.empty((game.n_blocks, game.n_base_pairs), np.uint16)
        blocks = np.arange(game.n_blocks)[:, None] * game.n_base_pairs
        # States with the same incoming stroke and contact have the same legal strokes: one matrix product for their logits.
        for group in np.split(order := np.argsort(kind, kind="stable"), np.flatnonzero(np.diff(kind[order])) + 1):
            first = int(base[group[0]])
            legal = game.legal_strokes(first)
            both = self.incoming[incoming[group[0]]] + self.contact[contact[group[0]]] + self.position[0]
            vectors = self.own[own[group]] + both + self.duel[duel[group]] + self.hurried[hurried[group]]
            x, farthest = _logits(vectors, efforts, hidden, (last[legal], last_bias[legal]))
            # The network was trained in float32.
            if not farthest <= _HIGHEST:
                raise PolicyError(f"the network gives no finite numbers in state: {game.describe(first)}")
            limits(x, (blocks + game.base_pair_start[base[group]]).ravel(), cumulative.ravel())
        return TabulatedPolicy(game=game, cumulative=cumulative.ravel(), waits=self._waits(game, hidden))

    def _waits(self, game: Game, hidden: "list[_Layer]") -> U16 | None:
        """``[S, 9]`` cumulative probabilities of positions where the opponent is in each state."""
        if not game.hides:
            return None
        weight, bias = (part[game.n_strokes :] for part in self.layers[-1])
        waits = np.empty((game.n_blocks, game.n_base_states, N_POSITIONS), np.uint16)
        blocks = np.arange(game.n_blocks)[:, None] * waits[0].size
        # What is the striker's own in a state is the opponent's to a receiver.
        efforts = (self.opponent_effort[:, None] + self.effort).reshape(game.n_blocks, -1)
        for base in np.array_split(np.arange(game.n_base_states), _PARTS):
            own, incoming, contact, duel, *_, hurried = game.observation(base).T
            strokes = self.own[incoming] + self.incoming[own]
            vectors = strokes + self.contact[contact] + self.position[1] + self.duel[duel] + self.hurried[hurried]
            x, farthest = _logits(vectors, efforts, hidden, (weight, bias))
            if not farthest <= _HIGHEST:
                raise PolicyError(
                    f"the network gives no finite numbers where the opponent is in one of states {base[0]} to {base[-1]}"
                )
            x[np.tile(~game.waiting.mask(base), (game.n_blocks, 1))] = -np.finfo(np.float64).max
            limits(x, (blocks + N_POSITIONS * base).ravel(), waits.ravel())
        return waits.reshape(-1, N_POSITIONS)


_Layer = tuple[tuple[F64, float], F64]  # rounded weights of a layer and their unit, and its biases


def _logits(vectors: F64, efforts: F64, hidden: "list[_Layer]", last: tuple[F64, F64]) -> tuple[F64, float]:
    """Outputs of the layers.

    Args:
        vectors: ``[B, W]`` sums of embeddings, without those of the efforts.
        efforts: ``[G, W]`` embeddings of both efforts.
        last: weights and biases of the last layer.

    Returns:
        ``[G B, K]`` logits, and the largest absolute value on the way.
    """
    x, farthest = np.empty((len(efforts) * len(vectors), vectors.shape[1])), 0.0
    highest = _spread(vectors, efforts, x)
    for layer, bias in hidden:
        x, unit = _product(x, layer, highest)
        far, highest = _affine(x, unit, bias, 0.0)
        farthest = max(farthest, far)
    x, unit = _product(x, _rounded(last[0]), highest)
    return x, max(farthest, _affine(x, unit, last[1], -np.inf)[0])


def _number(layer: str) -> int:
    return int(layer.rpartition(".")[2])


def _rounded(weight: F64) -> tuple[F64, float]:
    """Integers of so few bits that sums of their products are exact, and their unit, a power of two."""
    unit = _unit(float(np.abs(weight).max(initial=0.0)), _WEIGHT_BITS)
    return np.rint(weight * (1 / unit)), unit


def _product(x: F64, weight: tuple[F64, float], highest: float) -> tuple[F64, float]:
    """``x @ weight.T`` with rounded factors, so that the result does not depend on the order of the sums.

    Args:
        x: ``[N, W]`` numbers from 0 to ``highest``; overwritten.
        weight: ``[W', W]`` rounded weights and their unit.

    Returns:
        ``[N, W']`` integers, and their unit.
    """
    factor, unit = weight
    terms = max(1, factor.shape[1] - 1).bit_length()
    x_unit = _unit(highest, _EXACT_BITS - _WEIGHT_BITS - terms)
    np.rint(np.multiply(x, 1 / x_unit, out=x), out=x)
    return x @ factor.T, x_unit * unit


def _unit(highest: float, bits: int) -> float:
    """Power of two in units of which numbers up to the highest have at most so many bits."""
    return float(2.0 ** (max(math.frexp(highest)[1], _LEAST_EXPONENT) - bits))


@_compiled
def _spread(base: F64, efforts: F64, out: F64) -> float:
    """Write ReLU of ``[B, W]`` plus each row of ``[G, W]`` to ``[B G, W]``; returns the largest number."""
    highest = 0.0
    for block in range(len(efforts)):
        effort = efforts[block]
        for row in range(len(base)):
            first, values = base[row], out[block * len(base) + row]
            for i in range(values.size):
                values[i] = max(first[i] + effort[i], 0.0)
                highest = max(highest, values[i])
    return highest


@_compiled
def _affine(x: F64, unit: float, bias: F64, least: float) -> tuple[float, float]:
    """Multiply ``[N, W]`` by a unit, add ``[W]`` and raise to ``least``, 0 for ReLU, in place.

    Returns:
        The largest absolute value before that and the largest number after it.
    """
    farthest = highest = 0.0
    for row in range(len(x)):
        values = x[row]
        for i in range(values.size):
            value = values[i] * unit + bias[i]
            farthest = max(farthest, abs(value))
            values[i] = max(value, least)
            highest = max(highest, values[i])
    return farthest, highest


@_compiled
def limits(logits: F64, start: I64, cumulative: U16) -> None:
    """Write cumulative probabilities of the softmax of ``[N, K]`` logits, in units of 1/65535, each row from its start on."""
    length = logits.shape[1]
    total = np.empty(length)
    power = np.empty(length, np.int64)
    scale = power.view(np.float64)
    for row in range(len(logits)):
        top = logits[row, 0]
        for i in range(1, length):
            top = max(top, logits[row, i])
        for i in range(length):
            x = max(logits[row, i] - top, _SMALLEST)
            whole = np.rint(x * _LOG2E)
            rest = x - whole * _LN2_HIGH - whole * _LN2_LOW
            power[i] = (np.int64(whole) + _BIAS) << _FRACTION_BITS
            # Horner scheme of the exponential series.
            y = 1.0
            for n in range(_TERMS - 1, -1, -1):
                y = y * rest * _INVERSE[n] + 1.0
            total[i] = y
        so_far = 0.0
        for i in range(length):
            so_far += total[i] * scale[i]
            total[i] = so_far
        found = cumulative[start[row] : start[row] + length]
        for i in range(length):
            found[i] = np.uint16(np.rint(total[i] / so_far * CHOICE_ONE))
