"""The built page is verified before it is served, its first rally is the shipped one, and a rally becomes a video."""

import importlib.util
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import av
import msgspec
import numpy as np
import pytest

from docs.tools.first_rally import first_rally
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.commands.watch import MatchOptions, RallyOptions, watch
from shuttle_marl.staging import Motion
from shuttle_marl.watch import WatchError, building
from shuttle_marl.watch.first_rally import shipped_rally
from shuttle_marl.watch.server import browser_flags, check_video, write_video


@pytest.fixture
def built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A built page as in a wheel, without its source."""
    for name in building.FILES:
        (tmp_path / name).write_text(name)
    (tmp_path / building._STAMP).write_text("0" * 64)
    monkeypatch.setattr(building, "BUILT", tmp_path)
    monkeypatch.setattr(building, "SOURCE", tmp_path / "missing")
    return tmp_path


@pytest.mark.parametrize("name", [*building.FILES, building._STAMP])
def test_a_page_without_a_file_or_of_another_source_is_refused(name: str, built: Path) -> None:
    assert building.build() == built
    assert building._is_built("0" * 64)
    assert not building._is_built("1" * 64)
    (built / name).unlink()
    assert not building._is_built("0" * 64)
    with pytest.raises(building.BuildError, match="not complete; install the package again"):
        building.build()


def test_browsers_of_users_have_a_sandbox(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    assert "--no-sandbox" not in browser_flags(mesa=False)


def test_the_shipped_rally_is_that_of_the_default_match() -> None:
    expected = first_rally()
    found = shipped_rally(expected.key)
    assert found is not None, "run python -m docs.tools.first_rally"
    assert msgspec.json.encode(found.reply) == msgspec.json.encode(expected.reply)
    shown, staged = Motion.unpack(found.motion), Motion.unpack(expected.motion)
    np.testing.assert_allclose(shown.position, staged.position, atol=0.01)
    np.testing.assert_allclose(shown.shuttle, staged.shuttle, atol=0.01)


FPS = 4


def pictures(path: Path) -> list[Any]:
    """Every picture of a video."""
    with av.open(str(path)) as video:
        return [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]


@pytest.mark.slow
@pytest.mark.usefixtures("chromium_program")
def test_a_rally_is_filmed_and_the_film_is_the_same_again(served: Any, tmp_path: Path) -> None:
    address = f"{served.address}?quality=lite#seed=5&a=bc&b=minimax&rally=1"
    check_video(tmp_path / "a.mp4")
    counts = []
    with ThreadPoolExecutor(1) as alone:  # the browser of other tests is driven from the main thread
        for name in ("a.mp4", "b.mp4"):
            counts.append(alone.submit(write_video, address, tmp_path / name, size=(320, 180), fps=FPS).result())
    first, second = pictures(tmp_path / "a.mp4"), pictures(tmp_path / "b.mp4")
    assert counts == [len(first), len(second)]
    assert len(first) >= 2 * FPS
    assert first[0].shape == (180, 320, 3)
    assert np.array_equal(first, second)
    assert first[0].std() > 10, "a court, not one colour"
    assert np.abs(first[0].astype(int) - first[len(first) // 2]).max() > 50, "something moves"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mp4", "b.mp4"]
    with ThreadPoolExecutor(1) as alone, pytest.raises(WatchError, match="the page cannot show the rally"):
        alone.submit(write_video, f"{served.address}#seed=5&a=bc&b=bc&rally=900", tmp_path / "c.mp4").result()


def test_what_is_missing_is_said_before_any_work(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with pytest.raises(WatchError, match="is the day of the skill of --players; give both"):
        watch(match=MatchOptions(date="2021-07-31"))
    with pytest.raises(WatchError, match=r"ends in \.mp4 or \.webm"):
        check_video(tmp_path / "film.gif")
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CHROMIUM", raising=False)
    with pytest.raises(WatchError, match="needs Chromium or Chrome; install it"):
        check_video(tmp_path / "film.mp4")
    monkeypatch.setattr("shuttle_marl.watch.building.build", lambda *_: pytest.fail("the page is built, which takes a minute"))
    with pytest.raises(ShuttleError, match=r"none\.mcap"):
        watch(rallies=RallyOptions(replay=tmp_path / "none.mcap"))
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(WatchError, match=r"needs av and playwright: .* installs it"):
        check_video(tmp_path / "film.mp4")
