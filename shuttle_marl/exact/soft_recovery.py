"""Human-like play of the game with recovery: matrix games in which both players pay for the divergence from how people choose."""

import dataclasses

import numpy as np

from shuttle_marl.base.arrays import F64, U8
from shuttle_marl.base.compiling import compiled, inlined
from shuttle_marl.exact.met import Rows, rows_of
from shuttle_marl.exact.recovery import Saddle, mean_linear, most_replies, write_matrix
from shuttle_marl.exact.solver import BlockLinear
from shuttle_marl.exact.sweeps import Replies, gathered, replies
from shuttle_marl.game.recovery import N_POSITIONS


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
    largest, most = 0.0, most_replies(replies, value.size)
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
        write_matrix(rows, replies, following, s, False, entries, picked)
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
