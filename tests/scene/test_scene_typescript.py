"""Scene files as the official TypeScript reader of MCAP sees them, which is what web viewers read with."""

import collections
import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

PACKAGES = Path(__file__).parents[1] / "recording" / "typescript"
SCRIPT = Path(__file__).parent / "typescript" / "scene.mjs"
NODE, NPM = shutil.which("node"), shutil.which("npm")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(NODE is None or NPM is None, reason="needs Node and npm"),
]


def test_every_message_and_attachment_is_read(reel: Any, scene_file: Path, tmp_path: Path) -> None:
    for file in (PACKAGES / "package.json", PACKAGES / "package-lock.json", SCRIPT):
        shutil.copy(file, tmp_path)
    install = [str(NPM), "ci", "--ignore-scripts", "--no-audit", "--no-fund"]
    installed = subprocess.run(install, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300)
    if installed.returncode and os.environ.get("CI") != "true":
        pytest.skip(f"npm cannot install the reader: {installed.stderr[-500:]}")
    assert installed.returncode == 0, installed.stderr
    command = [str(NODE), SCRIPT.name, str(scene_file)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    expected = dict(collections.Counter(topic for _, topic, _ in reel.messages))
    assert found["streamed"] == found["indexed"] == expected
    layouts = {f"{name}.{viewer}.json" for name in ("layout", "match") for viewer in ("foxglove", "lichtblick")}
    assert set(found["attachments"]) == {*layouts, "rallies.arrow"}
    assert min(found["attachments"].values()) > 1000
