"""Boosted trees over codes (LightGBM, Ke et al., NIPS 2017): as arrays that are stored and evaluated without it."""

import dataclasses
from typing import Any, ClassVar, Final, Self

import numpy as np
import numpy.typing as npt

from shuttle_marl.arrays import F64, I16, I32, Bools, Ints
from shuttle_marl.dynamics.features import SLOTS
from shuttle_marl.errors import ShuttleError
from shuttle_marl.extras import install_hint
from shuttle_marl.kernel.compiling import compiled
from shuttle_marl.tensor_files import checked

INPUTS: Final = tuple(SLOTS)
"""Attributes that trees over attribute codes read, in this order."""
PARAMETERS: Final[dict[str, Any]] = {
    "objective": "binary",
    "learning_rate": 0.05,
    "min_data_in_leaf": 100,
    "lambda_l2": 10,
    "cat_smooth": 20,
    "max_cat_to_onehot": 4,
    "deterministic": True,
    "force_row_wise": True,
    "num_threads": 1,
    "seed": 0,
    "verbose": -10,
}
_LEAVES: Final = 8
_LEAST_ROWS: Final = 40
_ROUNDS: Final = 300
"""Chosen on blind folds of the training matches among 4 leaves with 200, 400 or 600 rounds and 8 with 100, 200 or 300."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Trees:
    """T trees over codes; the leaves that a row reaches are summed.

    Node m of tree t reads one code of a row and sends the row to one of two children: a later node of the tree, or the leaf
    -1 - child.

    Attributes:
        attribute: ``[T, M]`` column of the code that a node reads; of attribute codes, the position in :data:`INPUTS`.
        left: ``[T, M]`` codes that go to the first child: bit c is set where code c does.
        child: ``[T, M, 2]`` children; those of nodes that a tree does not have are leaf 0.
        value: ``[T, M + 1]`` leaves.
    """

    ORDERED: ClassVar = False

    attribute: I32
    left: I32
    child: I32
    value: F64

    def __len__(self) -> int:
        return len(self.value)

    def logits(self, codes: dict[str, I16]) -> F64:
        """``[N]`` sums of the leaves of trees over attribute codes."""
        return self.sums(np.stack([codes[name] for name in INPUTS], axis=1))[:, 0]

    def sums(self, columns: I16, outputs: int = 1) -> F64:
        """``[N, outputs]`` sums of the leaves of codes ``[N, A]``; tree t adds to output t modulo ``outputs``."""
        return np.asarray(_sums(columns, self.attribute, self.left, self.child, self.value, self.ORDERED, outputs))

    @classmethod
    def checked(cls, arrays: dict[str, npt.NDArray[Any]], columns: int = len(INPUTS)) -> Self:
        """Trees of arrays from a file, which are to read rows of so many codes.

        Raises:
            KeyError, ValueError: they are none.
        """
        trees, nodes = arrays["attribute"].shape
        attribute, left = (checked(arrays[name], np.int32, (trees, nodes)) for name in ("attribute", "left"))
        child = checked(arrays["child"], np.int32, (trees, nodes, 2))
        value = checked(arrays["value"], np.float64, (trees, nodes + 1))
        later = child > np.arange(nodes)[:, None]
        if not nodes:
            raise ValueError("trees without a node")
        if not (((attribute >= 0) & (attribute < columns)).all() and (later | (child < 0)).all()):
            raise ValueError("a tree reads what there is not, or runs in circles")
        if not ((child >= -1 - nodes) & (child < nodes)).all():
            raise ValueError("a tree has a node whose child there is not")
        return cls(attribute=attribute, left=left, child=child, value=value)


class OrderedTrees(Trees):
    """Trees over codes that have an order: ``left`` is the greatest code that goes to the first child."""

    ORDERED: ClassVar = True


@compiled
def _sums(
    columns: I16, attribute: I32, left: I32, child: I32,
    value: F64, ordered: bool, outputs: int,
) -> F64:  # fmt: skip
    out = np.zeros((len(columns), outputs))
    for row in range(len(columns)):
        for tree in range(len(value)):
            node = np.int32(0)
            while node >= 0:
                code = columns[row, attribute[tree, node]]
                goes_left = code <= left[tree, node] if ordered else (left[tree, node] >> code) & 1 == 1
                node = child[tree, node, 0 if goes_left else 1]
            out[row, tree % outputs] += value[tree, -1 - node]
    return out


def lightgbm() -> Any:
    """The module LightGBM: what fits needs it, what plays does not.

    Raises:
        ShuttleError: it is not installed.
    """
    try:
        import lightgbm as module  # noqa: PLC0415
    except ImportError as error:
        raise ShuttleError(f"fitting trees needs LightGBM, which is not installed; {install_hint('train')}") from error
    return module


def fit_trees(
    codes: dict[str, I16],
    label: Bools,
    *,
    leaves: int = _LEAVES,
    rounds: int = _ROUNDS,
    rate: float = PARAMETERS["learning_rate"],
    offset: F64 | None = None,
) -> Trees:
    """Fit trees that predict a label.

    Args:
        codes: of N strokes.
        label: ``[N]`` what is predicted.
        leaves: greatest number of leaves of a tree.
        rounds: greatest number of trees.
        rate: share of each step that is taken.
        offset: ``[N]`` logits that the trees are to add to; None: they are to say the whole logit.

    Raises:
        ShuttleError: LightGBM is not installed.
    """
    x = np.stack([codes[name] for name in INPUTS], axis=1).astype(np.int32)
    data = lightgbm().Dataset(x, label.astype(int), init_score=offset, categorical_feature=list(range(len(INPUTS))))
    return Trees(**_fitted(data, {"num_leaves": leaves, "learning_rate": rate}, rounds))


def fit_ordered_trees(columns: I16, label: Ints, classes: int, *, leaves: int, rounds: int, rate: float,
                      features: float, seed: int) -> OrderedTrees:  # fmt: skip
    """Fit trees whose sums are the logits of classes: one tree of each class a round.

    Args:
        columns: ``[N, A]`` codes that have an order.
        label: ``[N]`` class of each row.
        classes: number of classes.
        leaves: greatest number of leaves of a tree.
        rounds: greatest number of trees of a class.
        rate: share of each step that is taken.
        features: share of the columns that each tree may read, drawn for it.
        seed: of these draws.

    Raises:
        ShuttleError: LightGBM is not installed.
    """
    data = lightgbm().Dataset(columns.astype(np.int32), label.astype(int))
    parameters = {
        "objective": "multiclass", "num_class": classes, "num_leaves": leaves, "learning_rate": rate,
        "min_data_in_leaf": _LEAST_ROWS, "feature_fraction": features, "seed": seed,
    }  # fmt: skip
    return OrderedTrees(**_fitted(data, parameters, rounds))


def _fitted(data: Any, parameters: dict[str, Any], rounds: int) -> dict[str, npt.NDArray[Any]]:
    """Arrays of fitted trees by name; a node over codes that have an order holds a number between two of them."""
    fitted = lightgbm().train({**PARAMETERS, **parameters}, data, num_boost_round=rounds).dump_model()["tree_info"]
    leaves = parameters["num_leaves"]
    shape = (len(fitted), leaves - 1)
    attribute, left = np.zeros(shape, dtype=np.int32), np.zeros(shape, dtype=np.int32)
    child, value = np.full((*shape, 2), -1, dtype=np.int32), np.zeros((len(fitted), leaves))
    for t, tree in enumerate(fitted):
        # Nodes are numbered in the order in which they were split, so children come after their parents.
        open_nodes = [tree["tree_structure"]]
        while open_nodes:
            node = open_nodes.pop()
            if "split_index" not in node:
                value[t, node.get("leaf_index", 0)] = node["leaf_value"]
                continue
            m, threshold = node["split_index"], node["threshold"]
            attribute[t, m] = node["split_feature"]
            categorical = node["decision_type"] == "=="
            left[t, m] = sum(1 << int(code) for code in str(threshold).split("||")) if categorical else int(threshold)
            for side, name in enumerate(("left_child", "right_child")):
                below = node[name]
                child[t, m, side] = below["split_index"] if "split_index" in below else -1 - below["leaf_index"]
                open_nodes.append(below)
    return {"attribute": attribute, "left": left, "child": child, "value": value}
