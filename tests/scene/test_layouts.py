"""Layouts: every topic and field exists, and cameras are those of the scoreboards."""

import json
import re
from typing import Any

import numpy as np
import pytest

from shuttle_marl.scene import topics
from shuttle_marl.scene.board import CAMERAS, Camera
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


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.title)
def test_scoreboards_are_in_the_picture_of_their_camera(camera: Camera) -> None:
    """Seen from the camera, as three.js projects it: in the upper left quarter, with room for half a board."""
    phi, theta = np.radians(camera.phi), np.radians(camera.theta)
    away = camera.distance * np.array([-np.sin(phi) * np.sin(theta), -np.sin(phi) * np.cos(theta), np.cos(phi)])
    place = np.array(camera.target) + away
    seen = np.array(camera.point(-0.95, 0.58)) - place
    ahead = -away / camera.distance
    right = np.cross(ahead, [0, 0, 1])
    right /= np.linalg.norm(right)
    half = np.tan(np.radians(camera.fovy / 2)) * (seen @ ahead)
    assert seen @ right / half == pytest.approx(-0.95)
    assert seen @ np.cross(right, ahead) / half == pytest.approx(0.58)
