"""Profiles of single players by partial pooling: shifts towards the strokes of each, shrunk towards those of all.

The strength of the shrinkage is chosen on matches that the fit did not see, so a player is only as particular as the data
supports.
"""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
import torch

from shuttle_marl.arrays import F64, I16, I64, Bools, Ints

LEAST_STROKES: Final = 1000
"""A player with at least so many training strokes gets a model of their own."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PlayerChoices:
    """Choices of M players, as shifts of those of the average.

    Attributes:
        players: identifiers.
        style: ``[M, 15, 2, 39]`` shifts of the logits of shot type and technique, by incoming shot type and contact.
        area: ``[M, 13, 3, 9]`` shifts of the logits of the target, by shot type and technique.
    """

    players: tuple[str, ...]
    style: F64
    area: F64

    def shifted_choice(self, choice: F64, codes: dict[str, I16], player: Ints) -> F64:
        """``[N, 39]`` probabilities of the average moved to those of each row's player (-1: the average)."""
        if not self.players:
            return choice
        shift = self.style[player, codes["incoming_shot"], codes["contact"]]
        return _tilted(choice, np.where((player < 0)[:, None], 0.0, shift))

    def shifted_targets(self, targets: F64, codes: dict[str, I16], player: Ints) -> F64:
        """``[N, 9]`` likewise for the targets."""
        if not self.players:
            return targets
        shift = self.area[player, codes["shot"], codes["technique"]]
        return _tilted(targets, np.where((player < 0)[:, None], 0.0, shift))

    def index(self, players: npt.NDArray[np.str_]) -> I64:
        """``[N]`` position of each player, -1 for players without own model."""
        position = {player: i for i, player in enumerate(self.players)}
        return np.array([position.get(player, -1) for player in players.tolist()], dtype=np.int64)


def _tilted(probabilities: F64, shift: F64) -> F64:
    z = probabilities * np.exp(shift)
    return np.asarray(z / z.sum(axis=-1, keepdims=True))


def fit_choice_shifts(
    base: F64, cell: Ints, cells: int, player: Ints, players: int,
    label: Ints, precision: float,
) -> F64:  # fmt: skip
    """Most probable shifts ``[players, cells, C]`` under a normal prior.

    The shift of a player in a cell is the sum of one that holds in every cell and one of the cell, both with prior mean
    zero and the given precision (four times that for the cell's own).

    Args:
        base: ``[N, C]`` probabilities of the average player on each row, from networks that did not see its match.
        cell: ``[N]`` context in which a shift holds.
        cells: number of contexts.
        player: ``[N]`` player of each row.
        players: number of players.
        label: ``[N]`` what was chosen.
        precision: of the prior.
    """
    z = torch.from_numpy(np.log(np.maximum(base, 1e-9)))
    who, where, y = (torch.from_numpy(np.asarray(x, dtype=np.int64)) for x in (player, cell, label))
    everywhere = torch.zeros(players, z.shape[1], dtype=torch.float64, requires_grad=True)
    within = torch.zeros(players * cells, z.shape[1], dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.LBFGS([everywhere, within], max_iter=80, history_size=10, line_search_fn="strong_wolfe")

    def closure() -> torch.Tensor:
        optimiser.zero_grad()
        logits = z + everywhere[who] + within[who * cells + where]
        loss = torch.nn.functional.cross_entropy(logits, y, reduction="sum")
        loss = loss + 0.5 * precision * (everywhere.square().sum() + 4 * within.square().sum())
        torch.autograd.backward(loss)
        return loss

    optimiser.step(closure)  # type: ignore[no-untyped-call]
    total = everywhere.detach()[:, None] + within.detach().view(players, cells, -1)
    return np.asarray(total.numpy())


def fit_logit_shifts(logit: F64, label: Bools, player: Ints, precision: float) -> F64:
    """Most probable shift of a logit for each player (``[max + 1]``) under a normal prior, by Newton's method."""
    n = int(player.max()) + 1
    shift = np.zeros(n)
    for _ in range(30):
        p = 1 / (1 + np.exp(-(logit + shift[player])))
        gradient = np.bincount(player, weights=label - p, minlength=n) - precision * shift
        shift += gradient / (np.bincount(player, weights=p * (1 - p), minlength=n) + precision)
    return shift


def with_enough_strokes(players: npt.NDArray[np.str_]) -> Sequence[str]:
    """Players with at least :data:`LEAST_STROKES` rows, most first."""
    names, counts = np.unique(players, return_counts=True)
    order = np.lexsort((names, -counts))
    return [str(names[i]) for i in order if counts[i] >= LEAST_STROKES]
