"""Walks between two rallies of a match."""

import dataclasses
import itertools

import numpy as np
import pytest

from shuttle_marl.court.staging import BONES, Motion, StagingError, stage, with_walk
from shuttle_marl.court.staging.geometry import matrix
from shuttle_marl.game.court import NET_HEIGHT
from shuttle_marl.game.rules import FAULT
from tests import golden
from tests.staging.conftest import HANDS

FPS = 50


@pytest.fixture(scope="module", params=(1, 2), ids=[f"{a}-{b}" for a, b in HANDS[1:3]])
def match(request: pytest.FixtureRequest, played) -> list[Motion]:
    """Four rallies of two players, each served by the winner of the one before."""
    rallies = [played[4 * request.param]]
    for rally in played[4 * request.param + 1 : 4 * request.param + 4]:
        rallies.append(dataclasses.replace(rally, server=rallies[-1].winner))
    handed = [dataclasses.replace(rally, hands=HANDS[request.param]) for rally in rallies]
    return [stage(rally, seed=i, athletes=("male", "female")) for i, rally in enumerate(handed)]


@pytest.fixture(scope="module")
def walks(match) -> list[tuple[Motion, Motion, Motion]]:
    """A rally, the same with its walk, and the next rally."""
    return [(rally, with_walk(rally, following), following) for rally, following in itertools.pairwise(match)]


def test_the_rally_stays_and_the_walk_ends_in_the_next_one(walks) -> None:
    for rally, whole, following in walks:
        n = len(rally.time)
        for name in ("rotation", "position", "planted", "shuttle", "shuttle_velocity"):
            assert (getattr(whole, name)[:n] == getattr(rally, name)).all()
        assert 2.5 < (len(whole.time) - n) / FPS < 13
        assert np.abs(whole.position[-1, :, 0] - following.position[0, :, 0]).max() < 2e-3, "the hips"
        assert np.abs(whole.position[-1] - following.position[0]).max() < 0.06
        assert np.abs(whole.shuttle[-1] - following.shuttle[0]).max() < 0.02
        assert np.abs(whole.position[n] - whole.position[n - 1]).max() < 0.06


def test_walks_are_those_that_somebody_looked_at(walks) -> None:
    found = {}
    for i, (rally, whole, _) in enumerate(walks):
        name = f"{'-'.join(rally.trajectory.rally.hands)}, {i}"
        for part in ("shuttle", "position", "planted"):
            found[f"{name}, {part}"] = golden.weighted_sum(getattr(whole, part)[len(rally.time) :])
        found[f"{name}, rotation"] = golden.weighted_sum(matrix(whole.rotation[len(rally.time) :]))
    golden.check("walks", found, 1e-3)


def test_players_walk_and_their_feet_do_not_slide(walks) -> None:
    for rally, whole, _ in walks:
        part = slice(len(rally.time) - 1, None)
        hips = whole.position[part, :, 0, :2].astype(float)
        assert np.hypot(*np.moveaxis(np.diff(hips, axis=0), -1, 0)).max() * FPS < 2.5
        for foot, name in enumerate(("LeftToeBase", "RightToeBase")):
            stands = whole.planted[part, :, foot]
            way = np.hypot(*np.moveaxis(np.diff(whole.position[part, :, BONES.index(name), :2].astype(float), axis=0), -1, 0))
            assert way[stands[1:] & stands[:-1]].max() < 3e-3
        for seat in (0, 1):
            toes = whole.position[part, seat][:, [BONES.index("LeftToeBase"), BONES.index("RightToeBase")], 2]
            under = rally.skeletons[seat].at("RightToeBase")[2] - toes
            assert under.max() < 5e-3, "no foot is under the floor"
            knees = whole.position[part, seat][:, [BONES.index("LeftLeg"), BONES.index("RightLeg")], 2]
            assert knees.min() > 0.1
        assert whole.position[part, :, 0, 2].min() > 0.4, "the hips are lowest in the pick-up"


@pytest.mark.parametrize("distance", [0.6, 0.8])
def test_a_shuttle_near_the_net_is_flicked_over_it(distance: float, played) -> None:
    rally = next(rally for rally in played if rally.ending == FAULT and "net" in rally.catalogue.names[rally.stroke[-1]])
    first, second = (stage(each, seed=0) for each in (rally, dataclasses.replace(played[0], server=rally.winner)))
    shuttle = first.shuttle.copy()
    shuttle[-1, 1] = np.copysign(distance, shuttle[-1, 1])
    y, z = with_walk(dataclasses.replace(first, shuttle=shuttle), second).shuttle[len(first.time) - 1 :, 1:].T
    (at,) = np.flatnonzero(np.diff(np.sign(y)))
    assert z[at] - y[at] * (z[at + 1] - z[at]) / (y[at + 1] - y[at]) > NET_HEIGHT


def test_what_does_not_follow_is_refused(match, played) -> None:
    following = dataclasses.replace(played[1], hands=match[0].hands)
    with pytest.raises(StagingError, match="follows a walk already"):
        with_walk(dataclasses.replace(match[0], players=None), match[1])
    with pytest.raises(StagingError, match="different fps"):
        with_walk(match[0], stage(following, seed=0, athletes=("male", "female"), fps=100))
    with pytest.raises(StagingError, match="different skeletons"):
        with_walk(match[0], stage(following, seed=0))
    with pytest.raises(StagingError, match="different hands"):
        with_walk(match[0], stage(played[1], seed=0, athletes=("male", "female")))
    there = stage(dataclasses.replace(played[1], ends_changed=True), seed=0, athletes=("male", "female"))
    with pytest.raises(StagingError, match="change ends"):
        with_walk(match[0], there)
    opened = dataclasses.replace(following, stroke=played[1].stroke[:1], hurried=played[1].hurried[:1], ending=2)
    with pytest.raises(StagingError, match="the rally continues"):
        with_walk(stage(opened, seed=0, athletes=("male", "female")), match[1])
