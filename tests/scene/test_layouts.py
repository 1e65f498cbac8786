"""Layouts: every topic and field exists, and cameras are those of the scoreboards."""

import json
import re
from typing import Any

import pytest

from shuttle_marl.scene import topics
from shuttle_marl.scene.board import CAMERAS
from shuttle_marl.scene.topics import BOARDS, WORLD
from shuttle_marl.scene.write import LAYOUTS

DOCUMENTS = {path.name: json.loads(path.read_bytes()) for path in LAYOUTS}


def texts(thing: Any) -> list[str]:
    if isinstance(thing, dict):
        return [text for key, value in thing.items() for text in [key, *texts(value)]]
    if isinstance(thing, list):
        return [text for value in thing for text in texts(value)]
    return [thing] if isinstance(thing, str) else []


@pytest.mark.parametrize("name", DOCUMENTS)
def test_every_path_is_a_field_of_a_topic(name: str) -> None:
    paths = [text for text in texts(DOCUMENTS[name]) if re.match(r"/(rally|scene|log|tf)", text)]
    assert set(topics.SCENES) <= set(paths)
    assert topics.LOG in paths
    plotted = [path for path in paths if "." in path]
    assert len(plotted) >= 8
    for path in plotted:
        topic, *fields = path.replace("[:]", "").split(".")
        schema = topics.SCHEMAS[topic]
        for field in fields:
            schema = schema["properties"][field]


@pytest.mark.parametrize("name", DOCUMENTS)
def test_layouts_have_the_cameras_of_the_scoreboards(name: str) -> None:
    """A scoreboard is in the picture only if the layout has the camera for which it was placed."""

    def cameras(node: Any) -> list[dict[str, Any]]:
        children = node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()
        own = [node] if isinstance(node, dict) and "cameraState" in node else []
        return own + [camera for child in children for camera in cameras(child)]

    states = cameras(DOCUMENTS[name])
    assert len(states) == len(CAMERAS)
    for state, camera in zip(states, CAMERAS, strict=True):
        seen = state["cameraState"]
        angles = [seen["distance"], seen["phi"], seen["thetaOffset"], seen["fovy"]]
        assert angles == [camera.distance, camera.phi, camera.theta, camera.fovy]
        assert tuple(seen["targetOffset"]) == camera.target
        assert state["followTf"] == camera.frame
        assert state["followMode"] == ("follow-none" if camera.frame == WORLD else "follow-pose")
        assert {topic for topic, setting in state["topics"].items() if not setting["visible"]} == set(BOARDS) - {camera.board}
