"""Exact solution of the game with recovery: sweeps over states in which the receiver's position is hidden.

In each state the striker's strokes and the receiver's positions form a matrix game, whose value and optimal mixed strategies a
sweep computes by the simplex method. The value of a matrix game changes by at most the largest change of an entry, so the
operator contracts like that of :mod:`shuttle_marl.exact.fixed_point`, and its error bound holds (Shapley, PNAS 1953; a Newton
step with both players' strategies fixed is that of Pollatschek & Avi-Itzhak, Management Science 1969). A matrix game is solved
up to the gap between what its strategies guarantee, which counts as rounding. In human-like play both players pay for the
divergence from how people choose.
"""

import dataclasses
import functools
from typing import Any, Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64, I64, U8
from shuttle_marl.base.compiling import compiled, inlined
from shuttle_marl.exact.fixed_point import BlockLinear, Free, successors
from shuttle_marl.exact.profile import PairPolicy, Rows, rows_of
from shuttle_marl.exact.sweeps import Chances, Replies, gathered, replies, unit_of, worth_of
from shuttle_marl.game.policy import from_pair_probabilities
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.tables import Game

_LEAST: Final = 1e-11  # smallest reduced cost that counts as an improvement, relative to entries of about 1


class Fixed(NamedTuple):
    """What a player who is not free does in a block: strokes of the striker, or positions of the receiver."""

    share: float  # Probability with which it applies; else that player is free too. 0: both players are free
    strokes: Chances  # [base pairs] probability of each legal pair given its state, of a table in units of 1/65535; empty: none
    unit: float  # Probability that a chance of 1 stands for
    positions: F64  # [base states, 9] probabilities of positions; empty: none


class Strategies(NamedTuple):
    """Solution of a block of matrix games."""

    value: F64  # [base states] values
    strokes: F64  # [base pairs] probabilities of strokes
    positions: F64  # [base states, 9] probabilities of positions
    picked: U8  # [R] games that nature picks


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
    x[:k], y[:m] = 0.0, 0.0
    total = 0.0
    for a in range(k):
        if basis[a] < m:
            y[basis[a]] = max(tableau[a * width + m], 0.0)
            total += y[basis[a]]
    y[:m] /= total
    total = 0.0
    for b in range(m):
        if outside[b] >= m:
            x[outside[b] - m] = max(-tableau[k * width + b], 0.0)
            total += x[outside[b] - m]
    x[:k] /= total


@inlined
def _solved(matrix: F64, k: int, m: int, tableau: F64, basis: I64, outside: I64, x: F64, y: F64) -> tuple[float, float]:
    """Optimal strategies of a matrix game that the row player maximises; returns what they guarantee that player and allow them.

    A saddle point in pure strategies is found first, that of the lowest numbers.

    Args:
        matrix: overwritten; basis: ``[2 k]``, the other memory as for :func:`_simplex`.
    """
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
        x[:k], y[:m] = 0.0, 0.0
        x[row], y[column] = 1.0, 1.0
        return best, worst
    # No optimal strategy plays a row that is everywhere below what another row guarantees.
    n, rows = 0, basis[k:]
    for a in range(k):
        high = matrix[a * m]
        for b in range(1, m):
            high = max(high, matrix[a * m + b])
        if high >= best:
            for b in range(m):
                matrix[n * m + b] = matrix[a * m + b]
            rows[n] = a
            n += 1
    _simplex(matrix, n, m, tableau, basis, outside, x, y)
    low, high = 1e300, -1e300
    for b in range(m):
        mean = 0.0
        for a in range(n):
            mean += x[a] * matrix[a * m + b]
        low = min(low, mean)
    for a in range(n):
        mean = 0.0
        for b in range(m):
            mean += y[b] * matrix[a * m + b]
        high = max(high, mean)
    x[n:k] = 0.0
    for i in range(n - 1, -1, -1):
        share, x[i] = x[i], 0.0
        x[rows[i]] = share
    return low, high


@inlined
def _write_matrix(rows: Rows, replies: Replies, following: F64, s: int, against: bool, matrix: F64, picked: U8) -> None:
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


@inlined
def _reset(rows: Rows, replies: Replies, found: Strategies, s: int) -> tuple[int, int, int]:
    """Reset value and positions of a state; returns first pair, number of legal strokes and number of feasible positions."""
    first = replies.pair_start[s]
    k = replies.pair_start[s + 1] - first
    found.value[s] = 0.0
    found.positions[s] = 0.0
    if k == 0:
        found.positions[s, rows.position[s, 0]] = 1.0
    return first, k, rows.choices[s]


@compiled
def _saddles(rows: Rows, replies: Replies, following: F64, fixed: Fixed, against: bool, found: Strategies) -> float:
    """Write values and strategies of the matrix games of all states of a block; returns the largest gap that they leave.

    Args:
        rows: of G games, of which nature picks one after each stroke.
        following: ``[4, V]`` values of the successors (:mod:`shuttle_marl.exact.sweeps`).
        against: whether nature picks the worst game for the striker; else the best one.
    """
    value, x, y, picked = found
    largest, most = 0.0, max(1, (replies.pair_start[1:] - replies.pair_start[:-1]).max())
    share, bound = fixed.share, fixed.strokes.size > 0
    matrix, tableau, means = np.empty(most * 9), np.empty((most + 1) * 10), np.empty(most + 9)
    basis, outside, shares = np.empty(2 * most, np.int64), np.empty(9, np.int64), np.empty(9)
    for s in range(value.size):
        first, k, m = _reset(rows, replies, found, s)
        if k == 0:
            continue
        _write_matrix(rows, replies, following, s, against, matrix, picked)
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
        low, high = _solved(matrix, k, m, tableau, basis, outside, x[first : first + k], shares)
        value[s] = (low + high) / 2.0
        largest = max(largest, high - low)
        for b in range(m):
            y[s, rows.position[s, b]] = shares[b]
    return largest


@compiled
def _answers(rows: Rows, replies: Replies, following: F64, strokes: Chances, unit: float, found: Strategies) -> float:
    """The best positions of all states of a block against known strokes; as :func:`_saddles` for a share of 1, in less time."""
    value, x, y, _ = found
    means = np.empty(9)
    for s in range(value.size):
        first, k, m = _reset(rows, replies, found, s)
        if k == 0:
            continue
        means[:] = 0.0
        for a in range(k):
            chance, v, row = strokes[first + a] * unit, replies.first_reply[s] + a, rows.start[s] + a * m
            x[first + a] = chance
            if chance == 0.0:
                continue
            after = following[0, v], following[1, v], following[2, v], following[3, v]
            for b in range(m):
                fault, winner, below = rows.limits[0, row + b, 0], rows.limits[0, row + b, 1], rows.limits[0, row + b, 2]
                low, high = rows.hurry[0, row + b, 0], rows.hurry[0, row + b, 1]
                means[b] += chance * worth_of(float(fault), float(winner), float(below), low, high, after)
        best = means[:m].argmin()
        value[s], y[s, rows.position[s, best]] = means[best] / 65536.0, 1.0
    return 0.0


@compiled
def _soft_saddles(rows: Rows, replies: Replies, following: F64, prior: Fixed, tau: float, found: Strategies) -> float:
    """:func:`_saddles` of KL-regularised matrix games (:mod:`shuttle_marl.exact.optimal`).

    The receiver minimises the convex function tau log sum_a b(a) exp((M y)_a / tau) + tau KL(y || q) of positions y by Newton
    steps with a line search; at its minimum the striker's strokes are the soft maximum against y.

    Args:
        prior: strokes b and positions q.
        tau: cost of a nat of divergence from them.
    """
    value, x, y, picked = found
    largest, most = 0.0, max(1, (replies.pair_start[1:] - replies.pair_start[:-1]).max())
    entries, mean, trial, slope = np.empty(most * 9), np.empty(most), np.empty(9), np.empty(9)
    hessian, step = np.empty((10, 10)), np.empty(10)
    for s in range(value.size):
        first, k, m = _reset(rows, replies, found, s)
        if k == 0:
            continue
        played, before = x[first : first + k], prior.strokes[first : first + k].astype(np.float64) * prior.unit
        _write_matrix(rows, replies, following, s, False, entries, picked)
        matrix = entries[: k * m].reshape(k, m)
        usual, waits = np.empty(m), np.empty(m)
        for b in range(m):
            usual[b] = prior.positions[s, rows.position[s, b]]
            waits[b] = max(usual[b], 1e-12)
        waits /= waits.sum()
        now = _soft_value(matrix, before, usual, waits, tau, mean, played)
        for _ in range(60):
            # The gradient and the Hessian along sum y = 1, bordered by the constraint.
            decrease = 0.0
            _means(played, matrix, slope)
            for b in range(m):
                step[b] = -(slope[b] + tau * (np.log(waits[b] / max(usual[b], 1e-300)) + 1.0))
                for c in range(b + 1):
                    both = 0.0
                    for a in range(k):
                        both += played[a] * matrix[a, b] * matrix[a, c]
                    hessian[b, c] = hessian[c, b] = (both - slope[b] * slope[c]) / tau + (tau / waits[b] if b == c else 0.0)
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
                then = _soft_value(matrix, before, usual, trial, tau, mean, played)
                if then <= now + 1e-4 * scale * decrease + 1e-15:
                    break
                scale *= 0.5
            waits[:] = trial[:m]
            now = then
        total, divergence = 0.0, 0.0
        _means(played, matrix, slope)
        best = (-slope[:m] / tau).max()
        for b in range(m):
            total += usual[b] * np.exp(-slope[b] / tau - best)
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
def _means(played: F64, matrix: F64, out: F64) -> None:
    """Mean of each column of a matrix."""
    for b in range(matrix.shape[1]):
        out[b] = 0.0
        for a in range(played.size):
            out[b] += played[a] * matrix[a, b]


@inlined
def _soft_value(matrix: F64, before: F64, usual: F64, waits: F64, tau: float, mean: F64, played: F64) -> float:
    """What positions guarantee the receiver at most, and ``played``, the soft maximum of strokes against them."""
    k, m = matrix.shape
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


class _Ahead(NamedTuple):
    """What follows strategies of a block: the strokes that are played, state after state, and the weights of their successors."""

    start: I64  # [base states + 1] first stroke of each state
    reply: I64  # [N] reply of each stroke
    weight: F64  # [N, 4] weight of each of its successors


@compiled
def _look_ahead(found: Strategies, rows: Rows, replies: Replies, ahead: _Ahead) -> None:
    """Write what follows strategies."""
    _, x, y, picked = found
    start, reply, weight = ahead
    chosen, n = np.empty(9, np.int64), 0
    for s in range(start.size - 1):
        first, last, m, row = replies.pair_start[s], replies.pair_start[s + 1], rows.choices[s], rows.start[s]
        start[s], number = n, 0
        for b in range(m):
            if y[s, rows.position[s, b]] > 0.0:
                chosen[number] = b
                number += 1
        for pair in range(first, last):
            if x[pair] > 0.0:
                reply[n] = replies.first_reply[s] + pair - first
                low = high = late_low = late_high = 0.0
                for b in chosen[:number]:
                    share, g = x[pair] * y[s, rows.position[s, b]] / 65536.0, picked[row + b]
                    won, under = float(rows.limits[g, row + b, 1]), float(rows.limits[g, row + b, 2])
                    low += share * (under - won)
                    high += share * (65536.0 - under)
                    late_low += share * (under - won) * rows.hurry[g, row + b, 0]
                    late_high += share * (65536.0 - under) * rows.hurry[g, row + b, 1]
                weight[n] = low, high, late_low, late_high
                n += 1
            row += m
    start[-1] = n


@compiled
def _mean_ahead(ahead: _Ahead, following: F64, out: F64) -> None:
    """Mean of what follows strategies, 0 where the rally ends."""
    start, reply, weight = ahead
    for s in range(out.size):
        total = 0.0
        for i in range(start[s], start[s + 1]):
            v = reply[i]
            total += weight[i, 0] * following[0, v] + weight[i, 1] * following[1, v]
            total += weight[i, 2] * following[2, v] + weight[i, 3] * following[3, v]
        out[s] = total


def _mean_linear(games: tuple[Game, ...], block: int, found: Strategies) -> BlockLinear:
    """The linear part of a sweep at fixed strategies."""
    game, rows = games[0], rows_of(games, block)

    @functools.cache
    def ahead() -> _Ahead:
        n = int(np.count_nonzero(found.strokes > 0))
        written = _Ahead(np.empty(game.n_base_states + 1, np.int64), np.empty(n, np.int64), np.empty((n, 4)))
        _look_ahead(found, rows, replies(game), written)
        return written

    def linear(plain: F64, after_attack: F64) -> F64:
        out = np.empty(game.n_base_states)
        _mean_ahead(ahead(), gathered(game, plain, after_attack), out)
        return -out

    return linear


@dataclasses.dataclass(eq=False)
class Saddle(Free):
    """The states in which one player strikes: both players choose best, the striker strokes, the receiver positions.

    Attributes:
        strokes: for each block ``[base pairs]`` probabilities of a policy that the striker follows; None: free.
        tau: if above 0, both are free and pay so much for a nat of divergence from ``strokes`` and ``positions``, the priors.
    """

    strokes: tuple[Chances, ...] | None = None
    positions: F64 | None = None  # [S, 9] probabilities of positions of a policy that the receiver follows; None: free
    share: float = 1.0  # probability with which each choice follows the policy; else it is free
    tau: float = 0.0
    gap: float = 0.0  # largest gap of a matrix game so far

    def _strategies(self, block: int, plain: F64, after_attack: F64) -> Strategies:
        """Values, free strokes and positions, and picked games of a block."""
        game, fixed, rows = self.game, self._fixed(block), rows_of(self.games, block)
        found = Strategies(
            np.empty(game.n_base_states),
            np.empty(game.n_base_pairs),
            np.empty((game.n_base_states, N_POSITIONS)),
            np.zeros(game.waiting.start[-1], np.uint8),
        )
        following = gathered(game, plain, after_attack)
        if self.tau:
            gap = _soft_saddles(rows, replies(game), following, fixed, self.tau, found)
        elif fixed.share == 1 and fixed.strokes.size:
            gap = _answers(rows, replies(game), following, fixed.strokes, fixed.unit, found)
        else:
            gap = _saddles(rows, replies(game), following, fixed, self.against, found)
        self.gap = max(self.gap, gap)
        return found

    def block_sweep(self, block: int, plain: F64, after_attack: F64) -> tuple[F64, BlockLinear]:
        """Values of one block and their linear part; see :class:`~shuttle_marl.exact.fixed_point.Striker`."""
        found, fixed = self._strategies(block, plain, after_attack), self._fixed(block)
        if fixed.share and fixed.strokes.size:
            found = found._replace(strokes=(1 - fixed.share) * found.strokes + fixed.share * fixed.unit * fixed.strokes)
        elif fixed.share:
            found = found._replace(positions=(1 - fixed.share) * found.positions + fixed.share * fixed.positions)
        return found.value, _mean_linear(self.games, block, found)

    def _fixed(self, block: int) -> Fixed:
        strokes = np.empty(0) if self.strokes is None else self.strokes[block]
        positions = np.empty((0, N_POSITIONS)) if self.positions is None else self.positions[self.game.block_states(block)]
        share = self.share if (strokes.size or positions.size) and not self.tau else 0.0
        return Fixed(share, strokes, unit_of(strokes), np.ascontiguousarray(positions))

    def all_strategies(self, following: F64) -> tuple[F64, F64]:
        """``[P]`` strokes and ``[S, 9]`` positions, from the ``[S]`` values of the next states to the receiver."""
        blocks = [self._strategies(block, *successors(self.game, following, block)) for block in range(self.game.n_blocks)]
        return np.concatenate([found.strokes for found in blocks]), np.concatenate([found.positions for found in blocks])

    def policy(self, following: F64) -> tuple[Any, F64]:
        """The strokes, as a table if both choose best, and ``[S, 9]`` positions; argument as for :meth:`all_strategies`."""
        strokes, positions = self.all_strategies(following)
        if self.tau:
            return PairPolicy(game=self.game, probability=strokes), positions
        return from_pair_probabilities(self.game, strokes), positions
