"""Values where it matters whether the striker is hurried: by hand, and over the six outcomes of a stroke."""

import dataclasses

import numpy as np
import pytest

from shuttle_marl.exact import solve
from shuttle_marl.game.tables import ROOT
from shuttle_marl.game.thresholds import ONE
from tests.exact.exact_games import THREE_STROKES, hand_made


def test_three_strokes_that_hurried_strikers_miss() -> None:
    """One receiver in four is hurried after a return from below, one in two from above, and then half of all strokes are faults.

    A, L are the values above and below, H of a hurried striker from either height; X = 3/4 L + H/4 and Y = A/2 + H/2 are those of
    a return from below and from above: A = 1/4 - X/4 - Y/4, L = -1/4 - X/4 - Y/2, and H = -1/2 - X/4 - Y/4.
    """
    game = hand_made(THREE_STROKES)
    threshold = game.threshold.copy()
    threshold[game.hurried(game.base_pair_state) == 1] = np.array([8, 8, 12]) * (ONE // 16)
    hurry = np.tile(np.array([64, 128], np.uint8), (game.n_base_pairs, 1))
    found = solve(dataclasses.replace(game, threshold=threshold, hurry=hurry), tolerance=1e-12)
    # Unknowns A, L, H, X, Y.
    stroke = [[1, 0, 0, 1 / 4, 1 / 4], [0, 1, 0, 1 / 4, 1 / 2], [0, 0, 1, 1 / 4, 1 / 4]]
    matrix = [*stroke, [0, -3 / 4, -1 / 4, 1, 0], [-1 / 2, 0, -1 / 2, 0, 1]]
    above, below, hurried, *returned = np.linalg.solve(matrix, [1 / 4, -1 / 4, -1 / 2, 0, 0])
    for offset, value in enumerate((below, above, hurried, hurried)):
        assert found.value[0][4 + offset :: 4] == pytest.approx(value, abs=2e-12)
    assert found.value[0][ROOT] == pytest.approx(-1 / 8 - 7 / 16 * sum(returned), abs=2e-12)
