"""Pictures and the film of the live court in the documentation: ``python -m docs.tools.watch_pictures [--film]``.

``--film`` makes the film only. Needs the extra ``video`` and Chromium. The page is served and drawn on this machine, in full
quality.
"""

import sys
import tempfile
from pathlib import Path
from typing import Final

import av
from PIL import Image
from playwright.sync_api import Page

from benchmarks.court import serving, until
from docs.tools.markdown import IMAGES
from shuttle_marl.base.files import replace_file
from shuttle_marl.court.server import browser_page, write_video

SIZES: Final = {"wide": (1680, 980), "narrow": (390, 844)}
SHOWN: Final = (("watch", "wide"), ("analyse", "wide"), ("learn", "wide"), ("play", "wide"), ("play", "narrow"))
"""Modes of the page, and the sizes in which the documentation shows them."""
_PLACE: Final = "#seed=11&a=ppo&b=bc&rally=4&stroke=5"
_RALLY: Final = "#seed=0&a=bc:viktor-axelsen&b=bc:kento-momota&rally=1&stroke=9"
PLAYERS: Final = ("viktor-axelsen", "kento-momota")
_LIMIT: Final = 240_000
_FILM: Final = (640, 360)
_FPS: Final = 12
_QUALITY: Final = 55


def main() -> None:
    """Take the pictures of the modes, of two players with their own skill, and the film of a rally of theirs."""
    with serving("--players", *PLAYERS) as (address, _):
        take_film(f"{address}{_RALLY.partition('&stroke')[0]}", IMAGES / "film.webp")
    if "--film" in sys.argv:
        return
    with serving() as (address, _):
        for mode, size in SHOWN:
            _take(address, mode, size, IMAGES / f"watch_{mode}_{size}.jpg")
    with serving("--players", *PLAYERS) as (address, _):
        _take(address, "watch", "wide", IMAGES / "watch_players.jpg", place=_RALLY)


def take_film(address: str, picture: Path) -> None:
    """Film a whole rally of the page as an animated picture."""
    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / "rally.webm"
        write_video(address, film, size=_FILM, fps=_FPS)
        with av.open(str(film)) as video:
            first, *others = (Image.fromarray(frame.to_ndarray(format="rgb24")) for frame in video.decode(video=0))
        first.save(picture, save_all=True, append_images=others, duration=1000 // _FPS, loop=0, quality=_QUALITY, method=4)


def _take(address: str, mode: str, size: str, picture: Path, *, place: str = _PLACE) -> None:
    with browser_page(SIZES[size], reduced_motion="reduce") as page:
        page.set_default_timeout(_LIMIT)
        page.goto(f"{address}?quality=full{place}")
        _show(page, mode)
        replace_file(picture, page.screenshot(type="jpeg", quality=88))


def _until(page: Page, script: str) -> None:
    until(page, f"(() => {{ const s = window.viewer?.state(); return s && ({script}); }})()", _LIMIT / 1000)


def _show(page: Page, mode: str) -> None:
    _until(page, "s.analysis")
    page.locator(".bars .bar").nth(10).wait_for(state="attached")
    if mode == "play":
        page.keyboard.press("t")
        _until(page, "s.turn")
        page.keyboard.press("i")
        page.locator(".shots small", has_text="wins").first.wait_for()
    elif mode == "learn":
        page.get_by_role("tab", name="Learn").click()
        page.locator(".quiz button:not(:disabled)").first.wait_for()
        page.locator(".quiz button:not(:disabled)").first.click()
        page.wait_for_timeout(1500)
    elif mode == "analyse":
        page.get_by_role("tab", name="Analyse").click()
        _until(page, "s.mode === 'analyse' && s.analysis")
        page.keyboard.press("3")
        page.locator(".openings summary").click()
        page.locator(".openings tbody button").first.wait_for()
        page.evaluate("scrollTo(0, 0)")
    page.wait_for_timeout(1000)


if __name__ == "__main__":
    main()
