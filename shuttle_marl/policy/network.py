"""Policy networks, evaluated on every state without PyTorch and to the last bit alike on every machine.

The sum in a matrix product depends on the order of its terms, and so on the machine. Here both factors are rounded to whole
numbers of so few bits (22, and 24 for a layer of 128 numbers: as many as a float32 has) that every sum of products is a whole
number below 2^53, which no order of terms changes. What is left is additions of two numbers, and an exponential made of those.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.arrays import F64, I64
from shuttle_marl.game.policy import PolicyError
from shuttle_marl.game.stroke import Catalogue
from shuttle_marl.game.tables import LONGEST_DUEL, Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.tensor_files import checked

_WEIGHT_BITS: Final = 22
_EXACT_BITS: Final = 53
"""Whole numbers of so many bits are exact in float64."""
_LEAST_EXPONENT: Final = -900
"""Of a factor's largest number: below, its unit would be no number of float64."""
_HIGHEST: Final = float(np.finfo(np.float32).max)


def attribute_rows(catalogue: Catalogue) -> I64:
    """``[n + 1, 5]`` rows of an embedding that describe each stroke: its four attributes and itself; at the end "none yet".

    "None yet" is a row of its own, five times; its number plus one is the length of the embedding.
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
        contact, duel, effort, opponent_effort: ``[numbers, W]`` vectors of the other parts of an observation.
        layers: weights ``[W', W]`` and biases ``[W']`` of the layers behind, each after a ReLU; the last one gives n logits.
    """

    own: F64
    incoming: F64
    contact: F64
    duel: F64
    effort: F64
    opponent_effort: F64
    layers: tuple[tuple[F64, F64], ...]

    @classmethod
    def of_tensors(cls, tensors: Mapping[str, npt.NDArray[Any]], game: Game) -> "PolicyNetwork":
        """The network of the tensors by name that :mod:`shuttle_marl.training` saves.

        Raises:
            PolicyError: they are no such network for the game, or a number of theirs is not finite.
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
                # Added one after the other: `sum` chooses the order of the terms by itself.
                total = embedding[rows[:, 0]]
                for column in rows.T[1:]:
                    total = total + embedding[column]
                strokes.append(total)
            sizes = {"contact": 2, "duel": LONGEST_DUEL + 1, "effort": game.levels, "opponent_effort": game.levels}
            parts = {name: take(f"0.{name}.weight", size, width) for name, size in sizes.items()}
            hidden = sorted({name.rpartition(".")[0] for name in known if name.startswith("0.layers.")}, key=_number)
            layers = [(take(f"{name}.weight", width, width), take(f"{name}.bias", width)) for name in hidden]
            layers.append((take("1.weight", game.n_strokes, width), take("1.bias", game.n_strokes)))
            if known:
                raise ValueError(f"{next(iter(known))} belongs to no layer")
        except (KeyError, IndexError, ValueError) as error:
            raise PolicyError(f"no network of a policy for this game ({error}); train the agent again") from error
        return cls(own=strokes[0], incoming=strokes[1], layers=tuple(layers), **parts)

    def table(self, game: Game) -> TabulatedPolicy:
        """The policy on every state: the softmax of the logits of the legal strokes.

        Raises:
            PolicyError: a number in the network is beyond those of float32.
        """
        from shuttle_marl.policy import compiled  # noqa: PLC0415  waits until numba is wanted

        base = np.flatnonzero(game.playable[: game.n_base_states])
        own, incoming, contact, duel = game.observation(base).T[:4]
        efforts = (self.effort[:, None] + self.opponent_effort).reshape(game.n_blocks, -1)
        hidden, (last, last_bias) = [(_rounded(weight), bias) for weight, bias in self.layers[:-1]], self.layers[-1]
        kind = 2 * incoming + contact
        cumulative = np.empty((game.n_blocks, game.n_base_pairs), np.uint16)
        blocks = np.arange(game.n_blocks)[:, None] * game.n_base_pairs
        # States of one incoming stroke and contact have the same legal strokes: one product of matrices, of those logits alone.
        for group in np.split(order := np.argsort(kind, kind="stable"), np.flatnonzero(np.diff(kind[order])) + 1):
            first = int(base[group[0]])
            legal = game.legal_strokes(first)
            both = self.incoming[incoming[group[0]]] + self.contact[contact[group[0]]]
            x = np.empty((game.n_blocks * len(group), len(both)))
            highest = compiled.spread(self.own[own[group]] + both + self.duel[duel[group]], efforts, x)
            farthest = 0.0
            for layer, bias in hidden:
                x, unit = _product(x, layer, highest)
                far, highest = compiled.rectify(x, unit, bias)
                farthest = max(farthest, far)
            x, unit = _product(x, _rounded(last[legal]), highest)
            # While it learned, the network was one of float32 numbers.
            if not max(farthest, compiled.shift(x, unit, last_bias[legal])) <= _HIGHEST:
                raise PolicyError(f"the network gives no finite numbers in state: {game.describe(first)}")
            compiled.limits(x, (blocks + game.base_pair_start[base[group]]).ravel(), cumulative.ravel())
        return TabulatedPolicy(game=game, cumulative=cumulative.ravel())


def _number(layer: str) -> int:
    return int(layer.rpartition(".")[2])


def _rounded(weight: F64) -> tuple[F64, float]:
    """Whole numbers of so few bits that sums of their products are exact, and the power of two that they count."""
    unit = _unit(float(np.abs(weight).max(initial=0.0)), _WEIGHT_BITS)
    return np.rint(weight * (1 / unit)), unit


def _product(x: F64, weight: tuple[F64, float], highest: float) -> tuple[F64, float]:
    """``x @ weight.T``, of factors that are rounded so that the order of the sums changes nothing.

    Args:
        x: ``[N, W]`` numbers from 0 to ``highest``; overwritten.
        weight: ``[W', W]``, rounded.
        highest: of x.

    Returns:
        ``[N, W']`` whole numbers, and what they count.
    """
    from shuttle_marl.policy import compiled  # noqa: PLC0415  waits until numba is wanted

    factor, unit = weight
    terms = max(1, factor.shape[1] - 1).bit_length()
    x_unit = _unit(highest, _EXACT_BITS - _WEIGHT_BITS - terms)
    compiled.round_to(x, 1 / x_unit)
    return x @ factor.T, x_unit * unit


def _unit(highest: float, bits: int) -> float:
    """The power of two of which numbers up to the highest are whole ones of at most some bits."""
    return float(2.0 ** (max(math.frexp(highest)[1], _LEAST_EXPONENT) - bits))
