"""The game of fitted models, within the support of the training matches: compiled to tables, or asked stroke by stroke.

**Catalogue.** It contains a stroke if at least 3 % of the good strokes of its shot type go to its area, and at least 20 good
strokes equal it; and the same stroke to the other side, which players of different hands need: what flies to the forehand side of
a right-hander flies to the backhand side of a left-hander.

**Legality.** A stroke is a legal reply where people *choose* it. People have played the stroke against the incoming shot type in
the area where it is met, or, where fewer than 50 such strokes at its height are known, in this third of the court (front, middle,
back); and twice against the incoming shot type, or it is the most frequent target of its shot type, height and technique there,
with five strokes to any target; and its shot type five times in this third at this height. Of the strokes with which the fitted
average player meets the incoming stroke at this height, at least 2 % are such strokes of its shot type, and at least 1 % of
those of its shot type have its technique. What happens less often is an opportunity of few situations, such as a net kill of a
short lift, whose results say nothing about the others. Where this leaves no stroke, areas do not count; then the shot types are
legal that make up 5 % of all strokes from this third and height, with each technique that occurs five times against any stroke;
and in small data, where this leaves none either, all that occur five times at this height. No stroke of the front court is legal
in the back third, and none around the head on the forehand side.

**Extremes.** Faults and winners are counted in nested cells: shot type and area; the whole stroke; against one incoming shot
type; against one incoming shot type and area. The rate of a cell is shrunk to that of the enclosing cell with the weight of 40
strokes. The predicted probabilities of a fault and of a winner of a legal pair are clipped to the central 90 % of the Beta
posterior of the innermost cell (with Jeffreys' half event on either side). A cell without strokes has the width of 40 strokes.
Cells contain strokes of all efforts and duels, of hurried strikers and of others, so they bound the mean over these situations,
weighted by their frequencies (of efforts after the striker's previous shot type, of hurried strikers by incoming and own shot
type), and not the probability in each: bounds around the mean would cut off what a hurried striker risks.

**Without tables** a :class:`ModelStepper` plays the same game from the modules, slower by two orders of magnitude; a test
compares both.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import scipy  # its statistics are imported when first used

from shuttle_marl.base.arrays import F32, F64, I16, I64, U8, U16, Bools, Ints
from shuttle_marl.base.errors import OptionError, ShuttleError
from shuttle_marl.base.files import replace_file
from shuttle_marl.base.pytorch import own_settings
from shuttle_marl.base.tensor_files import checked, tensor_bytes
from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.features import SLOTS, STATE, Rows, mirrored_where
from shuttle_marl.dynamics.fitted import FittedModels, ModelError
from shuttle_marl.dynamics.models import log_odds, sigmoid
from shuttle_marl.dynamics.modules import LONG_DUEL
from shuttle_marl.game import shipped
from shuttle_marl.game.court import BACK, FOREHAND, N_AREAS, N_SIDES, N_THIRDS, mirrored, third_of
from shuttle_marl.game.draws import ONE, with_fault_odds
from shuttle_marl.game.layout import ALL, GameError, base_pairs, layout
from shuttle_marl.game.rally import Stepper
from shuttle_marl.game.stroke import AROUND_THE_HEAD, FRONT_COURT, N_SERVES, N_SHOTS, N_TECHNIQUES, SHOTS, Catalogue
from shuttle_marl.game.tables import Game, hurry_units, thresholds

THREADS: Final = 1  # threads of PyTorch; fixed, because another order of summation gives other numbers. More would not be faster
AREA_SHARE: Final = 0.03
SHOT_SHARE: Final = 0.02
"""Minimum share of a legal shot type in the choices of the fitted average player, of those to supported targets. Chosen with the
other numbers of the rule by the health of the solved game and the illegal strokes of people (``docs/truth_record.md``)."""
TECHNIQUE_SHARE: Final = 0.01
_FALLBACK_SHARE: Final = 0.05
CONTEXT_STROKES: Final = 20.0  # weight of the contexts of a shot type in those of an incoming stroke, in strokes
MIN_STROKES: Final = 20
MIN_REPLIES: Final = 2
SMALL_CELL: Final = 50  # strokes against a shot type in an area, at a height, below which those in its third count
MIN_STYLE: Final = 5
PRIOR_STROKES: Final = 40.0
CREDIBLE: Final = 0.90
_HURRIED: Final = 2  # difference of the number of a base state of a hurried striker


def _supported(rows: Rows) -> Bools:
    good = rows.take((rows.outcome != Outcome.FAULT) & (rows.codes["area"] >= 0))
    count = good.count("shot", "area", "contact", "technique")
    to_area = count.sum(axis=(2, 3))
    in_area = to_area >= AREA_SHARE * np.maximum(to_area.sum(axis=1, keepdims=True), 1)
    return np.asarray((count >= MIN_STROKES) & in_area[:, :, None, None])


def catalogue_of(rows: Rows) -> Catalogue:
    """Strokes with enough support and, but for serves, those to the other side; by shot type, area, height, technique."""
    supported = _supported(rows)
    supported[N_SERVES:] |= supported[N_SERVES:, mirrored(np.arange(N_AREAS))]
    return Catalogue(*(np.ascontiguousarray(column, dtype=np.int8) for column in np.argwhere(supported).T))


def average_choices(models: FittedModels, rows: Rows, catalogue: Catalogue) -> F64:
    """``[n, 2, 13, 3]`` share of shot types and techniques in the average player's choices, by incoming stroke and height.

    It is the mean over the contexts in which people meet the incoming stroke at this height and, with the weight of
    :data:`CONTEXT_STROKES`, over those in which they meet any stroke of its shot type; zero where nobody met one.
    """
    context = [name for name in STATE if not name.startswith("incoming_") and name not in ("hands", "contact")]
    share = np.zeros((len(catalogue), 2, N_SHOTS, N_TECHNIQUES))
    for shot, contact in np.ndindex(N_SHOTS, 2):
        met = rows.take((rows.codes["incoming_shot"] == shot) & (rows.codes["contact"] == contact))
        strokes = np.flatnonzero(catalogue.shot == shot)
        if not len(met) or not len(strokes):
            continue
        contexts, which = np.unique(np.stack([met.codes[name] for name in context]), axis=1, return_inverse=True)
        pooled = CONTEXT_STROKES * np.bincount(which.ravel()) / len(met)
        weights = np.tile(pooled, (len(strokes), 1))
        for k, stroke in enumerate(strokes.tolist()):
            same = np.ones(len(met), dtype=bool)
            for part in ("area", "height", "technique"):
                same &= met.codes[f"incoming_{part}"] == getattr(catalogue, part)[stroke]
            weights[k] += np.bincount(which.ravel()[same], minlength=len(pooled))
        codes = {name: np.tile(column, len(strokes)) for name, column in zip(context, contexts, strict=True)}
        fixed = {"incoming_shot": shot, "contact": contact, "hands": 0}
        codes |= {name: np.full(codes["own_shot"].shape, value, dtype=np.int16) for name, value in fixed.items()}
        for part in ("area", "height", "technique"):
            codes[f"incoming_{part}"] = np.repeat(getattr(catalogue, part)[strokes], len(pooled)).astype(np.int16)
        choice = models.choice(_read(models, codes)).reshape(len(strokes), len(pooled), N_SHOTS, N_TECHNIQUES)
        share[strokes, contact] = np.einsum("kc,kcst->kst", weights / weights.sum(axis=1, keepdims=True), choice)
    return share


def replies_of(rows: Rows, catalogue: Catalogue, choices: F64, share: float = SHOT_SHARE) -> Bools:
    """``[n + 1, n]`` legal replies to each stroke (row n: at the serve), by the rule of this module; ``choices``: the average
    player's, see :func:`average_choices`; ``share``: minimum share of a shot type."""
    n, aimed = len(catalogue), rows.take(rows.codes["area"] >= 0)
    parts = (catalogue.shot, catalogue.area, catalogue.height, catalogue.technique)
    style = (catalogue.shot, catalogue.height, catalogue.technique)
    count = aimed.count("incoming_shot", "shot", "area", "contact", "technique")
    here = aimed.count("incoming_shot", "incoming_area", "shot", "area", "contact", "technique")
    styled = rows.count("incoming_shot", "shot", "contact", "technique")
    supported = _supported(rows)
    # Replies by incoming shot type, third of the court and height at which it is met, and own shot type.
    met = rows.count("incoming_shot", "incoming_area", "contact", "shot")
    situation, in_third = (
        np.stack(
            [cells[:N_SHOTS, :N_AREAS][:, third_of(np.arange(N_AREAS)) == third].sum(axis=1) for third in range(N_THIRDS)], axis=1
        )
        for cells in (met, here)
    )
    everywhere = situation.sum(axis=0)
    anywhere = (everywhere >= MIN_STYLE) & (everywhere >= _FALLBACK_SHARE * everywhere.sum(axis=-1, keepdims=True))
    of_technique = choices >= TECHNIQUE_SHARE * choices.sum(axis=-1, keepdims=True)
    enough = (styled[:N_SHOTS].sum(axis=0)[style] >= MIN_STYLE) & ~catalogue.is_serve
    front = np.isin(catalogue.shot, [SHOTS.index(name) for name in FRONT_COURT])
    # By incoming shot type: the replies that people play often, and where those of each shot type and technique go.
    times = np.where(supported, count, 0)
    commonest = (times > 0) & (times == times.max(axis=2, keepdims=True)) & (styled >= MIN_STYLE)[:, :, None]
    frequent = (times >= MIN_REPLIES) | commonest
    usual = count / np.maximum(count.sum(axis=2, keepdims=True), 1)
    replies = np.zeros((n + 1, n), dtype=bool)
    replies[n] = catalogue.is_serve
    for incoming, (shot, area) in enumerate(zip(catalogue.shot, catalogue.area, strict=True)):
        third, cell = third_of(area), here[shot, area]
        reach = ~(front & (third == BACK)) & ~((catalogue.technique == AROUND_THE_HEAD) & (area % N_SIDES == FOREHAND))
        played = frequent[shot][parts] & reach & ~catalogue.is_serve
        played &= of_technique[incoming][catalogue.height, catalogue.shot, catalogue.technique]
        played &= situation[shot, third, catalogue.height, catalogue.shot] >= MIN_STYLE
        small = cell.sum(axis=(0, 1, 3)) < SMALL_CELL
        there = played & ((cell[parts] > 0) | (small[catalogue.height] & (in_third[shot, third][parts] > 0)))
        # Where the strokes of each shot type and technique go: those of the cell, shrunk to those against the shot type.
        aim = (cell + CONTEXT_STROKES * usual[shot]) / (cell.sum(axis=1, keepdims=True) + CONTEXT_STROKES)
        legal_aim = np.zeros(aim.shape)
        legal_aim[parts] = np.where(there, aim[parts], 0)
        chosen = (choices[incoming] * legal_aim.sum(axis=1).transpose(1, 0, 2)).sum(axis=-1) >= share
        legal = there & chosen[catalogue.height, catalogue.shot]
        for contact in (0, 1):
            options = (played, reach & enough & anywhere[third, catalogue.height, catalogue.shot], reach & enough)
            for option in options:
                if not legal[catalogue.height == contact].any():
                    legal |= option & (catalogue.height == contact)
        replies[incoming] = legal
    return replies


def between_hands(replies: Bools, catalogue: Catalogue) -> Bools:
    """Legal replies between players of different hands: to every stroke those that fly to the other side."""
    return replies[:, catalogue.other_side]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Support:
    """Support in the data for every edge x -> y of a game, where y is the reply to x."""

    strokes: F64  # [E] strokes in the innermost cell (for faults of unknown target, the expected number)
    faults: F64  # [E] faults among them
    winners: F64  # [E] winners among them
    fault_range: F64  # [E, 2] bounds of the predicted probability of a fault
    winner_range: F64  # [E, 2] bounds of that of a winner


def support_of(rows: Rows, targets: F64, game: Game, *, opposite: bool = False) -> Support:
    """Count the cells of every edge; ``targets``: ``[N, 9]`` probability of each target; one-hot where it is known; ``opposite``:
    whether the game is that of players with different hands."""
    which, area = np.nonzero(targets > 0)
    weight = targets[which, area]
    c = {name: code[which].astype(np.int64) for name, code in rows.codes.items()}
    fault = weight * (rows.outcome[which] == Outcome.FAULT)
    winner = weight * (rows.outcome[which] == Outcome.WINNER)
    catalogue, n = game.catalogue, game.n_strokes
    # The "own" end of an edge is the incoming stroke of the player who replies.
    own, stroke = game.edge_own, game.edge_incoming
    struck = np.append(catalogue.other_side, n)[stroke] if opposite else stroke
    of_edge = [np.append(getattr(catalogue, name), 0)[struck] for name in ("shot", "area", "height", "technique")]
    of_edge += [np.append(catalogue.shot, N_SHOTS)[own], np.append(catalogue.area, N_AREAS)[own]]
    of_row = [c["shot"], area, c["contact"], c["technique"], c["incoming_shot"], c["incoming_area"]]
    # Nested cells: a shot type, with its area, the whole stroke, against a shot type, and against one to an area.
    levels = [(_key(of_row[:depth]), _key(of_edge[:depth])) for depth in (1, 2, 4, 5, 6)]
    ranges = []
    for events in (fault, winner):
        rate = np.full(len(stroke), events.sum() / weight.sum())
        for level, (rows_in, edges_in) in enumerate(levels):
            total, hits = _cell_sums(rows_in, weight, edges_in), _cell_sums(rows_in, events, edges_in)
            a, b = hits + PRIOR_STROKES * rate, total - hits + PRIOR_STROKES * (1 - rate)
            if level < len(levels) - 1:
                rate = a / (a + b)
        # Jeffreys prior: an event that was never observed is still possible.
        a, b = a + 0.5, b + 0.5
        tail = (1 - CREDIBLE) / 2
        ranges.append(np.stack([scipy.stats.beta.ppf(tail, a, b), scipy.stats.beta.ppf(1 - tail, a, b)], axis=1))
    strokes, faults, winners = (_cell_sums(rows_in, part, edges_in) for part in (weight, fault, winner))
    ranges[0][stroke == n] = ranges[1][stroke == n] = (0.0, 1.0)
    return Support(strokes=strokes, faults=faults, winners=winners, fault_range=ranges[0], winner_range=ranges[1])


def is_serve_pair(game: Game, pair: Ints | slice = ALL) -> Bools:
    """``[base pairs]`` whether the stroke of a base pair is a serve."""
    return np.asarray(game.catalogue.is_serve[game.base_pair_stroke[pair]])


def is_duel_pair(game: Game, pair: Ints | slice = ALL) -> Bools:
    """``[base pairs]`` whether the stroke of a base pair is a net shot after two or more consecutive net shots."""
    net, duel = game.catalogue.is_net_shot[game.base_pair_stroke[pair]], game.duel(game.base_pair_state[pair])
    return np.asarray(net & (duel >= LONG_DUEL - 1))


def is_long_duel_pair(game: Game, pair: Ints | slice = ALL) -> Bools:
    """``[base pairs]`` whether the stroke of a base pair is a net shot in a long duel."""
    return np.asarray(is_duel_pair(game, pair) & (game.duel(game.base_pair_state[pair]) >= LONG_DUEL))


def _key(parts: Sequence[Ints]) -> I64:
    return np.asarray(np.ravel_multi_index(tuple(parts), (32,) * len(parts)))


def _cell_sums(keys: I64, weights: F64, wanted: I64) -> F64:
    unique, inverse = np.unique(keys, return_inverse=True)
    total = np.bincount(inverse, weights=weights)
    position = np.minimum(np.searchsorted(unique, wanted), len(unique) - 1)
    return np.where(unique[position] == wanted, total[position], 0.0)


MIN_END: Final = 0.003  # minimum probability that a stroke other than a serve ends the rally, so that the game is a contraction


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PairProbabilities:
    """Predictions for every base pair, ``[base pairs]`` each, before rounding."""

    fault: F64  # probability of a fault, at effort 0
    returned: F64  # probability that a good stroke is returned
    above: F64  # probability that a returned stroke is met above the net
    hurry: F64  # [base pairs, 2] probability that who returns it is hurried, from below and from above the net
    clipped: Bools  # whether the probability of a fault or a winner was clipped to the supported range
    fault_odds: F64  # [L] odds of a fault at each level of effort, relative to those at effort 0


def empty_game(catalogue: Catalogue, replies: Bools) -> Game:
    """Layout of a game without probabilities."""
    tables = layout(catalogue, replies, duels=True)
    pairs = base_pairs(tables)
    threshold, hurry = np.zeros((pairs, 3), dtype=np.uint16), np.zeros((pairs, 2), dtype=np.uint8)
    return Game(catalogue=catalogue, threshold=threshold, hurry=hurry, **tables)


def pair_probabilities(models: FittedModels, game: Game, support: Support, calm: Ints | None = None) -> PairProbabilities:
    """Evaluate the models on base pairs, in double precision, clipped to the supported range; ``game``: the layout; its
    thresholds are ignored; ``calm``: numbers of base pairs whose strikers are not hurried: those are evaluated and, in the second
    half of the result, those of hurried strikers that are equal otherwise (None: all base pairs, in their order)."""
    first = np.flatnonzero(game.hurried(game.base_pair_state) == 0) if calm is None else calm
    # Pairs of a striker who is not hurried, and those of a hurried one that are equal otherwise.
    late = game.base_pair_start[game.base_pair_state[first] + _HURRIED] + game.base_pair_rank[first]
    pairs = np.stack([first, late], axis=1)
    those = np.arange(game.n_base_pairs) if calm is None else pairs.T.ravel()
    at = pairs if calm is None else np.arange(len(those)).reshape(2, -1).T
    codes = _read(models, codes_of_pairs(game, those, opposite=models.opposite))
    logit = log_odds(models.averaged(models.fault, codes))[at]
    returned = models.averaged(models.returned, codes)[at]
    situations, codes_of = models.situations, {name: code[at[:, 0]] for name, code in codes.items()}
    edge = game.base_pair_edge[pairs[:, 0]]
    is_serve, long, duel = (test(game, pairs[:, 0]) for test in (is_serve_pair, is_long_duel_pair, is_duel_pair))
    hurried = situations.hurried_share[codes_of["incoming_shot"], codes_of["shot"]]
    share = np.stack([1 - hurried, hurried], axis=1)
    # The supported ranges are those of the mean over the situations.
    weights = situations.spread(codes_of["own_shot"], np.full(len(pairs), -1), np.where(duel, -1, 0))
    fault = situations.mixed(logit, weights)
    winner = (1 - fault) * (1 - returned)
    mean_fault, mean_winner = ((share * part).sum(axis=1) for part in (fault, winner))
    supported_fault = np.clip(mean_fault, *support.fault_range[edge].T)
    supported_winner = np.clip(mean_winner, *support.winner_range[edge].T)
    moved = supported_fault != mean_fault
    clipped = moved | (supported_winner != mean_winner)
    logit[moved] = situations.moved_to(supported_fault[moved], logit[moved], weights[moved], share[moved])
    fault[moved] = situations.mixed(logit[moved], weights[moved])
    winner = np.minimum(winner * (supported_winner / mean_winner)[:, None], 1 - fault)
    logit = logit + (situations.duel * long)[:, None]
    # The minimum probability of an end holds at every level of effort, so also at the one with the fewest faults.
    fewest = situations.effort.min()
    lowest = sigmoid(logit + fewest)
    least = np.where(is_serve, 0.0, MIN_END)[:, None] - winner
    short = lowest < least
    of_pairs = {
        "fault": np.where(short, sigmoid(log_odds(least) - fewest), sigmoid(logit)),
        "returned": 1 - winner / (1 - np.where(short, least, fault)),
        "clipped": np.stack([clipped, clipped], axis=1),
    }
    back = np.argsort(at, axis=None)
    return PairProbabilities(
        **{name: part.ravel()[back] for name, part in of_pairs.items()},
        above=models.averaged(models.above, codes),
        hurry=models.averaged(models.hurried, codes),
        fault_odds=np.exp(situations.effort),
    )


def _read(models: FittedModels, codes: dict[str, I16]) -> dict[str, I16]:
    return codes if models.knows_hurried else {**codes, "hurried": np.zeros_like(codes["hurried"])}


def rounded(probabilities: PairProbabilities) -> tuple[U16, U8]:
    """Thresholds ``[base pairs, 3]`` at effort 0, and chances of a hurried receiver ``[base pairs, 2]``."""
    limits = thresholds(1 - probabilities.fault, probabilities.returned, probabilities.above)
    return limits, hurry_units(probabilities.hurry)


def compile_game(game: Game, probabilities: PairProbabilities) -> Game:
    """The game with thresholds, chances of hurried receivers, and odds of faults."""
    limits, hurry = rounded(probabilities)
    odds = np.rint(probabilities.fault_odds * ONE).astype(np.int32)
    return dataclasses.replace(game, threshold=limits, hurry=hurry, fault_odds=odds)


def pair_log_choices(models: FittedModels, game: Game) -> F32:
    """``[base pairs]`` log-probability of each stroke for the average player, before normalising over legal strokes. Whole
    multiples of 1 / :data:`~shuttle_marl.game.shipped.CHOICE_UNITS`."""
    state = np.flatnonzero(game.playable[: game.n_base_states])
    codes = _read(models, codes_of_states(game, state, opposite=models.opposite))
    choice = np.full((game.n_base_states, N_SHOTS * N_TECHNIQUES), np.nan)
    pair_state, pair_stroke = game.base_pair_state, game.base_pair_stroke
    pair_style = game.catalogue.shot[pair_stroke] * np.int64(N_TECHNIQUES) + game.catalogue.technique[pair_stroke]
    # Targets are predicted once for every state and style that occurs.
    styles, position = np.unique(pair_state * np.int64(N_SHOTS * N_TECHNIQUES) + pair_style, return_inverse=True)
    of_state = styles // (N_SHOTS * N_TECHNIQUES)
    rows = np.searchsorted(state, of_state)
    target_codes = {name: code[rows] for name, code in codes.items()}
    target_codes["shot"] = (styles % (N_SHOTS * N_TECHNIQUES) // N_TECHNIQUES).astype(np.int16)
    target_codes["technique"] = (styles % N_TECHNIQUES).astype(np.int16)
    area = mirrored(game.catalogue.area) if models.opposite else game.catalogue.area
    total = np.zeros(game.n_base_pairs)
    for discipline, share in enumerate(models.share):
        if share == 0:
            continue
        of_all = {**codes, "discipline": np.full(len(state), discipline, dtype=np.int16)}
        choice[state] = models.choice({name: of_all[name] for name in STATE})
        of_targets = {**target_codes, "discipline": np.full(len(styles), discipline, dtype=np.int16)}
        target = models.targets(of_targets)
        assert target.shape == (len(styles), N_AREAS)
        total += share * choice[pair_state, pair_style] * target[position, area[pair_stroke]]
    return (np.rint(shipped.CHOICE_UNITS * np.log(np.maximum(total, 1e-12))) / shipped.CHOICE_UNITS).astype(np.float32)


_SUPPORT: Final = tuple(field.name for field in dataclasses.fields(Support))


def save_support(folder: Path, support: Support, opposite: Support) -> None:
    """Write the support of a model, in its game and in that of players with different hands."""
    arrays = {name: getattr(support, name) for name in _SUPPORT}
    arrays |= {f"{shipped.OPPOSITE}.{name}": getattr(opposite, name) for name in _SUPPORT}
    replace_file(folder / shipped.SUPPORT, tensor_bytes(arrays, {}, pack=True))


def load_support(folder: Path, *, opposite: bool = False) -> Support:
    """Read the support of a model; ``opposite``: that in the game of players with different hands. Raises ModelError: the file is
    missing, differs from the model card, or is invalid. Raises GameError: the model card cannot be read."""
    prefix = f"{shipped.OPPOSITE}." if opposite else ""
    with shipped.readable(folder, shipped.SUPPORT, "support", ModelError) as (_, arrays):
        edges = arrays[f"{prefix}strokes"].shape[:1]
        shapes = {name: (*edges, 2) if name.endswith("range") else edges for name in _SUPPORT}
        return Support(**{name: checked(arrays[prefix + name], np.float64, shape) for name, shape in shapes.items()})


class ModelStepper(Stepper):
    """Plays the layout of a game with the outputs of its models, not with tables; :func:`model_stepper` shares one per model."""

    def __init__(self, game: Game, models: FittedModels, support: Support) -> None:
        super().__init__(game)
        self._models, self._support = models, support
        self._row = functools.lru_cache(maxsize=4096)(self._evaluated)
        self._limits = self._met = 2 * [
            [_Computed(3, functools.partial(self._limits_at, odds)) for odds in game.fault_odds.tolist()]
        ]
        self._hurry = self._late = 2 * [_Computed(2, lambda row: self._row(row)[1])]

    def __reduce__(self) -> tuple[Any, ...]:
        return model_stepper, (self.game,)

    def _limits_at(self, odds: int, row: int) -> U16:
        return with_fault_odds(self._row(row)[0], odds)

    def _evaluated(self, row: int) -> tuple[U16, U8]:
        state = int(self.game.base_pair_state[row])
        late = self.is_hurried(state)
        calm = row - (int(self.game.base_pair_start[state] - self.game.base_pair_start[state - 2]) if late else 0)
        with own_settings(THREADS):
            limits, hurry = rounded(pair_probabilities(self._models, self.game, self._support, np.array([calm])))
        return limits[int(late)], hurry[int(late)]


class _Computed:
    """A table that computes its rows when they are read; indexed as if it were flat."""

    def __init__(self, width: int, row: Callable[[int], U16 | U8]) -> None:
        self._width, self._row = width, row

    def __getitem__(self, entry: int) -> int:
        row, column = divmod(entry, self._width)
        return int(self._row(row)[column])


@functools.lru_cache(maxsize=2)
def model_stepper(game: Game) -> ModelStepper:
    """The stepper of the models that a game was compiled from. Raises OptionError: a game without models: of other tables, a
    variant of a model, of a pair, or with recovery. Raises ModelError: the models cannot be read."""
    origin = shipped.origin_of(game)
    if origin is None or origin != shipped.Origin(origin.folder) or game.people is not None:
        raise OptionError(
            "outcomes='models': only the game of a model has some, such as default; variants of it, pairs, and the "
            "game with recovery are tables made from these"
        )
    return ModelStepper(game, FittedModels.load(origin.folder), load_support(origin.folder))


def codes_of_states(game: Game, state: Ints, *, opposite: bool) -> dict[str, I16]:
    """``[N]`` codes of the context of states, without discipline; ``opposite``: whether striker and receiver have different
    hands."""
    catalogue = game.catalogue
    codes: dict[str, I16] = {}
    for name, stroke in (("own", game.own(state)), ("incoming", game.incoming(state))):
        for attribute in ("shot", "area", "height", "technique"):
            code = f"{name}_{attribute}"
            # The last two codes of a previous stroke are "none" and "unknown".
            codes[code] = np.append(getattr(catalogue, attribute), SLOTS[code] - 2)[stroke].astype(np.int16)
    codes["contact"] = game.contact(state).astype(np.int16)
    codes["hurried"] = game.hurried(state).astype(np.int16)
    codes["hands"] = np.full_like(codes["contact"], opposite)
    codes["own_area"] = mirrored_where(codes["hands"] == 1, codes["own_area"])
    return codes


def codes_of_pairs(game: Game, pair: Ints, *, opposite: bool) -> dict[str, I16]:
    """``[N]`` codes of base pairs of a game, without discipline; ``opposite`` as for :func:`codes_of_states`."""
    codes = codes_of_states(game, game.base_pair_state[pair], opposite=opposite)
    for attribute in ("shot", "technique", "area"):
        codes[attribute] = getattr(game.catalogue, attribute)[game.base_pair_stroke[pair]].astype(np.int16)
    codes["area"] = mirrored_where(codes["hands"] == 1, codes["area"])
    return codes


def layouts_of(rows: Rows, models: FittedModels) -> tuple[Game, Game]:
    """Layouts of the games of strokes between equal and between different hands: catalogue and legal replies, no probabilities.
    Raises ShuttleError: too few kinds of stroke occur often enough."""
    catalogue = catalogue_of(rows)
    try:
        replies = replies_of(rows, catalogue, average_choices(models, rows, catalogue))
        return empty_game(catalogue, replies), empty_game(catalogue, between_hands(replies, catalogue))
    except GameError as error:
        raise ShuttleError(
            f"these strokes make no game ({error}): every stroke of a game occurs at least {MIN_STROKES} times in the data; "
            "add matches"
        ) from error
