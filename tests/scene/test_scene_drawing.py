"""Court, shuttle and words of a scene."""

import itertools
import re

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from shuttle_marl.base.arrays import F64
from shuttle_marl.court.scene.shapes import court
from shuttle_marl.court.scene.write import frames_of, percent
from shuttle_marl.court.staging import stage
from shuttle_marl.court.staging.skeleton import CORK, FEATHER, RACKET_BUTT, RACKET_HEAD, RACKET_LENGTH
from tests.staging.played import self_play_rallies


@pytest.mark.parametrize(
    ("probability", "words"),
    [(0.0, "0 %"), (0.001, "under 1 %"), (0.006, "1 %"), (0.5, "50 %"), (0.994, "99 %"), (0.999, "over 99 %"), (1.0, "100 %")],
)
def test_no_probability_is_rounded_to_a_certainty(probability: float, words: str) -> None:
    assert percent(probability) == words


def numbers(message: object) -> list[float]:
    """All numbers of a message, in the order of its fields."""
    return [float(x) for x in re.findall(r"(?<![\w.])-?\d+\.?\d*(?:e-?\d+)?", str(message))]


def boxes_of(entity: object) -> F64:
    """``[N, 6]`` centres and sizes of the boxes of an entity."""
    found = re.findall(r"CubePrimitive \{.*?position: Some\(Vector3 \{(.*?)\}.*?size: Some\(Vector3 \{(.*?)\}", str(entity))
    return np.array([numbers(f"{place} {size}") for place, size in found])


def test_lines_of_the_court_are_those_of_the_laws() -> None:
    """Law 1: 13.40 m by 6.10 m, lines of 4 cm that belong to the areas which they bound; posts of 1.55 m on the side lines."""
    ground, net = map(boxes_of, court(5))
    lines = []
    for side in (-1, 1):
        lines += [[side * x, 0, 0.04, 13.40] for x in (3.05 - 0.02, 2.59 - 0.02)]
        lines += [[0, side * y, 6.10, 0.04] for y in (6.70 - 0.02, 6.70 - 0.76, 1.98 + 0.02)]
        lines += [[0, side * (1.98 + 6.70) / 2, 0.04, 6.70 - 1.98]]
    assert_allclose(ground[2:, [0, 1, 3, 4]], lines, atol=1e-9)
    assert_allclose(net[:2, [0, 2, 5]], [[-3.05, 0.775, 1.55], [3.05, 0.775, 1.55]])
    tape, mesh = net[2::2], net[3::2]
    assert_allclose(tape[:, 2] + tape[:, 5] / 2, 1.524 + 0.026 * (tape[:, 0] / 3.05) ** 2)
    assert_allclose(mesh[:, 2] + mesh[:, 5] / 2, tape[:, 2] - tape[:, 5] / 2)
    assert_allclose(tape[:, 5] + mesh[:, 5], 0.76)


def test_racket_and_shuttle_keep_the_laws() -> None:
    """Laws 2 and 4, in metres."""
    assert 0.025 <= 2 * CORK <= 0.028
    (near, _, ahead), (far, wide, behind) = FEATHER
    assert 0.062 <= np.hypot(far - near, behind - ahead) <= 0.070
    assert 0.058 <= 2 * np.hypot(far, wide) <= 0.068
    assert RACKET_LENGTH <= 0.680
    assert RACKET_BUTT < 0 < 2 * RACKET_HEAD[1] <= 0.23


def test_the_cork_flies_ahead() -> None:
    """From a contact to the next one."""
    motion = stage(next(rally for rally in self_play_rallies("bc", 40, seed=11) if len(rally) == 4), seed=5)
    cork = Rotation.from_quat(frames_of(motion)["shuttle"][:, 3:]).as_matrix()[:, :, 2]
    seen = 0
    for first, last in itertools.pairwise(motion.contact_frame.tolist()):
        flight = slice(first, last)
        way = motion.shuttle_velocity[flight].astype(float)
        assert_allclose(cork[flight], way / np.linalg.norm(way, axis=1, keepdims=True), atol=1e-3)
        seen += last - first
    assert seen > 50
