"""Steps of both feet: between random stands, and the parts of them by hand."""

from typing import Any

import numpy as np
import pytest

from shuttle_marl.base.arrays import F64
from shuttle_marl.staging.feet import Feet, Plant, _reachable, _swings, lifted, move, standing, steps
from shuttle_marl.staging.motions import MOTIONS
from shuttle_marl.staging.timeline import Stand, feet_at
from tests import golden

FRAMES, FPS = 120, 50


def test_feet_stand_at_contacts_as_somebody_looked_at() -> None:
    """Left and right foot: to the right, ahead, and their headings, of a player who faces the net."""
    found = {f"{name}, feet": feet_at(motion, np.zeros(2), 0.0, 0.0)[:2] for motion, name in enumerate(MOTIONS)}
    golden.check("footwork", found, 1e-6)


def a_way(rng: np.random.Generator) -> tuple[F64, F64, F64]:
    """Hips over the floor, their headings, and the reach of the feet, in each frame."""
    knots = np.linspace(0, FRAMES - 1, 7)
    x, y, yaw, reach = (np.interp(np.arange(FRAMES), knots, rng.normal(0, scale, 7)) for scale in (0.7, 0.7, 0.6, 0.1))
    return np.column_stack([x, y]), yaw, 0.75 + reach


def some_stands(rng: np.random.Generator, hips: F64, yaw: F64, first: int = 0) -> list[Stand]:
    stands: list[Stand] = []
    while first < FRAMES - 8:
        end = first + int(rng.integers(0, 12))
        here = min(first, FRAMES - 1)
        aside = np.array([[-0.2, 0.0], [0.2, 0.0]]) + rng.normal(0, 0.08, (2, 2))
        stand = Stand(
            begin=first,
            end=min(end, FRAMES - 1),
            place=hips[here] + aside,
            yaw=yaw[here] + rng.normal(0, 0.3, 2) + 2 * np.pi * rng.integers(-1, 2, 2),
            last=int(rng.integers(2)),
            hop=bool(stands) and rng.random() < 0.2,
            stride=float(rng.choice([0.4, 0.78, 1.25])),
            stays=float(rng.choice([0.03, 0.14, 0.3, 0.8])),
        )
        stands.append(stand)
        first = stand.end + int(rng.integers(2, 40))
    return stands


def table(plants: list[Plant]) -> F64:
    """``[N, 5]`` begin, end, place and heading of each."""
    return np.array([(plant.begin, plant.end, *plant.place, plant.yaw) for plant in plants]).reshape(-1, 5)


def columns(parts: Feet) -> list[F64]:
    return [golden.weighted_sum(np.asarray(part, dtype=float).swapaxes(0, 1)) for part in parts]


def test_steps_between_random_stands_are_those_that_somebody_looked_at() -> None:
    found = {}
    for seed in range(30):
        rng = np.random.default_rng(seed)
        hips, yaw, reach = a_way(rng)
        if seed % 5 == 0:
            hips[:] = hips[0]
        plants = steps(some_stands(rng, hips, yaw, int(rng.integers(6))), hips, yaw, reach, FPS)
        feet = move(plants, np.maximum(rng.normal(0.0, 0.03, FRAMES), 0.0), FRAMES, FPS)
        told: list[list[Any]] = [[len(own), golden.weighted_sum(table(own))] for own in plants]
        frame = int(rng.integers(5, FRAMES))
        stand, kept = standing(plants, feet.ball[:, frame], frame)
        told += [[stand.begin, stand.end, stand.place, stand.yaw, *(table(own)[-2:] for own in kept)]]
        # The way is another one after that frame.
        branch = FRAMES // 2
        other, turned, reach = a_way(rng)
        hips = np.concatenate([hips[: frame + 1], hips[frame] + other[frame + 1 :] - other[frame]])
        again = [stand, *some_stands(rng, hips, turned, stand.end + int(rng.integers(2, 30)))]
        continued = steps(again, hips, turned, reach, FPS, kept)
        after = move(continued, np.zeros(FRAMES), FRAMES, FPS, branch)
        told += [[len(own), golden.weighted_sum(table(own))] for own in continued]
        told += [columns(feet), columns(after), columns(feet.part(slice(0, branch)).joined(after.part(slice(branch - 1, None))))]
        slips = rng.random((2, FRAMES - branch)) < 0.1
        told += [[lifted(continued, slips, branch), *(golden.weighted_sum(table(own)) for own in continued)]]
        found[f"steps {seed}"] = told
    golden.check("footwork", found, 1e-5)


def stand(at: int, right: float = 0.0, **others: float) -> Stand:
    """A stand of one frame with the left foot in the origin."""
    place = np.array([[0.0, 0.0], [right, 0.0]])
    return Stand(begin=at, end=at, place=place, yaw=np.zeros(2), **others)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("right", "stays", "stride", "landings"),
    [
        (0.49, 0.5, 1.0, [(0, 40)]),
        (0.5, 0.5, 1.0, [(0, 13), (27, 40)]),
        (1.49, 0.5, 1.0, [(0, 13), (27, 40)]),
        (1.5, 0.5, 1.0, [(0, 0), (13, 27), (40, 40)]),
    ],
)
def test_feet_step_as_far_as_they_have_to(right: float, stays: float, stride: float, landings: list[tuple[int, int]]) -> None:
    """Less than ``stays`` is no step; a foot that stays near takes no part in a step of less than one and a half strides."""
    still = np.zeros((41, 2))
    ends = [stand(0), stand(40, right, stays=stays, stride=stride)]
    _, found = steps(ends, still, np.zeros(41), np.full(41, 9.0), FPS)
    assert [(plant.begin, plant.end) for plant in found] == landings


def plants_at(*frames: tuple[int, int], x: float = 0.0) -> list[Plant]:
    return [Plant(begin, end, np.array([x, 0.0]), 0.0) for begin, end in frames]


@pytest.mark.parametrize(
    ("x", "side", "found"), [(0.5, 1.0, [(0, 9)]), (0.501, 1.0, []), (0.3, -1.0, []), (0.29, -1.0, [(0, 9)])]
)
def test_feet_reach_as_far_as_the_leg_and_do_not_cross(x: float, side: float, found: list[tuple[int, int]]) -> None:
    kept = _reachable(plants_at((0, 9), x=x), np.zeros((10, 2)), np.zeros(10), np.full(10, 0.5), side, -1)
    assert [(plant.begin, plant.end) for plant in kept] == found


def test_feet_stand_in_the_longest_time_within_reach_but_known_ones_in_the_first() -> None:
    reach = np.array([1, 0, 1, 1, 0, 0, 1, 1, 1, 0.0])
    for sure, frames in ((-1, (6, 8)), (0, (0, 0)), (1, (0, 3))):
        (kept,) = _reachable(plants_at((0, 9), x=0.5), np.zeros((10, 2)), np.zeros(10), reach, 1.0, sure)
        assert (kept.begin, kept.end) == frames


def test_a_foot_stands_once_at_a_time() -> None:
    overlapping = plants_at((0, 4), (3, 8), (8, 12), (13, 15), (14, 15), (15, 19))
    kept = _reachable(overlapping, np.zeros((20, 2)), np.zeros(20), np.ones(20), 1.0, -1)
    assert [(plant.begin, plant.end) for plant in kept] == [(0, 4), (5, 8), (9, 12), (13, 15), (16, 19)]


def test_steps_are_made_while_the_hips_travel() -> None:
    """One step takes place in the middle of the way, in two frames at least, all within the interval."""
    still, early, late = np.zeros((3, 20, 2))
    early[16:], late[19:] = 1.0, 1.0
    assert _swings(3, 17, 1, still, FPS) == [(3, 17)]
    assert _swings(3, 17, 2, still, FPS) == [(3, 10), (10, 17)]
    assert _swings(15, 19, 2, late, FPS) == [(17, 19), (17, 19)]
    assert _swings(15, 19, 2, early, FPS) == [(15, 17), (15, 17)]


def test_a_foot_in_the_air_lands_within_a_tenth_of_a_second() -> None:
    """Or where it would have, if it lands no later; a foot that stands stays."""
    ball = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.1]])
    left = plants_at((0, 30))
    for begin, end, place in ((20, 15, 0.6), (15, 15, 1.0), (12, 12, 1.0)):
        right = [*plants_at((0, 5)), *plants_at((begin, 30), x=1.0)]
        found, kept = standing((left, right), ball, 10)
        assert (found.begin, found.end) == (end, end)
        assert [(plant.begin, plant.end) for plant in (*kept[0], *kept[1])] == [(0, 10), (0, 5), (end, end)]
        assert found.place[1] == pytest.approx([place, 0.0])
    assert left[0].end == 30, "the plan itself is not changed"
    found, kept = standing((left, plants_at((0, 5))), ball, 10)
    assert [(plant.begin, plant.end) for plant in kept[1]] == [(0, 10)]


def test_a_foot_is_lifted_before_it_slips_and_planted_after_it() -> None:
    for slipping, frames in (
        ([], (10, 20)),
        ([10], (11, 20)),
        ([14], (15, 20)),
        ([15], (10, 14)),
        ([12, 18], (13, 17)),
        ([20], (10, 19)),
    ):
        plants, slips = (plants_at((10, 20)), plants_at((10, 20))), np.zeros((2, 30), dtype=bool)
        slips[1, slipping] = True
        assert lifted(plants, slips, 0) == bool(slipping)
        assert [(plant.begin, plant.end) for own in plants for plant in own] == [(10, 20), frames]
