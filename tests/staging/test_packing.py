"""Packed motions: what goes in comes out, and the golden file is read."""

import json
from pathlib import Path

import numpy as np
import pytest

from shuttle_marl.court.staging import Motion, StagingError
from tests.staging.reader import read

GOLDEN = Path(__file__).parent / "golden"


def same_rotations(a: np.ndarray, b: np.ndarray, close: float) -> bool:
    """Whether quaternions mean the same rotations but for ``close`` radians; q and -q do."""
    away = np.minimum(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
    return bool((2 * away < close).all())


def test_a_motion_comes_back_within_two_millimetres_from_few_bytes(motions: list[Motion]) -> None:
    for motion in motions:
        content = motion.pack()
        again = read(content)
        assert len(content) / 1024 / motion.time[-1] <= 6
        for name in ("position", "sweet_spot", "shuttle"):
            np.testing.assert_allclose(getattr(again, name), getattr(motion, name), atol=1e-3)
        assert same_rotations(again.rotation, motion.rotation, 1e-3)
        np.testing.assert_array_equal(again.planted, motion.planted)
        strokes = again.head["strokes"]
        assert [stroke["frame"] for stroke in strokes] == motion.contact_frame.tolist()
        assert [stroke["hurried"] for stroke in strokes] == motion.trajectory.rally.hurried.tolist()
        players = zip(motion.skeletons, motion.hands, strict=True)
        assert again.head["players"] == [{"athlete": skeleton.name, "hand": hand} for skeleton, hand in players]


def test_the_rest_of_a_motion_is_packed_for_who_has_its_begin(motions: list[Motion]) -> None:
    motion = motions[0]
    whole = motion.pack()
    for first in (1, int(motion.contact_frame[-1]), len(motion.time) - 1):
        rest = motion.pack(first)
        assert len(rest) < len(whole)
        again = read(rest)
        assert (again.head["first"], len(again.position)) == (first, len(motion.time) - first)
        np.testing.assert_allclose(again.position, motion.position[first:], atol=1e-3)
        np.testing.assert_allclose(again.shuttle, motion.shuttle[first:], atol=1e-3)
    for first in (-1, len(motion.time)):
        with pytest.raises(StagingError, match="this motion has frames 0 to"):
            motion.pack(first)


def test_the_golden_file_is_read() -> None:
    expected = json.loads((GOLDEN / "rally.json").read_text(encoding="utf-8"))
    motion = read((GOLDEN / "rally.smot").read_bytes())
    assert motion.head["fps"] == expected["fps"]
    assert len(motion.position) == expected["frames"]
    assert [stroke["frame"] for stroke in motion.head["strokes"]] == expected["contact_frames"]
    assert [stroke["name"] for stroke in motion.head["strokes"]] == expected["strokes"]
    for at in expected["at"]:
        row = at["frame"]
        np.testing.assert_allclose(motion.shuttle[row], at["shuttle"], atol=2e-5)
        np.testing.assert_allclose(motion.position[row], at["position"], atol=2e-5)
        assert same_rotations(motion.rotation[row], np.array(at["rotation"]), 1e-4)
        assert motion.planted[row].tolist() == at["planted"]
