"""Exact solution of the game with recovery: sweeps over states in which the receiver's position is hidden.

In each state the striker's strokes and the receiver's positions form a matrix game, whose value and optimal mixed strategies a
sweep computes by the simplex method. The value of a matrix game changes by at most the largest change of an entry, so the
operator contracts like that of :mod:`shuttle_marl.exact.fixed_point`, and its error bound holds (Shapley, PNAS 1953; a Newton
step with both players' strategies fixed is that of Pollatschek & Avi-Itzhak, Management Science 1969). A matrix game is solved
up to the gap between what its strategies guarantee, which counts as rounding.

If one player's positions are fixed, the other one strikes in a game without recovery, whose tables are the means over these
positions (:func:`met`): everything else that is exact is computed there.
"""

import dataclasses
import functools
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64, I8, I32, I64, U8, U16
from shuttle_marl.base.compiling import compiled, inlined
from shuttle_marl.exact.fixed_point import FIRST_RALLY_STATE, ExactError
from shuttle_marl.exact.sweeps import Chances, Replies, gathered, replies, unit_of, worth_of
from shuttle_marl.game.layout import ALL, Indices
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.tables import HURRY_ONE, Game
from shuttle_marl.game.thresholds import ONE


class Rows(NamedTuple):
    """Outcomes of a block by position, see :class:`shuttle_marl.game.recovery.Waiting`."""

    choices: I32
    position: I8
    start: I64
    limits: U16
    """``[R, 3]`` thresholds."""
    hurry: U8


def rows_of(game: Game, block: int) -> Rows:
    """The rows of one block of states."""
    waiting = game.waiting
    return Rows(waiting.choices, waiting.position, waiting.start, waiting.limits[block // game.levels], waiting.hurry)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MetGame(Game):
    """The game against a receiver whose positions are known: the means of the tables over them.

    Attributes:
        of: the game with recovery.
        table: for each block the row of the following two; blocks that are alike share one.
        mean_limits: ``[T, base pairs, 3]`` thresholds, not rounded.
        mean_hurry: ``[T, base pairs, 2]`` chances of a hurried receiver, not rounded.
    """

    of: Game
    table: tuple[int, ...]
    mean_limits: F64
    mean_hurry: F64

    def __post_init__(self) -> None:
        """Its layout is that of a game that was checked."""

    @property
    def tables(self) -> Game:
        """The game that has its layout."""
        return self.of

    @functools.cached_property
    def limits(self) -> F64:  # type: ignore[override]
        """``[T, base pairs, 3]`` thresholds."""
        return self.mean_limits

    def table_of(self, block: int) -> int:
        """Row of ``limits`` that holds in a block."""
        return self.table[block]

    def hurry_at(self, table: int) -> F64:  # type: ignore[override]
        """``[base pairs, 2]`` chances of a hurried receiver."""
        return self.mean_hurry[table]

    def limit_row(self, pairs: slice | Indices = ALL) -> I64:
        """``[...]`` row of legal pairs in ``limits`` as ``[T * base pairs, 3]``."""
        block, base = np.divmod(self._numbers(pairs), self.n_base_pairs)
        return np.asarray(np.array(self.table, dtype=np.int64)[block] * self.n_base_pairs + base)

    def hurry_of(self, pairs: slice | Indices = ALL) -> F64:
        """``[..., 2]`` probability that the receiver of a return is hurried."""
        return self.mean_hurry.reshape(-1, 2)[self.limit_row(pairs)] / HURRY_ONE


def people_positions(game: Game) -> F64:
    """``[S, 9]`` probabilities of people's positions where the opponent is in each state."""
    assert game.recovery is not None
    return np.tile(game.people_positions(np.arange(game.n_base_states)), (game.n_blocks, 1))


def met(game: Game, positions: F64 | None) -> MetGame:
    """The game against a receiver who chooses positions.

    Args:
        game: with recovery, the tables with which the striker strikes.
        positions: ``[S, 9]`` their probabilities in each state of the striker; None: those of people.
    """
    size, base = game.n_base_states, game.n_base_pairs
    table: list[int] = []
    known: list[tuple[int, F64]] = []
    limits, hurry = [], []
    for block in range(game.n_blocks):
        here = people_positions(game)[:size] if positions is None else positions[game.block_states(block)]
        level = block // game.levels
        found = next((k for k, (other, before) in enumerate(known) if other == level and np.array_equal(before, here)), None)
        if found is None:
            found = len(known)
            known.append((level, here))
            limits.append(np.empty((base, 3)))
            hurry.append(np.empty((base, 2)))
            _means(
                np.ascontiguousarray(here, dtype=np.float64), game.base_pair_start, rows_of(game, block), limits[-1], hurry[-1]
            )
        table.append(found)
    fields = {field.name: getattr(game, field.name) for field in dataclasses.fields(Game)}
    fields["recovery"] = None
    return MetGame(**fields, of=game, table=tuple(table), mean_limits=np.stack(limits), mean_hurry=np.stack(hurry))


@compiled
def _means(positions: F64, pair_start: I32, rows: Rows, limits: F64, hurry: F64) -> None:
    """Mean tables over ``[base states, 9]`` probabilities of positions."""
    for s in range(positions.shape[0]):
        m, row = rows.choices[s], rows.start[s]
        for pair in range(pair_start[s], pair_start[s + 1]):
            fault = winner = below = late_low = late_high = 0.0
            for i in range(m):
                share, r = positions[s, rows.position[s, i]], row + i
                won, under = float(rows.limits[r, 1]), float(rows.limits[r, 2])
                fault += share * float(rows.limits[r, 0])
                winner += share * won
                below += share * under
                late_low += share * (under - won) * rows.hurry[r, 0]
                late_high += share * (65536.0 - under) * rows.hurry[r, 1]
            limits[pair, 0], limits[pair, 1], limits[pair, 2] = fault, winner, below
            hurry[pair, 0] = late_low / (below - winner) if below > winner else 0.0
            hurry[pair, 1] = late_high / (65536.0 - below) if below < 65536.0 else 0.0
            row += m


def largest_continuation_by_position(game: Game) -> float:
    """The supremum of the probability that the rally continues, over all legal pairs but the serves and all positions.

    Raises:
        ExactError: it is 1.
    """
    waiting = game.waiting
    ends = waiting.limits[:, waiting.start[FIRST_RALLY_STATE] :, 1]
    if ends.size and ends.min() == 0:
        raise ExactError("a stroke never ends the rally against some position; exact values need a probability above 0")
    return float(1 - ends.min(initial=ONE - 1) / ONE)


# Matrix games.

_LEAST: Final = 1e-11
"""Smallest reduced cost that counts as an improvement, relative to entries of about 1."""


@inlined
def _simplex(matrix: F64, k: int, m: int, tableau: F64, basis: I64, outside: I64, x: F64, y: F64) -> None:
    """Optimal mixed strategies of a matrix game that the row player maximises.

    The column player's linear program, maximise sum u with A u <= 1 for the matrix A shifted to positive entries, is solved in
    the condensed form of the simplex method: k + 1 rows and m + 1 columns.

    Args:
        matrix: ``[k m]`` entries, row after row.
        tableau: ``[(k + 1) (m + 1)]``, basis: ``[k]``, outside: ``[m]``; memory to work in.
        x: ``[k]`` strategy of the rows, y: ``[m]`` of the columns; written.
    """
    least, largest, width = matrix[0], matrix[0], m + 1
    for a in range(1, k * m):
        least, largest = min(least, matrix[a]), max(largest, matrix[a])
    scale = max(largest - least, 1e-300)
    for a in range(k):
        for b in range(m):
            tableau[a * width + b] = (matrix[a * m + b] - least) / scale + 1.0
        tableau[a * width + m] = 1.0
        basis[a] = m + a
    for b in range(m):
        tableau[k * width + b] = 1.0
        outside[b] = b
    tableau[k * width + m] = 0.0
    for step in range(60 * m):
        column, gain = -1, _LEAST
        for b in range(m):
            cost = tableau[k * width + b]
            # The largest reduced cost; after many steps the first positive one of least number (Bland), which never cycles.
            if (step < 20 * m and cost > gain) or (
                step >= 20 * m and cost > _LEAST and (column < 0 or outside[b] < outside[column])
            ):
                column, gain = b, cost
        if column < 0:
            break
        row, ratio = -1, 1e300
        for a in range(k):
            entry = tableau[a * width + column]
            if entry > 1e-12:
                limit = tableau[a * width + m] / entry
                if limit < ratio - 1e-13 or (limit <= ratio + 1e-13 and row >= 0 and basis[a] < basis[row]):
                    row, ratio = a, limit
        if row < 0:
            break
        pivot = tableau[row * width + column]
        for b in range(width):
            if b != column:
                tableau[row * width + b] /= pivot
        for a in range(k + 1):
            factor = tableau[a * width + column]
            if a != row and factor != 0.0:
                for b in range(width):
                    if b != column:
                        tableau[a * width + b] -= factor * tableau[row * width + b]
                tableau[a * width + column] = -factor / pivot
        tableau[row * width + column] = 1.0 / pivot
        basis[row], outside[column] = outside[column], basis[row]
    for a in range(k):
        x[a] = 0.0
    for b in range(m):
        y[b] = 0.0
    total = 0.0
    for a in range(k):
        if basis[a] < m:
            y[basis[a]] = max(tableau[a * width + m], 0.0)
            total += y[basis[a]]
    for b in range(m):
        y[b] /= total
    total = 0.0
    for b in range(m):
        if outside[b] >= m:
            x[outside[b] - m] = max(-tableau[k * width + b], 0.0)
            total += x[outside[b] - m]
    for a in range(k):
        x[a] /= total


@compiled
def matrix_game(matrix: F64, x: F64, y: F64) -> tuple[float, float]:
    """Value and optimal strategies of a matrix game that the row player maximises.

    Args:
        matrix: ``[k, m]``.
        x: ``[k]`` strategy of the rows, y: ``[m]`` of the columns; written.

    Returns:
        What the strategies guarantee the row player at least, and at most.
    """
    k, m = matrix.shape
    flat, size = matrix.ravel(), (k + 1) * (m + 1)
    return _solve(flat, k, m, np.empty(size), np.empty(k, np.int64), np.empty(m, np.int64), x, y)


@inlined
def _solve(matrix: F64, k: int, m: int, tableau: F64, basis: I64, outside: I64, x: F64, y: F64) -> tuple[float, float]:
    """:func:`matrix_game`; a saddle point in pure strategies is found first, that of the lowest numbers."""
    best, row, worst, column = -1e300, 0, 1e300, 0
    for a in range(k):
        low = matrix[a * m]
        for b in range(1, m):
            low = min(low, matrix[a * m + b])
        if low > best + 1e-12:
            best, row = low, a
    for b in range(m):
        high = matrix[b]
        for a in range(1, k):
            high = max(high, matrix[a * m + b])
        if high < worst - 1e-12:
            worst, column = high, b
    if worst - best <= 1e-12:
        for a in range(k):
            x[a] = 0.0
        for b in range(m):
            y[b] = 0.0
        x[row], y[column] = 1.0, 1.0
        return best, worst
    _simplex(matrix, k, m, tableau, basis, outside, x, y)
    low, high = 1e300, -1e300
    for b in range(m):
        mean = 0.0
        for a in range(k):
            mean += x[a] * matrix[a * m + b]
        low = min(low, mean)
    for a in range(k):
        mean = 0.0
        for b in range(m):
            mean += y[b] * matrix[a * m + b]
        high = max(high, mean)
    return low, high


@compiled
def _saddles(rows: Rows, replies: Replies, following: F64, value: F64, x: F64, y: F64) -> float:
    """Values of the matrix games of all states of a block, and the strategies.

    Args:
        following: ``[4, V]`` values of the successors (:mod:`shuttle_marl.exact.sweeps`).
        value: ``[base states]``, x: ``[base pairs]`` strokes, y: ``[base states, 9]`` positions; written.

    Returns:
        The largest gap between what the strategies of a state guarantee.
    """
    largest, most = 0.0, 1
    for s in range(value.size):
        most = max(most, replies.pair_start[s + 1] - replies.pair_start[s])
    matrix, tableau = np.empty(most * 9), np.empty((most + 1) * 10)
    basis, outside, shares = np.empty(most, np.int64), np.empty(9, np.int64), np.empty(9)
    for s in range(value.size):
        first, m = replies.pair_start[s], rows.choices[s]
        k = replies.pair_start[s + 1] - first
        value[s] = 0.0
        y[s] = 0.0
        if k == 0:
            y[s, rows.position[s, 0]] = 1.0
            continue
        row = rows.start[s]
        for a in range(k):
            v = replies.first_reply[s] + a
            after = following[0, v], following[1, v], following[2, v], following[3, v]
            for b in range(m):
                fault, winner, below = rows.limits[row, 0], rows.limits[row, 1], rows.limits[row, 2]
                matrix[a * m + b] = (
                    worth_of(float(fault), float(winner), float(below), rows.hurry[row, 0], rows.hurry[row, 1], after) / 65536.0
                )
                row += 1
        low, high = _solve(matrix, k, m, tableau, basis, outside, x[first : first + k], shares)
        value[s] = (low + high) / 2.0
        largest = max(largest, high - low)
        for b in range(m):
            y[s, rows.position[s, b]] = shares[b]
    return largest


@compiled
def _mean_worth(chances: Chances, unit: float, rows: Rows, replies: Replies, following: F64, out: F64) -> None:
    """``[base states, 9]`` mean value of the strokes of each state against each feasible position; the others are infinite."""
    for s in range(out.shape[0]):
        first, last, m, row = replies.pair_start[s], replies.pair_start[s + 1], rows.choices[s], rows.start[s]
        out[s] = np.inf
        for b in range(m):
            out[s, rows.position[s, b]] = 0.0
        for pair in range(first, last):
            chance = chances[pair] * unit
            if chance > 0.0:
                v = replies.first_reply[s] + pair - first
                after = following[0, v], following[1, v], following[2, v], following[3, v]
                for b in range(m):
                    r = row + b
                    fault, winner, below = rows.limits[r, 0], rows.limits[r, 1], rows.limits[r, 2]
                    worth = worth_of(float(fault), float(winner), float(below), rows.hurry[r, 0], rows.hurry[r, 1], after)
                    out[s, rows.position[s, b]] += chance * worth / 65536.0
            row += m


@compiled
def _mean_change(chances: Chances, unit: float, y: F64, rows: Rows, replies: Replies, following: F64, out: F64) -> None:
    """Mean of what follows the strokes of each state, for chances of strokes and ``[base states, 9]`` of positions."""
    for s in range(out.size):
        first, last, m, row = replies.pair_start[s], replies.pair_start[s + 1], rows.choices[s], rows.start[s]
        total = 0.0
        for pair in range(first, last):
            chance = chances[pair] * unit
            if chance > 0.0:
                v = replies.first_reply[s] + pair - first
                for b in range(m):
                    share = chance * y[s, rows.position[s, b]]
                    if share > 0.0:
                        won, under = float(rows.limits[row + b, 1]), float(rows.limits[row + b, 2])
                        low = following[0, v] + rows.hurry[row + b, 0] * following[2, v]
                        high = following[1, v] + rows.hurry[row + b, 1] * following[3, v]
                        total += share * ((under - won) * low + (65536.0 - under) * high)
            row += m
        out[s] = total / 65536.0


@dataclasses.dataclass(eq=False)
class Saddle:
    """Both players choose best: the striker a stroke, the receiver a position. The states are those in which one player strikes.

    Attributes:
        game: with recovery, the tables with which that player strikes.
        gap: largest gap of a matrix game so far.
    """

    game: Game
    gap: float = 0.0

    @functools.cached_property
    def contraction(self) -> float:
        """Factor by which a sweep reduces an error of the rally states."""
        return largest_continuation_by_position(self.game)

    def strategies(self, block: int, plain: F64, after_attack: F64) -> tuple[F64, F64, F64]:
        """Values, strokes ``[base pairs]`` and positions ``[base states, 9]`` of a block."""
        game = self.game
        value, x, y = np.empty(game.n_base_states), np.empty(game.n_base_pairs), np.empty((game.n_base_states, N_POSITIONS))
        gap = _saddles(rows_of(game, block), replies(game), gathered(game, plain, after_attack), value, x, y)
        self.gap = max(self.gap, gap)
        return value, x, y

    def block_sweep(self, block: int, plain: F64, after_attack: F64) -> "tuple[F64, _MeanLinear]":
        """Values of one block and their linear part; see :class:`~shuttle_marl.exact.solver.Player`."""
        value, x, y = self.strategies(block, plain, after_attack)
        return value, _MeanLinear(self.game, block, x, y)


@dataclasses.dataclass(frozen=True, eq=False)
class _MeanLinear:
    """The linear part of a sweep at fixed strokes and positions of a block."""

    game: Game
    block: int
    strokes: Chances
    positions: F64

    def __call__(self, plain: F64, after_attack: F64) -> F64:
        game, out = self.game, np.empty(self.game.n_base_states)
        following = gathered(game, plain, after_attack)
        _mean_change(
            self.strokes, unit_of(self.strokes), self.positions, rows_of(game, self.block), replies(game), following, out
        )
        return -out


@dataclasses.dataclass(frozen=True, eq=False)
class Outwaited:
    """A striker who follows a policy, against a receiver who chooses the best positions.

    Attributes:
        game: with recovery, the tables with which the striker strikes.
        strokes: for each block ``[base pairs]`` probability of each legal pair given its state, of a table in units of 1/65535.
    """

    game: Game
    strokes: tuple[Chances, ...]

    @functools.cached_property
    def contraction(self) -> float:
        """Factor by which a sweep reduces an error of the rally states."""
        return largest_continuation_by_position(self.game)

    def positions(self, block: int, plain: F64, after_attack: F64) -> tuple[F64, F64]:
        """``[base states]`` values to the striker, and ``[base states, 9]`` the best positions, the first one of a tie."""
        game, chance = self.game, self.strokes[block]
        worth = np.empty((game.n_base_states, N_POSITIONS))
        following = gathered(game, plain, after_attack)
        _mean_worth(chance, unit_of(chance), rows_of(game, block), replies(game), following, worth)
        least = worth.min(axis=1)
        chosen = np.eye(N_POSITIONS)[np.argmax(worth <= least[:, None] + _TIE, axis=1)]
        return least, chosen

    def block_sweep(self, block: int, plain: F64, after_attack: F64) -> tuple[F64, _MeanLinear]:
        """Values of one block and their linear part; see :class:`~shuttle_marl.exact.solver.Player`."""
        value, chosen = self.positions(block, plain, after_attack)
        return value, _MeanLinear(self.game, block, self.strokes[block], chosen)


_TIE: Final = 1e-12
