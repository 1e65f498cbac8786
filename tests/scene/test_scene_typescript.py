"""Scene files as the official TypeScript reader of MCAP sees them, which is what web viewers read with."""

import collections
import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.needs import node_readers


@pytest.mark.slow
def test_every_message_and_attachment_is_read(reel: Any, scene_file: Path, tmp_path: Path) -> None:
    command = node_readers(tmp_path / "reader", Path(__file__).parent / "typescript" / "scene.mjs")
    done = subprocess.run([*command, str(scene_file)], capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    expected = dict(collections.Counter(topic for _, topic, _ in reel.messages))
    assert found["streamed"] == found["indexed"] == expected
    layouts = {f"layout.{viewer}.json" for viewer in ("foxglove", "lichtblick")}
    assert set(found["attachments"]) == layouts
    assert min(found["attachments"].values()) > 1000
