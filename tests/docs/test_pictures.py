"""Pictures of the documentation: every one has data, and is drawn again when they change."""

import json
from pathlib import Path

import pytest

from docs.tools import pictures
from docs.tools.markdown import IMAGES


def test_no_picture_is_older_than_its_data() -> None:
    assert pictures.outdated() == []


def test_changed_data_and_unknown_pictures_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorded = json.loads(pictures.SOURCES.read_text())
    sources = tmp_path / "sources.json"
    sources.write_text(json.dumps({**recorded, "stroke_value.png": "0" * 64}))
    monkeypatch.setattr(pictures, "SOURCES", sources)
    assert pictures.outdated() == ["stroke_value.png"]


def test_every_picture_of_a_page_exists() -> None:
    shown = {name for names in pictures.PICTURES for name in names}
    assert shown == {path.name for path in IMAGES.iterdir()} - {"sources.json"}
