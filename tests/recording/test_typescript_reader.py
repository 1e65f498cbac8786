"""Rally logs as the official TypeScript readers of MCAP and Arrow see them, under Node.

Node is on the machine or the tests are skipped; the packages, with versions and hashes in ``typescript/package-lock.json``,
are installed by npm into a temporary folder.
"""

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.recording import Rallies, RallyLog

SOURCE = Path(__file__).with_name("typescript")
NODE, NPM = shutil.which("node"), shutil.which("npm")
OLDEST = 18
"""Versions of Node before this lack what the packages need."""

Read = Callable[..., tuple[int, list[dict[str, Any]]]]

pytestmark = pytest.mark.slow


def node_version() -> int:
    if NODE is None or NPM is None:
        return 0
    done = subprocess.run([NODE, "--version"], capture_output=True, text=True, check=True)
    return int(done.stdout.strip().removeprefix("v").partition(".")[0])


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> Read:
    """Reads files: the exit status and what was found in each."""
    if node_version() < OLDEST:
        pytest.skip(f"needs Node {OLDEST} or later, and npm")
    folder = tmp_path_factory.mktemp("node") / "reader"
    shutil.copytree(SOURCE, folder, ignore=shutil.ignore_patterns("node_modules"))
    install = [str(NPM), "ci", "--ignore-scripts", "--no-audit", "--no-fund"]
    installed = subprocess.run(install, cwd=folder, capture_output=True, text=True, check=False, timeout=300)
    if installed.returncode and os.environ.get("CI") != "true":
        pytest.skip(f"npm cannot install the readers: {installed.stderr[-500:]}")
    assert installed.returncode == 0, installed.stderr

    def run(*paths: Path) -> tuple[int, list[dict[str, Any]]]:
        command = [str(NODE), str(folder / "read.mjs"), *map(str, paths)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
        assert done.stdout, done.stderr
        return done.returncode, json.loads(done.stdout)

    return run


def strokes(rallies: Rallies) -> list[list[int]]:
    return [part.tolist() for part in np.split(rallies.stroke, rallies.first_stroke[1:-1])]


def test_a_tournament_is_read_whole(read: Read, played: Path) -> None:
    status, [found] = read(played)
    assert status == 0, found
    with RallyLog(played) as log:
        rallies = Rallies.concatenate([batch for _, batch in log.batches()])
        assert found["stream"] == {"messages": len(log.rallies), "topics": ["/rallies"]}
        indexed = found["indexed"]
        assert indexed["first"] == log.first_rally.tolist()
        assert indexed["strokes"] == strokes(rallies)
        assert indexed["attachments"] == {"rally_index": len(log.rallies)}
        about = indexed["metadata"]["shuttle_marl.rally_log"]
        assert about == log.header.to_metadata()
        assert json.loads(about["header"])["policies"][0]["name"] == "attacking"
