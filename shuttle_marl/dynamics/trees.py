"""Boosted trees over attribute codes (LightGBM, Ke et al., NIPS 2017), stored as arrays and evaluated without LightGBM.

They are evaluated with bit masks of the reachable leaves (QuickScorer, Lucchese et al., SIGIR 2015).
"""

from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from shuttle_marl.base.arrays import F64, I16, I32, U8, Bools
from shuttle_marl.base.tensor_files import checked
from shuttle_marl.dynamics.boosting import PARAMETERS, check_nodes, lightgbm, stored_trees
from shuttle_marl.dynamics.features import SLOTS
from shuttle_marl.dynamics.network import attributes, in_chunks

_LOWEST: Final = np.array([0, *((bits & -bits).bit_length() - 1 for bits in range(1, 256))])
"""``[256]`` position of the lowest bit."""
INPUTS: Final = tuple(SLOTS)
"""Inputs of the trees, in this order."""
_LEAVES: Final = 8
_ROUNDS: Final = 300
"""Chosen by cross-validation over the training matches: 4 leaves with 200, 400 or 600 rounds, 8 with 100, 200 or 300."""


class Trees(nn.Module):
    """T trees over attribute codes; their prediction is the sum of the leaves that a row reaches.

    Node m of tree t tests one code of a row and sends the row to one of two children: a later node of the tree, or leaf
    -1 - child. The trees themselves are :attr:`arrays`.

    Args:
        attribute: ``[T, M]`` attribute that a node tests, as an index into :data:`INPUTS`.
        left: ``[T, M]`` bit mask of the codes that go to the first child.
        child: ``[T, M, 2]`` children; unused nodes have leaf 0.
        value: ``[T, M + 1]`` leaves.
    """

    masks: Tensor
    """``[attributes, codes, T]`` uint8 leaves that a tree can still reach, one bit each, by the code of one attribute."""
    leaves: Tensor
    """``[T * 256]`` leaf of each tree by the bits of those that are left."""

    def __init__(self, *, attribute: I32, left: I32, child: I32, value: F64) -> None:
        super().__init__()
        self.arrays: dict[str, npt.NDArray[Any]] = {"attribute": attribute, "left": left, "child": child, "value": value}
        nodes = np.minimum(_LOWEST, value.shape[1] - 1)
        self.register_buffer("masks", torch.from_numpy(_masks(attribute, left, child)))
        self.register_buffer("leaves", torch.from_numpy(value[:, nodes].ravel()))

    def __len__(self) -> int:
        return self.masks.shape[2]

    def forward(self, codes: Tensor) -> Tensor:
        """``[N]`` sums of leaves, from ``[N, 15]`` codes: those are left that no test of a tree removes (QuickScorer)."""
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
        """Trees from the arrays of a file.

        Raises:
            KeyError, ValueError: an array is missing or invalid.
        """
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


def fit_trees(
    codes: dict[str, I16],
    label: Bools,
    *,
    leaves: int = _LEAVES,
    rounds: int = _ROUNDS,
    rate: float = PARAMETERS["learning_rate"],
    offset: F64 | None = None,
) -> Trees:
    """Fit trees that predict a binary label.

    Args:
        offset: ``[N]`` logits to which those of the trees are added; None: no offset.
    """
    lgb = lightgbm()
    x = attributes(codes).numpy()
    data = lgb.Dataset(x, label.astype(int), init_score=offset, categorical_feature=list(range(len(INPUTS))))
    parameters = {**PARAMETERS, "num_leaves": leaves, "learning_rate": rate}
    arrays, nodes = stored_trees(lgb.train(parameters, data, num_boost_round=rounds), leaves)
    left = np.zeros(arrays["attribute"].shape, dtype=np.int32)
    for t, m, threshold in nodes:
        left[t, m] = sum(1 << int(code) for code in threshold.split("||"))
    return Trees(left=left, **arrays)
