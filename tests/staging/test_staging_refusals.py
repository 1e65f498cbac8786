"""Options, branches and packed motions that are just within what is accepted, and just beyond it."""

import dataclasses
import json
import types
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.game import default_game
from shuttle_marl.game.rally.record import Rally
from shuttle_marl.game.rules import RETURNED_BELOW
from shuttle_marl.staging import Motion, StagingError
from shuttle_marl.staging import motion as packing
from shuttle_marl.staging.assemble import _branch, _check
from shuttle_marl.staging.motion import Branch
from shuttle_marl.staging.skeleton import N_BONES
from shuttle_marl.staging.walk import with_walk

CONTENT = (Path(__file__).parent / "golden" / "rally.smot").read_bytes()


@pytest.mark.parametrize(
    ("fps", "lead_in", "importance", "message"),
    [
        (25, 1.0, 0.0, None),
        (1000, 3600.0, 1.0, None),
        (24, 1.0, 0.0, "24 frames a second"),
        (1001, 1.0, 0.0, "1001 frames a second"),
        (25, 0.99, 0.0, r"0\.99 s before the serve"),
        (25, 3600.5, 0.0, r"3600\.5 s before the serve"),
        (25, 1.0, -0.01, r"importance -0\.01"),
        (25, 1.0, 1.01, r"importance 1\.01"),
    ],
)
def test_options_of_a_staging(fps: int, lead_in: float, importance: float, message: str | None) -> None:
    if message is None:
        _check(fps, lead_in, importance)
        return
    with pytest.raises(StagingError, match=message):
        _check(fps, lead_in, importance)


CATALOGUE = default_game().catalogue
SERVES = [k for k, name in enumerate(CATALOGUE.names) if name.startswith("short-serve")]
LIFTS = [k for k, name in enumerate(CATALOGUE.names) if name.startswith("lift:")]


def a_rally(*stroke: int, **others: Any) -> Rally:
    strokes = np.array(stroke, dtype=np.int64)
    given: dict[str, Any] = {"server": 0, "hurried": np.zeros(len(strokes), bool), "ending": RETURNED_BELOW}
    return Rally(catalogue=CATALOGUE, stroke=strokes, **given | others)


def staged(rally: Rally, frames: int = 200, contacts: tuple[int, ...] = (100, 150, 180)) -> Any:
    """What a branch reads of a motion."""
    return types.SimpleNamespace(
        players=("first", "second"),
        trajectory=types.SimpleNamespace(rally=rally),
        contact_frame=np.array(contacts[: len(rally)], dtype=np.int64),
        time=np.zeros(frames),
        fps=50,
    )


OLD = a_rally(SERVES[0], LIFTS[0], LIFTS[1])


@pytest.mark.parametrize(
    ("rally", "from_stroke", "at", "strokes", "frame"),
    [
        (OLD, None, None, 3, 180),
        (OLD, 2, None, 2, 150),
        (OLD, 1, None, 1, 100),
        (OLD, 0, None, 0, 50),  # a second before the serve at the latest
        (OLD, 0, 1, 0, 1),
        (OLD, 0, 50, 0, 50),
        (a_rally(SERVES[0], LIFTS[2]), 1, None, 1, 100),
        (a_rally(SERVES[1]), 0, 7, 0, 7),
    ],
)
def test_branches_of_a_motion(rally: Rally, from_stroke: int | None, at: int | None, strokes: int, frame: int) -> None:
    found = _branch(rally, staged(OLD), from_stroke, at)
    assert (found.strokes, found.frame) == (strokes, frame)
    assert found.player(1) == "second"


def test_waiting_goes_on_from_any_of_its_frames() -> None:
    waiting = staged(a_rally(), 60)
    assert _branch(OLD, waiting, None, None).frame == 59
    assert _branch(OLD, waiting, None, 59).frame == 59
    with pytest.raises(StagingError, match="at 60: the waiting before the serve has frames 1 to 59"):
        _branch(OLD, waiting, None, 60)


@pytest.mark.parametrize(
    ("rally", "from_stroke", "at", "message"),
    [
        (OLD, -1, None, "from_stroke -1: the motion has 3 strokes, the rally 3"),
        (OLD, 4, None, "from_stroke 4: the motion has 3 strokes"),
        (a_rally(SERVES[0]), 2, None, "from_stroke 2: the motion has 3 strokes, the rally 1"),
        (a_rally(SERVES[1], LIFTS[0]), 1, None, "other strokes before number 1"),
        (a_rally(SERVES[0], LIFTS[0], hurried=np.array([False, True])), 2, None, "other strokes before number 2"),
        (dataclasses.replace(OLD, server=1), 1, None, "other strokes"),
        (dataclasses.replace(OLD, points=(1, 0)), 1, None, "other strokes"),
        (dataclasses.replace(OLD, ends_changed=True), 1, None, "other strokes"),
        (dataclasses.replace(OLD, hands=("right", "left")), 1, None, "other hands"),
        (OLD, 1, 100, "at: a rally is continued at a contact"),
        (OLD, 0, 0, "at 0: the waiting before the serve has frames 1 to 50"),
        (OLD, 0, 51, "at 51"),
    ],
)
def test_branches_that_a_motion_does_not_have(rally: Rally, from_stroke: int, at: int | None, message: str) -> None:
    with pytest.raises(StagingError, match=message):
        _branch(rally, staged(OLD), from_stroke, at)


def test_unpacked_motions_are_not_continued() -> None:
    motion = Motion.unpack(CONTENT)
    with pytest.raises(StagingError, match="an unpacked motion cannot be continued"):
        _branch(motion.trajectory.rally, motion, None, None)
    known = types.SimpleNamespace(players=("first", "second"))
    for pair in ((motion, known), (known, motion), (motion, motion)):
        with pytest.raises(StagingError, match="no walk leads from or to an unpacked motion"):
            with_walk(*pair)


def walked(**others: Any) -> Any:
    rally = types.SimpleNamespace(open=others.pop("open", False), ends_changed=others.pop("ends_changed", False))
    given = {"fps": 50, "skeletons": 1, "hands": ("right", "right")} | others
    return types.SimpleNamespace(players=(1, 2), trajectory=types.SimpleNamespace(rally=rally), **given)


@pytest.mark.parametrize(
    ("rally", "following", "message"),
    [
        (walked(open=True), walked(), "the rally continues"),
        (walked(), walked(ends_changed=True), "the players change ends"),
        (walked(fps=25), walked(), "different fps"),
        (walked(), walked(skeletons=2), "different skeletons"),
        (walked(hands=("left", "right")), walked(), "different hands"),
    ],
)
def test_rallies_between_which_nobody_walks(rally: Any, following: Any, message: str) -> None:
    with pytest.raises(StagingError, match=message):
        with_walk(rally, following)


def packed(**changes: Any) -> bytes:
    """The golden file with another head; the entries of ``stroke`` are those of its first stroke."""
    head, data = packing.read_head(CONTENT)
    head["strokes"][0] |= changes.pop("stroke", {})
    about = json.dumps(head | changes).encode()
    return CONTENT[:5] + zlib.compress(len(about).to_bytes(4, "little") + about + data)


HEAD, DATA = packing.read_head(CONTENT)


@pytest.mark.parametrize(
    "changes",
    [
        {"fps": 24},
        {"fps": 1001},
        {"fps": 50.0},
        {"fps": -50},
        {"frames": 0},
        {"frames": -1},
        {"first": 1 << 24},
        {"first": -1},
        {"frames": str(HEAD["frames"])},
        {"stroke": {"frame": -1}},
        {"stroke": {"frame": 1 << 24}},
        {"stroke": {"end_frame": -1}},
        {"stroke": {"end_frame": 1 << 24}},
        {"stroke": {"end_frame": 100.0}},
    ],
)
def test_numbers_of_frames_that_no_motion_has(changes: dict[str, Any]) -> None:
    with pytest.raises(StagingError, match="frame numbers out of range"):
        Motion.unpack(packed(**changes))


def test_frame_rates_at_the_ends_of_the_range() -> None:
    for fps in (25, 1000):
        assert Motion.unpack(packed(fps=fps)).fps == fps


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frames": HEAD["frames"] + 1}, "bytes of frames, expected"),
        ({"players": [{"athlete": "male", "hand": "both"}] * 2}, "hands"),
        ({"players": [{"athlete": "male", "hand": "right"}, {"athlete": "male", "hand": "both"}]}, "hands"),
        ({"ending": "draw"}, "damaged"),
        ({"first": 3}, "these frames begin at 3: give the motion that has the 3 before them, at 50 a second"),
    ],
)
def test_heads_that_contradict_the_frames(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(StagingError, match=message):
        Motion.unpack(packed(**changes))


def test_the_motion_before_has_the_frames_before_at_the_same_rate() -> None:
    motion = Motion.unpack(CONTENT)
    rest = motion.pack(10)
    for before in (None, dataclasses.replace(motion, fps=25), dataclasses.replace(motion, time=motion.time[:9])):
        with pytest.raises(StagingError, match="these frames begin at 10"):
            Motion.unpack(rest, before)
    whole = Motion.unpack(rest, dataclasses.replace(motion, time=motion.time[:10]))
    assert len(whole.time) == len(motion.time)
    for first in (-1, len(motion.time)):
        with pytest.raises(StagingError, match=f"first frame {first}: this motion has frames 0 to {len(motion.time) - 1}"):
            motion.pack(first)
    for first in (0, len(motion.time) - 1):
        assert packing.read_head(motion.pack(first))[0]["frames"] == len(motion.time) - first


def test_bytes_of_a_motion_of_two_frames() -> None:
    """Hips, largest components and the others of 23 bones of two players, feet, and loose places of the shuttle."""
    frames = packing.Frames(
        hips=np.array([[[1.0, -2.0, 0.9], [-1.0, 2.0, 0.8]], [[1.001, -2.0, 0.9], [-1.0, 2.002, 0.8]]]),
        local=np.tile([0.0, 0.6, 0.0, 0.8], (2, 2, N_BONES, 1)),
        planted=np.array([[[True, False], [False, True]], [[False, True], [True, True]]]),
        loose=np.array([[0.5, 0.25, 1.0]]),
    )
    frames.local[1, 0, 3] = [-0.8, 0.6, 0.0, 0.0]
    content = packing.write({"name": "ü"}, frames)
    head, data = packing.read_head(content)
    assert head == {"name": "ü"}
    assert len(data) == 2 * (2 * (6 + 7 * N_BONES) + 1) + 6
    again = packing.read_frames(data, 2, 1)
    assert np.abs(again.hips - frames.hips).max() < 1e-9, "steps of a quarter of a millimetre"
    assert (again.planted == frames.planted).all()
    assert np.abs(again.loose - frames.loose).max() < 1e-9, "steps of half a millimetre"
    expected = frames.local.copy()
    expected[1, 0, 3] *= -1  # the same rotation, the largest component is positive
    assert np.abs(again.local - expected).max() < 1e-4
    for count, loose in ((2, 0), (2, 2), (1, 1)):
        with pytest.raises(StagingError, match=rf"{len(data)} bytes of frames, expected"):
            packing.read_frames(data, count, loose)


def test_the_bytes_that_a_reader_expects() -> None:
    """Second differences, zigzag, low bytes before high bytes, column by column."""
    column = np.array([[0.0, 300.0], [1.0, 300.0], [0.0, 300.0]])
    # 0, 1, 0 has the differences 0, 1, -2; 300, 300, 300 has 300, -300, 0: zigzag 0, 2, 3 and 600, 599, 0.
    assert packing._deltas(column) == bytes([0, 2, 3, 0, 0, 0, 600 & 255, 599 & 255, 0, 2, 2, 0])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"SMOT", "of version none: expected 2"),
        (b"SMOS\x02" + CONTENT[5:], "first bytes are not SMOT"),
        (b"SMOT\x03" + CONTENT[5:], "of version 03"),
        (b"SMOT\x02" + zlib.compress(b"\x02\0\0\0[]"), "its head is no object"),
        (b"SMOT\x02" + zlib.compress(b"\x04\0\0\0nope"), "its head is no JSON"),
        (b"SMOT\x02" + zlib.compress(b"\x02\0\0\0{}")[:-1], "cut off"),
        (b"SMOT\x02" + b"nothing", "damaged"),
    ],
)
def test_contents_that_are_no_motion(content: bytes, message: str) -> None:
    with pytest.raises(StagingError, match=message):
        packing.read_head(content)


def test_unchanged_frames_of_a_branch_end_with_its_frame() -> None:
    rows: list[slice] = []
    player = types.SimpleNamespace(course=types.SimpleNamespace(part=rows.append))
    Branch(types.SimpleNamespace(players=(None, player)), 2, 7).course(1)  # type: ignore[arg-type]
    assert rows == [slice(0, 8)]
