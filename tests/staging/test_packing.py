"""Packed motions: what goes in comes out, the golden file is read, and no bytes from outside do harm."""

import dataclasses
import json
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.staging import Motion, StagingError
from shuttle_marl.staging import motion as packing
from shuttle_marl.staging.skeleton import N_BONES

GOLDEN = Path(__file__).parent / "golden"


def same_rotations(a: np.ndarray, b: np.ndarray, close: float) -> bool:
    """Whether quaternions mean the same rotations but for ``close`` radians; q and -q do."""
    away = np.minimum(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
    return bool((2 * away < close).all())


@pytest.fixture(scope="module")
def packed(motions: list[Motion]) -> list[bytes]:
    return [motion.pack() for motion in motions]


def test_a_motion_comes_back_within_two_millimetres_from_few_bytes(motions: list[Motion], packed: list[bytes]) -> None:
    for motion, content in zip(motions, packed, strict=True):
        again = Motion.unpack(content)
        assert len(content) / 1024 / motion.time[-1] <= 6
        for name in ("position", "sweet_spot", "shuttle"):
            np.testing.assert_allclose(getattr(again, name), getattr(motion, name), atol=1e-3)
        assert same_rotations(again.rotation, motion.rotation, 1e-3)
        for name in ("planted", "contact_frame", "time"):
            np.testing.assert_array_equal(getattr(again, name), getattr(motion, name))
        assert again.hands == motion.hands
        np.testing.assert_array_equal(again.trajectory.rally.hurried, motion.trajectory.rally.hurried)
        assert again.skeletons == motion.skeletons


def test_the_rest_of_a_motion_is_put_behind_what_is_known(motions: list[Motion], packed: list[bytes]) -> None:
    motion, known = motions[0], Motion.unpack(packed[0])
    for first in (1, int(motion.contact_frame[-1]), len(motion.time) - 1):
        rest = motion.pack(first)
        assert len(rest) < len(packed[0])
        whole = Motion.unpack(rest, known)
        np.testing.assert_allclose(whole.position, known.position, atol=1e-6)
        np.testing.assert_allclose(whole.shuttle, known.shuttle, atol=1e-3)
        for before in (None, dataclasses.replace(known, fps=25), dataclasses.replace(known, time=known.time[: first - 1])):
            with pytest.raises(StagingError, match="give the motion that has"):
                Motion.unpack(rest, before)
    for first in (-1, len(motion.time)):
        with pytest.raises(StagingError, match="this motion has frames 0 to"):
            motion.pack(first)


def test_the_golden_file_is_read() -> None:
    expected = json.loads((GOLDEN / "rally.json").read_text(encoding="utf-8"))
    motion = Motion.unpack((GOLDEN / "rally.smot").read_bytes())
    assert motion.fps == expected["fps"]
    assert len(motion.time) == expected["frames"]
    assert motion.contact_frame.tolist() == expected["contact_frames"]
    assert [motion.trajectory.rally.catalogue.names[k] for k in motion.trajectory.rally.stroke] == expected["strokes"]
    for at in expected["at"]:
        row = at["frame"]
        np.testing.assert_allclose(motion.shuttle[row], at["shuttle"], atol=2e-5)
        np.testing.assert_allclose(motion.position[row], at["position"], atol=2e-5)
        assert same_rotations(motion.rotation[row], np.array(at["rotation"]), 1e-4)
        assert motion.planted[row].tolist() == at["planted"]


def test_the_golden_file_is_written_again_bit_for_bit() -> None:
    content = (GOLDEN / "rally.smot").read_bytes()
    head, data = packing.read_head(content)
    loose = len(data) - head["frames"] * (2 * (6 + 7 * N_BONES) + 1)
    frames = packing.read_frames(data, head["frames"], loose // 6)
    again = packing.write(head, frames)
    assert zlib.decompress(again[5:]) == zlib.decompress(content[5:])


def packed_with(**changes: Any) -> bytes:
    """The golden file with another head; the entries of ``stroke`` are those of its first stroke."""
    content = (GOLDEN / "rally.smot").read_bytes()
    head, data = packing.read_head(content)
    head["strokes"][0] |= changes.pop("stroke", {})
    about = json.dumps(head | changes).encode()
    return content[:5] + zlib.compress(len(about).to_bytes(4, "little") + about + data)


@pytest.mark.parametrize("fps", [25, 1000])
def test_frame_rates_at_the_ends_of_the_range(fps: int) -> None:
    assert Motion.unpack(packed_with(fps=fps)).fps == fps


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        *(({"fps": fps}, "frame numbers out of range") for fps in (0, -50, 24, 1001, 50.0)),
        *(({"frames": frames}, "frame numbers out of range") for frames in (0, -1, "9", 1 << 40)),
        *(({"first": first}, "frame numbers out of range") for first in (-1, 1 << 24)),
        *(({"stroke": {"frame": frame}}, "frame numbers out of range") for frame in (-1, 1 << 24)),
        *(({"stroke": {"end_frame": frame}}, "frame numbers out of range") for frame in (-1, 1 << 24, 100.0)),
        ({"frames": 9}, "bytes of frames, expected"),
        ({"first": 3}, "these frames begin at 3: give the motion that has the 3 before them, at 50 a second"),
        ({"players": [{"athlete": "male", "hand": "right"}, {"athlete": "male", "hand": "both"}]}, "hands"),
        ({"players": [{"athlete": "../../male", "hand": "right"}] * 2}, "expected one of male, female"),
        ({"ending": "draw"}, "damaged"),
        ({"strokes": [{"name": "x"}]}, "damaged"),
    ],
)
def test_heads_that_no_motion_has(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(StagingError, match=message):
        Motion.unpack(packed_with(**changes))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: b"GLTF" + c[4:], "first bytes"),
        (lambda c: c[:4], "version none: expected 2"),
        (lambda c: c[:4] + b"\x07" + c[5:], "version 07: expected 2"),
        (lambda c: c[:-40], "cut off"),
        (lambda c: c[:300] + bytes([c[300] ^ 8]) + c[301:], "damaged|cut off"),
        (lambda c: c[:5] + b"nothing", "damaged"),
        (lambda c: c[:5] + zlib.compress(b"\x04\0\0\0nope"), "damaged"),
        (lambda c: c[:5] + zlib.compress(b"\x02\0\0\0[]"), "damaged"),
        (lambda c: c[:5] + zlib.compress(b"\x02\0\0\0{}"), "damaged"),
        (lambda c: c[:5] + zlib.compress(zlib.decompress(c[5:])[:-3]), "bytes of frames, expected"),
    ],
)
def test_bytes_that_are_no_packed_motion(change: Callable[[bytes], bytes], message: str) -> None:
    with pytest.raises(StagingError, match=message):
        Motion.unpack(change((GOLDEN / "rally.smot").read_bytes()))


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 9), st.integers(0, 9), st.integers(0, 1000))
def test_any_frames_come_back(count: int, loose: int, seed: int) -> None:
    """Hips and shuttle to half a step, rotations to a ten-thousandth, anywhere within eight metres."""
    rng = np.random.default_rng(seed)
    turns = rng.normal(size=(count, 2, N_BONES, 4))
    frames = packing.Frames(
        hips=rng.uniform(-8, 8, (count, 2, 3)),
        local=turns / np.linalg.norm(turns, axis=-1, keepdims=True),
        planted=rng.random((count, 2, 2)) < 0.5,
        loose=rng.uniform(-8, 8, (loose, 3)),
    )
    head, data = packing.read_head(packing.write({"name": "ü"}, frames))
    again = packing.read_frames(data, count, loose)
    assert head == {"name": "ü"}
    np.testing.assert_allclose(again.hips, frames.hips, atol=1.3e-4)
    np.testing.assert_allclose(again.loose, frames.loose, atol=2.6e-4)
    np.testing.assert_array_equal(again.planted, frames.planted)
    assert same_rotations(again.local, frames.local, 3e-4)
