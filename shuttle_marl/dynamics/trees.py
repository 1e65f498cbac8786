"""The yardstick: gradient-boosted trees on the same rows and the same features (LightGBM, Ke et al., NIPS 2017)."""

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.dynamics.features import Codes
from shuttle_marl.dynamics.training import fold_of_match
from shuttle_marl.errors import ShuttleError

_FOLDS: Final = 5
_PARAMETERS: Final[dict[str, Any]] = {
    "objective": "binary",
    "learning_rate": 0.05,
    "min_data_in_leaf": 100,
    "lambda_l2": 10,
    "cat_smooth": 20,
    "max_cat_to_onehot": 4,
    "deterministic": True,
    "force_row_wise": True,
    "num_threads": 2,
    "seed": 0,
    "verbose": -10,
}
_LEAVES: Final = (8, 15)


def tree_predictions(
    names: tuple[str, ...],
    train: dict[str, Codes],
    label: npt.NDArray[np.bool_],
    match: npt.NDArray[np.integer],
    test: dict[str, Codes],
) -> npt.NDArray[np.float64]:
    """Fit on train, predict on test. Number of leaves and of rounds are chosen by cross-validation over matches.

    Args:
        names: slots that the trees read, all categorical.
        train, test: their codes.
        label: ``[N]`` what to predict, on the rows of train.
        match: ``[N]`` match of each row of train.

    Returns:
        ``[M]`` chances on the rows of test.

    Raises:
        ShuttleError: LightGBM is not installed.
    """
    try:
        import lightgbm as lgb  # noqa: PLC0415  an oracle of the evaluation, not needed to play
    except ImportError as error:
        raise ShuttleError("the comparison with trees needs LightGBM: pip install 'shuttle-marl[test]'") from error
    x = np.stack([train[name] for name in names], axis=1).astype(np.int32)
    categorical = list(range(len(names)))
    fold = fold_of_match(match, _FOLDS)
    folds = [(np.flatnonzero(fold != k), np.flatnonzero(fold == k)) for k in range(_FOLDS)]
    best: tuple[float, int, int] | None = None
    for leaves in _LEAVES:
        data = lgb.Dataset(x, label.astype(int), categorical_feature=categorical, free_raw_data=False)
        history: Any = lgb.cv(
            {**_PARAMETERS, "num_leaves": leaves},
            data,
            num_boost_round=1500,
            folds=folds,
            callbacks=[lgb.early_stopping(40, verbose=False)],
        )
        losses = history["valid binary_logloss-mean"]
        candidate = (losses[-1], leaves, len(losses))
        best = candidate if best is None else min(best, candidate)
    assert best is not None
    data = lgb.Dataset(x, label.astype(int), categorical_feature=categorical, free_raw_data=False)
    booster = lgb.train({**_PARAMETERS, "num_leaves": best[1]}, data, num_boost_round=best[2])
    rows = np.stack([test[name] for name in names], axis=1).astype(np.int32)
    return np.asarray(booster.predict(rows), dtype=np.float64)
