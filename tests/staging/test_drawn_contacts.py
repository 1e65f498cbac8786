"""Drawn places and times of contacts, part by part, with uniform draws that a test gives."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shuttle_marl.game import default_game
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.rally.record import Rally
from shuttle_marl.game.rules import FAULT, HURRIED_ABOVE, HURRIED_BELOW, RETURNED_ABOVE, RETURNED_BELOW, WINNER
from shuttle_marl.game.shipped import waiting_places
from shuttle_marl.game.stroke import SHOTS, TECHNIQUES
from shuttle_marl.staging import draw, load_skeleton
from shuttle_marl.staging.assemble import players_of
from shuttle_marl.staging.draw import Measured, TrajectoryBuilder, load_measured, quantile
from shuttle_marl.staging.flight import fall, net_height
from shuttle_marl.staging.motions import MOTIONS, Stance
from shuttle_marl.staging.trajectory import NET, OPEN, OUT, RETURN, WIN

CATALOGUE = default_game().catalogue
FPS = 50
MALE, FEMALE = load_skeleton("male"), load_skeleton("female")


def stroke(name: str) -> int:
    """The first stroke of the catalogue whose name begins so."""
    return next(k for k, each in enumerate(CATALOGUE.names) if each.startswith(name))


def a_rally(*names: str, **others: Any) -> Rally:
    strokes = np.array([stroke(name) for name in names], dtype=np.int64)
    given: dict[str, Any] = {"server": 0, "hurried": np.zeros(len(strokes), bool), "ending": WINNER}
    return Rally(catalogue=CATALOGUE, stroke=strokes, **given | others)


def builder(rally: Rally, u: float | dict[int, float] = 0.5) -> TrajectoryBuilder:
    """A builder whose draws are all the same, or some by number and one half otherwise."""
    made = TrajectoryBuilder(rally, players_of(rally, (MALE, FEMALE)), 1, FPS)
    made.uniform = lambda _, number: u.get(number, 0.5) if isinstance(u, dict) else u  # type: ignore[method-assign, assignment]
    return made


SERVE, LIFT, CLEAR, SMASH, BLOCK = (
    "short-serve:front-centre:below:back",
    "lift:back-left",
    "clear:back-right:above:fore",
    "smash:",
    "block:",
)


def table(**changes: Any) -> Measured:
    """Measured tables of the same numbers for everything."""
    given = {
        "flight_time": np.tile([0.5, 1.0, 2.0], (13, 1)),
        "flight_time_by_length": np.tile(np.array([0.6, 1.0, 1.4])[None] + np.arange(13)[:, None] / 100, (13, 2, 1, 1)),
        "places": np.zeros((13, 9, 2, 5)),
        "base": np.zeros((13, 9, 2)),
        "net_share": np.full(13, 0.4),
        "out_by": np.array([[0.0, 0.1, 0.2, 0.3, 0.4], [0.0, 0.2, 0.4, 0.6, 0.8]]),
        "serve": np.zeros((2, 2, 2, 5)),
    }
    return Measured(**(given | changes))


def test_times_within_the_quartiles_of_a_length() -> None:
    """Linear on both sides of the median; lengths over 13 m count as the longest ones."""
    measured = table()
    for u, seconds in ((0.0, 0.6), (0.25, 0.8), (0.5, 1.0), (0.75, 1.2), (1.0, 1.4)):
        assert measured.seconds(3, 0, 0.9, u) == pytest.approx(seconds)
        assert measured.seconds(3, 1, 2.3, u) == pytest.approx(seconds + 0.02)
        assert measured.seconds(3, 1, 12.0, u) == measured.seconds(3, 1, 30.0, u) == pytest.approx(seconds + 0.12)
    close = table(flight_time=np.tile([0.9, 1.0, 1.1], (13, 1)))
    assert close.seconds(0, 0, 0.0, 0.0) == 0.9
    assert close.seconds(0, 0, 0.0, 1.0) == 1.1


def test_quantiles_are_interpolated_and_held() -> None:
    knots = np.array([0.0, 1.0, 3.0, 7.0, 9.0])
    for u, value in (
        (0.0, 0.0),
        (0.05, 0.0),
        (0.15, 0.5),
        (0.25, 1.0),
        (0.375, 2.0),
        (0.5, 3.0),
        (0.75, 7.0),
        (0.95, 9.0),
        (1.0, 9.0),
    ):
        assert quantile(knots, u) == pytest.approx(value)


def test_the_shipped_tables() -> None:
    measured = load_measured()
    assert measured.flight_time.shape == (13, 3)
    assert measured.flight_time_by_length.shape == (13, 2, 13, 3)
    assert measured.places.shape == (13, 9, 2, 5)
    assert measured.serve.shape == (2, 2, 2, 5)
    assert_allclose(measured.flight_time[SHOTS.index("smash")], [0.4, 0.467, 0.533])
    assert_allclose(measured.out_by[:, 2], [0.181, 0.237])
    assert measured.net_share[SHOTS.index("net-shot")] == 0.908
    assert measured.serve[0, 0, 1, 2] == 3.091
    assert measured.serve[0, 1, 0, 2] == 0.932
    assert measured.flight_time_by_length[SHOTS.index("clear"), 1, 9, 0] == 0.8


def test_draws_are_uniform_and_differ_between_strokes_and_numbers() -> None:
    rally = a_rally(SERVE, LIFT)
    made, again = (TrajectoryBuilder(rally, players_of(rally, (MALE, MALE)), 5, FPS) for _ in range(2))
    found = np.array([[made.uniform(i, number) for number in range(88)] for i in range(40)])
    assert again.uniform(3, 7) == found[3, 7]
    assert found.min() >= 0
    assert found.max() < 1
    assert len(set(found.ravel())) == found.size
    assert_allclose(np.quantile(found, [0.25, 0.5, 0.75]), [0.25, 0.5, 0.75], atol=0.03)


@pytest.mark.parametrize(
    ("ending", "last", "shot", "hurried", "height"),
    [
        (RETURNED_BELOW, "drop:front-left", "net-shot", False, 0),
        (RETURNED_ABOVE, "drop:front-left", "net-kill", False, 1),
        (HURRIED_BELOW, "drive:middle", "block", True, 0),
        (HURRIED_ABOVE, "drive:middle", "drive", True, 1),
        (RETURNED_BELOW, LIFT, "lift", False, 0),
        (RETURNED_ABOVE, LIFT, "clear", False, 1),
    ],
)
def test_the_reply_that_is_expected_in_an_open_rally(ending: int, last: str, shot: str, hurried: bool, height: int) -> None:
    made = builder(a_rally(SERVE, last, ending=ending))
    assert SHOTS[made.shot[-1]] == shot
    assert (len(made.shot), made.hurried[-1], made.height[-1], made.area[-1], made.technique[-1]) == (3, hurried, height, 1, 0)
    assert len(builder(a_rally(SERVE, last)).shot) == 2
    waiting = builder(a_rally(ending=RETURNED_BELOW))
    assert (SHOTS[waiting.shot[0]], TECHNIQUES[waiting.technique[0]]) == ("short-serve", "backhand")


def test_how_a_rally_ends() -> None:
    """A shuttle into the net is drawn with the measured share, unless it was aimed at the middle."""
    assert builder(a_rally(SERVE, LIFT))._end(0) == RETURN
    assert builder(a_rally(SERVE, LIFT))._end(1) == WIN
    assert builder(a_rally(SERVE, LIFT, ending=RETURNED_BELOW))._end(1) == OPEN
    for name, u, end in (
        (LIFT, 0.39, NET),
        (LIFT, 0.4, OUT),
        ("drive:middle-centre", 0.99, NET),
        ("drop:front-centre", 0.99, NET),
    ):
        made = builder(a_rally(SERVE, name, ending=FAULT), {6: u})
        made.measured = table()
        assert made._end(1) == end
    made = builder(a_rally(SERVE, ending=FAULT), {6: 0.9})
    made.measured = table()
    assert made._end(0) == OUT, "serves to the middle may be too short"


def test_the_serve_and_where_both_players_wait_for_it() -> None:
    """Distances of the server, then of the receiver: from the centre line and from the net; at least 12 cm and 40 cm."""
    places = np.array([[[[0.0, 0.2, 0.4, 0.6, 0.8], [2, 2.5, 3, 3.5, 4]], [[0.5, 0.6, 0.7, 0.8, 0.9], [3, 3.5, 4, 4.5, 5]]]] * 2)
    for points, sign in ((0, 1.0), (1, -1.0)):
        made = builder(a_rally(SERVE, points=(points, 0)), {1: 0.25, 2: 0.75, 3: 0.5, 4: 0.95, 5: 0.5})
        made.measured = table(serve=places)
        before = np.zeros((2, 2))
        contact, stance = made._serve(before)
        assert_allclose(before, [[sign * 0.2, -3.5], [sign * 0.7, -5.0]])
        assert_allclose(stance.root, before[0])
        assert MOTIONS[stance.motion] == "backhand serve"
        assert contact[2] == pytest.approx(1.04), "the middle of the range of heights"
        assert_allclose(contact[:2] - before[0], MALE_SERVE, atol=0.02)
        made = builder(a_rally(SERVE, points=(points, 0)), 0.0)
        made.measured = table(serve=places)
        made._serve(before)
        assert_allclose(before, [[sign * 0.12, -2.38], [sign * 0.5, -3.0]])


MALE_SERVE = players_of(a_rally(SERVE), (MALE, MALE))[0].library.contact[0, 0, :2]


def test_players_go_where_they_wait_after_their_last_stroke() -> None:
    base = np.arange(13 * 9 * 2.0).reshape(13, 9, 2)
    rally = a_rally(SERVE, LIFT, SMASH, BLOCK)
    made = builder(rally)
    made.measured = table(base=base)
    own = [base[made.shot[i], made.area[i]] for i in range(4)]
    start = [base[made.shot[i], 4] for i in range(4)]
    assert_allclose(made._bases(0), [start[0], start[0]])
    assert_allclose(made._bases(1), [own[0], start[1]])
    assert_allclose(made._bases(2), [own[0], own[1]])
    assert_allclose(made._bases(3), [own[2], own[1]])
    # The receiver of a stroke waits where they chose, a left-hander on the other side.
    waited = dataclasses.replace(rally, waited=np.array([0, 3, 6, 8]), hands=("right", "left"))
    made = builder(waited)
    made.measured = table(base=base)
    places = waiting_places()
    assert_allclose(made._bases(1), [places[3] * [1, -1], start[1]])
    assert_allclose(made._bases(2), [own[0], places[6] * [-1, -1]])


def test_contacts_are_as_high_as_drawn_and_overhead_ones_as_the_player_is_tall() -> None:
    made = builder(a_rally(SERVE, CLEAR, LIFT))
    assert made._height(0, 0.25) == pytest.approx(0.98 + 0.25 * 0.12)
    assert made._height(1, 0.5) == pytest.approx(2.47 * FEMALE.scale)
    assert made._height(1, 0.5, flat=True) == pytest.approx(2.17 * FEMALE.scale)
    assert made._height(2, 1.0) == pytest.approx(1.2)


@pytest.mark.parametrize(
    ("shot", "area", "which", "place"),
    [
        ("short-serve", 0, 0.49, (0.5, 1.78)),
        ("short-serve", 0, 0.5, (-2.79, 3.0)),
        ("short-serve", 1, 0.5, (0.5, 1.78)),
        ("lift", 7, 0.9, (0.5, 7.1)),
        ("lift", 6, 0.49, (0.5, 7.1)),
        ("lift", 6, 0.5, (-2.79, 3.0)),
        ("lift", 8, 0.5, (2.79, 3.0)),
        ("drive", 3, 0.1, (-2.79, 3.0)),
        ("drive", 5, 0.9, (2.79, 3.0)),
        ("drive", 4, 0.9, (0.5, 7.1)),
    ],
)
def test_where_a_shuttle_lands_out(shot: str, area: int, which: float, place: tuple[float, float]) -> None:
    """The median: 20 cm beside the court, 40 cm behind it, or before the short service line; 5 cm at least."""
    made = builder(a_rally(SERVE))
    made.measured, made.shot, made.area = table(), np.array([SHOTS.index(shot)]), np.array([area])
    assert_allclose(made._outside(0, 0.5, 3.0, which, 0.5), place)
    x, y = made._outside(0, 0.5, 3.0, which, 0.0)
    for value, far, line in ((x, place[0], 2.59), (abs(y), place[1], 6.7 if place[1] > 5 else 1.98)):
        if value != far and far not in (0.5, 3.0):
            assert abs(abs(value) - line) == pytest.approx(0.05)


def test_points_in_the_net() -> None:
    """Just before the net, where the flight to the drawn point passes it, a little to much too low."""
    made = builder(a_rally(SERVE), {8 * 3 + 5: 0.5})
    contact, point = np.array([0.2, -2.0, 0.8]), np.array([1.2, 3.0, 1.0])
    found = made._net_point(0, contact, point, 0.4, 2)
    assert_allclose(found, [0.6, -0.02, float(net_height(0.6)) - 0.03 - 0.8 * 0.6 * 0.25])
    high = made._net_point(0, np.array([0.2, -2.0, 2.5]), point, 0.4, 2)
    assert_allclose(high[2], float(net_height(0.6)) - 0.03 - 0.9 * 0.6 * 0.25)


PLACES = np.zeros((13, 9, 2, 5))
PLACES[:, :, 0], PLACES[:, :, 1] = [-2, -1, 0.5, 1, 2], [1, 2, 3, 4, 5]


@pytest.mark.parametrize(
    ("names", "hurried", "end", "area", "expected"),
    [
        ((SERVE, LIFT, CLEAR), False, RETURN, None, (0.5, 3.0, 2.47 * MALE.scale, 1)),
        ((SERVE, LIFT, LIFT), False, RETURN, None, (0.5, 3.0, 0.85, 0)),
        ((SERVE, LIFT, LIFT), True, RETURN, None, (0.5, 3.0, 0.675, 0)),  # lower, in a hurry
        ((SERVE, SMASH, "drive:middle-left:above"), False, RETURN, None, (0.5, 3.0, 1.64, 1)),  # a flat one
        ((SERVE, LIFT), False, WIN, None, (0.5, 3.0, 0.014, 0)),
        ((SERVE, LIFT), False, OUT, 7, (0.5, 7.1, 0.014, 0)),
        ((SERVE, LIFT, "net-kill:"), False, RETURN, 7, (0.5, 2.0, 1.85, 1)),  # steps in: half of the range
    ],
)
def test_points_where_a_shuttle_is_met(
    names: tuple[str, ...], hurried: bool, end: int, area: int | None, expected: tuple[float, ...]
) -> None:
    made = builder(a_rally(*names, hurried=np.arange(len(names)) > (1 if hurried else 9)))
    made.measured = table(places=PLACES)
    if area is not None:
        made.area[1] = area
    point, met = made._point(1, end, 0)
    assert_allclose(np.append(point, met), expected, atol=1e-9)


def test_each_try_has_draws_of_its_own() -> None:
    """For the third try, numbers 25 to 28: x, y, height, and the side of a shuttle that lands out."""
    made = builder(a_rally(SERVE, LIFT, LIFT), {25: 0.25, 26: 0.75, 27: 0.2})
    made.measured = table(places=PLACES)
    assert_allclose(made._point(1, RETURN, 2)[0], [-1.0, 4.0, 0.64])
    made = builder(a_rally(SERVE, LIFT), {27: 0.6, 28: 0.75})
    made.measured, made.area[1] = table(places=PLACES), 8
    assert_allclose(made._point(1, OUT, 2)[0], [2.59 + 0.3, 3.0, 0.014])


def test_points_close_to_the_net_and_of_serves() -> None:
    """A shuttle far below the top of the net is met farther from it; serves land in the service court."""
    near = PLACES * [[[[1], [0.0]]]]
    for reply, height, y in (
        ("lift:back-left:below", 0.85, 0.7 / 1.3),
        ("push:", 1.25, 0.3 / 0.7),
        ("drive:middle-left:below", 1.185, 0.365 / 0.35),
    ):
        made = builder(a_rally(SERVE, LIFT, reply))
        made.measured = table(places=near)
        point, _ = made._point(1, RETURN, 0)
        assert point[1:] == pytest.approx([y, height])
    made = builder(a_rally(SERVE, LIFT))
    made.measured = table(places=near)
    assert made._point(1, WIN, 0)[0][1] == 0.12
    for points, sign in ((0, -1), (1, 1)):
        made = builder(a_rally(SERVE, LIFT, points=(points, 0)))
        made.measured = table(places=near)
        point, _ = made._point(0, RETURN, 0)
        assert point[:2] == pytest.approx([sign * 0.5, 2.02])
        made.measured = table(places=0 * near)
        assert made._point(0, RETURN, 0)[0][0] == pytest.approx(sign * 0.04)


def stance_at(x: float, y: float, motion: str = "lunge") -> Stance:
    return Stance(motion=MOTIONS.index(motion), heading=0.0, root=np.array([x, y]), reach=0.2)


def test_how_late_a_receiver_is() -> None:
    """4.5 m/s² after a reaction of 0.06 s, and 15 cm to spare."""
    made = builder(a_rally(SERVE, LIFT))
    seconds = np.array([0.0, 0.06, 0.26, 1.06])
    found = made._late(stance_at(3.0, -4.0), np.zeros(2), seconds)
    assert_allclose(found, [4.85, 4.85, 4.85 - 4.5 * 0.04, 0.35])
    assert made._late(None, np.zeros(2), seconds).tolist() == [0, 0, 0, 0]


@pytest.mark.parametrize(
    ("shot", "motion", "hand", "x", "aside"),
    [
        (SMASH, "defence", "right", -0.9, 0.0),
        (SMASH, "defence", "right", -0.3, 0.2),
        (SMASH, "defence", "right", 0.1, 0.6),
        (SMASH, "backhand defence", "right", 0.1, 0.0),
        (SMASH, "backhand defence", "right", -0.9, 0.4),
        (SMASH, "defence", "left", 0.7, 0.0),
        (SMASH, "backhand defence", "left", 0.9, 0.4),
        (SMASH, "lunge", "right", 0.5, 0.0),
        (LIFT, "defence", "right", 0.5, 0.0),
    ],
)
def test_fast_shuttles_come_to_the_side_of_the_stroke(shot: str, motion: str, hand: str, x: float, aside: float) -> None:
    """The receiver stands 20 cm to the right, and sees the shuttle at -x; 30 cm beside them is at the body."""
    made = builder(a_rally(SERVE, shot, hands=(hand, "right")))
    found = made._aside(
        1, stance_at(0.0, -4.0, motion), np.array([x, 4.0, 0.8]), np.array([0.2 if hand == "right" else -0.2, -4.0])
    )
    assert found == pytest.approx(aside)
    assert made._aside(1, None, np.zeros(3), np.zeros(2)) == 0


def test_hurried_players_are_short_of_their_place_and_stretch() -> None:
    point, base = np.array([0.5, 3.0, 0.7]), np.array([0.0, -4.0])
    calm, hurried = (
        builder(a_rally(SERVE, LIFT, LIFT, hurried=np.array([False, False, late])))._stance(2, point, base)
        for late in (False, True)
    )
    way = base - calm.root
    assert_allclose(hurried.root, calm.root + 0.08 * way / np.hypot(*way))
    assert hurried.reach == pytest.approx(min(calm.reach + 0.35, 1.0))
    assert MOTIONS[calm.motion] == "defence"
    there = calm.root + np.array([0.01, 0.0])
    near = builder(a_rally(SERVE, LIFT, LIFT, hurried=np.array([False, False, True])))._stance(2, point, there)
    assert_allclose(near.root, there)


def test_clears_are_met_further_back_than_smashes() -> None:
    point, base = np.array([0.5, 5.0, 2.45]), np.array([0.0, -4.0])
    roots = [builder(a_rally(SERVE, LIFT, name))._stance(2, point, base).root for name in (CLEAR, "smash:middle-left:above:fore")]
    assert_allclose(roots[0] - roots[1], [0.0, 0.3])


def test_points_nearer_to_the_receiver_are_among_those_of_the_matches() -> None:
    made = builder(a_rally(SERVE, LIFT, LIFT))
    made.measured = table(places=PLACES)
    point, base = np.array([0.5, 3.0, 0.7]), np.array([3.0, -3.0])
    root = made._stance(2, point, base).root
    for share, expected in ((0.25, point[:2] + 0.25 * (root - base)), (1.0, np.clip(point[:2] + root - base, [-2, 1], [2, 5]))):
        assert_allclose(made._nearer(1, point, base, share), [*expected, 0.7])
    beyond = made._nearer(1, np.array([9.0, 3.0, 0.7]), base, 0.0)
    assert_allclose(beyond, [9.0, 3.0, 0.7])


def test_tries_of_a_stroke() -> None:
    """Time of flight in frames, within the quartiles of the shot; floor and net end it later and earlier."""
    contact, base = np.array([0.0, -3.0, 0.7]), np.array([0.2, -3.5])
    made = builder(a_rally(SERVE, LIFT, LIFT))
    made.measured = table(places=PLACES, flight_time=np.tile([0.5, 1.0, 1.313], (13, 1)))
    returned = made._try(1, RETURN, contact, base, 0)
    assert (returned.ticks, returned.least, returned.most, returned.met) == (53, 25, 65, 0)  # 6.02 m: 1.06 s
    assert_allclose(returned.point, [0.5, 3.0, 0.85])
    assert returned.late == pytest.approx(made._late(returned.stance, base, np.array(1.06)))
    assert returned.aside == 0
    later = made._try(1, RETURN, contact, base, 7)
    assert_allclose(later.point, made._nearer(1, returned.point, base, 0.6))
    won = made._try(1, WIN, contact, base, 0)
    assert (won.ticks, won.least, won.most, won.stance) == (round((1.12 * 1.06 + 0.1) * 50), 1, 450, None)
    made.area[1] = 1
    net = made._try(1, NET, contact, base, 0)
    assert net.ticks == round(1.06 * 0.5 * 50)
    assert net.point[1] == -0.02
    assert net.late == 0
    # A hurried receiver gets a quick one.
    quick = builder(a_rally(SERVE, LIFT, LIFT, hurried=np.array([False, False, True])))
    quick.measured = made.measured
    assert quick._try(1, RETURN, contact, base, 0).ticks == round((0.66 + 0.2) * 50)


def test_flights_of_no_strokes_and_of_some() -> None:
    assert draw._joined([], np.zeros((0, 3))).start.shape == (0, 3)
    one = fall(np.array([[1.0, -2.0, 1.0]]), np.array([[3.0, 4.0, 2.0]]), np.array([0.5]))
    both = draw._joined([one, one], np.array([[1.0, 1.0, 1.0], [-1.0, -1.0, 1.0]]))
    assert_allclose(both.start, [[1, -2, 1], [-1, 2, 1]])
    assert_allclose(both.heading, [[0.6, 0.8], [-0.6, -0.8]])
    assert_allclose(both.velocity(1, 0), [-3, -4, 2])


def test_areas_where_kills_are_met() -> None:
    for name, area, met in ((LIFT, 8, 8), ("net-kill:", 8, 2), ("net-kill:", 4, 1)):
        made = builder(a_rally(SERVE, LIFT, name))
        made.area[1] = area
        assert made._met_in(1) == met
    assert AREAS[2].startswith("front")
