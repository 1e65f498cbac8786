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
from shuttle_marl.exact.solver import BlockLinear, successors
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
    """``[G, R, 3]`` thresholds in G games."""
    hurry: U8
    """``[G, R, 2]`` chances of a hurried receiver."""


def rows_of(games: tuple[Game, ...], block: int) -> Rows:
    """The rows of one block of states of games with the same layout and feasible positions."""
    return _rows_of(games, block // games[0].levels)


@functools.lru_cache(maxsize=8)
def _rows_of(games: tuple[Game, ...], level: int) -> Rows:
    first = games[0].waiting
    if len(games) == 1:
        return Rows(first.choices, first.position, first.start, first.limits[level : level + 1], first.hurry[None])
    limits, hurry = (np.stack(part) for part in zip(*((g.waiting.limits[level], g.waiting.hurry) for g in games), strict=True))
    return Rows(first.choices, first.position, first.start, limits, hurry)


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
    usual = np.empty(0) if positions is not None else game.people_positions(np.arange(size))
    for block in range(game.n_blocks):
        here = usual if positions is None else positions[game.block_states(block)]
        level = block // game.levels
        found = next((k for k, (other, before) in enumerate(known) if other == level and np.array_equal(before, here)), None)
        if found is None:
            found = len(known)
            known.append((level, here))
            limits.append(np.empty((base, 3)))
            hurry.append(np.empty((base, 2)))
            _means(
                np.ascontiguousarray(here, dtype=np.float64), game.base_pair_start, rows_of((game,), block), limits[-1], hurry[-1]
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
                won, under = float(rows.limits[0, r, 1]), float(rows.limits[0, r, 2])
                fault += share * float(rows.limits[0, r, 0])
                winner += share * won
                below += share * under
                late_low += share * (under - won) * rows.hurry[0, r, 0]
                late_high += share * (65536.0 - under) * rows.hurry[0, r, 1]
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


class Fixed(NamedTuple):
    """What a player who is not free does in a block: strokes of the striker, or positions of the receiver."""

    share: float
    """Probability with which it applies; else that player is free too. 0: both players are free."""
    strokes: Chances
    """``[base pairs]`` probability of each legal pair given its state, of a table in units of 1/65535; empty: none."""
    unit: float
    """Probability that a chance of 1 stands for."""
    positions: F64
    """``[base states, 9]`` probabilities of positions; empty: none."""


@inlined
def _fill(rows: Rows, replies: Replies, following: F64, s: int, against: bool, matrix: F64, picked: U8) -> None:
    """Write the values of the strokes of a state against its positions, stroke after stroke, and the games that nature picks."""
    row, m, a = rows.start[s], rows.choices[s], 0
    for v in range(replies.first_reply[s], replies.first_reply[s] + replies.pair_start[s + 1] - replies.pair_start[s]):
        after = following[0, v], following[1, v], following[2, v], following[3, v]
        for _ in range(m):
            for g in range(rows.limits.shape[0]):
                fault, winner, below = rows.limits[g, row, 0], rows.limits[g, row, 1], rows.limits[g, row, 2]
                low, high = rows.hurry[g, row, 0], rows.hurry[g, row, 1]
                entry = worth_of(float(fault), float(winner), float(below), low, high, after) / 65536.0
                if g == 0 or (entry < matrix[a] if against else entry > matrix[a]):
                    matrix[a], picked[row] = entry, g
            row, a = row + 1, a + 1


@compiled
def _saddles(
    rows: Rows, replies: Replies, following: F64, fixed: Fixed, against: bool, value: F64, x: F64, y: F64, picked: U8
) -> float:
    """Values of the matrix games of all states of a block, and the strategies.

    Args:
        rows: of G games, of which nature picks one after each stroke.
        following: ``[4, V]`` values of the successors (:mod:`shuttle_marl.exact.sweeps`).
        against: whether nature picks the worst game for the striker; else the best one.
        value: ``[base states]``, x: ``[base pairs]`` strokes, y: ``[base states, 9]`` positions, picked: ``[R]`` games; written.

    Returns:
        The largest gap between what the strategies of a state guarantee.
    """
    largest, most = 0.0, 1
    share, bound = fixed.share, fixed.strokes.size > 0
    for s in range(value.size):
        most = max(most, replies.pair_start[s + 1] - replies.pair_start[s])
    matrix, tableau, means = np.empty(most * 9), np.empty((most + 1) * 10), np.empty(most + 9)
    basis, outside, shares = np.empty(most, np.int64), np.empty(9, np.int64), np.empty(9)
    for s in range(value.size):
        first, m = replies.pair_start[s], rows.choices[s]
        k = replies.pair_start[s + 1] - first
        value[s] = 0.0
        y[s] = 0.0
        if k == 0:
            y[s, rows.position[s, 0]] = 1.0
            continue
        _fill(rows, replies, following, s, against, matrix, picked)
        if share > 0.0:
            # The fixed player's mean, which the free choices of both only add to.
            for a in range(k if not bound else 1):
                for b in range(m if bound else 1):
                    mean = 0.0
                    for c in range(k if bound else m):
                        chance = fixed.strokes[first + c] * fixed.unit if bound else fixed.positions[s, rows.position[s, c]]
                        mean += chance * (matrix[c * m + b] if bound else matrix[a * m + c])
                    means[b if bound else a] = mean
            for a in range(k):
                for b in range(m):
                    matrix[a * m + b] = (1.0 - share) * matrix[a * m + b] + share * means[b if bound else a]
        low, high = _solve(matrix, k, m, tableau, basis, outside, x[first : first + k], shares)
        value[s] = (low + high) / 2.0
        largest = max(largest, high - low)
        for b in range(m):
            y[s, rows.position[s, b]] = shares[b]
    return largest


@compiled
def _mean_change(x: F64, y: F64, rows: Rows, picked: U8, replies: Replies, following: F64, out: F64) -> None:
    """Mean of what follows, for probabilities of strokes ``[base pairs]`` and of positions ``[base states, 9]``."""
    for s in range(out.size):
        first, last, m, row = replies.pair_start[s], replies.pair_start[s + 1], rows.choices[s], rows.start[s]
        total = 0.0
        for pair in range(first, last):
            chance = x[pair]
            if chance > 0.0:
                v = replies.first_reply[s] + pair - first
                for b in range(m):
                    share, g = chance * y[s, rows.position[s, b]], picked[row + b]
                    if share > 0.0:
                        won, under = float(rows.limits[g, row + b, 1]), float(rows.limits[g, row + b, 2])
                        low = following[0, v] + rows.hurry[g, row + b, 0] * following[2, v]
                        high = following[1, v] + rows.hurry[g, row + b, 1] * following[3, v]
                        total += share * ((under - won) * low + (65536.0 - under) * high)
            row += m
        out[s] = total / 65536.0


def mean_linear(games: tuple[Game, ...], block: int, x: F64, y: F64, picked: U8) -> BlockLinear:
    """The linear part of a sweep at fixed strokes ``[base pairs]``, positions ``[base states, 9]`` and games ``[R]``."""
    game, rows = games[0], rows_of(games, block)

    def linear(plain: F64, after_attack: F64) -> F64:
        out = np.empty(game.n_base_states)
        _mean_change(x, y, rows, picked, replies(game), gathered(game, plain, after_attack), out)
        return -out

    return linear


@dataclasses.dataclass(eq=False)
class Saddle:
    """The states in which one player strikes: both players choose best, the striker strokes, the receiver positions.

    Attributes:
        games: with recovery, the tables with which that player strikes; of several, nature picks one after each stroke.
        against: whether nature picks against that player; else in favour.
        strokes: for each block ``[base pairs]`` probabilities of a policy that the striker follows; None: free.
        positions: ``[S, 9]`` probabilities of positions of a policy that the receiver follows; None: free.
        share: probability with which each choice follows the policy; else it is free.
        gap: largest gap of a matrix game so far.
    """

    games: tuple[Game, ...]
    against: bool = False
    strokes: tuple[Chances, ...] | None = None
    positions: F64 | None = None
    share: float = 1.0
    gap: float = 0.0

    @property
    def game(self) -> Game:
        """The first of the games."""
        return self.games[0]

    @functools.cached_property
    def contraction(self) -> float:
        """Factor by which a sweep reduces an error of the rally states."""
        return max(map(largest_continuation_by_position, self.games))

    def strategies(self, block: int, plain: F64, after_attack: F64) -> tuple[F64, F64, F64, U8]:
        """Values, free strokes ``[base pairs]`` and positions ``[base states, 9]``, and picked games ``[R]`` of a block."""
        game = self.game
        value, x, y = np.empty(game.n_base_states), np.empty(game.n_base_pairs), np.empty((game.n_base_states, N_POSITIONS))
        picked, rows = np.zeros(game.waiting.start[-1], np.uint8), rows_of(self.games, block)
        gap = _saddles(
            rows, replies(game), gathered(game, plain, after_attack), self._fixed(block), self.against, value, x, y, picked
        )
        self.gap = max(self.gap, gap)
        return value, x, y, picked

    def block_sweep(self, block: int, plain: F64, after_attack: F64) -> tuple[F64, BlockLinear]:
        """Values of one block and their linear part; see :class:`~shuttle_marl.exact.solver.Player`."""
        value, x, y, picked = self.strategies(block, plain, after_attack)
        fixed = self._fixed(block)
        if fixed.strokes.size:
            x = (1 - fixed.share) * x + fixed.share * fixed.unit * fixed.strokes
        elif fixed.positions.size:
            y = (1 - fixed.share) * y + fixed.share * fixed.positions
        return value, mean_linear(self.games, block, x, y, picked)

    def _fixed(self, block: int) -> Fixed:
        strokes = np.empty(0) if self.strokes is None else self.strokes[block]
        positions = np.empty((0, N_POSITIONS)) if self.positions is None else self.positions[self.game.block_states(block)]
        share = self.share if strokes.size or positions.size else 0.0
        return Fixed(share, strokes, unit_of(strokes), np.ascontiguousarray(positions))

    def all_strategies(self, following: F64) -> tuple[F64, F64]:
        """``[P]`` strokes and ``[S, 9]`` positions, from the ``[S]`` values of the next states to the receiver."""
        blocks = [self.strategies(block, *successors(self.game, following, block)) for block in range(self.game.n_blocks)]
        return np.concatenate([found[1] for found in blocks]), np.concatenate([found[2] for found in blocks])


@compiled
def _soft_saddles(
    rows: Rows, replies: Replies, following: F64, prior: F64, people: F64, tau: float, value: F64, x: F64, y: F64, picked: U8
) -> float:
    """Values of the KL-regularised matrix games of all states of a block (:mod:`shuttle_marl.exact.optimal`), and the strategies.

    The receiver minimises the convex function tau log sum_a b(a) exp((M y)_a / tau) + tau KL(y || q) of positions y by Newton
    steps with a line search; at its minimum the striker's strokes are the soft maximum against y.

    Args:
        prior: ``[base pairs]`` strokes b, people: ``[base states, 9]`` positions q.
        tau: cost of a nat of divergence from them.

    Returns:
        The largest gap between what the strategies of a state guarantee.
    """
    largest, most = 0.0, 1
    for s in range(value.size):
        most = max(most, replies.pair_start[s + 1] - replies.pair_start[s])
    entries, mean, trial = np.empty(most * 9), np.empty(most), np.empty(9)
    hessian, step = np.empty((10, 10)), np.empty(10)
    for s in range(value.size):
        first, m = replies.pair_start[s], rows.choices[s]
        k = replies.pair_start[s + 1] - first
        value[s] = 0.0
        y[s] = 0.0
        if k == 0:
            y[s, rows.position[s, 0]] = 1.0
            continue
        played, before = x[first : first + k], prior[first : first + k]
        _fill(rows, replies, following, s, False, entries, picked)
        matrix = entries[: k * m].reshape(k, m)
        usual, waits = np.empty(m), np.empty(m)
        for b in range(m):
            usual[b] = people[s, rows.position[s, b]]
            waits[b] = max(usual[b], 1e-12)
        waits /= waits.sum()
        now = _soft_value(matrix, k, m, before, usual, waits, tau, mean, played)
        for _ in range(60):
            # The gradient and the Hessian along sum y = 1, bordered by the constraint.
            decrease = 0.0
            for b in range(m):
                slope = 0.0
                for a in range(k):
                    slope += played[a] * matrix[a, b]
                step[b] = -(slope + tau * (np.log(waits[b] / max(usual[b], 1e-300)) + 1.0))
            for b in range(m):
                for c in range(b + 1):
                    both = left = right = 0.0
                    for a in range(k):
                        both += played[a] * matrix[a, b] * matrix[a, c]
                        left += played[a] * matrix[a, b]
                        right += played[a] * matrix[a, c]
                    hessian[b, c] = hessian[c, b] = (both - left * right) / tau + (tau / waits[b] if b == c else 0.0)
                hessian[b, m] = hessian[m, b] = 1.0
                trial[b] = step[b]
            hessian[m, m] = step[m] = 0.0
            _solve_linear(hessian, step, m + 1)
            scale = 1.0
            for b in range(m):
                decrease -= trial[b] * step[b]
                if step[b] < 0.0:
                    scale = min(scale, -0.95 * waits[b] / step[b])
            if decrease > -1e-14:
                break
            while scale > 1e-10:
                for b in range(m):
                    trial[b] = waits[b] + scale * step[b]
                then = _soft_value(matrix, k, m, before, usual, trial, tau, mean, played)
                if then <= now + 1e-4 * scale * decrease + 1e-15:
                    break
                scale *= 0.5
            for b in range(m):
                waits[b] = trial[b]
            now = then
        total, divergence = 0.0, 0.0
        for b in range(m):
            slope = 0.0
            for a in range(k):
                slope += played[a] * matrix[a, b]
            trial[b] = -slope / tau
        best = trial[:m].max()
        for b in range(m):
            total += usual[b] * np.exp(trial[b] - best)
        for a in range(k):
            if played[a] > 0.0:
                divergence += played[a] * np.log(played[a] / before[a])
        low = -tau * (best + np.log(total)) - tau * divergence
        value[s] = (low + now) / 2.0
        largest = max(largest, now - low)
        for b in range(m):
            y[s, rows.position[s, b]] = waits[b]
    return largest


@inlined
def _soft_value(matrix: F64, k: int, m: int, before: F64, usual: F64, waits: F64, tau: float, mean: F64, played: F64) -> float:
    """What positions guarantee the receiver at most, and ``played``, the soft maximum of strokes against them."""
    best, total, divergence = -1e300, 0.0, 0.0
    for a in range(k):
        mean[a] = 0.0
        for b in range(m):
            mean[a] += waits[b] * matrix[a, b]
        if before[a] > 0.0:
            best = max(best, mean[a])
    for a in range(k):
        played[a] = before[a] * np.exp(min((mean[a] - best) / tau, 0.0))
        total += played[a]
    for a in range(k):
        played[a] /= total
    for b in range(m):
        divergence += waits[b] * np.log(waits[b] / max(usual[b], 1e-300))
    return best + tau * np.log(total) + tau * divergence


@inlined
def _solve_linear(matrix: F64, right: F64, size: int) -> None:
    """Solve a small linear system by Gaussian elimination with partial pivoting; both arguments are overwritten."""
    for i in range(size):
        pivot = i
        for j in range(i + 1, size):
            if abs(matrix[j, i]) > abs(matrix[pivot, i]):
                pivot = j
        if pivot != i:
            for c in range(size):
                matrix[i, c], matrix[pivot, c] = matrix[pivot, c], matrix[i, c]
            right[i], right[pivot] = right[pivot], right[i]
        for j in range(i + 1, size):
            factor = matrix[j, i] / matrix[i, i]
            for c in range(i, size):
                matrix[j, c] -= factor * matrix[i, c]
            right[j] -= factor * right[i]
    for i in range(size - 1, -1, -1):
        for c in range(i + 1, size):
            right[i] -= matrix[i, c] * right[c]
        right[i] /= matrix[i, i]


@dataclasses.dataclass(eq=False)
class SoftSaddle(Saddle):
    """Both players choose best and pay for the divergence from how people choose: ``strokes`` and ``positions`` are the priors.

    Attributes:
        tau: cost of a nat.
    """

    tau: float = 0.0

    def strategies(self, block: int, plain: F64, after_attack: F64) -> tuple[F64, F64, F64, U8]:
        """Values, strokes, positions and games of a block; see :meth:`Saddle.strategies`."""
        game, prior = self.game, self._fixed(block)
        value, x, y = np.empty(game.n_base_states), np.empty(game.n_base_pairs), np.empty((game.n_base_states, N_POSITIONS))
        following, rows = gathered(game, plain, after_attack), rows_of(self.games, block)
        strokes = np.asarray(prior.strokes, dtype=np.float64) * prior.unit
        picked = np.zeros(game.waiting.start[-1], np.uint8)
        gap = _soft_saddles(rows, replies(game), following, strokes, prior.positions, self.tau, value, x, y, picked)
        self.gap = max(self.gap, gap)
        return value, x, y, picked

    def block_sweep(self, block: int, plain: F64, after_attack: F64) -> tuple[F64, BlockLinear]:
        """Values of one block and their linear part; see :class:`~shuttle_marl.exact.solver.Player`."""
        value, x, y, picked = self.strategies(block, plain, after_attack)
        return value, mean_linear(self.games, block, x, y, picked)
