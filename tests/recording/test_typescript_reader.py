"""Rally logs as the official TypeScript readers of MCAP and Arrow see them, under Node.

Their versions and hashes stand in ``typescript/package-lock.json``.
"""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from shuttle_marl.recording import RallyLog
from tests.needs import node_readers
from tests.recording.conftest import read_rallies

pytestmark = pytest.mark.slow


def test_a_tournament_is_read_whole(played: Path, tmp_path: Path) -> None:
    command = node_readers(tmp_path / "reader", Path(__file__).parent / "typescript" / "read.mjs")
    done = subprocess.run([*command, str(played)], capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    [found] = json.loads(done.stdout)
    rallies = read_rallies(played)
    with RallyLog(played) as log:
        assert found["stream"] == {"messages": len(log.rallies), "topics": ["/rallies"]}
        indexed = found["indexed"]
        assert indexed["first"] == log.first_rally.tolist()
        assert indexed["strokes"] == [part.tolist() for part in np.split(rallies.stroke, rallies.first_stroke[1:-1])]
        assert indexed["attachments"] == {"rally_index": len(log.rallies)}
        about = indexed["metadata"]["shuttle_marl.rally_log"]
        assert about == log.header.to_metadata()
        assert json.loads(about["header"])["policies"][0]["name"] == "attacking"
