"""Choices by the two strokes of a rally that the state no longer holds: shifts of the average player's logits.

The shifts of the strokes three and four before (shot type, area, technique) add up, and are shrunk towards zero. The strokes one
and two before are inputs of the average player's networks, whose out-of-fold predictions are shifted. Small networks over all
four strokes predict unseen matches no better. :mod:`shuttle_marl.policy.history` plays with the shifts.
"""

from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.base.arrays import F64, I64
from shuttle_marl.dynamics.features import SLOTS, Rows
from shuttle_marl.dynamics.fitted import ModelError, tilted
from shuttle_marl.dynamics.models import labelled, labels_of, softmax
from shuttle_marl.dynamics.network import Ensemble, unseen
from shuttle_marl.dynamics.players import fit_shifts
from shuttle_marl.game.court import N_AREAS, mirrored
from shuttle_marl.game.shipped import HISTORY, read_model
from shuttle_marl.game.stroke import N_SHOTS

Arrays = dict[str, npt.NDArray[np.float16]]
_PRECISION: Final = 100.0
"""Of 30, 100, 200, 300 and 500, the precision of the prior with the lowest log-loss on the validation matches."""
_NONE: Final = {name: SLOTS[f"own_{name}"] - 2 for name in ("shot", "area", "technique")}
"""Code of the attributes where there was no stroke."""


def fit_history(
    networks: dict[str, Ensemble], train: Rows, validation: Rows | None, folds: int
) -> tuple[Arrays, dict[str, dict[str, float]]]:
    """Fit the shifts.

    Args:
        networks: choices of the average player.
        train, validation: all strokes of some matches, in playing order; None: no scores.
        folds: folds of the training matches left out by members of the networks.

    Returns:
        Arrays of :class:`shuttle_marl.policy.history.HistoryPolicy`; and for ``choice`` and ``target`` the mean ``cross_entropy``
        on the validation matches and that ``of_average``, in nats.
    """
    parts, scores = [], dict[str, dict[str, float]]()
    sizes = [none + 1 for none in _NONE.values() for _ in range(2)]
    for name in ("choice", "target"):
        base, label, values = _choices(name, networks[name], train, folds)
        tables = fit_shifts(base, label, list(values), sizes, [_PRECISION] * len(sizes))
        parts.append([np.stack(tables[i : i + 2]) for i in range(0, len(tables), 2)])
        if validation is not None:
            base, label, values = _choices(name, networks[name], validation, None)
            shift = sum(table[value] for table, value in zip(tables, values, strict=True))
            losses = (float(-np.log(p[np.arange(len(p)), label]).mean()) for p in (tilted(base, np.asarray(shift)), base))
            scores[name] = dict(zip(("cross_entropy", "of_average"), losses, strict=True))
    arrays = (np.concatenate(both, axis=-1).astype(np.float16) for both in zip(*parts, strict=True))
    return dict(zip(_NONE, arrays, strict=True)), scores


def load_history(folder: Path) -> Arrays:
    """The shifts of a model folder.

    Raises:
        ModelError: the file is missing, or differs from the model card.
    """
    try:
        return read_model(folder, HISTORY).arrays
    except (OSError, KeyError, ValueError) as error:
        raise ModelError(f"{folder / HISTORY}: no readable choices ({error}); fit or install the model again") from error


def _choices(name: str, network: Ensemble, rows: Rows, folds: int | None) -> tuple[F64, I64, I64]:
    """Choices after known strokes.

    Returns:
        ``[N, C]`` probabilities of the average player (out-of-fold, unless ``folds`` is None), ``[N]`` label, and ``[6, N]`` the
        attributes of the earlier strokes, each of lag 3 and 4. Areas are named as a game does.
    """
    which = labelled(name, rows)
    values, rows = _remembered(rows)[:, which], rows.take(which)
    members = softmax(network.logits(rows.codes))
    base = members.mean(axis=0) if folds is None else unseen(members, rows.match, folds)
    label = labels_of(name, rows)
    if name == "target":
        opposite = rows.codes["hands"] == 1
        base[opposite] = base[opposite][:, mirrored(np.arange(N_AREAS))]
        label = rows.game_codes["area"].astype(np.int64)
    known = (values <= np.repeat(list(_NONE.values()), 2)[:, None]).all(axis=0)
    return base[known], label[known], values[:, known]


def _remembered(rows: Rows) -> I64:
    """``[6, N]`` attributes of the strokes three and four before; one above the code of none where they are unknown."""
    codes = rows.game_codes
    # Where the striker's last stroke is known, it is two rows before, with the strokes before it.
    same = codes["own_shot"] < N_SHOTS
    return np.stack([
        np.where(same, np.roll(codes[f"{who}_{name}"], 2), np.where(rows.stroke <= 2, none, none + 1)).astype(np.int64)
        for name, none in _NONE.items()
        for who in ("incoming", "own")
    ])  # fmt: skip
