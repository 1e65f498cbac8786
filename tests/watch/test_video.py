"""A rally filmed without a screen."""

import subprocess
import sys
from pathlib import Path

import av
import pytest

from shuttle_marl.watch import WatchError
from shuttle_marl.watch.video import FPS, SIZE, browser_program, check_video

pytestmark = pytest.mark.slow


def test_a_rally_becomes_a_video(page_folder: Path, tmp_path: Path) -> None:
    try:
        browser_program()
    except WatchError as error:
        pytest.skip(str(error))
    out = tmp_path / "rally.mp4"
    command = [sys.executable, "-m", "shuttle_marl.watch", "--a", "attacking", "--b", "safe", "--seed", "4", "--video", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    with av.open(str(out), "r") as container:
        stream = container.streams.video[0]
        assert (stream.width, stream.height, stream.average_rate) == (*SIZE, FPS)
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert f"{len(frames)} frames" in done.stdout
    assert len(frames) > 2 * FPS
    assert abs(frames[0].astype(int) - frames[len(frames) // 2]).max() > 50, "nothing moves"


def test_what_cannot_be_filmed_is_said_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(WatchError, match=r"ends in \.mp4 or \.webm"):
        check_video(tmp_path / "rally.gif")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CHROMIUM", raising=False)
    with pytest.raises(WatchError, match="needs Chromium"):
        check_video(tmp_path / "rally.mp4")
