"""Boosted trees of LightGBM (Ke et al., NIPS 2017) as arrays, without PyTorch."""

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.base.arrays import I32
from shuttle_marl.base.extras import hinted

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


def check_nodes(attribute: I32, child: I32, inputs: int) -> None:
    """Check that nodes ``[..., M]`` test one of the inputs, and have later nodes or leaves as children.

    Raises:
        ValueError: one does not.
    """
    nodes = attribute.shape[-1]
    if not attribute.size:
        raise ValueError("trees without a node")
    later, leaf = (child > np.arange(nodes)[:, None]) & (child < nodes), (child < 0) & (child >= -1 - nodes)
    if not (((attribute >= 0) & (attribute < inputs)).all() and (later | leaf).all()):
        raise ValueError("a node of a tree has an unknown attribute, or an unknown or earlier child")


def lightgbm() -> Any:
    """LightGBM, which only fits need.

    Raises:
        ModuleNotFoundError: it is not installed.
    """
    with hinted():
        import lightgbm as module  # noqa: PLC0415
    return module


def stored_trees(booster: Any, leaves: int) -> tuple[dict[str, npt.NDArray[Any]], list[tuple[int, int, Any]]]:
    """The trees of LightGBM as arrays.

    Returns:
        ``attribute``, ``child`` and ``value`` as in :class:`Trees`; and (tree, node, threshold) of each node.
    """
    fitted = booster.dump_model()["tree_info"]
    shape = (len(fitted), leaves - 1)
    attribute = np.zeros(shape, dtype=np.int32)
    child, value = np.full((*shape, 2), -1, dtype=np.int32), np.zeros((len(fitted), leaves))
    nodes: list[tuple[int, int, Any]] = []
    for t, tree in enumerate(fitted):
        # LightGBM numbers nodes in the order of their splits, so children come after their parents.
        stack = [tree["tree_structure"]]
        while stack:
            node = stack.pop()
            if "split_index" not in node:
                value[t, node.get("leaf_index", 0)] = node["leaf_value"]
                continue
            m = node["split_index"]
            attribute[t, m] = node["split_feature"]
            nodes.append((t, m, node["threshold"]))
            for side, name in enumerate(("left_child", "right_child")):
                below = node[name]
                child[t, m, side] = below["split_index"] if "split_index" in below else -1 - below["leaf_index"]
                stack.append(below)
    return {"attribute": attribute, "child": child, "value": value}, nodes
