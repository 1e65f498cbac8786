"""Estimates from few strokes: means over cells of similar strokes, shrunk towards coarser cells.

The cells of a legal pair form a hierarchy: the shot type; with incoming shot type, contact and whether the striker is hurried;
with the whole stroke and the incoming stroke; with the own last stroke. An estimate at a level is the mean of its cell, with
``SHRINK`` pseudo-observations of the level above. Efforts and duels are ignored.
"""

import dataclasses
import functools
from collections.abc import Callable

import numpy as np

from shuttle_marl.base.arrays import F64, I32, I64, Floats, Ints
from shuttle_marl.exact.profile import PairPolicy
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.draws import CHOICE_ONE, ONE
from shuttle_marl.game.recovery import STEP, Recovery
from shuttle_marl.game.rules import FAULT, HURRIED_ABOVE, HURRIED_BELOW, OUTCOMES, RETURNED_ABOVE, RETURNED_BELOW, WINNER
from shuttle_marl.game.tables import Game, hurry_units
from shuttle_marl.recording.logs import Log, Transitions

SHRINK = 32.0  # pseudo-observations of the coarser cell
_SWEEPS = 30
_MOST = 2000  # largest effect of a position, in steps of log-odds
_LEAST = 64  # least probability that a stroke ends a rally, in units of 1/65536


@functools.lru_cache(maxsize=4)
def state_cells(game: Game) -> tuple[I64, ...]:
    """``[base states]`` each: cell of every state, from coarse to fine."""
    state = np.arange(game.n_base_states)
    own, incoming = (np.asarray(part(state), dtype=np.int64) for part in (game.own, game.incoming))
    received = 2 * game.hurried(state) + game.contact(state)
    n = game.n_strokes + 1
    parts = (np.zeros_like(state), *(4 * came + received for came in (game.incoming_shot(state), incoming, n * own + incoming)))
    return tuple(np.unique(part, return_inverse=True)[1].astype(np.int64) for part in parts)


@functools.lru_cache(maxsize=4)
def pair_cells(game: Game) -> tuple[I64, ...]:
    """``[base pairs]`` each: cell of every legal pair, from coarse to fine."""
    state, stroke = game.base_pair_state, game.base_pair_stroke.astype(np.int64)
    what = (game.catalogue.shot[stroke].astype(np.int64), game.catalogue.shot[stroke].astype(np.int64), stroke, stroke)
    parts = (cell[state] * game.n_strokes + each for cell, each in zip(state_cells(game), what, strict=True))
    return tuple(np.unique(part, return_inverse=True)[1].astype(np.int64) for part in parts)


def counts(game: Game, pair: Ints) -> F64:
    """``[base pairs]`` number of observations in the finest cell of each pair."""
    cell = pair_cells(game)[-1]
    return np.bincount(cell[pair % game.n_base_pairs], minlength=int(cell.max()) + 1)[cell].astype(np.float64)


def shrunk_means(game: Game, pair: Ints, values: Floats, *, prior: float, shrink: float = SHRINK) -> F64:
    """``[base pairs]`` mean of the values of similar strokes.

    Args:
        pair: ``[M]`` legal pair of each observation.
        values: ``[M]`` its value.
        prior: estimate without any observation.
        shrink: pseudo-observations of the coarser cell.
    """
    base = np.asarray(pair) % game.n_base_pairs
    estimate = np.array([prior])
    for cell, coarser in zip(pair_cells(game), _coarser_cells(game), strict=True):
        number, total = (np.bincount(cell[base], weight, len(coarser)) for weight in (None, values))
        estimate = (total + shrink * estimate[coarser]) / (number + shrink)
    return np.asarray(estimate[pair_cells(game)[-1]])


@functools.lru_cache(maxsize=4)
def _coarser_cells(game: Game) -> tuple[I64, ...]:
    """For each level of :func:`pair_cells`, the cell of the level above that contains each cell."""
    found, above = [], np.zeros(game.n_base_pairs, dtype=np.int64)
    for cell in pair_cells(game):
        coarser = np.zeros(int(cell.max()) + 1, dtype=np.int64)
        coarser[cell] = above
        found.append(coarser)
        above = cell
    return tuple(found)


def cloned(game: Game, pair: Ints, *, shrink: float = SHRINK, prior: F64 | None = None) -> F64:
    """``[base pairs]`` cloned probability of each stroke in its state; ``prior``: without observations; None: uniform."""
    state = game.base_pair_state
    base = np.asarray(pair) % game.n_base_pairs
    chance: F64 = 1.0 / np.bincount(state)[state] if prior is None else prior
    for cell, stroke_cell in zip(state_cells(game), _stroke_cells(game), strict=True):
        number = np.bincount(cell[state[base]], minlength=int(cell.max()) + 1)[cell[state]]
        played = np.bincount(stroke_cell[base], minlength=int(stroke_cell.max()) + 1)[stroke_cell]
        chance = (played + shrink * chance) / (number + shrink)
    return normalised(game, chance)


def normalised(game: Game, weight: F64) -> F64:
    """``[base pairs]`` weights of strokes, which add up to 1 in each state."""
    state = game.base_pair_state
    return np.asarray(weight / np.bincount(state, weight, game.n_base_states)[state])


@functools.lru_cache(maxsize=4)
def _stroke_cells(game: Game) -> tuple[I64, ...]:
    """``[base pairs]`` each: cell of the state and the whole stroke."""
    state, stroke = game.base_pair_state, game.base_pair_stroke.astype(np.int64)
    parts = (cell[state] * game.n_strokes + stroke for cell in state_cells(game))
    return tuple(np.unique(part, return_inverse=True)[1].astype(np.int64) for part in parts)


Backup = Callable[[F64, I32], F64]  # maps Q-values ``[base pairs]`` and base states ``[U]`` to the values of those states


def by_state(game: Game, values: F64, states: Ints, reduce: np.ufunc) -> F64:
    """``[U]`` reduction of ``[base pairs]`` values over the legal strokes of base states."""
    row, pair = game.pairs(states)
    start = np.flatnonzero(np.diff(row, prepend=-1))
    return np.asarray(reduce.reduceat(values[pair], start))


def expected_under(game: Game, chance: F64) -> Backup:
    """Values under a policy ``[base pairs]``."""
    return lambda q, states: by_state(game, chance * q, states, np.add)


def best_of(game: Game) -> Backup:
    """Values of the best stroke."""
    return lambda q, states: by_state(game, q, states, np.maximum)


def fitted_q(data: Transitions, backup: Backup, *, shrink: float = SHRINK) -> F64:
    """Fitted Q iteration (Ernst, Geurts & Wehenkel, JMLR 2005): ``[base pairs]`` probability of winning after each stroke."""
    game, prior = data.game, float(data.won[data.first].mean())
    fit = functools.partial(shrunk_means, game, data.pair, prior=prior, shrink=shrink)
    going = data.following >= 0
    states, index = np.unique(game.base(data.following[going]), return_inverse=True)
    q = fit(data.won.astype(np.float64))
    for _ in range(_SWEEPS):
        target = data.reward.astype(np.float64)
        target[going] = backup(q, states.astype(np.int32))[index]
        updated = fit(target)
        done, q = float(np.abs(updated - q).max()) < 1e-4, updated
        if done:
            break
    return q


def greedy(game: Game, q: F64) -> PairPolicy:
    """The policy that plays the first best stroke."""
    order = np.lexsort((-game.base_pair_rank, q, game.base_pair_state))
    last = np.append(np.diff(game.base_pair_state[order]) > 0, True)
    chance = np.zeros(game.n_base_pairs)
    chance[order[last]] = 1.0
    return PairPolicy(game=game, probability=chance)


def estimated_game(log: Log, *, shrink: float = SHRINK) -> Game:
    """The game with outcomes estimated from the strokes of both players; ``shrink``: pseudo-observations of the coarser cell."""
    prior = 1 / len(OUTCOMES)
    shares = [
        shrunk_means(log.game, log.pair, (log.outcome == outcome).astype(np.float64), prior=prior, shrink=shrink)
        for outcome in range(len(OUTCOMES))
    ]
    return game_of(log.game, np.stack(shares, axis=1))


def game_of(game: Game, shares: F64) -> Game:
    """The game with outcomes of given probabilities ``[base pairs, 6]``, at all efforts."""
    returned = shares[:, RETURNED_BELOW:HURRIED_BELOW] + shares[:, HURRIED_BELOW:]
    cumulative = np.cumsum(np.column_stack([shares[:, :RETURNED_BELOW], returned]), axis=1)
    cumulative = cumulative[:, :3] / cumulative[:, 3:] * ONE
    # Every stroke ends some rallies, so that play ends.
    cumulative[:, 1] = np.maximum(cumulative[:, 1], _LEAST)
    threshold = np.maximum.accumulate(np.clip(np.rint(cumulative), 0, ONE - 1), axis=1).astype(np.uint16)
    hurry = hurry_units(shares[:, HURRIED_BELOW:] / np.maximum(returned, np.finfo(np.float64).tiny))
    return dataclasses.replace(game, threshold=threshold, hurry=hurry)


def with_faults(game: Game, penalty: F64) -> Game:
    """The game in which ``penalty`` (``[base pairs]``) is added to the probability of a fault."""
    shares = game.outcome_probabilities(slice(0, game.n_base_pairs))
    fault = np.minimum(shares[:, 0] + penalty, 1.0)
    others = shares[:, 1:] * ((1 - fault) / np.maximum(1 - shares[:, 0], 1e-9))[:, None]
    return game_of(game, np.column_stack([fault, others]))


_RIDGE_EFFECT = 4.0  # information of a cell that changes nothing, in observations with even odds
_PEOPLE = 4.0  # pseudo-observations of the feasible positions of a cell


def with_positions(model: Game, pair: Ints, outcome: Ints, place: Ints) -> Game:
    """A model of the game with recovery, with effects of positions and frequencies of them from strokes.

    Args:
        model: with outcomes that are means over the positions of the strokes.
        pair, outcome, place: ``[M]`` each; place is where the receiver waited.
    """
    base, shares = pair % model.n_base_pairs, model.outcome_probabilities(slice(0, model.n_base_pairs))
    state, stroke = model.base_pair_state[base], model.base_pair_stroke[base]
    p, late = shares[base], outcome >= HURRIED_BELOW
    above, returned = np.isin(outcome, (RETURNED_ABOVE, HURRIED_ABOVE)), outcome >= RETURNED_BELOW
    of_contact = np.where(above, RETURNED_ABOVE, RETURNED_BELOW)
    rows = np.arange(len(base))
    contact = p[rows, of_contact] + p[rows, of_contact + 2]
    chances = (
        (outcome != FAULT, outcome == WINNER, p[:, WINNER] / (1 - p[:, FAULT])),
        (returned, above, (p[:, RETURNED_ABOVE] + p[:, HURRIED_ABOVE]) / p[:, RETURNED_BELOW:].sum(axis=1)),
        (returned, late, p[rows, of_contact + 2] / contact),
    )
    shot, area, served = model.catalogue.shot[stroke], model.catalogue.area[stroke], model.catalogue.is_serve[stroke]
    effect = np.zeros(model.recovery.effect.shape)
    for found, (counted, happened, chance) in zip(effect, chances, strict=True):
        used = counted & ~served
        logit = np.log(np.clip(chance, 1e-4, 1 - 1e-4)) - np.log1p(-np.clip(chance, 1e-4, 1 - 1e-4))
        cell = np.ravel_multi_index((shot, area, place), found.shape)[used]
        # A step of Newton for each shot type and position, and then one for each area too.
        for cells in (np.ravel_multi_index((shot, place), found.shape[::2])[used], cell):
            odds = 1 / (1 + np.exp(-(logit[used] + found.ravel()[cell])))
            size = cells.max(initial=0) + 1
            step = np.bincount(cells, happened[used] - odds, size) / (np.bincount(cells, odds * (1 - odds), size) + _RIDGE_EFFECT)
            added = np.zeros(found.size)
            added[cell] = step[cells]
            np.add(found, added.reshape(found.shape), out=found)
    people = _PEOPLE * (model.recovery.people > 0) / (model.recovery.people > 0).sum(axis=-1, keepdims=True)
    own, incoming = (np.append(model.catalogue.area, N_AREAS)[part(state)] for part in (model.own, model.incoming))
    np.add.at(people, (model.incoming_shot(state), own, incoming, model.contact(state), model.hurried(state), place), 1)
    people = np.floor(CHOICE_ONE * people / people.sum(axis=-1, keepdims=True)).astype(np.uint16)
    flat = people.reshape(-1, people.shape[-1])
    flat[np.arange(len(flat)), flat.argmax(axis=1)] += (CHOICE_ONE - flat.sum(axis=1, dtype=np.int64)).astype(np.uint16)
    steps = np.rint(np.clip(effect / STEP, -_MOST, _MOST)).astype(np.int16)
    return dataclasses.replace(model, recovery=Recovery(people=people, effect=steps))
