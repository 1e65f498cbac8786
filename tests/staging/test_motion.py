"""Staged rallies measured as motion, also of hurried strikers, and rallies that are continued without a jump."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from shuttle_marl.base.arrays import F64
from shuttle_marl.court.staging import ENDS, Motion, StagingError, continue_motion, stage
from shuttle_marl.court.staging.flight import net_height
from shuttle_marl.court.staging.geometry import matrix
from shuttle_marl.court.staging.poses import DEFENCE, DEFENCE_BACKHAND
from shuttle_marl.court.staging.trajectory import NET, OUT, RETURN, WIN
from shuttle_marl.game import default_game
from shuttle_marl.game.court import AREAS, MIDDLE_CUT, SHORT_SERVICE, SIDE_CUT
from shuttle_marl.game.rally import Rally, RallyError
from shuttle_marl.game.rules import FAULT, RETURNED_ABOVE, RETURNED_BELOW, WINNER
from shuttle_marl.game.stroke import SHOTS, TECHNIQUES
from tests import golden
from tests.staging.flight_metrics import flights_of, summary_of_flights
from tests.staging.motion_metrics import clearance, measure


def test_motions_keep_all_limits(motions: list[Motion]) -> None:
    for motion in motions:
        found = measure(motion)
        assert found.contact.max() <= 0.01, "the racket meets the shuttle"
        assert len(found.slide) > 4
        assert found.slide.max() <= 0.02
        assert found.sunk <= 0.005
        assert found.speed.max() <= 6.5
        assert found.acceleration.max() <= 12.0
        assert found.joint_excess == 0
        assert (found.clearance >= 0.01).all()
        assert found.landing.max() <= 0.05
        assert found.true_end.all()
    assert np.concatenate([measure(motion).timely for motion in motions]).mean() >= 0.75, "most are as long as in matches"


def test_motions_are_those_that_somebody_looked_at(motions: list[Motion], played: list[Rally]) -> None:
    found, looked = {}, {f"rally {i}": motion for i, motion in enumerate(motions)}
    rally = next(rally for rally in played if 5 <= len(rally) <= 8 and rally.hurried.any())
    continued = stage(prefix(rally, 0), seed=0, lead_in=2.0)
    for k in range(len(rally)):
        continued = continue_motion(continued, prefix(rally, k + 1), seed=0)
    for name, motion in (looked | {"stroke by stroke": continued}).items():
        for part in ("shuttle", "position", "planted"):
            found[f"{name}, {part}"] = golden.weighted_sum(getattr(motion, part))
        found[f"{name}, rotation"] = golden.weighted_sum(matrix(motion.rotation))  # a quaternion and its negative are the same
    golden.check("motions", found, 1e-3)


@pytest.fixture(scope="module")
def staged(motions: list[Motion], played: list[Rally]) -> list[Motion]:
    """Enough rallies for a few of every shot."""
    return [*motions, *(stage(rally, seed=i) for i, rally in enumerate(played[8:24]))]


def test_flights_fit_the_names_of_their_shots(staged: list[Motion]) -> None:
    found = summary_of_flights([flight for motion in staged for flight in flights_of(motion, 0)])
    flights = found["flights"]
    golden.check("flights", flights, 1e-3)
    assert flights["net-shot"]["below_cm"]["p90"] <= 25
    assert flights["cross-court-net-shot"]["below_cm"]["p90"] <= 25
    assert flights["block"]["below_cm"]["p90"] <= 37
    assert flights["drive"]["net_cm"]["p90"] <= 45
    assert flights["drop"]["kmh"]["p90"] <= 120
    assert flights["block"]["kmh"]["p90"] <= 90
    assert flights["half-smash"]["kmh"]["p90"] < flights["smash"]["kmh"]["median"]
    assert found["half_smash_slower"] > 0.95
    assert 4 <= flights["clear"]["apex_m"] <= 7
    assert 4 <= flights["lift"]["apex_m"] <= 7


def test_net_shots_that_are_killed_are_loose(staged: list[Motion]) -> None:
    loose = []
    for motion in staged:
        rally = motion.trajectory.rally
        tight = rally.catalogue.is_net_shot[rally.stroke] | (rally.catalogue.shot[rally.stroke] == SHOTS.index("block"))
        loose += [clearance(motion, int(i)) for i in np.flatnonzero(tight & (rally.outcome == RETURNED_ABOVE))]
    assert len(loose) >= 3
    assert min(loose) > 0.35


def test_fast_shuttles_at_the_body_are_met_with_the_backhand(staged: list[Motion]) -> None:
    """Defenders meet them on the side of their racket of where they stood, and with the backhand in the middle."""
    beside: dict[int, list[float]] = {DEFENCE: [], DEFENCE_BACKHAND: []}
    for motion in staged:
        trajectory, rally = motion.trajectory, motion.trajectory.rally
        for i in np.flatnonzero(rally.catalogue.is_attack[rally.stroke[:-1]]) + 1:
            seat = int(rally.striker[i])
            right = trajectory.contact[i, 0] * rally.facing(seat) - trajectory.base[i - 1, seat, 0]
            if trajectory.stance[i].motion in beside:
                beside[trajectory.stance[i].motion].append(float(right) * (1 if rally.hands[seat] == "right" else -1))
    assert len(beside[DEFENCE]) >= 3
    assert min(beside[DEFENCE]) > 0.2
    assert len(beside[DEFENCE_BACKHAND]) >= 3
    assert max(beside[DEFENCE_BACKHAND]) < 0.4


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
        assert trajectory.contact[0, 2] < 1.15, "Law 9: the serve is struck below 1.15 m"
        above = trajectory.rally.catalogue.height[trajectory.rally.stroke].astype(bool)
        assert (trajectory.contact[above, 2] > net_height(trajectory.contact[above, 0])).all()
        assert (trajectory.contact[~above, 2] < net_height(trajectory.contact[~above, 0])).all()
        assert (trajectory.end[:-1] == RETURN).all()
        assert (trajectory.end[-1] == WIN) == (trajectory.rally.ending == WINNER)
        assert (trajectory.end[-1] in (OUT, NET)) == (trajectory.rally.ending == FAULT)


def test_receivers_wait_where_they_chose(played: list[Rally]) -> None:
    """The front and the back corner on the forehand side, which for a left-hander is on the left; 2.6 m apart."""
    for rally, hand in zip(sorted(played, key=len)[-2:], ("right", "left"), strict=True):
        front, back = (
            np.median(
                [
                    motion.position[frame, 1 - seat, 0, :2] * rally.facing(1 - seat) * (1 if hand == "right" else -1, -1)
                    for frame, seat in zip(motion.contact_frame[1:], rally.striker[1:].tolist(), strict=True)
                ],
                axis=0,
            )
            for motion in (
                stage(dataclasses.replace(rally, hands=(hand, hand), waited=np.full(len(rally), position)).checked(), seed=2)
                for position in (0, 6)
            )
        )
        assert min(front[0], back[0]) > 0.55, "beyond the middle positions"
        assert back[1] - front[1] > 1.2, "as far as the time allows"
    with pytest.raises(RallyError, match=r"positions .*: expected 0 to 8, or -1"):
        dataclasses.replace(played[1], waited=np.full(len(played[1]), 9)).checked()


def test_players_stay_on_their_half(motions: list[Motion]) -> None:
    for motion in motions:
        for seat in (0, 1):
            assert (motion.position[:, seat, 0, 1] * motion.trajectory.rally.facing(seat) < 0).all()


def test_every_end_of_a_rally_is_staged(played: list[Rally]) -> None:
    seen = set()
    for i, rally in enumerate(played):
        short = dataclasses.replace(rally, stroke=rally.stroke[:3], hurried=rally.hurried[:3], waited=rally.waited[:3])
        motion = stage(short, seed=i)
        end = ENDS[motion.trajectory.end[-1]]
        if end not in seen:
            assert measure(motion).true_end.all()
            seen.add(end)
        if seen == {"winner", "out", "net"}:
            return
    pytest.fail(f"forty rallies have only these ends: {seen}")


def test_changed_ends_turn_the_whole_rally(played: list[Rally]) -> None:
    rally = next(rally for rally in played if 3 <= len(rally) <= 5)
    here, there = (stage(dataclasses.replace(rally, ends_changed=changed), seed=3) for changed in (False, True))
    half_turn = np.array([-1.0, -1.0, 1.0])
    for name in ("shuttle", "shuttle_velocity", "position", "sweet_spot"):
        assert getattr(there, name) == pytest.approx(getattr(here, name) * half_turn, abs=1e-6)
    assert matrix(there.rotation) == pytest.approx(np.diag(half_turn) @ matrix(here.rotation), abs=1e-5)


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
    even = Rally(catalogue=catalogue, server=0, stroke=none, hurried=none > 0, waited=none, ending=RETURNED_BELOW)
    odd = dataclasses.replace(even, points=(3, 2))
    assert [AREAS[rally.aim[0, serve]] for rally in (even, odd)] == ["back-right", "back-left"]
    assert [rally.as_named(0, serve) for rally in (even, odd)] == [True, False]
    (x0, x1), (y0, y1) = even.aim_box(0, serve)
    assert odd.aim_box(0, serve) == ((-x1, -x0), (y0, y1))
    centre = catalogue.index("short-serve:front-centre:below:backhand")
    assert even.aim_box(0, centre) == ((-SIDE_CUT, 0.0), (SHORT_SERVICE, MIDDLE_CUT))
    clear = next(k for k, name in enumerate(catalogue.names) if name.startswith("clear:back-left"))
    assert odd.aim[0, clear] == catalogue.area[clear], "other strokes are not"


def test_areas_of_a_left_handed_receiver_are_mirrored() -> None:
    catalogue = default_game().catalogue
    none = np.zeros(0, np.int64)
    rally = Rally(
        catalogue=catalogue, server=0, stroke=none, hurried=none > 0, waited=none, ending=RETURNED_BELOW, hands=("left", "right")
    )
    clear = next(k for k, name in enumerate(catalogue.names) if name.startswith("clear:back-left"))
    assert [AREAS[rally.aim[seat, clear]] for seat in (0, 1)] == ["back-left", "back-right"], "seat 1 aims at the left-hander"
    serve = catalogue.index("long-serve:back-right:below:forehand")
    assert [AREAS[rally.aim[seat, serve]] for seat in (0, 1)] == ["back-right", "back-right"], "into the right service court"
    assert [rally.as_named(seat, serve) for seat in (0, 1)] == [True, False]


def test_players_strike_on_the_side_of_their_racket(motions: list[Motion]) -> None:
    side: dict[tuple[str, int], list[float]] = {}
    for motion in motions:
        rally = motion.trajectory.rally
        for i, frame in enumerate(motion.contact_frame.tolist()):
            seat = int(rally.striker[i])
            right = rally.facing(seat) * float(motion.shuttle[frame, 0] - motion.position[frame, seat, 0, 0])
            side.setdefault((rally.hands[seat], int(rally.catalogue.technique[rally.stroke[i]])), []).append(right)
    mean = {(hand, TECHNIQUES[technique]): float(np.mean(values)) for (hand, technique), values in side.items()}
    assert mean["right", "forehand"] > 0.1 > -0.1 > mean["left", "forehand"]
    assert mean["left", "backhand"] > 0.05 > -0.05 > mean["right", "backhand"]


HANDS = (("right", "right"), ("left", "right"))
ATHLETES = (("male", "female"), ("female", "male"))


def returns(rallies: list[Rally], hurried: bool) -> F64:
    """``[2, 4]`` means over all returns from below and from above, where all strikers are hurried but the server, or none.

    Time from the arrival within 15 cm to the contact [s], speed of the hips at the contact [m/s], height of the contact, and its
    distance from the hips over the floor [m].
    """
    found: tuple[list[list[float]], list[list[float]]] = ([], [])
    for k, played in enumerate(rallies):
        rally = dataclasses.replace(played, hurried=(np.arange(len(played)) > 0) & hurried, hands=HANDS[k % 2])
        motion = stage(rally, seed=k, athletes=ATHLETES[k // 2 % 2])
        for i in range(1, len(rally)):
            hips = motion.position[:, rally.striker[i], 0, :2].astype(float)
            before, at = motion.contact_frame[i - 1], motion.contact_frame[i]
            away = np.linalg.norm(hips[before : at + 1] - hips[at], axis=1) > 0.15
            since = np.argmax(away[::-1]) if away.any() else len(away)
            speed = float(np.linalg.norm(hips[at + 1] - hips[at - 1])) * motion.fps / 2
            reach = float(np.linalg.norm(motion.shuttle[at, :2] - hips[at]))
            found[rally.catalogue.height[rally.stroke[i]]].append([since / motion.fps, speed, motion.shuttle[at, 2], reach])
    return np.array([np.mean(rows, axis=0) for rows in found])


def test_hurried_strikers_arrive_later_and_reach_further(played: list[Rally]) -> None:
    early, speed, height, reach = np.moveaxis(returns(played[:16], True) - returns(played[:16], False), -1, 0)
    assert (early < -0.03).all()
    assert (speed > 0.2).all()
    assert (height < -0.05).all()
    assert reach[0] > 0.03, "strokes from below; overhead strokes reach upwards"


SAME = ("rotation", "position", "planted", "shuttle", "shuttle_velocity")
BOTH_HANDS = (("right", "left"), ("left", "right"))


def prefix(rally: Rally, strokes: int) -> Rally:
    """The first strokes of a rally, while it was open."""
    ending = int(rally.outcome[strokes - 1]) if strokes else RETURNED_BELOW
    kept = {name: getattr(rally, name)[:strokes] for name in ("stroke", "hurried", "waited")}
    return dataclasses.replace(rally, **kept, ending=ending)


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
    for i, one in enumerate(rally for rally in played if 4 <= len(rally) <= 9):
        if i == 3:
            break
        rally = dataclasses.replace(one, hands=BOTH_HANDS[i % 2])
        motion = stage(prefix(rally, 0), seed=i, athletes=("female", "male"), lead_in=2.0)
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


def test_waiting_takes_any_time(played: list[Rally]) -> None:
    rally = played[0]
    waiting = stage(prefix(rally, 0), seed=1, lead_in=4.0)
    longer = continue_motion(waiting, prefix(rally, 0), seed=1)
    assert len(longer.time) == len(waiting.time) + 60
    joins(waiting, longer, len(waiting.time) - 1)
    hand = np.linalg.norm(longer.shuttle[:, None] - longer.position[:, rally.server], axis=2).min(axis=1)
    assert hand.max() < 0.2, "the server holds the shuttle"
    served = continue_motion(longer, rally, seed=1)
    joins(longer, served, len(longer.time) - 1)
    assert served.contact_frame[0] >= len(longer.time) + 50
    again = continue_motion(served, rally, seed=2, from_stroke=0)
    joins(served, again, int(served.contact_frame[0]) - 50)
    sound(again)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fps": 24}, "24 frames a second: expected 25 to 1000"),
        ({"fps": 1001}, "1001 frames a second"),
        ({"lead_in": 0.99}, "before the serve: expected 1 to 3600"),
        ({"lead_in": 3600.5}, "before the serve: expected 1 to 3600"),
        ({"athletes": ("male", "robot")}, "expected one of male, female"),
    ],
)
def test_options_that_no_staging_has(played: list[Rally], change: dict[str, Any], message: str) -> None:
    with pytest.raises(StagingError, match=message):
        stage(played[0], seed=0, **change)


@pytest.fixture(scope="module")
def two_strokes(played: list[Rally]) -> tuple[Rally, Motion]:
    """A rally, and the motion of its first two strokes."""
    rally = next(rally for rally in played if len(rally) > 3)
    return rally, stage(prefix(rally, 2), seed=0, fps=25)


@pytest.mark.parametrize(
    ("change", "arguments", "message"),
    [
        (lambda rally: {"server": 1 - rally.server}, {}, "other strokes before number 2"),
        (lambda rally: {"hurried": rally.hurried ^ (np.arange(len(rally)) == 1)}, {}, "other strokes before number 2"),
        (lambda rally: {"stroke": rally.stroke[[0, *[2] * (len(rally) - 1)]]}, {}, "other strokes before number 2"),
        (lambda rally: {"points": (1, 1)}, {}, "other strokes"),
        (lambda rally: {"ends_changed": True}, {}, "other strokes"),
        (lambda rally: {"hands": ("left", "right")}, {}, "other hands"),
        (lambda rally: {}, {"from_stroke": -1}, "from_stroke -1: the motion has 2 strokes"),
        (lambda rally: {}, {"from_stroke": 3}, "from_stroke 3: the motion has 2 strokes"),
    ],
)
def test_what_cannot_be_continued(
    two_strokes: tuple[Rally, Motion], change: Callable[[Rally], dict[str, Any]], arguments: dict[str, int], message: str
) -> None:
    rally, motion = two_strokes
    with pytest.raises(StagingError, match=message):
        continue_motion(motion, dataclasses.replace(rally, **change(rally)), seed=0, **arguments)
