"""Court, net, racket and shuttle have one size, in scenes, in pictures and on the page."""

import numpy as np
import pytest

from shuttle_marl.game import court
from shuttle_marl.scene import models
from shuttle_marl.scene.mesh import Mesh
from shuttle_marl.staging import FEATHER, RACKET_HEAD, RACKET_LENGTH, SHUTTLE_SCALE, SWEET_SPOT
from tests.scene.conftest import Reel


def points(meshes: list[Mesh]) -> np.ndarray:
    return np.concatenate([mesh.vertices for mesh in meshes])


def test_the_racket_of_a_scene() -> None:
    along, across, through = np.array([0.0, 0, 1]), np.array([1.0, 0, 0]), np.array([0.0, 1, 0])
    found = points(models.racket(along, through))
    frame = 0.006  # the frame lies around the strings
    assert np.ptp(found @ along) == pytest.approx(RACKET_LENGTH + frame, abs=1e-3)
    assert np.ptp(found @ across) == pytest.approx(2 * (RACKET_HEAD[1] + frame), abs=4e-3)
    strung = found[found @ along > SWEET_SPOT - RACKET_HEAD[0] + 0.02]
    assert (strung @ along).max() - SWEET_SPOT == pytest.approx(RACKET_HEAD[0] + frame, abs=1e-3)


def test_the_shuttle_of_a_scene() -> None:
    found = points(models.shuttle()) / SHUTTLE_SCALE
    assert found[:, 2].min() == pytest.approx(-FEATHER[1][2])
    assert np.hypot(found[:, 0], found[:, 1]).max() == pytest.approx(np.hypot(*FEATHER[1][:2]))


def test_court_and_net_of_a_scene(reel: Reel) -> None:
    entities = {entity.id: entity for _, message in reel.of("/scene/court") for entity in message.entities}
    ground, net = entities["court"], entities["net"]
    lines = [box for box in ground.cubes if min(box.size.x, box.size.y) == pytest.approx(court.LINE)]
    for axis, size in (("x", court.WIDTH), ("y", court.LENGTH)):
        edges = [getattr(box.pose.position, axis) + side * getattr(box.size, axis) / 2 for box in lines for side in (-1, 1)]
        assert max(edges) - min(edges) == pytest.approx(size)
    heights = {round(point.z, 4) for point in net.lines[0].points}
    assert max(heights) == pytest.approx(court.NET_HEIGHT)
    assert min(heights) == pytest.approx(court.NET_HEIGHT_CENTRE - court.NET_DEPTH, abs=1e-3)
    assert {round(box.size.z, 4) for box in net.cubes} == {court.TAPE, court.NET_HEIGHT}
