"""Matrix games that are solved by hand, and the small linear systems of human-like play."""

import numpy as np
import pytest

from shuttle_marl.exact.matrix_games import matrix_game

Rows = tuple[tuple[float, ...], ...]

# A pair of rows and columns [[a, b], [c, d]] without a saddle point: (d - c, a - b) and (d - b, a - c) over a + d - b - c.
PENNIES = ((1.0, -1.0), (-1.0, 1.0))
TILTED = ((3.0, -1.0), (-2.0, 4.0))
STONE = ((0.0, -1.0, 1.0), (1.0, 0.0, -1.0), (-1.0, 1.0, 0.0))


@pytest.mark.parametrize(
    ("matrix", "value", "rows", "columns"),
    [
        pytest.param(((2.5,),), 2.5, [1], [1], id="no choice"),
        pytest.param(((1, 5, 3),), 1, [1], [1, 0, 0], id="one row"),
        pytest.param(((1,), (5,), (3,)), 5, [0, 1, 0], [1], id="one column"),
        pytest.param(((2, 3), (1, 4)), 2, [1, 0], [1, 0], id="saddle point first"),
        pytest.param(((0, 4, 1), (2, 6, 3), (1, 5, 9)), 2, [0, 1, 0], [1, 0, 0], id="saddle point of the second row"),
        pytest.param(((0, -3, 0), (0, -2, 0)), -2, [0, 1], [0, 1, 0], id="saddle point below 0"),
        pytest.param(((1, 1), (1, 1)), 1, [1, 0], [1, 0], id="of equal ones the lowest numbers"),
        pytest.param(((0, 0.25), (0.25, 0), (0.25, 0.25)), 0.25, [0, 0, 1], [1, 0], id="small differences"),
        pytest.param(PENNIES, 0, [0.5, 0.5], [0.5, 0.5], id="pennies"),
        pytest.param(TILTED, 1, [0.6, 0.4], [0.5, 0.5], id="tilted"),
        pytest.param(((-2, 4), (3, -1)), 1, [0.4, 0.6], [0.5, 0.5], id="tilted, rows swapped"),
        pytest.param(((-1, 3), (4, -2)), 1, [0.6, 0.4], [0.5, 0.5], id="tilted, columns swapped"),
        pytest.param(((0.6, 0.0), (0.0, 0.2)), 0.15, [0.25, 0.75], [0.25, 0.75], id="entries below 1"),
        pytest.param(((-0.4, -1.0), (-1.0, -0.8)), -0.85, [0.25, 0.75], [0.25, 0.75], id="the same less 1"),
        pytest.param(STONE, 0, [1 / 3] * 3, [1 / 3] * 3, id="stone, paper, scissors"),
        pytest.param(((1, 0, 0), (0, 2, 0), (0, 0, 4)), 4 / 7, [4 / 7, 2 / 7, 1 / 7], [4 / 7, 2 / 7, 1 / 7], id="a diagonal"),
        pytest.param(((-9, -9), *TILTED), 1, [0, 0.6, 0.4], [0.5, 0.5], id="a bad row first"),
        pytest.param((TILTED[0], (-9, -9), TILTED[1]), 1, [0.6, 0, 0.4], [0.5, 0.5], id="a bad row between"),
        pytest.param((*TILTED, (-9, -9), (-3, -9)), 1, [0.6, 0.4, 0, 0], [0.5, 0.5], id="bad rows last"),
        pytest.param((*TILTED, (0, 0.5)), 1, [0.6, 0.4, 0], [0.5, 0.5], id="a row that is worse than the value"),
        pytest.param(((0, 0.5), *TILTED), 1, [0, 0.6, 0.4], [0.5, 0.5], id="such a row first"),
        pytest.param(((-10, 1), (1, 0)), 1 / 12, [1 / 12, 11 / 12], [1 / 12, 11 / 12], id="the least entry far below"),
        pytest.param(((3, -1, 4), (-2, 4, 5)), 1, [0.6, 0.4], [0.5, 0.5, 0], id="a column too many"),
        pytest.param(((9, 3, -1), (9, -2, 4)), 1, [0.6, 0.4], [0, 0.5, 0.5], id="a column too many first"),
    ],
)
@pytest.mark.parametrize(("unit", "shift"), [(1.0, 0.0), (1e-7, 0.0), (1e5, -3e5)])
def test_values_and_strategies_by_hand(
    matrix: Rows, value: float, rows: list[float], columns: list[float], unit: float, shift: float
) -> None:
    """In any unit and from any zero the strategies are the same."""
    given = np.array(matrix, np.float64) * unit + shift
    before, x, y = given.copy(), np.full(len(rows), np.nan), np.full(len(columns), np.nan)
    low, high = matrix_game(given, x, y)
    assert low == pytest.approx(value * unit + shift, abs=1e-9 * unit)
    assert high == pytest.approx(low, abs=1e-9 * unit)
    np.testing.assert_allclose(x, rows, atol=1e-8)
    np.testing.assert_allclose(y, columns, atol=1e-8)
    np.testing.assert_array_equal(given, before)


def test_strategies_of_many_columns_guarantee_the_value() -> None:
    """The game of Colonel Blotto's guesses, a_ij = |i - j| among nine numbers: one who hides at the ends is 4 away on average."""
    number = np.arange(9.0)
    x, y = np.empty(9), np.empty(9)
    low, high = matrix_game(np.abs(number[:, None] - number), x, y)
    assert (low, high) == (pytest.approx(4), pytest.approx(4))
    np.testing.assert_allclose(x, [0.5, *[0] * 7, 0.5], atol=1e-12)
    assert y @ number == pytest.approx(4)
