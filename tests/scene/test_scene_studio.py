"""Scene files opened in a real viewer, in a browser without a window."""

import io
import os
import re
import shutil
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
import pytest
from mcap.reader import make_reader

from experiments.studio import NO_PROBLEMS, StudioError, install, visit
from shuttle_marl.game import default_game
from shuttle_marl.recording import RallyLog
from shuttle_marl.scene import topics
from shuttle_marl.scene.rally_report import SECOND
from shuttle_marl.scene.write import EPOCH, select, write_scene
from tests.scene.conftest import read

HALF = 0.4
"""Pixels for one of the window: the browser draws without a graphics card, which takes most of the time."""
ROWS = 30
"""Rows of a table on its first page."""
COURT = np.array([34, 115, 83]) / 255
"""Colour of the mat as Studio lights it."""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not all(map(shutil.which, ("node", "npm"))), reason="needs Node and npm"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the viewer."""
    path = tmp_path_factory.mktemp("studio") / "studio"
    try:
        install(path)
    except StudioError as error:
        if os.environ.get("CI") == "true":
            raise
        pytest.skip(f"the viewer cannot be installed: {error}")
    return path


def court_share(picture: npt.NDArray[np.float32]) -> float:
    """Share of the window that shows the mat."""
    return float((np.abs(picture[..., :3] - COURT).max(axis=-1) < 0.05).mean())


def counted(content: bytes) -> dict[str, int]:
    """Number of messages of each topic, as the file says."""
    summary = make_reader(io.BytesIO(content)).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    return {summary.channels[i].topic: n for i, n in summary.statistics.channel_message_counts.items()}


@pytest.mark.slow(minutes=True)
def test_a_whole_match_opens_without_alerts(folder: Path, log_path: Path, tmp_path: Path) -> None:
    with RallyLog(log_path) as log:
        content, _ = write_scene(log, select(log, match=0), default_game())
    path = tmp_path / "match.mcap"
    path.write_bytes(content)
    seen = visit(folder, path, tmp_path / "match.png", 5.0, match=True, scale=HALF)
    assert seen["problems"] == NO_PROBLEMS
    assert seen["errors"] == []
    assert seen["topics"] == counted(content)
    before, after = seen["clock"]
    assert before == 5.0
    assert after >= before + 1, "it does not play"
    assert court_share(plt.imread(tmp_path / "match.png")) > 0.05
    assert re.search(r"#\d+ [a-z-]+ to [a-z-]+", seen["panels"]["RosOut!log"])
    summaries = [message for time, topic, message in read(content) if topic == topics.SUMMARY and time <= EPOCH + 5 * SECOND]
    listed = re.findall(r"[a-z-]+:[a-z-]+:(?:above|below):[a-z-]+", seen["panels"]["Table!top"])
    assert listed == [stroke["stroke"] for stroke in summaries[-1]["strokes"]][:ROWS]
