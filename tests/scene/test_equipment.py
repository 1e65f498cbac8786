"""Court, net, racket and shuttle have one size, in scenes, in pictures and on the page."""

import pytest

from shuttle_marl.game import court
from tests.scene.conftest import Reel


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
