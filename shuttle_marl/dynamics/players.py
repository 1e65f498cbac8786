"""Choices of single players by partial pooling: shifts of the average player's logits, shrunk towards zero.

The precision of the prior, which sets the strength of the shrinkage, is chosen on the validation matches.
"""

import dataclasses
from typing import Any, Final

import numpy as np
import torch

from shuttle_marl.base.arrays import F64, I64, Bools, Ints
from shuttle_marl.dynamics.features import SLOTS, Rows
from shuttle_marl.dynamics.fitted import PlayerChoices, tilted
from shuttle_marl.dynamics.models import latent_target, softmax
from shuttle_marl.dynamics.network import Ensemble, unseen
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.stroke import N_TECHNIQUES

MIN_STROKES: Final = 1000
"""Training strokes from which a player gets a model."""
CHOICE_PRECISIONS: Final = (3.0, 10.0, 30.0, 100.0)
_TYPICAL_PRECISION: Final = {"style": 30.0, "area": 3.0}
"""Precisions that were chosen for the shipped model."""


def fit_choice_shifts(
    base: F64, cell: Ints, cells: int, player: Ints, players: int, label: Ints, precision: float
) -> F64:  # fmt: skip
    """Maximum a posteriori shifts ``[players, cells, C]`` under a normal prior.

    The shift of a player in a cell is the sum of a shift shared by all cells and one of the cell, both with prior mean zero and
    the given precision (four times that for the cell).

    Args:
        base: ``[N, C]`` probabilities of the average player, from networks that were not fitted to the match.
        cell: ``[N]`` context in which a shift applies.
        player: ``[N]`` player of each row.
        label: ``[N]`` observed choice.
        precision: of the prior.
    """
    z = torch.from_numpy(np.log(np.maximum(base, 1e-9)))
    player_index, cell_index, y = (torch.from_numpy(np.asarray(x, dtype=np.int64)) for x in (player, cell, label))
    shared = torch.zeros(players, z.shape[1], dtype=torch.float64, requires_grad=True)
    within = torch.zeros(players * cells, z.shape[1], dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.LBFGS([shared, within], max_iter=80, history_size=10, line_search_fn="strong_wolfe")

    def closure() -> torch.Tensor:
        optimiser.zero_grad()
        logits = z + shared[player_index] + within[player_index * cells + cell_index]
        loss = torch.nn.functional.cross_entropy(logits, y, reduction="sum")
        loss = loss + 0.5 * precision * (shared.square().sum() + 4 * within.square().sum())
        torch.autograd.backward(loss)
        return loss

    optimiser.step(closure)  # type: ignore[no-untyped-call]
    total = shared.detach()[:, None] + within.detach().view(players, cells, -1)
    return np.asarray(total.numpy())


def player_choices(
    networks: dict[str, Ensemble], train: Rows, validation: Rows | None, folds: int | None
) -> tuple[PlayerChoices, dict[str, Any]]:
    """Shifts of single players' choices.

    Args:
        validation: strokes of other matches, on which the precision of the prior is chosen (the strongest one where these
            players have none); None: that of the shipped model.
        folds: folds of the training matches left out by members of the networks; None: the networks were fitted to other matches.

    Returns:
        The shifts of players with enough strokes, and the precision with its score.
    """
    others = train.take(np.zeros(len(train), dtype=np.bool_)) if validation is None else validation
    strikers, counts = np.unique(train.striker, return_counts=True)
    names = tuple(str(strikers[i]) for i in np.lexsort((strikers, -counts)) if counts[i] >= MIN_STROKES)
    empty = PlayerChoices(
        players=names,
        style=np.zeros((len(names), SLOTS["incoming_shot"], SLOTS["contact"], networks["choice"].spec.outputs)),
        area=np.zeros((len(names), SLOTS["shot"], SLOTS["technique"], N_AREAS)),
    )
    if not names:
        return empty, {}
    chosen: dict[str, Any] = {}
    shifts: dict[str, F64] = {}
    for kind, name, slots in (("style", "choice", ("incoming_shot", "contact")), ("area", "target", ("shot", "technique"))):
        network = networks[name]
        every = train.take(labelled(name, train))
        members = softmax(network.logits(every.codes))
        # Over all matches, because the folds are numbered by them: some matches have none of these players.
        base = members.mean(axis=0) if folds is None else unseen(members, every.match, folds)
        own = empty.index(every.striker) >= 0
        ours, base = every.take(own), base[own]
        theirs = others.take(labelled(name, others) & (empty.index(others.striker) >= 0))
        own_label, label = (labels_of(name, rows) for rows in (ours, theirs))
        own_cell, cell = (
            rows.codes[slots[0]].astype(np.int64) * SLOTS[slots[1]] + rows.codes[slots[1]] for rows in (ours, theirs)
        )
        average = softmax(network.logits(theirs.codes)).mean(axis=0)
        player = empty.index(ours.striker)
        candidates: list[tuple[float, float, F64]] = []
        for precision in CHOICE_PRECISIONS if validation is not None else (_TYPICAL_PRECISION[kind],):
            shift = fit_choice_shifts(
                base, own_cell, SLOTS[slots[0]] * SLOTS[slots[1]], player, len(names), own_label, precision
            )  # fmt: skip
            shifted = tilted(average, shift[empty.index(theirs.striker), cell])
            candidates.append((cross_entropy(shifted, label) if len(shifted) else -precision, precision, shift))
        loss, precision, shifts[kind] = min(candidates, key=lambda candidate: candidate[0])
        chosen[kind] = {
            "precision": precision,
            "cross_entropy": loss if len(average) else None,
            "cross_entropy_of_average": cross_entropy(average, label) if len(average) else None,
        }
    style, area = shifts["style"].reshape(empty.style.shape), shifts["area"].reshape(empty.area.shape)
    return dataclasses.replace(empty, style=style, area=area), chosen


def labelled(name: str, rows: Rows) -> Bools:
    """``[N]`` rows with a known label of the network ``choice`` or ``target``."""
    return np.ones(len(rows), dtype=bool) if name == "choice" else ~latent_target(rows)


def labels_of(name: str, rows: Rows) -> I64:
    """``[N]`` label of the network: shot type and technique (``choice``), or area (``target``)."""
    if name == "target":
        return rows.codes["area"].astype(np.int64)
    return rows.codes["shot"].astype(np.int64) * N_TECHNIQUES + rows.codes["technique"]


def cross_entropy(p: F64, label: I64) -> float:
    """Mean cross-entropy of probabilities ``[N, C]``, in nats."""
    return float(-np.log(p[np.arange(len(p)), label]).mean())
