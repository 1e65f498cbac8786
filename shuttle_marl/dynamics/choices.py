"""Choices that differ from the average player's: shifts of their logits, shrunk towards zero.

Those of a player (:func:`player_choices`) are shrunk as the validation matches choose. Those by the rally so far
(:func:`fit_history`) add up: by the strokes three and four before, which the state no longer holds (shot type, area, technique),
by the number of the stroke, and by the score. They shift out-of-fold predictions of the average player's networks; small networks
over all four strokes predict unseen matches no better. :mod:`shuttle_marl.policy.baselines` plays with them.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import torch

from shuttle_marl.base.arrays import F64, I64, Ints
from shuttle_marl.dynamics.features import SLOTS, Rows
from shuttle_marl.dynamics.fitted import PlayerChoices, tilted
from shuttle_marl.dynamics.models import labelled, labels_of, softmax, unseen
from shuttle_marl.dynamics.modules import Ensemble
from shuttle_marl.game.court import N_AREAS, mirrored
from shuttle_marl.game.policy import STAGES, stages_of
from shuttle_marl.game.stroke import N_SHOTS

MIN_STROKES: Final = 1000
CHOICE_PRECISIONS: Final = (3.0, 10.0, 30.0, 100.0)
_TYPICAL_PRECISION: Final = {"style": 30.0, "area": 3.0}  # precisions that were chosen for the shipped model
Arrays = dict[str, npt.NDArray[np.float16]]
_NONE: Final = {name: SLOTS[f"own_{name}"] - 2 for name in ("shot", "area", "technique")}  # code of no stroke
_LAGGED: Final = 2 * len(_NONE)
_SIZES: Final = np.array([*np.repeat(list(_NONE.values()), 2) + 1, *STAGES.values()])
"""Rows of each table of shifts: of an attribute of the strokes three and four before, and of a stage."""
_PRECISIONS: Final = (*_LAGGED * (100.0,), 30.0, 100.0)
"""Precision of the prior of each table, by the log-loss on the validation matches: of 30 to 500 for strokes, of 10 to 300 for
stages, where halves of the training matches decided between those that the validation matches do not tell apart."""


def fit_shifts(base: F64, label: Ints, rows: Sequence[Ints], sizes: Sequence[int], precisions: Sequence[float]) -> list[F64]:
    """Maximum a posteriori tables of shifts ``[size, C]`` that are looked up and added up, under a normal prior of mean zero.

    Args:
        base: ``[N, C]`` probabilities without shifts.
        label: ``[N]`` observed choice.
        rows: for each table ``[N]`` rows that apply, -1 for none.
        sizes: number of rows of each table.
        precisions: precision of the prior of each table.
    """
    z = torch.from_numpy(np.log(np.maximum(base, 1e-9)))
    y, *index = (torch.from_numpy(np.asarray(each, dtype=np.int64)) for each in (label, *rows))
    tables = [torch.zeros(size, z.shape[1], dtype=torch.float64, requires_grad=True) for size in sizes]
    index = [at % (size + 1) for at, size in zip(index, sizes, strict=True)]
    optimiser = torch.optim.LBFGS(tables, max_iter=80, history_size=10, line_search_fn="strong_wolfe")

    def closure() -> torch.Tensor:
        optimiser.zero_grad()
        logits = z
        for table, at in zip(tables, index, strict=True):
            logits = logits + torch.nn.functional.embedding(at, torch.nn.functional.pad(table, (0, 0, 0, 1)))
        loss = torch.nn.functional.cross_entropy(logits, y, reduction="sum")
        for table, precision in zip(tables, precisions, strict=True):
            loss = loss + 0.5 * precision * table.square().sum()
        torch.autograd.backward(loss)
        return loss

    optimiser.step(closure)  # type: ignore[no-untyped-call]
    return [np.asarray(table.detach().numpy()) for table in tables]


class Choices(NamedTuple):
    """Observed choices among C, with what decides the shift."""

    average: F64  # ``[N, C]`` probabilities of the average player, from networks that were not fitted to the match
    cell: I64  # ``[N]`` context in which a shift applies
    player: I64  # ``[N]`` player
    label: I64  # ``[N]`` observed choice

    def shifts(self, cells: int, players: int, precision: float) -> F64:
        """Maximum a posteriori shifts ``[players, cells, C]`` under a normal prior; each is the sum of one that all cells share
        and one of the cell, both with prior mean zero and the given precision (four times that for the cell)."""
        rows = self.player, self.player * cells + self.cell
        shared, within = fit_shifts(self.average, self.label, rows, (players, players * cells), (precision, 4 * precision))
        return np.asarray(shared[:, None] + within.reshape(players, cells, -1))

    def cross_entropy(self, shift: F64 | None = None) -> float:
        """Mean cross-entropy of the average player, or with shifts ``[players, cells, C]``, in nats."""
        p = self.average if shift is None else tilted(self.average, shift[self.player, self.cell])
        return float(-np.log(p[np.arange(len(p)), self.label]).mean())


def best_shifts(
    ours: Choices, others: Choices, cells: int, players: int, precisions: Sequence[float] = CHOICE_PRECISIONS
) -> tuple[float, float, F64]:
    """Cross-entropy on other choices, precision, and shifts of the best precision; without others of the largest one."""
    candidates: list[tuple[float, float, F64]] = []
    for precision in precisions:
        shift = ours.shifts(cells, players, precision)
        candidates.append((others.cross_entropy(shift) if len(others.label) else -precision, precision, shift))
    return min(candidates, key=lambda candidate: candidate[0])


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
    others = train.take(np.zeros(len(train), np.bool_)) if validation is None else validation
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
        theirs = others.take(labelled(name, others) & (empty.index(others.striker) >= 0))
        average = softmax(network.logits(theirs.codes)).mean(axis=0)

        def choices(rows: Rows, average: F64, name: str = name, slots: tuple[str, str] = slots) -> Choices:
            cell = rows.codes[slots[0]].astype(np.int64) * SLOTS[slots[1]] + rows.codes[slots[1]]
            return Choices(average, cell, empty.index(rows.striker), labels_of(name, rows))

        known = choices(theirs, average)
        precisions = CHOICE_PRECISIONS if validation is not None else (_TYPICAL_PRECISION[kind],)
        loss, precision, shifts[kind] = best_shifts(
            choices(every.take(own), base[own]), known, SLOTS[slots[0]] * SLOTS[slots[1]], len(names), precisions
        )
        chosen[kind] = {
            "precision": precision,
            "cross_entropy": loss if len(average) else None,
            "cross_entropy_of_average": known.cross_entropy() if len(average) else None,
        }
    style, area = shifts["style"].reshape(empty.style.shape), shifts["area"].reshape(empty.area.shape)
    return dataclasses.replace(empty, style=style, area=area), chosen


def fit_history(
    networks: dict[str, Ensemble], train: Rows, validation: Rows | None, folds: int
) -> tuple[Arrays, dict[str, dict[str, float]]]:
    """Fit the shifts.

    Args:
        networks: choices of the average player.
        train, validation: all strokes of some matches, in playing order; None: no scores.
        folds: folds of the training matches left out by members of the networks.

    Returns:
        Arrays of :class:`shuttle_marl.policy.baselines.HistoryPolicy`; and for ``choice`` and ``target`` the mean
        ``cross_entropy`` on the validation matches and that ``of_average``, in nats.
    """
    parts, scores = [], dict[str, dict[str, float]]()
    for name in ("choice", "target"):
        base, label, values = _choices(name, networks[name], train, folds)
        tables = fit_shifts(base, label, list(values), _SIZES.tolist(), _PRECISIONS)
        parts.append([*(np.stack(tables[i : i + 2]) for i in range(0, _LAGGED, 2)), *tables[_LAGGED:]])
        if validation is not None:
            base, label, values = _choices(name, networks[name], validation, None)
            shift = sum(np.pad(table, ((0, 1), (0, 0)))[value] for table, value in zip(tables, values, strict=True))
            losses = (float(-np.log(p[np.arange(len(p)), label]).mean()) for p in (tilted(base, np.asarray(shift)), base))
            scores[name] = dict(zip(("cross_entropy", "of_average"), losses, strict=True))
    arrays = (np.concatenate(both, axis=-1).astype(np.float16) for both in zip(*parts, strict=True))
    return dict(zip((*_NONE, *STAGES), arrays, strict=True)), scores


def _choices(name: str, network: Ensemble, rows: Rows, folds: int | None) -> tuple[F64, I64, I64]:
    """``[N, C]`` probabilities of the average player (out-of-fold, unless ``folds`` is None), ``[N]`` label, and ``[8, N]``
    attributes of the earlier strokes, each of lag 3 and 4, and stages, for choices after known strokes. Areas are named as a game
    does."""
    which = labelled(name, rows)
    values, rows = _remembered(rows)[:, which], rows.take(which)
    members = softmax(network.logits(rows.codes))
    base = members.mean(axis=0) if folds is None else unseen(members, rows.match, folds)
    label = labels_of(name, rows)
    if name == "target":
        opposite = rows.codes["hands"] == 1
        base[opposite] = base[opposite][:, mirrored(np.arange(N_AREAS))]
        label = rows.game_codes["area"].astype(np.int64)
    known = (values < _SIZES[:, None]).all(axis=0)
    return base[known], label[known], values[:, known]


def _remembered(rows: Rows) -> I64:
    """``[8, N]`` attributes of the strokes three and four before, one above the code of none where they are unknown; stages."""
    codes = rows.game_codes
    # Where the striker's last stroke is known, it is two rows before, with the strokes before it.
    same = codes["own_shot"] < N_SHOTS
    lagged = [
        np.where(same, np.roll(codes[f"{who}_{name}"], 2), np.where(rows.stroke <= 2, none, none + 1)).astype(np.int64)
        for name, none in _NONE.items()
        for who in ("incoming", "own")
    ]
    return np.stack([*lagged, *stages_of(rows.stroke, rows.points).values()])
