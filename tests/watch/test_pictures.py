"""Five states of the page look as in the stored pictures; ``PICTURES=write`` before ``pytest`` stores them anew.

A state is a function of its address and a time: the playback is paused there, motion is reduced, and ``viewer.draw()`` draws it.
Renderers differ a little between machines, so small copies are compared, with a tolerance. Fonts differ much, so the page is
drawn with one that Matplotlib ships.
"""

import base64
import io
import itertools
import os
import time
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
import pytest
from PIL import Image

from tests.watch.conftest import Viewer

pytestmark = pytest.mark.slow

FOLDER: Final = Path(__file__).parent / "pictures"
PLACE: Final = "?language=en#seed=5&a=bc&b=minimax&rally=1&stroke=3"
SIZE: Final = (320, 200)
"""Size of the stored pictures, a quarter of the window [px]."""
BOARDS: Final = range(52, 72)
"""Rows that are not compared: the boards behind the court have letters in a font of the machine."""
DIFFERENT: Final = 0.15
"""Least difference of a pixel, of the range of a channel."""
TOLERATED: Final = 0.02
"""Largest share of different pixels."""


_FONT: Final = Path(mpl.get_data_path()) / "fonts/ttf/DejaVuSans.ttf"
_USE_FONT: Final = """async (content) => {
  const font = new FontFace("Everywhere", Uint8Array.from(atob(content), (byte) => byte.charCodeAt(0)));
  document.fonts.add(await font.load());
  const sheet = new CSSStyleSheet();
  sheet.replaceSync("* { font-family: Everywhere !important }");
  document.adoptedStyleSheets.push(sheet);
}"""


def picture(viewer: Viewer) -> Image.Image:
    """The page, small."""
    viewer.page.evaluate("document.fonts.ready.then(() => window.viewer.draw())")
    return Image.open(io.BytesIO(viewer.page.screenshot())).convert("RGB").resize(SIZE, Image.Resampling.BOX)


def settled(viewer: Viewer) -> Image.Image:
    """The page when nothing more arrives for a second."""
    now, before = picture(viewer), None
    while before is None or difference(now, before):
        viewer.page.wait_for_timeout(1000)
        now, before = picture(viewer), now
    return now


def difference(a: Image.Image, b: Image.Image) -> float:
    """Share of pixels that differ."""
    apart = np.abs(np.asarray(a, np.float64) - np.asarray(b, np.float64)).max(axis=-1) / 255
    return float((np.delete(apart, BOARDS, axis=0) > DIFFERENT).mean())


def as_stored(viewer: Viewer, mode: str, seconds: float = 60) -> Image.Image:
    """The page once it looks as stored: what a busy machine sends late may arrive in between."""
    path, end = FOLDER / f"{mode}.png", time.monotonic() + seconds
    if os.environ.get("PICTURES") == "write":
        settled(viewer).save(path, optimize=True)
    with Image.open(path) as stored:
        expected = stored.convert("RGB")
    while True:
        now = picture(viewer)
        apart = difference(now, expected)
        if apart <= TOLERATED:
            return now
        assert time.monotonic() < end, f"{mode}: {apart:.1%} of the pixels of the page differ from {path}"
        viewer.page.wait_for_timeout(500)


def test_states_of_the_page_look_as_before(viewer: Any, served: Any) -> None:
    viewer.page.set_viewport_size({"width": 1280, "height": 800})
    viewer.open(f"{served.address}{PLACE}").analysed().play(False)
    viewer.page.evaluate(_USE_FONT, base64.b64encode(_FONT.read_bytes()).decode())
    viewer.until(lambda: viewer.page.locator(".bars .bar").count() > 10, 240)  # a busy machine solves for minutes
    found, earlier = {}, picture(viewer.seek(1.0))
    for mode in ("watch", "analyse", "learn", "play", "words"):
        if mode == "words":
            viewer.press("w")
        elif mode != "watch":
            viewer.enter(mode)
        if mode in ("watch", "analyse"):
            viewer.play(False).seek(1.5)
        if mode == "analyse":
            viewer.until(lambda: viewer.state("match") is not None)
        found[mode] = as_stored(viewer, mode)
    assert difference(earlier, found["watch"]) > TOLERATED, "half a second of a rally is seen"
    assert min(difference(found[a], found[b]) for a, b in itertools.combinations(found, 2)) > TOLERATED, "modes differ"
