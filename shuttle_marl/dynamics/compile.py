"""From fitted models to the tables that everything runs on."""

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.dynamics.features import STATE, codes_of_pairs, codes_of_states
from shuttle_marl.dynamics.fitted import FittedModels
from shuttle_marl.dynamics.support import Support, is_serve_pair
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.layout import layout, thresholds
from shuttle_marl.game.rally import Game
from shuttle_marl.game.stroke import N_SHOTS, N_TECHNIQUES, Catalogue

Floats = npt.NDArray[np.float64]

LEAST_END: Final = 0.003
"""At least this share of any stroke but a serve ends the rally, so that the game contracts and no stall pays."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PairProbabilities:
    """Predictions of the models for every legal pair, ``[P]`` each, before rounding to the tables.

    Attributes:
        fault: the striker faults.
        returned: a good stroke is returned.
        above: a returned stroke is met above the net.
        clipped: the fault or the winner probability was moved into the range that the data supports.
    """

    fault: Floats
    returned: Floats
    above: Floats
    clipped: npt.NDArray[np.bool_]


def empty_game(catalogue: Catalogue, replies: npt.NDArray[np.bool_]) -> Game:
    """The layout of a game whose probabilities are not known yet."""
    tables = layout(catalogue, replies)
    return Game(catalogue=catalogue, threshold=np.zeros((int(tables["pair_start"][-1]), 3), dtype=np.uint16), **tables)


def pair_probabilities(
    models: FittedModels, game: Game, support: Support, *, pessimism: float = 0.0, striker: str | None = None,
    receiver: str | None = None,
) -> PairProbabilities:  # fmt: skip
    """Evaluate the models on every legal pair, in double precision, within what the data supports.

    Args:
        models: the models.
        game: the layout; its thresholds are not read.
        support: ranges of the probabilities of its edges.
        pessimism: lower bound of the ensemble for the striker, in standard deviations of its logits.
        striker, receiver: profiles of players; default the average.
    """
    codes = codes_of_pairs(game)
    striker_shift = models.striker.get(striker, 0.0) if striker else 0.0
    receiver_shift = models.receiver.get(receiver, 0.0) if receiver else 0.0
    fault = models.averaged(models.fault, codes, pessimism=pessimism, shift=striker_shift)
    returned = models.averaged(models.returned, codes, pessimism=pessimism, shift=receiver_shift)
    above = models.averaged(models.above, codes)
    edge = game.pair_edge
    winner = (1 - fault) * (1 - returned)
    supported_fault = np.clip(fault, support.fault_range[edge, 0], support.fault_range[edge, 1])
    supported_winner = np.clip(winner, support.winner_range[edge, 0], support.winner_range[edge, 1])
    clipped = (supported_fault != fault) | (supported_winner != winner)
    least = np.where(is_serve_pair(game), 0.0, LEAST_END)
    fault = np.maximum(supported_fault, least - supported_winner)
    winner = np.minimum(supported_winner, 1 - fault)
    return PairProbabilities(fault=fault, returned=1 - winner / (1 - fault), above=above, clipped=clipped)


def compile_game(game: Game, probabilities: PairProbabilities) -> Game:
    """The game with its thresholds."""
    table = thresholds(1 - probabilities.fault, probabilities.returned, probabilities.above)
    return dataclasses.replace(game, threshold=table)


def pair_log_choices(models: FittedModels, game: Game) -> npt.NDArray[np.float32]:
    """``[P]`` log of the probability that the average player chooses a legal stroke, before dividing by the legal total."""
    state = np.flatnonzero(game.playable)
    codes = codes_of_states(game, state)
    choice = np.full((game.n_states, N_SHOTS * N_TECHNIQUES), np.nan)
    pair_style = game.catalogue.shot[game.pair_stroke] * np.int64(N_TECHNIQUES) + game.catalogue.technique[game.pair_stroke]
    # Targets are asked for once for every state and style that occurs.
    styles, position = np.unique(game.pair_state * np.int64(N_SHOTS * N_TECHNIQUES) + pair_style, return_inverse=True)
    of_state = styles // (N_SHOTS * N_TECHNIQUES)
    rows = np.searchsorted(state, of_state)
    target_codes = {name: code[rows] for name, code in codes.items()}
    target_codes["shot"] = (styles % (N_SHOTS * N_TECHNIQUES) // N_TECHNIQUES).astype(np.int16)
    target_codes["technique"] = (styles % N_TECHNIQUES).astype(np.int16)
    total = np.zeros(game.n_pairs)
    for discipline, share in enumerate(models.share):
        of_all = {**codes, "discipline": np.full(len(state), discipline, dtype=np.int16)}
        choice[state] = models.choice({name: of_all[name] for name in STATE})
        of_targets = {**target_codes, "discipline": np.full(len(styles), discipline, dtype=np.int16)}
        target = models.targets(of_targets)
        assert target.shape == (len(styles), N_AREAS)
        total += share * choice[game.pair_state, pair_style] * target[position, game.catalogue.area[game.pair_stroke]]
    return np.log(np.maximum(total, 1e-12)).astype(np.float32)
