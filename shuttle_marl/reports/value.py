"""Value of a stroke: the one definition that ratings, advice, reports, pictures, the page and the suite read.

The value of a stroke is the probability with which its striker wins the rally, if both players then go on as two policies do. Its
**advantage** is that minus the probability before the choice, the mean over what the striker's own policy plays there. A figure
of the game that is promised is **calibrated**: the mean over the refits of the game on resampled matches, times the share of
predicted advantages that real matches realise (:func:`~shuttle_marl.game.shipped.factor_of`).

The value **added** by a recorded stroke is the change from before it to what it led to. After Decroos, Bransen, Van Haaren &
Davis, "Actions Speak Louder than Goals: Valuing Player Actions in Soccer", KDD 2019, with probabilities of winning from the game
instead of learned ones.
"""

from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa

from shuttle_marl.base.arrays import F64, I64, Bools, Ints
from shuttle_marl.data.schema import Outcome
from shuttle_marl.data.upstream import date_of
from shuttle_marl.dynamics.features import Rows, hurry_of, marked_rows
from shuttle_marl.exact import evaluate, visits
from shuttle_marl.exact.profile import StatePolicy, met_by
from shuttle_marl.game import rules
from shuttle_marl.game.court import N_AREAS, steps_between
from shuttle_marl.game.layout import ALL, LONGEST_DUEL, Indices
from shuttle_marl.game.pairs import game_of_people, people_of
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.game.shipped import Estimate, factor_of
from shuttle_marl.game.stroke import N_SHOTS, N_TECHNIQUES, Catalogue
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.registry import resolve

NORMAL: Final = 1.6448536  # 95 % quantile of the normal distribution: intervals of the reports contain the truth in 90 % of cases
TOLERANCE: Final = 1e-6  # largest error of exact values
LEAST_REFITS: Final = 5  # number of refits below which nothing is advised and no refits agree


class Value:
    """Values of strokes for one player; ``game``: tables with which the player strikes; ``values``: ``[S]`` each: value to a
    player, of -1 to 1, of the states in which player 0 strikes and in which player 1 does; ``seat``: of the striker;
    ``opponent``: policy by which the receiver waits in the game with recovery (None: as people do)."""

    def __init__(self, game: Game, values: tuple[F64, F64], seat: int = 0, opponent: StatePolicy | None = None) -> None:
        self._tables = game if opponent is None else met_by(game, opponent)
        self._before, self._after = values[seat], values[1 - seat]

    def before(self, states: slice | Indices) -> F64:
        """``[...]`` probability of winning the rally before the choice in some states."""
        return np.asarray((1 + self._before[states]) / 2)

    def win(self, pairs: slice | Indices = ALL) -> F64:
        """``[...]`` probability of winning the rally with legal pairs, all by default."""
        return np.asarray((1 + self._tables.stroke_values(self._after, pairs)) / 2)

    def advantage(self, pairs: slice | Indices, states: Ints) -> F64:
        """``[...]`` change of that probability by legal pairs of some states."""
        return np.asarray((self._tables.stroke_values(self._after, pairs) - self._before[states]) / 2)


def error_of(values: F64) -> F64:
    """``[...]`` standard deviation of figures in one more refit, from ``[R, ...]`` in R refits; NaN of fewer than two."""
    if len(values) < 2:
        return np.full(values.shape[1:], np.nan)
    return np.asarray(values.std(axis=0, ddof=1) * np.sqrt(1 + 1 / len(values)))


def agree(values: F64) -> Bools:
    """Whether ``[R, ...]`` values in the refits have a mean that is larger than their disagreement; False of too few refits."""
    return np.asarray((np.abs(values.mean(axis=0)) > NORMAL * error_of(values)) & (len(values) >= LEAST_REFITS))


def calibrated(values: F64, factor: Estimate | None) -> Estimate:
    """Calibrated figure: mean over the refits times the factor, with a 90 % interval; ``values``: ``[R]`` in each refit;
    ``factor``: share of advantages that real matches realise, with its 95 % interval (None: unknown, taken as 1)."""
    factor = factor or Estimate(1.0, 1.0, 1.0)
    mean, off = float(np.mean(values)), (factor.high - factor.low) / (2 * 1.959964)
    error = NORMAL * float(np.hypot(factor.value * error_of(values), mean * off))
    return Estimate(factor.value * mean, factor.value * mean - error, factor.value * mean + error)


COLUMNS: Final = ("win_before", "win_after", "value_added", "decision", "execution", "decision_expected")
_UNKNOWN: Final = -1


def add_values(strokes: pa.Table, reference: TabulatedPolicy, opponent: TabulatedPolicy | None = None) -> pa.Table:
    """Add the value of every stroke, if both players continue like a reference policy.

    ``win_before`` is the striker's probability of winning the rally before the stroke and ``win_after`` after it: 1 for a winner,
    0 for a fault, and for a returned stroke 1 minus the opponent's ``win_before``, which depends on the contact that the opponent
    reaches and on whether they are hurried, but not on the reply. ``value_added`` is the difference, from -1 to 1; over a rally
    the server's values minus the receiver's sum to the outcome minus the probability at the serve. ``decision`` is the part due
    to the choice of the stroke (its expected value minus that of the reference's choice), ``execution`` the rest: skill and luck.
    ``decision_expected`` is the part of the decision that real matches realise
    (:func:`shuttle_marl.game.shipped.factor_of`); null where it is unknown. The target of a fault is not recorded; its decision
    is the mean over the targets of the same shot type and technique, weighted by the probability that the reference aims and
    faults there.

    Strokes outside the game's catalogue are replaced by the nearest one (same shot type and contact, then same technique, then
    the nearest area), and states outside the game by the mean over the striker's own last stroke. Values of strokes whose context
    was not recorded are null.

    Args:
        strokes: table of schema :data:`shuttle_marl.data.schema.STROKES`, rallies in order.
        reference: the policy, with its game; in the game of a pair that of seat 0.
        opponent: in the game of a pair, the policy of seat 1; all strokes are then those of its two players.

    Returns:
        The table with float64 columns :data:`COLUMNS`.
    """
    second = None
    if opponent is not None:
        second = strokes["player"].to_numpy(zero_copy_only=False) == people_of(opponent.game).players[1]
    columns = stroke_values(placed(strokes, reference.game), reference, opponent, second)
    for name, column in columns.items():
        strokes = strokes.append_column(name, pa.array(column, pa.float64(), from_pandas=True))
    return strokes


def stroke_values(
    found: "Placed", reference: TabulatedPolicy, opponent: TabulatedPolicy | None = None, second: Bools | None = None
) -> dict[str, F64]:
    """``[N]`` each of :data:`COLUMNS`, as :func:`add_values` adds them; ``second``: strokes of seat 1."""
    sides = (reference,) if opponent is None else (reference, opponent)
    rows, incoming, state = found.rows, found.incoming, found.state
    striking = evaluate(reference, sides[-1]).striking
    before, decision = np.full(len(rows), np.nan), np.full(len(rows), np.nan)
    for seat, policy in enumerate(sides):
        mine = np.ones(len(rows), np.bool_) if second is None else second == bool(seat)
        theirs = sides[len(sides) - 1 - seat]
        # The mean over possible own last strokes, where the recorded one is unknown or impossible.
        value = Value(policy.game, striking, seat, theirs)
        mean = _means_over_own(policy, theirs, value)[incoming, rows.codes["hurried"], rows.codes["contact"]]
        before[mine] = np.where(state >= 0, value.before(state), mean)[mine]
        decision[mine] = _decisions(policy, found, value)[mine]
    before[incoming == _UNKNOWN] = np.nan
    after = np.full(len(rows), np.nan)
    after[rows.outcome == Outcome.FAULT], after[rows.outcome == Outcome.WINNER] = 0.0, 1.0
    returned = np.flatnonzero((rows.outcome == Outcome.RETURNED) & (rows.next_contact >= 0))
    after[returned] = 1 - before[returned + 1]
    realised = np.nan if (factor := factor_of(reference.game)) is None else factor.value
    parts = (before, after, after - before, decision, after - before - decision, decision * realised)
    return dict(zip(COLUMNS, parts, strict=True))


def add_values_of_pairs(strokes: pa.Table, reference: str, game: Game) -> pa.Table:
    """Add the value of every stroke in the game of the two people who played it, where the model has their skill.

    Args:
        strokes: table of schema :data:`shuttle_marl.data.schema.STROKES`, rallies in order.
        reference: name of the reference policy.
        game: game of the other matches, and the model with the skill.

    Returns:
        The table with the columns of :func:`add_values` and ``value_game``, the hash of the game.

    Raises:
        PolicyError: the policy is unknown.
        GameError: a file of the model is damaged.
    """
    match = strokes["match"].to_numpy(zero_copy_only=False)
    starts = np.flatnonzero(np.concatenate([[True], match[1:] != match[:-1]])) if len(match) else np.zeros(1, dtype=np.intp)
    parts: list[tuple[Game, pa.Table]] = []
    for start, end in zip(starts.tolist(), [*starts[1:].tolist(), len(match)], strict=True):
        part = strokes.slice(start, end - start)
        of_part = _game_of_people(part, game)
        if parts and parts[-1][0] is of_part:
            parts[-1] = (of_part, pa.concat_tables([parts[-1][1], part]))
        else:
            parts.append((of_part, part))
    valued = []
    for of_part, part in parts:
        sides = [tabulate(resolve(reference, seat), seat) for seat in dict.fromkeys(of_part.seats)]
        valued.append(add_values(part, *sides).append_column("value_game", pa.array([of_part.hash] * len(part), pa.string())))
    return pa.concat_tables(valued)


def _game_of_people(strokes: pa.Table, game: Game) -> Game:
    """The game of the two people of a match; ``game`` itself if the model does not know them."""
    people = sorted(strokes["player"].unique().to_pylist())
    found = None if len(people) != 2 else game_of_people(game, (people[0], people[1]), date_of(strokes["match"][0].as_py()))
    return game if found is None else found


class Placed(NamedTuple):
    """N strokes of a table in a game."""

    rows: Rows  # the strokes in context
    incoming: I64  # [N] catalogue index of the incoming stroke (`strokes_before`)
    state: I64  # [N] state; -1: unknown
    stroke: I64  # [N] catalogue index of the stroke, or of the nearest one to it; -1: unknown
    rank: I64  # [N] its position among the legal strokes of the state; -1: unknown or not legal


def placed(strokes: pa.Table, game: Game) -> Placed:
    """The strokes of a table of schema :data:`shuttle_marl.data.schema.STROKES` in a game."""
    rows, nearest = marked_rows(strokes, hurry_of(game)), nearest_strokes(game.catalogue)
    own, incoming = (strokes_before(rows, name, nearest, game.n_strokes) for name in ("own", "incoming"))
    state = states_of(game, rows, own, incoming)
    shot, area, technique = (rows.game_codes[part].astype(np.int64) for part in ("shot", "area", "technique"))
    stroke = np.where((area >= 0) & (state >= 0), nearest[shot, area, game.contact(state), technique], _UNKNOWN)
    rank = np.where(stroke >= 0, game.rank(state, stroke), _UNKNOWN).astype(np.int64)
    return Placed(rows, incoming, state, stroke, rank)


def nearest_strokes(catalogue: Catalogue) -> I64:
    """``[13, 9, 2, 3]`` catalogue index of the nearest stroke to each combination; -1 if there is none of the shot and height."""
    exact = catalogue.by_parts.astype(np.int64)
    area, technique = np.arange(N_AREAS), np.arange(N_TECHNIQUES)
    between_areas = steps_between(area[:, None], area)
    distance = 10 * (technique[:, None] != technique)[None, :, None, :] + between_areas[:, None, :, None]
    distance = distance.reshape(N_AREAS * N_TECHNIQUES, N_AREAS * N_TECHNIQUES)
    nearest = exact.copy()
    for shot in range(N_SHOTS):
        for height in range(2):
            strokes = exact[shot, :, height].reshape(-1)
            if (strokes >= 0).any():
                best = np.where(strokes >= 0, distance, distance.max() + 1).argmin(axis=1)
                nearest[shot, :, height] = strokes[best].reshape(N_AREAS, N_TECHNIQUES)
    return nearest


def _means_over_own(policy: TabulatedPolicy, opponent: TabulatedPolicy, value: Value) -> F64:
    """``[n + 1, 2, 2]`` mean probability of winning by incoming stroke, hurried and contact, weighted by visits."""
    game = policy.game
    weight = visits(policy, opponent).states[0] + 1e-12
    state = np.arange(game.n_states)
    group = 4 * game.incoming(state).astype(np.int64) + 2 * game.hurried(state) + game.contact(state)
    size = 4 * (game.n_strokes + 1)
    total = np.bincount(group, weight, size)
    with np.errstate(invalid="ignore"):
        return np.asarray((np.bincount(group, weight * value.before(state), size) / total).reshape(-1, 2, 2))


def _decisions(reference: TabulatedPolicy, found: Placed, value: Value) -> F64:
    """``[N]`` advantage of each stroke over the choice of the reference, the policy of the striker; NaN where unknown."""
    game, rows, state = reference.game, found.rows, found.state
    legal = (found.rank >= 0) & (rows.outcome != Outcome.FAULT)
    decision = np.full(len(rows), np.nan)
    decision[legal] = value.advantage(game.pair_at(state[legal], found.rank[legal]), state[legal])
    # Where a fault lands says little about its target: take the mean over the targets.
    fault = np.flatnonzero((state >= 0) & (rows.outcome == Outcome.FAULT))
    row, pairs = game.pairs(state[fault])
    aimed = game.base_pair_stroke[pairs % game.n_base_pairs]
    shot, technique = (rows.game_codes[part][fault][row] for part in ("shot", "technique"))
    alike = (game.catalogue.shot[aimed] == shot) & (game.catalogue.technique[aimed] == technique)
    row, pairs = row[alike], pairs[alike]
    weight = reference.probability_of(pairs) * game.outcome_probabilities(pairs)[:, rules.FAULT]
    total = np.bincount(row, weight, len(fault))
    with np.errstate(invalid="ignore"):
        decision[fault] = np.bincount(row, weight * value.advantage(pairs, state[fault][row]), len(fault)) / total
    return decision


def strokes_before(rows: Rows, name: str, strokes: Ints, n_strokes: int) -> I64:
    """``[N]`` catalogue index of a previous stroke: n before the serve, -1 where unknown or not in the catalogue; ``name``:
    ``own`` or ``incoming``; ``strokes``: ``[13, 9, 2, 3]`` catalogue index by shot type, area, height and technique;
    ``n_strokes``: n, the number of strokes in the catalogue."""
    shot, area, height, technique = (
        rows.game_codes[f"{name}_{part}"].astype(np.int64) for part in ("shot", "area", "height", "technique")
    )
    known = (shot < N_SHOTS) & (area < N_AREAS) & (height < 2) & (technique < N_TECHNIQUES)
    index = np.where(shot == N_SHOTS, n_strokes, -1)
    index[known] = strokes[shot[known], area[known], height[known], technique[known]]
    return index


def states_of(game: Game, rows: Rows, own: Ints, incoming: Ints) -> I64:
    """``[N]`` state in which each stroke was struck, -1 where the game has no such state or the context is unknown; ``own``,
    ``incoming``: ``[N]`` catalogue indices of the previous strokes (:func:`strokes_before`)."""
    duel = np.minimum(rows.net_run, LONGEST_DUEL) if game.counts_duels else 0
    effort, opponent_effort = (
        np.minimum(count, game.levels - 1) if game.levels > 1 else 0 for count in (rows.attacks, rows.opponent_attacks)
    )
    parts = (own, incoming, rows.codes["contact"], duel, effort, opponent_effort, rows.codes["hurried"])
    return game.state_of(*parts).astype(np.int64)
