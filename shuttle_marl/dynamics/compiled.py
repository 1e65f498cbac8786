"""Fitted models compiled to the tables of a game, within what the training matches support.

**Catalogue.** A stroke is in it if at least 3 % of its shot type's good strokes go to its area, at least 2 % are played
with its height and technique, and at least 15 good strokes are exactly it.

**Legality.** A stroke may answer an incoming stroke if its shot type, height and technique were played at least five times
against that shot type in that area; if nothing was from one of the contacts, against that shot type anywhere; if still
nothing, against anything.

**Extremes.** How often strokes fault and win is counted in cells, each inside the one before: the shot type and area; the
whole stroke; the same against one incoming shot type; the same against one incoming shot type and area. A cell's rate is
shrunk to that of the cell around it with the weight of 40 strokes. The predicted probability of a fault and of a winner of a
legal pair must lie inside the central 90 % of the Beta posterior of its innermost cell; it is moved to the nearest end
otherwise (Beta with Jeffreys' half event on either side). A cell without strokes of its own thus still has the width of
40 strokes. A cell holds strokes of every effort, in short duels and long ones, so it bounds the mean over these situations,
as often as they occur after the own last shot type, and not the probability in each.
"""

import dataclasses
from typing import Final

import numpy as np
from scipy.stats import beta

from shuttle_marl.arrays import F32, F64, I64, Bools, Ints
from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.features import STATE, Rows, codes_of_pairs, codes_of_states
from shuttle_marl.dynamics.fitted import FittedModels
from shuttle_marl.dynamics.models import log_odds, sigmoid
from shuttle_marl.dynamics.situations import LONG_DUEL
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.stroke import N_SHOTS, N_TECHNIQUES, Catalogue
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import base_pairs, layout, thresholds
from shuttle_marl.game.thresholds import ONE

AREA_SHARE: Final = 0.03
TECHNIQUE_SHARE: Final = 0.02
LEAST_STROKES: Final = 15
LEAST_REPLIES: Final = 5
PRIOR_STROKES: Final = 40.0
CREDIBLE: Final = 0.90


def catalogue_of(rows: Rows) -> Catalogue:
    """The strokes with enough support among good strokes; order: shot type, area, height, technique."""
    good = rows.take((rows.outcome != Outcome.FAULT) & (rows.codes["area"] >= 0))
    c = {name: good.codes[name].astype(np.int64) for name in ("shot", "area", "contact", "technique")}
    count = np.zeros((N_SHOTS, N_AREAS, 2, N_TECHNIQUES), dtype=np.int64)
    np.add.at(count, (c["shot"], c["area"], c["contact"], c["technique"]), 1)
    total = np.maximum(count.sum(axis=(1, 2, 3)), 1)
    in_area = count.sum(axis=(2, 3)) / total[:, None] >= AREA_SHARE
    in_style = count.sum(axis=1) / total[:, None, None] >= TECHNIQUE_SHARE
    kept = np.argwhere((count >= LEAST_STROKES) & in_area[:, :, None, None] & in_style[:, None])
    return Catalogue(*(np.ascontiguousarray(column, dtype=np.int8) for column in kept.T))


def replies_of(rows: Rows, catalogue: Catalogue) -> Bools:
    """``[n + 1, n]`` which stroke may answer which (row n: at the start); see the rule in the module's first lines."""
    n = len(catalogue)
    count = np.zeros((N_SHOTS + 2, N_AREAS + 2, N_SHOTS, 2, N_TECHNIQUES), dtype=np.int64)
    names = ("incoming_shot", "incoming_area", "shot", "contact", "technique")
    np.add.at(count, tuple(rows.codes[name].astype(np.int64) for name in names), 1)
    seen = count[:N_SHOTS, :N_AREAS]
    style = (catalogue.shot, catalogue.height, catalogue.technique)
    anywhere, anything = seen.sum(axis=1), seen.sum(axis=(0, 1))
    replies = np.zeros((n + 1, n), dtype=bool)
    replies[n] = catalogue.is_serve
    for y in range(n):
        for contact in (0, 1):
            candidates = (catalogue.height == contact) & ~catalogue.is_serve
            shot, area = catalogue.shot[y], catalogue.area[y]
            for support in (seen[shot, area], anywhere[shot], anything):
                allowed = candidates & (support[style] >= LEAST_REPLIES)
                if allowed.any():
                    replies[y] |= allowed
                    break
    return replies


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Support:
    """Support in the data for every edge x -> y of a game, when y answers x.

    Attributes:
        strokes: ``[E]`` strokes in the innermost cell (of faults with unknown target: the expected number).
        faults, winners: ``[E]`` of these.
        fault_range, winner_range: ``[E, 2]`` bounds of the predicted probabilities.
    """

    strokes: F64
    faults: F64
    winners: F64
    fault_range: F64
    winner_range: F64


def support_of(rows: Rows, targets: F64, game: Game) -> Support:
    """Count the cells of every edge.

    Args:
        rows: strokes of known outcome.
        targets: ``[N, 9]`` probability of each intended target; one-hot where it is known.
        game: the layout.
    """
    which, area = np.nonzero(targets > 0)
    weight = targets[which, area]
    c = {name: code[which].astype(np.int64) for name, code in rows.codes.items()}
    fault = weight * (rows.outcome[which] == Outcome.FAULT)
    winner = weight * (rows.outcome[which] == Outcome.WINNER)
    catalogue, n = game.catalogue, game.n_strokes
    own, stroke = game.edge_own, game.edge_incoming
    e_shot, e_area, e_height, e_technique = (
        np.append(getattr(catalogue, a), 0).astype(np.int64)[stroke] for a in ("shot", "area", "height", "technique")
    )
    # An edge names the stroke that is answered (its "own" end is the incoming stroke of the one who answers).
    e_in_shot = np.append(catalogue.shot, N_SHOTS).astype(np.int64)[own]
    e_in_area = np.append(catalogue.area, N_AREAS).astype(np.int64)[own]
    stroke_key = _key((c["shot"], area, c["contact"], c["technique"]))
    edge_key = _key((e_shot, e_area, e_height, e_technique))
    levels = (
        (c["shot"], e_shot),
        (_key((c["shot"], area)), _key((e_shot, e_area))),
        (stroke_key, edge_key),
        (_key((stroke_key, c["incoming_shot"])), _key((edge_key, e_in_shot))),
        (_key((stroke_key, c["incoming_shot"], c["incoming_area"])), _key((edge_key, e_in_shot, e_in_area))),
    )
    ranges = []
    for events in (fault, winner):
        rate = np.full(len(stroke), events.sum() / weight.sum())
        for level, (of_row, of_edge) in enumerate(levels):
            total, hits = _looked_up(of_row, weight, of_edge), _looked_up(of_row, events, of_edge)
            a, b = hits + PRIOR_STROKES * rate, total - hits + PRIOR_STROKES * (1 - rate)
            if level < len(levels) - 1:
                rate = a / (a + b)
        # Half a fault and half a good stroke more (Jeffreys): never to have seen an event does not exclude it.
        a, b = a + 0.5, b + 0.5
        tail = (1 - CREDIBLE) / 2
        ranges.append(np.stack([beta.ppf(tail, a, b), beta.ppf(1 - tail, a, b)], axis=1))
    innermost = levels[-1]
    strokes, faults, winners = (_looked_up(innermost[0], v, innermost[1]) for v in (weight, fault, winner))
    ranges[0][stroke == n] = ranges[1][stroke == n] = (0.0, 1.0)
    return Support(strokes=strokes, faults=faults, winners=winners, fault_range=ranges[0], winner_range=ranges[1])


def is_serve_pair(game: Game) -> Bools:
    """``[base pairs]`` whether the stroke of a base pair is a serve."""
    return np.asarray(game.catalogue.is_serve[game.base_pair_stroke])


def is_duel_pair(game: Game) -> Bools:
    """``[base pairs]`` whether the stroke of a base pair is a net shot after two or more net shots in a row."""
    return np.asarray(game.catalogue.is_net_shot[game.base_pair_stroke] & (game.duel(game.base_pair_state) >= LONG_DUEL - 1))


def is_long_duel_pair(game: Game) -> Bools:
    """``[base pairs]`` whether the stroke of a base pair is a net shot of a long duel."""
    return np.asarray(is_duel_pair(game) & (game.duel(game.base_pair_state) >= LONG_DUEL))


def _key(parts: tuple[I64 | Ints, ...]) -> I64:
    """One integer for a tuple of small ones."""
    key = np.zeros(len(parts[0]), dtype=np.int64)
    for part in parts:
        key = key * 32 + part
    return key


def _looked_up(keys: I64, weights: F64, wanted: I64) -> F64:
    """Sum of the weights of the rows whose key is wanted."""
    unique, inverse = np.unique(keys, return_inverse=True)
    total = np.bincount(inverse, weights=weights)
    position = np.minimum(np.searchsorted(unique, wanted), len(unique) - 1)
    return np.where(unique[position] == wanted, total[position], 0.0)


LEAST_END: Final = 0.003
"""At least this share of any stroke but a serve ends the rally, so that the game contracts and no stall pays."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PairProbabilities:
    """Predictions of the models for every base pair, ``[base pairs]`` each, before rounding to the tables.

    Attributes:
        fault: the striker faults, at effort 0.
        returned: a good stroke is returned.
        above: a returned stroke is met above the net.
        clipped: the fault or the winner probability was moved into the range that the data supports.
        fault_odds: ``[L]`` odds of a fault at each level of effort, relative to those at effort 0.
    """

    fault: F64
    returned: F64
    above: F64
    clipped: Bools
    fault_odds: F64


def empty_game(catalogue: Catalogue, replies: Bools) -> Game:
    """The layout of a game whose probabilities are not known yet."""
    tables = layout(catalogue, replies, duels=True)
    return Game(catalogue=catalogue, threshold=np.zeros((base_pairs(tables), 3), dtype=np.uint16), **tables)


def pair_probabilities(models: FittedModels, game: Game, support: Support, *, pessimism: float = 0.0) -> PairProbabilities:
    """Evaluate the models on every base pair, in double precision, within what the data supports.

    Args:
        models: the models.
        game: the layout; its thresholds are not read.
        support: ranges of the probabilities of its edges.
        pessimism: lower bound of the ensemble for the striker, in standard deviations of its logits.
    """
    codes = codes_of_pairs(game)
    logit = log_odds(models.averaged(models.fault, codes, pessimism=pessimism))
    returned = models.averaged(models.returned, codes, pessimism=pessimism)
    above = models.averaged(models.above, codes)
    situations, edge = models.situations, game.base_pair_edge
    # What the data supports is the mean over the situations, because that is what its cells hold.
    weights = situations.spread(codes["own_shot"], np.full(len(logit), -1), np.where(is_duel_pair(game), -1, 0))
    fault = situations.mixed(logit, weights)
    winner = (1 - fault) * (1 - returned)
    supported_fault = np.clip(fault, *support.fault_range[edge].T)
    supported_winner = np.clip(winner, *support.winner_range[edge].T)
    moved = supported_fault != fault
    clipped = moved | (supported_winner != winner)
    logit[moved] = situations.logit_of_mean(supported_fault[moved], weights[moved])
    logit = logit + situations.duel * is_long_duel_pair(game)
    # The least probability of an end holds at every level of effort, so at the one with the fewest faults.
    fewest = situations.effort.min()
    lowest = sigmoid(logit + fewest)
    least = np.where(is_serve_pair(game), 0.0, LEAST_END) - supported_winner
    short = lowest < least
    fault = np.where(short, sigmoid(log_odds(least) - fewest), sigmoid(logit))
    returned = 1 - supported_winner / (1 - np.where(short, least, supported_fault))
    odds = np.exp(situations.effort)
    return PairProbabilities(fault=fault, returned=returned, above=above, clipped=clipped, fault_odds=odds)


def compile_game(game: Game, probabilities: PairProbabilities) -> Game:
    """The game with its thresholds and its odds of faults."""
    table = thresholds(1 - probabilities.fault, probabilities.returned, probabilities.above)
    odds = np.rint(probabilities.fault_odds * ONE).astype(np.int32)
    return dataclasses.replace(game, threshold=table, fault_odds=odds)


def pair_log_choices(models: FittedModels, game: Game) -> F32:
    """``[base pairs]`` log of the probability that the average player chooses a stroke, before dividing by the legal total."""
    state = np.flatnonzero(game.playable[: game.n_base_states])
    codes = codes_of_states(game, state)
    choice = np.full((game.n_base_states, N_SHOTS * N_TECHNIQUES), np.nan)
    pair_state, pair_stroke = game.base_pair_state, game.base_pair_stroke
    pair_style = game.catalogue.shot[pair_stroke] * np.int64(N_TECHNIQUES) + game.catalogue.technique[pair_stroke]
    # Targets are asked for once for every state and style that occurs.
    styles, position = np.unique(pair_state * np.int64(N_SHOTS * N_TECHNIQUES) + pair_style, return_inverse=True)
    of_state = styles // (N_SHOTS * N_TECHNIQUES)
    rows = np.searchsorted(state, of_state)
    target_codes = {name: code[rows] for name, code in codes.items()}
    target_codes["shot"] = (styles % (N_SHOTS * N_TECHNIQUES) // N_TECHNIQUES).astype(np.int16)
    target_codes["technique"] = (styles % N_TECHNIQUES).astype(np.int16)
    total = np.zeros(game.n_base_pairs)
    for discipline, share in enumerate(models.share):
        if share == 0:
            continue
        of_all = {**codes, "discipline": np.full(len(state), discipline, dtype=np.int16)}
        choice[state] = models.choice({name: of_all[name] for name in STATE})
        of_targets = {**target_codes, "discipline": np.full(len(styles), discipline, dtype=np.int16)}
        target = models.targets(of_targets)
        assert target.shape == (len(styles), N_AREAS)
        total += share * choice[pair_state, pair_style] * target[position, game.catalogue.area[pair_stroke]]
    return np.log(np.maximum(total, 1e-12)).astype(np.float32)
