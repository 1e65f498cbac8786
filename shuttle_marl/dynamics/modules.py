"""The models as PyTorch modules: networks, trees and ridge regression, and what happens to a stroke.

    models, game = load_models(), default_game()
    codes = attributes(codes_of_pairs(game, np.arange(1000), opposite=False))  # code 0 of the discipline: men's singles
    good, returned = models.m_succ(codes), models.m_ret(codes)  # [1000] each

Every module maps ``[N, 15]`` integer codes, in the order of :data:`~shuttle_marl.dynamics.features.SLOTS`, to probabilities in
double precision. The tables of a game are compiled from these modules and nothing else
(:func:`shuttle_marl.dynamics.compiled.pair_probabilities`).
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Mapping
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt
import torch
from scipy.special import expit
from torch import Tensor, nn
from torch.nn import functional

from shuttle_marl.base.arrays import F64, I16, I32, I64, U8, Ints
from shuttle_marl.base.tensor_files import checked
from shuttle_marl.dynamics.features import NET_SHOT, SLOTS, STATE, Rows, check_nodes
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.stroke import N_SHOTS, N_TECHNIQUES

_CHUNK: Final = 1024  # strokes of an evaluation: few enough that their hidden layers stay in the cache
_LOWEST: Final = np.array([0, *((bits & -bits).bit_length() - 1 for bits in range(1, 256))])  # [256] position of the lowest bit
INPUTS: Final = tuple(SLOTS)
LEVELS: Final = 2
LONG_DUEL: Final = 3  # minimum number of consecutive net shots before a stroke in a long duel


@dataclasses.dataclass(frozen=True, kw_only=True)
class NetworkSpec:
    """Inputs, outputs and size of an ensemble."""

    inputs: tuple[str, ...]  # names of attributes (`SLOTS`)
    crosses: tuple[tuple[str, ...], ...]  # tuples of inputs whose products enter the linear part
    outputs: int
    hidden: int = 64  # width of both hidden layers
    members: int = 10


def _products(text: str) -> tuple[tuple[str, ...], ...]:
    return tuple(tuple(product.split()) for product in text.split(","))


GOOD, OUT, SHORT = range(3)
_STROKE: Final = (*STATE, "shot", "technique", "area")
_CONTEXT: Final = _products(
    "shot contact technique, incoming_shot incoming_area, incoming_shot shot, incoming_area shot, own_shot incoming_shot,"
    "shot area, hurried shot, hurried incoming_shot"
)
_FLIGHT: Final = (*_CONTEXT, *_products("shot area technique, incoming_area area, own_area area, hands area"))
_REPLY: Final = _products(
    "incoming_shot incoming_area contact, own_shot incoming_shot, own_area incoming_shot, hurried incoming_shot"
)
_AIM: Final = _products(
    "shot technique contact, incoming_area shot, incoming_shot shot, own_area shot, incoming_area technique, hurried shot,"
    "hands shot, hands incoming_area"
)
SPECS: Final = {
    "choice": NetworkSpec(inputs=STATE, crosses=_REPLY, outputs=N_SHOTS * N_TECHNIQUES),
    "target": NetworkSpec(inputs=(*STATE, "shot", "technique"), crosses=_AIM, outputs=N_AREAS),
    "success": NetworkSpec(inputs=_STROKE, crosses=_CONTEXT, outputs=3),
    "return": NetworkSpec(inputs=_STROKE, crosses=_FLIGHT, outputs=1),
    "contact": NetworkSpec(inputs=_STROKE, crosses=_FLIGHT, outputs=1),
}
HURRIED: Final = ("hurried_below", "hurried_above")  # trees of hurried receivers, by the height at which they meet the shuttle
_PAIRS: Final = tuple(itertools.combinations(SLOTS, 2))
_TRIPLES: Final = _products(
    "incoming_shot shot area, contact shot area, own_area incoming_area area, shot area technique, own_area shot area,"
    "incoming_area shot area, own_shot incoming_shot shot, discipline shot area, incoming_shot incoming_area shot"
)
RIDGE: Final = NetworkSpec(inputs=tuple(SLOTS), crosses=(*_PAIRS, *_TRIPLES), outputs=1)
RIDGE_SIZES: Final = (*SLOTS.values(), *(math.prod(SLOTS[name] for name in cross) for cross in RIDGE.crosses))
RIDGE_SCALES: Final = np.array([1.0] * len(SLOTS) + [0.25] * len(_PAIRS) + [0.3] * len(_TRIPLES))
"""By product: those that are scaled down have a stronger ridge."""


def attributes(codes: dict[str, I16]) -> Tensor:
    """``[N, 15]`` int32 codes in the order of :data:`~shuttle_marl.dynamics.features.SLOTS`, the inputs of all modules.

    Attributes that are missing are 0: who reads them not may leave them out.
    """
    table = np.zeros((len(next(iter(codes.values()))), len(SLOTS)), dtype=np.int32)
    for k, name in enumerate(SLOTS):
        if name in codes:
            table[:, k] = codes[name]
    return torch.from_numpy(table)


def encode(spec: NetworkSpec, codes: Tensor) -> Tensor:
    """``[N, inputs + crosses]`` int32 active columns of the multi-hot input, from ``[N, 15]`` codes."""
    strides, offsets = (part.to(codes.device) for part in _columns(spec))
    # A product of doubles is exact here, and fast.
    return (codes.double() @ strides + offsets).int()


@functools.cache
def _columns(spec: NetworkSpec) -> tuple[Tensor, Tensor]:
    crosses = [*((name,) for name in spec.inputs), *spec.crosses]
    strides, widths = torch.zeros(len(SLOTS), len(crosses), dtype=torch.float64), []
    for column, cross in enumerate(crosses):
        width = 1
        for name in reversed(cross):
            strides[list(SLOTS).index(name), column] = width
            width *= SLOTS[name]
        widths.append(width)
    return strides, torch.tensor([0, *itertools.accumulate(widths[:-1])], dtype=torch.float64)


class Ensemble(nn.Module):
    """K networks from ``[N, 15]`` codes of :data:`~shuttle_marl.dynamics.features.SLOTS` to ``[K, N, outputs]`` logits. A member
    is the sum of a linear model on one-hot attributes and their products, and of a perceptron with two hidden layers on these.
    Weights are looked up and summed for all members at once; the multi-hot input is never materialised."""

    def __init__(self, spec: NetworkSpec) -> None:
        super().__init__()
        self.spec = spec
        simple = sum(SLOTS[name] for name in spec.inputs)
        width = simple + sum(math.prod(SLOTS[name] for name in cross) for cross in spec.crosses)
        k, hidden = spec.members, spec.hidden
        self.first = nn.Parameter(torch.zeros(simple, k, hidden))
        self.first_bias = nn.Parameter(torch.zeros(k, 1, hidden))
        self.second = nn.Parameter(torch.zeros(k, hidden, hidden))
        self.second_bias = nn.Parameter(torch.zeros(k, 1, hidden))
        self.last = nn.Parameter(torch.zeros(k, hidden, spec.outputs))
        self.last_bias = nn.Parameter(torch.zeros(k, 1, spec.outputs))
        self.linear = nn.Parameter(torch.zeros(width, k, spec.outputs))

    def initialise(self, generator: torch.Generator, prior: Tensor) -> None:
        """Random weights; ``prior`` is the ``[outputs]`` logits of an untrained network."""
        with torch.no_grad():
            hidden = self.spec.hidden
            scales = (
                (self.first, math.sqrt(2 / len(self.spec.inputs))),
                (self.second, math.sqrt(2 / hidden)),
                (self.last, 0.1 / math.sqrt(hidden)),
            )
            for weight, scale in scales:
                weight.copy_(torch.randn(weight.shape, generator=generator) * scale)
            self.last_bias.copy_(prior.expand_as(self.last_bias))

    def forward(self, codes: Tensor, dropout: float = 0.0, generator: torch.Generator | None = None) -> Tensor:
        """Logits ``[K, N, outputs]``; ``dropout`` applies to both hidden layers."""
        columns = encode(self.spec, codes)

        def drop(hidden: Tensor) -> Tensor:
            if dropout == 0:
                return hidden
            # One mask for all members: sampling ten would cost as much as the products.
            mask = (torch.rand(hidden.shape[1:], generator=generator) >= dropout).to(hidden.dtype)
            return hidden * (mask / (1 - dropout))

        def embedded(table: Tensor, indices: Tensor) -> Tensor:
            summed = functional.embedding_bag(indices, table.flatten(1), mode="sum")
            return summed.view(len(indices), *table.shape[1:]).transpose(0, 1)

        hidden = drop(torch.relu(embedded(self.first, columns[:, : len(self.spec.inputs)]) + self.first_bias))
        hidden = drop(torch.relu(torch.baddbmm(self.second_bias, hidden, self.second)))
        return torch.baddbmm(self.last_bias, hidden, self.last) + embedded(self.linear, columns)

    def logits(self, codes: dict[str, I16]) -> F64:
        """``[K, N, outputs]`` logits of N strokes."""
        return in_chunks(self, codes, axis=1)


def in_chunks(module: Callable[[Tensor], Tensor], codes: dict[str, I16], *, axis: int = 0) -> F64:
    """Results of a module on N strokes, evaluated some thousands at a time; ``axis``: that of the strokes in a result."""
    table = attributes(codes)
    with torch.no_grad():
        parts = [module(table[start : start + _CHUNK]) for start in range(0, max(1, len(table)), _CHUNK)]
    return np.concatenate([part.numpy() for part in parts], axis=axis)


class Ridge(nn.Module):
    """Logistic regression on attributes and products of attributes; ``weight``: ``[1 + columns]`` coefficients, the intercept
    first."""

    weight: Tensor

    def __init__(self, weight: F64) -> None:
        super().__init__()
        self.register_buffer("weight", torch.from_numpy(weight))

    def forward(self, codes: Tensor) -> Tensor:
        """``[N]`` logits, from ``[N, 15]`` codes of :data:`~shuttle_marl.dynamics.features.SLOTS`."""
        return self.weight[0] + self.weight[1:][encode(RIDGE, codes)].sum(dim=1)

    def logits(self, codes: dict[str, I16]) -> F64:
        """``[N]`` logits."""
        return in_chunks(self, codes)


class Trees(nn.Module):
    """T boosted trees over attribute codes; their prediction is the sum of the leaves that a row reaches.

    They are evaluated with bit masks of the reachable leaves (QuickScorer, Lucchese et al., SIGIR 2015).

    Node m of tree t tests one code of a row and sends the row to one of two children: a later node of the tree, or leaf
    -1 - child. The trees themselves are :attr:`arrays`.

    Args:
        attribute: ``[T, M]`` attribute that a node tests, as an index into :data:`INPUTS`.
        left: ``[T, M]`` bit mask of the codes that go to the first child.
        child: ``[T, M, 2]`` children; unused nodes have leaf 0.
        value: ``[T, M + 1]`` leaves.
    """

    masks: Tensor  # [attributes, codes, T] uint8 leaves that a tree can still reach, one bit each, by the code of one attribute
    leaves: Tensor  # ``[T * 256]`` leaf of each tree by the bits of those that are left

    def __init__(self, *, attribute: I32, left: I32, child: I32, value: F64) -> None:
        super().__init__()
        self.arrays: dict[str, npt.NDArray[Any]] = {"attribute": attribute, "left": left, "child": child, "value": value}
        nodes = np.minimum(_LOWEST, value.shape[1] - 1)
        self.register_buffer("masks", torch.from_numpy(_masks(attribute, left, child)))
        self.register_buffer("leaves", torch.from_numpy(value[:, nodes].ravel()))

    def __len__(self) -> int:
        return self.masks.shape[2]

    def forward(self, codes: Tensor) -> Tensor:
        """``[N]`` sums of leaves, from ``[N, 15]`` codes: those are left that no test of a tree removes."""
        left = self.masks[0].index_select(0, codes[:, 0])
        for masks, column in zip(self.masks[1:], codes.T[1:], strict=True):
            left &= masks.index_select(0, column)
        index = left.int() + 256 * torch.arange(len(self), dtype=torch.int32, device=codes.device)
        return self.leaves.index_select(0, index.flatten()).view(left.shape).sum(dim=1)

    def logits(self, codes: dict[str, I16]) -> F64:
        """``[N]`` sums of leaves."""
        return in_chunks(self, codes)

    @classmethod
    def checked(cls, arrays: dict[str, npt.NDArray[Any]]) -> Self:
        """Trees from the arrays of a file. Raises KeyError, ValueError: an array is missing or invalid."""
        trees, nodes = arrays["attribute"].shape
        attribute, left = (checked(arrays[name], np.int32, (trees, nodes)) for name in ("attribute", "left"))
        child = checked(arrays["child"], np.int32, (trees, nodes, 2))
        value = checked(arrays["value"], np.float64, (trees, nodes + 1))
        check_nodes(attribute, child, len(INPUTS))
        return cls(attribute=attribute, left=left, child=child, value=value)


def _masks(attribute: I32, left: I32, child: I32) -> U8:
    trees, nodes = attribute.shape
    # Leaves below each child, from the last node to the first, since children come after their parents.
    below = np.zeros((trees, nodes, 2), dtype=np.uint8)
    for node in range(nodes - 1, -1, -1):
        to = child[:, node]
        inner = below[np.arange(trees)[:, None], np.maximum(to, 0)]
        below[:, node] = np.where(to < 0, 1 << (-1 - np.minimum(to, -1)), inner[..., 0] | inner[..., 1])
    used = np.zeros((trees, nodes), dtype=bool)
    used[:, 0] = True
    for side in (0, 1):
        tree_of, parent = np.nonzero(child[..., side] >= 0)
        used[tree_of, child[tree_of, parent, side]] = True
    masks = np.full((len(INPUTS), max(SLOTS.values()), trees), 255, dtype=np.uint8)
    codes = np.arange(masks.shape[1])
    for tree, node in np.argwhere(used):
        first = (left[tree, node] >> codes) & 1 == 1
        kept = np.where(first, below[tree, node, 0], below[tree, node, 1]).astype(np.uint8)
        lost = np.where(first, below[tree, node, 1], below[tree, node, 0]).astype(np.uint8)
        # A tree without a split has the same leaf on both sides.
        masks[attribute[tree, node], :, tree] &= ~lost | kept
    return masks


class _Calibrated(nn.Module):
    """An ensemble of networks, other parts, and the calibration of their common log-odds; ``line``: ``[2]`` slope and intercept
    of the calibrated log-odds."""

    line: Tensor

    def __init__(self, network: Ensemble, trees: Trees, line: F64) -> None:
        super().__init__()
        self.network, self.trees = network, trees
        self.register_buffer("line", torch.from_numpy(np.array(line)))

    def calibrated(self, members: Tensor) -> Tensor:
        """``[N]`` calibrated log-odds of the mean of the members' probabilities ``[K, N]``."""
        return self.line[0] * torch.logit(members.mean(dim=0), eps=1e-9) + self.line[1]


class MSucc(_Calibrated):
    """``M_succ``: the probability that a stroke is good."""

    def fault_logit(self, codes: Tensor) -> Tensor:
        """``[N]`` log-odds of a fault, at effort 0 and outside of long duels."""
        good = torch.softmax(self.network(codes), dim=-1)[..., GOOD]
        return self.calibrated(1 - good) + self.trees(codes)

    def forward(self, codes: Tensor, shift: Tensor | float = 0.0) -> Tensor:
        """``[N]`` probabilities; ``shift``: change of the log-odds of a fault, such as that by effort and long duels
        (:attr:`~shuttle_marl.dynamics.modules.Situations.offsets`)."""
        return torch.sigmoid(-self.fault_logit(codes) - shift)


class MContact(_Calibrated):
    """The probability that a returned stroke is met above the net."""

    def logit(self, codes: Tensor) -> Tensor:
        """``[K, N]`` log-odds by member of the ensemble, not calibrated: the mean of the parts."""
        return (self.network(codes)[..., 0] + self.trees(codes)) / 2

    def forward(self, codes: Tensor) -> Tensor:
        """``[N]`` probabilities."""
        return torch.sigmoid(self.calibrated(torch.sigmoid(self.logit(codes))))


class MRet(MContact):
    """``M_ret``: the probability that the opponent returns a good stroke."""

    def __init__(self, network: Ensemble, trees: Trees, ridge: Ridge, line: F64) -> None:
        super().__init__(network, trees, line)
        self.ridge = ridge

    def logit(self, codes: Tensor) -> Tensor:
        """``[K, N]`` log-odds by member of the ensemble, not calibrated: the mean of the parts."""
        return (self.network(codes)[..., 0] + self.ridge(codes) + self.trees(codes)) / 3


class MHurried(nn.Module):
    """The probability that who returns a stroke is hurried, by the height at which they meet it; ``trees``: by name
    (:data:`~shuttle_marl.dynamics.modules.HURRIED`); a height without trees has probability 0; ``lines``: ``[2, 2]`` slope and
    intercept of the calibrated log-odds, by height."""

    lines: Tensor

    def __init__(self, trees: Mapping[str, Trees], lines: F64) -> None:
        super().__init__()
        self.known, self.trees = dict(trees), nn.ModuleDict(dict(trees))
        self.register_buffer("lines", torch.from_numpy(np.array(lines)))

    def forward(self, codes: Tensor) -> Tensor:
        """``[N, 2]`` probabilities if the receiver meets the stroke below and above the net."""
        found = torch.zeros(len(codes), len(HURRIED), dtype=self.lines.dtype, device=codes.device)
        for height, name in enumerate(HURRIED):
            if name in self.known:
                found[:, height] = torch.sigmoid(self.lines[height, 0] * self.known[name](codes) + self.lines[height, 1])
        return found


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Situations:
    """Effects of earlier strokes of the rally on the log-odds of a fault, and frequencies of the situations. A situation is a
    level of effort and whether the stroke is a net shot in a long duel. The calibrated probabilities of the networks are those at
    effort 0 outside of long duels."""

    effort: F64  # [L] offset of each level of effort; the first is 0
    duel: float  # offset of a net shot in a long duel
    effort_share: F64  # [15, L] frequency of each level, by code of the striker's previous shot type (`own_shot`)
    duel_share: float  # frequency of long duels among the net shots after two net shots
    hurried_share: F64  # [15, 13] frequency of hurried strikers by codes of incoming and own shot type; 0 where not known

    @property
    def offsets(self) -> F64:
        """``[2 L]`` offset of each situation: the levels outside of long duels, then inside."""
        return np.concatenate([self.effort, self.effort + self.duel])

    def _known(self, rows: Rows) -> tuple[I64, I64]:
        """``[N]`` level of effort, and 1 after a long run of net shots, 0 else; -1 each where unknown."""
        level = np.where(rows.attacks < 0, -1, np.minimum(rows.attacks, len(self.effort) - 1))
        return level, np.where(rows.net_run < 0, -1, rows.net_run >= LONG_DUEL)

    def weights(self, rows: Rows) -> F64:
        """``[N, 2 L]`` probability of each situation: 0 or 1 where it is known, frequencies where unknown."""
        level, long = self._known(rows)
        return self.spread(rows.codes["own_shot"], level, np.where(NET_SHOT[rows.codes["shot"]], long, 0))

    def spread(self, own_shot: Ints, level: Ints, long: Ints) -> F64:
        """``[N, 2 L]`` probability of each situation; ``own_shot``: ``[N]`` code of the striker's previous shot type; ``level``:
        ``[N]`` level of effort, -1 where unknown; ``long``: ``[N]`` 1 for a net shot in a long duel, 0 for other strokes, -1 for
        a net shot where unknown."""
        levels = np.where((level < 0)[:, None], self.effort_share[own_shot], np.eye(len(self.effort))[level])
        inside = np.where(long < 0, self.duel_share, long)
        return np.concatenate([(1 - inside)[:, None] * levels, inside[:, None] * levels], axis=1)

    def mixed(self, logit: F64, weights: F64) -> F64:
        """Probability of a fault, averaged over the situations; ``logit``: ``[N, ...]`` at effort 0 outside of long duels;
        ``weights``: ``[N, 2 L]`` probability of each situation."""
        total = np.zeros_like(logit)
        for offset, weight in zip(self.offsets, weights.T, strict=True):
            total += weight.reshape(-1, *(1,) * (logit.ndim - 1)) * expit(logit + offset)
        return total

    def moved_to(self, mean: F64, logit: F64, weights: F64, share: F64) -> F64:
        """``[N, B]`` logits, those of a row moved by the same amount, so that the mean probability is a given one; ``mean``:
        ``[N]`` probabilities between 0 and 1; ``logit``: ``[N, B]`` at effort 0 outside of long duels, in B cases; ``weights``:
        ``[N, 2 L]`` probability of each situation; ``share``: ``[N, B]`` probability of each case."""
        target = np.log(mean) - np.log1p(-mean)
        # The slope of the mean's log-odds is close to 1, so the fixed-point iteration converges fast.
        for _ in range(20):
            current = (share * self.mixed(logit, weights)).sum(axis=1)
            logit = logit + (target - (np.log(current) - np.log1p(-current)))[:, None]
        return logit

    def codes(self, rows: Rows) -> dict[str, I16]:
        """``[N]`` codes of the situation: ``effort`` (L where unknown) and ``duel`` (0, 1, 2 where unknown)."""
        effort, duel = self._known(rows)
        return {
            "effort": np.where(effort < 0, len(self.effort), effort).astype(np.int16),
            "duel": np.where(duel < 0, 2, duel).astype(np.int16),
        }
