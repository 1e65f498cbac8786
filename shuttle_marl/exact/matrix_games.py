"""Value and optimal mixed strategies of a matrix game, by the simplex method."""

from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64, I64
from shuttle_marl.base.compiling import compiled, inlined

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
    flat, size = matrix.copy().ravel(), (k + 1) * (m + 1)
    return solved(flat, k, m, np.empty(size), np.empty(2 * k, np.int64), np.empty(m, np.int64), x, y)


@inlined
def solved(matrix: F64, k: int, m: int, tableau: F64, basis: I64, outside: I64, x: F64, y: F64) -> tuple[float, float]:
    """:func:`matrix_game`; a saddle point in pure strategies is found first, that of the lowest numbers.

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
        for a in range(k):
            x[a] = 0.0
        for b in range(m):
            y[b] = 0.0
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
    for a in range(n, k):
        x[a] = 0.0
    for i in range(n - 1, -1, -1):
        share, x[i] = x[i], 0.0
        x[rows[i]] = share
    return low, high
