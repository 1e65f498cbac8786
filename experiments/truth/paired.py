"""Paired comparison of two games on the same matches: differences of slopes, and of the log-loss of V."""

from pathlib import Path

import numpy as np
from safetensors.numpy import load_file, save

from experiments.truth.decisions import (
    Promises,
    centred,
    contact_log_losses,
    fault_log_losses,
    outcomes,
    value_log_losses,
)
from experiments.truth.matches import RESAMPLES, Strokes, ratio_by_match
from shuttle_marl.base.arrays import F64
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import replace_file


def save_values(path: Path, strokes: Strokes, promised: Promises) -> None:
    """Write the promises of a game for N strokes."""
    arrays = {**vars(promised), "result": strokes.result, "number": strokes.number}
    replace_file(path, save(arrays))


def load_values(path: Path, strokes: Strokes) -> Promises:
    """Promises written by :func:`save_values` for the same strokes.

    Raises:
        ShuttleError: the file cannot be read, or is of other strokes.
    """
    try:
        arrays = load_file(path)
        if not all(np.array_equal(arrays[name], getattr(strokes, name)) for name in ("result", "number")):
            raise ShuttleError(f"{path}: values of other strokes; expected the same matches, parts and seed")
        # Files of the game before hurried strikers have no forecasts of faults and contacts.
        unknown = np.full(len(strokes), np.nan)
        forecasts = {name: arrays.get(name, unknown) for name in ("fault", "returned", "above", "hurried")}
        return Promises(value=arrays["value"], advantage=arrays["advantage"], **forecasts)
    except (OSError, KeyError, ValueError) as error:
        raise ShuttleError(f"{path}: no readable values ({error}); write them with --values") from error


def differences(strokes: Strokes, ours: Promises, theirs: Promises, seed: int = 0) -> dict[str, dict[str, float]]:
    """Differences ours - theirs, with 95 % intervals by a bootstrap over matches.

    Args:
        strokes: N strokes.
        ours, theirs: promises of two games; only strokes that both know count.
        seed: random seed of the bootstrap.

    Returns:
        ``value``, ``low`` and ``high`` of ``slope_1`` … ``slope_end``, and of ``value_log_loss``, ``fault_log_loss`` and
        ``contact_log_loss`` (nats a stroke; the last two where both know them).
    """
    both = np.isfinite(ours.advantage) & np.isfinite(theirs.advantage)
    out = {}
    for (name, our_outcome), (_, their_outcome) in zip(outcomes(strokes, ours), outcomes(strokes, theirs), strict=True):
        among = both & np.isfinite(our_outcome) & np.isfinite(their_outcome)
        x, y, match = centred(strokes, ours, our_outcome, among)
        u, v, _ = centred(strokes, theirs, their_outcome, among)
        matches, index = np.unique(match, return_inverse=True)
        sums = np.stack([np.bincount(index, product) for product in (x * y, x * x, u * v, u * u)])
        draws = np.random.default_rng(seed).integers(0, len(matches), (RESAMPLES, len(matches)))
        low, high = np.quantile(_slopes(sums[:, draws].sum(axis=-1)), [0.025, 0.975])
        out[f"slope_{name}"] = {"value": float(_slopes(sums.sum(axis=-1))), "low": float(low), "high": float(high)}
    for name, losses in (("value", value_log_losses), ("fault", fault_log_losses), ("contact", contact_log_losses)):
        change = losses(strokes, ours) - losses(strokes, theirs)
        used = np.isfinite(change)
        if used.any():
            out[f"{name}_log_loss"] = ratio_by_match(change[used], np.ones(int(used.sum())), strokes.rows.match[used], seed)
    return out


def _slopes(sums: F64) -> F64:
    return np.asarray(sums[0] / sums[1] - sums[2] / sums[3])
