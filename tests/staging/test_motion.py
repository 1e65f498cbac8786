"""Staged rallies measured as motion, and the measures themselves on motions that were spoilt."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from benchmarks.motion_metrics import joints, measure
from shuttle_marl.game import default_game
from shuttle_marl.game.court import AREAS, MIDDLE_CUT, SHORT_SERVICE, SIDE_CUT
from shuttle_marl.game.rally.record import Rally, RallyError
from shuttle_marl.game.rules import FAULT, RETURNED_BELOW, WINNER
from shuttle_marl.staging import ENDS, Motion, StagingError, continue_motion, stage
from shuttle_marl.staging.rotation import matrix
from shuttle_marl.staging.skeleton import BONE
from shuttle_marl.staging.trajectory import NET, OUT, RETURN, WIN, net_height


def test_motions_keep_all_limits(motions: list[Motion]) -> None:
    for motion in motions:
        found = measure(motion)
        assert found.contact.max() <= 0.01, "the racket meets the shuttle"
        assert len(found.slide) > 4
        assert found.slide.max() <= 0.02
        assert found.sunk <= 0.02
        assert found.speed.max() <= 6.5
        assert found.acceleration.max() <= 12.0
        assert found.joint_excess == 0
        assert (found.clearance >= 0.01).all()
        assert found.landing.max() <= 0.05
        assert found.true_end.all()
    assert np.concatenate([measure(motion).timely for motion in motions]).mean() >= 0.9, "as long as in matches"


def test_the_same_arguments_give_the_same_motion(played: list[Rally]) -> None:
    first, again = (stage(played[0], seed=3) for _ in range(2))
    other = stage(played[0], seed=4)
    for name in ("time", "shuttle", "rotation", "position", "planted", "contact_frame"):
        assert np.array_equal(getattr(first, name), getattr(again, name))
    assert not np.array_equal(first.shuttle[: len(other.shuttle)], other.shuttle[: len(first.shuttle)])


def test_a_rally_takes_place_as_it_was_played(motions: list[Motion]) -> None:
    for motion in motions:
        trajectory = motion.trajectory
        assert len(motion.contact_frame) == len(trajectory.rally)
        assert (np.diff(motion.contact_frame) > 0).all()
        side = np.array([trajectory.rally.facing(int(seat)) for seat in trajectory.rally.striker])
        assert (trajectory.contact[:, 1] * side < 0).all(), "a stroke is struck on the striker's half"
        above = trajectory.rally.catalogue.height[trajectory.rally.stroke].astype(bool)
        assert (trajectory.contact[above, 2] > net_height(trajectory.contact[above, 0])).all()
        assert (trajectory.contact[~above, 2] < net_height(trajectory.contact[~above, 0])).all()
        assert (trajectory.end[:-1] == RETURN).all()
        assert (trajectory.end[-1] == WIN) == (trajectory.rally.ending == WINNER)
        assert (trajectory.end[-1] in (OUT, NET)) == (trajectory.rally.ending == FAULT)


def test_players_stay_on_their_half(motions: list[Motion]) -> None:
    for motion in motions:
        for seat in (0, 1):
            assert (motion.position[:, seat, 0, 1] * motion.trajectory.rally.facing(seat) < 0).all()


def test_bones_keep_their_lengths_and_the_racket_its_hand(motions: list[Motion]) -> None:
    for motion in motions:
        for seat in (0, 1):
            parents, rest = motion.parents(seat), motion.rest(seat)
            hand = BONE["RightHand" if motion.handedness[seat] == "right" else "LeftHand"]
            assert parents[BONE["Racket"]] == hand
            for bone, parent in enumerate(parents):
                if parent < 0:
                    continue
                turn = matrix(motion.rotation[:, seat, parent])
                away = motion.position[:, seat, bone] - motion.position[:, seat, parent]
                np.testing.assert_allclose(away, turn @ (rest[bone] - rest[parent]), atol=2e-4)


def test_a_left_hander_is_the_mirror_image(played: list[Rally]) -> None:
    """The hips wait on the same spot; whatever the right hand does the left one does."""
    right = stage(played[1], seed=2)
    left = stage(played[1], seed=2, handedness=("left", "left"))
    for motion, hand, other in ((right, "RightHand", "LeftHand"), (left, "LeftHand", "RightHand")):
        seat = int(motion.trajectory.rally.striker[-1])
        frame = int(motion.contact_frame[-1])
        racket = motion.position[frame, seat, BONE["Racket"]]
        near, far = (np.linalg.norm(racket - motion.position[frame, seat, BONE[name]]) for name in (hand, other))
        assert near < 0.12 < far
    assert {joint.name for joint in joints(left, 0)} == {joint.name for joint in joints(right, 0)}


def test_every_end_of_a_rally_is_staged(played: list[Rally]) -> None:
    """Net faults hit the net and stay on the striker's side; shuttles that are out come down outside."""
    seen = set()
    for i, rally in enumerate(played):
        short = dataclasses.replace(rally, stroke=rally.stroke[:3], hurried=rally.hurried[:3])
        motion = stage(short, seed=i)
        end = ENDS[motion.trajectory.end[-1]]
        if end not in seen:
            assert measure(motion).true_end.all()
            seen.add(end)
        if seen == {"winner", "out", "net"}:
            return
    pytest.fail(f"forty rallies have only these ends: {seen}")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"handedness": ("right", "both")}, "expected right or left"),
        ({"fps": 10}, "expected 25 to 1000"),
        ({"athletes": ("male", "robot")}, "expected one of male, female"),
    ],
)
def test_wrong_options(played: list[Rally], change: dict[str, object], message: str) -> None:
    with pytest.raises(StagingError, match=message):
        stage(played[0], seed=0, **change)  # type: ignore[arg-type]


def test_wrong_rallies() -> None:
    catalogue = default_game().catalogue
    serve = int(np.flatnonzero(catalogue.is_serve)[0])
    reply = int(np.flatnonzero(~catalogue.is_serve)[0])

    def checked(**changes: object) -> None:
        fields: dict[str, Any] = {"catalogue": catalogue, "server": 0, "stroke": np.array([serve]), "ending": WINNER, **changes}
        Rally(**{"hurried": np.zeros(np.shape(fields["stroke"]), np.bool_), **fields}).checked()

    checked()
    for changes, message in (
        ({"stroke": np.array([], dtype=np.int64)}, "without strokes"),
        ({"stroke": np.array([reply])}, "starts with a serve"),
        ({"stroke": np.array([serve, serve])}, "starts with a serve"),
        ({"stroke": np.array([len(catalogue)])}, "the catalogue has"),
        ({"server": 2}, "expected seat 0 or 1"),
        ({"ending": 6}, "expected 0 to 5"),
        ({"hurried": np.array([True])}, "none for the serve"),
    ):
        with pytest.raises(RallyError, match=message):
            checked(**changes)
    with pytest.raises(RallyError, match="take turns"):
        Rally.from_strokes(catalogue, [(0, serve, 2), (0, reply, 1)])
    wrong = 3 - int(catalogue.height[reply])
    with pytest.raises(RallyError, match="heights of the strokes"):
        Rally.from_strokes(catalogue, [(0, serve, wrong), (1, reply, WINNER)])


def test_changed_ends_turn_the_whole_rally(played: list[Rally]) -> None:
    rally = next(rally for rally in played if 3 <= len(rally) <= 5)
    here, there = (stage(dataclasses.replace(rally, ends_changed=changed), seed=3) for changed in (False, True))
    half_turn = np.array([-1.0, -1.0, 1.0])
    for name in ("shuttle", "shuttle_velocity", "position", "sweet_spot"):
        assert getattr(there, name) == pytest.approx(getattr(here, name) * half_turn, abs=1e-6)
    assert matrix(there.rotation) == pytest.approx(np.diag(half_turn) @ matrix(here.rotation), abs=1e-5)
    with pytest.raises(StagingError, match="other strokes"):
        continue_motion(here, there.trajectory.rally, seed=3)


def test_the_score_decides_the_service_court(played: list[Rally]) -> None:
    rally = next(rally for rally in played if 3 <= len(rally) <= 5)
    for points in (0, 1, 4, 7):
        of_server = (points, 2) if rally.server == 0 else (2, points)
        motion = stage(dataclasses.replace(rally, points=of_server), seed=3)
        own = motion.position[motion.contact_frame[0], :, 0, 0] * [motion.trajectory.rally.facing(seat) for seat in (0, 1)]
        assert ((own > 0) == (points % 2 == 0)).all(), "both stand in their own right court for an even score"


def test_serves_to_the_side_are_mirrored() -> None:
    catalogue = default_game().catalogue
    serve = catalogue.index("long-serve:back-right:below:forehand")
    none = np.zeros(0, np.int64)
    even = Rally(catalogue=catalogue, server=0, stroke=none, hurried=none > 0, ending=RETURNED_BELOW)
    odd = dataclasses.replace(even, points=(3, 2))
    assert [AREAS[rally.aim[serve]] for rally in (even, odd)] == ["back-right", "back-left"]
    assert [rally.as_named(serve) for rally in (even, odd)] == [True, False]
    (x0, x1), (y0, y1) = even.aim_box(serve)
    assert odd.aim_box(serve) == ((-x1, -x0), (y0, y1))
    centre = catalogue.index("short-serve:front-centre:below:backhand")
    assert even.aim_box(centre) == ((-SIDE_CUT, 0.0), (SHORT_SERVICE, MIDDLE_CUT))
    clear = next(k for k, name in enumerate(catalogue.names) if name.startswith("clear:back-left"))
    assert odd.aim[clear] == catalogue.area[clear], "other strokes are not"
