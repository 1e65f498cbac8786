"""Rallies that are continued: what was shown stays, and what follows joins it without a jump."""

import dataclasses

import numpy as np
import pytest

from benchmarks.motion_metrics import measure
from shuttle_marl.game.rally.record import Rally
from shuttle_marl.game.rules import RETURNED_ABOVE, RETURNED_BELOW
from shuttle_marl.staging import ENDS, Motion, StagingError, continue_motion, stage

SAME = ("rotation", "position", "planted", "shuttle", "shuttle_velocity")
HANDS = (("right", "left"), ("left", "right"))


def prefix(rally: Rally, strokes: int) -> Rally:
    """The first strokes of a rally, while it was open."""
    ending = int(rally.outcome[strokes - 1]) if strokes else RETURNED_BELOW
    return dataclasses.replace(rally, stroke=rally.stroke[:strokes], hurried=rally.hurried[:strokes], ending=ending)


def with_stroke(rally: Rally, k: int, stroke: int, ending: int) -> Rally:
    """The rally with another k-th stroke as its last one."""
    return dataclasses.replace(prefix(rally, k + 1), stroke=np.r_[rally.stroke[:k], stroke], ending=ending)


def joins(before: Motion, after: Motion, branch: int) -> None:
    """Frames before the branch are identical bit for bit, and nothing jumps behind it."""
    for name in SAME:
        np.testing.assert_array_equal(getattr(after, name)[:branch], getattr(before, name)[:branch])
    for name in SAME[:3]:
        np.testing.assert_array_equal(getattr(after, name)[branch], getattr(before, name)[branch])
    near = slice(max(branch - 2, 0), branch + 4)
    hips = after.position[near, :, 0].astype(np.float64)
    acceleration = np.diff(hips, 2, axis=0) * after.fps**2
    assert np.linalg.norm(acceleration[..., :2], axis=-1).max() <= 12
    bones = np.diff(after.position[near].astype(np.float64), axis=0) * after.fps
    assert np.linalg.norm(bones, axis=-1).max() < 45


def sound(motion: Motion) -> None:
    found = measure(motion)
    assert found.joint_excess == 0
    assert (found.contact <= 0.006).all()
    assert found.slide.max() <= 0.005
    assert found.acceleration.max() <= 12.0
    assert found.speed.max() <= 6.5
    assert found.true_end.all()


def test_a_rally_that_is_played_stroke_by_stroke(played: list[Rally]) -> None:
    for i, rally in enumerate(rally for rally in played if 4 <= len(rally) <= 9):
        if i == 3:
            break
        motion = stage(prefix(rally, 0), seed=i, handedness=HANDS[i % 2], athletes=("female", "male"), lead_in=2.0)
        assert len(motion.time) == 101
        sound(motion)
        for k in range(len(rally)):
            before = motion
            branch = int(before.contact_frame[k - 1]) if k else len(before.time) - 1
            motion = continue_motion(before, prefix(rally, k + 1), seed=i)
            joins(before, motion, branch)
        sound(motion)
        assert ENDS[motion.trajectory.end[-1]] != "open"
        np.testing.assert_array_equal(motion.trajectory.rally.stroke, rally.stroke)


def test_another_stroke_than_the_one_that_was_played(played: list[Rally]) -> None:
    other, rally = sorted(played, key=len)[-2:]
    motion = stage(rally, seed=7)
    for k in (1, 3, len(rally) - 1):
        tail = [s for s in other.stroke[1:] if rally.catalogue.height[s] == rally.catalogue.height[rally.stroke[k]]]
        changed = with_stroke(rally, k, tail[0], RETURNED_ABOVE)
        branched = continue_motion(motion, changed, seed=7, from_stroke=k)
        joins(motion, branched, int(motion.contact_frame[k - 1]))
        sound(branched)
        assert ENDS[branched.trajectory.end[-1]] == "open"


def test_waiting_takes_any_time_and_ends_in_any_frame(played: list[Rally]) -> None:
    rally = played[0]
    waiting = stage(prefix(rally, 0), seed=1, lead_in=4.0)
    longer = continue_motion(waiting, prefix(rally, 0), seed=1, lead_in=3.0)
    assert len(longer.time) == len(waiting.time) + 150
    joins(waiting, longer, len(waiting.time) - 1)
    hand = np.linalg.norm(longer.shuttle[:, None] - longer.position[:, rally.server], axis=2).min(axis=1)
    assert hand.max() < 0.2, "the server holds the shuttle"
    served = continue_motion(longer, rally, seed=1, at=77)
    joins(longer, served, 77)
    assert served.contact_frame[0] >= 77 + 50
    sound(served)


def test_what_cannot_be_continued(played: list[Rally]) -> None:
    rally = next(rally for rally in played if len(rally) > 3)
    motion = stage(prefix(rally, 2), seed=0)
    other = dataclasses.replace(rally, server=1 - rally.server)
    hurried = dataclasses.replace(rally, hurried=rally.hurried ^ (np.arange(len(rally)) == 1))
    for arguments, message in (
        ({"rally": other}, "other strokes before number 2"),
        ({"rally": hurried}, "other strokes before number 2"),
        ({"from_stroke": 3}, "from_stroke 3: the motion has 2 strokes"),
        ({"at": 3}, "continued at a contact"),
        ({"from_stroke": 0, "at": 10_000}, "the waiting before the serve has frames 1 to"),
        ({"motion": Motion.unpack(motion.pack())}, "unpacked motion cannot be continued"),
    ):
        with pytest.raises(StagingError, match=message):
            continue_motion(**{"motion": motion, "rally": rally, "seed": 0, **arguments})  # type: ignore[arg-type]
    with pytest.raises(StagingError, match="expected 1 to 3600"):
        stage(rally, seed=0, lead_in=0.1)
