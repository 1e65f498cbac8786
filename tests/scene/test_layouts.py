"""Layouts: every topic and field exists, and cameras are those of the scoreboards."""

import json
import re
from typing import Any

import pytest

from shuttle_marl.scene import topics
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
