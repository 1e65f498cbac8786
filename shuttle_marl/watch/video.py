"""A rally as a video, without a screen: the page is opened in a browser without a window, and its frames are encoded."""

import base64
import importlib.util
import io
import os
import shutil
from collections.abc import Callable, Iterable
from ctypes.util import find_library
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final

from shuttle_marl.extras import install_hint
from shuttle_marl.files import replacing
from shuttle_marl.watch import WatchError

if TYPE_CHECKING:
    from playwright.sync_api import Page

Progress = Callable[[Iterable[int]], Iterable[int]]

SIZE: Final = (1280, 720)
FPS: Final = 25
BROWSERS: Final = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "microsoft-edge")
_FLAGS: Final = (
    "--no-sandbox",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--ignore-gpu-blocklist",
    "--use-gl=angle",
)
_WAIT: Final = 120_000
"""Time that the page has for each thing it is asked to do [ms]."""
_FAILED: Final = ".notice:not(.hidden):not(.good), p[role=alert]"
"""Places on the page that say what went wrong."""
_PICTURE: Final = {"format": "jpeg", "quality": 95, "optimizeForSpeed": True}
_FORMATS: Final = {".mp4": "libx264", ".webm": "libvpx-vp9"}


def check_video(path: Path) -> None:
    """Refuse what cannot be made before any work is done.

    Raises:
        WatchError: the name of the file says no format, or a library or the browser is missing.
    """
    if path.suffix not in _FORMATS:
        raise WatchError(f"--video {path}: expected a name that ends in {' or '.join(_FORMATS)}")
    missing = [library for library in ("av", "playwright") if importlib.util.find_spec(library) is None]
    if missing:
        raise WatchError(f"--video needs {' and '.join(missing)}: {install_hint('video')}")
    browser_program()


def write_video(address: str, path: Path, progress: Progress = iter, *, size: tuple[int, int] = SIZE, fps: int = FPS) -> int:
    """Film the rally that a page shows.

    Args:
        address: of the page, with what it shall show.
        path: the video, ``.mp4`` or ``.webm``; moved into place when it is whole.
        progress: wraps the numbers of the frames, to show how far it is.
        size: width and height of the picture, both even.
        fps: pictures a second.

    Returns:
        How many frames it has.

    Raises:
        WatchError: there is no browser, or the page shows nothing.
    """
    from playwright.sync_api import Error, sync_playwright  # noqa: PLC0415  an extra

    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=browser_program(), args=browser_flags())
            page = browser.new_page(viewport={"width": size[0], "height": size[1]}, reduced_motion="reduce")
            page.set_default_timeout(_WAIT)
            page.goto(address)
            page.locator(f"body[data-ready], {_FAILED}").first.wait_for()
            if page.locator("body[data-ready]").count() == 0:
                raise WatchError(f"the page shows no rally: {page.locator(_FAILED).first.inner_text()}")
            page.evaluate("window.viewer.film()")
            frames = int(page.evaluate("window.viewer.state().duration") * fps + 1e-6) + 1
            with replacing(path) as file:
                _encode(page, progress(range(frames)), file, path.suffix, size, fps)
            browser.close()
            return frames
    except Error as error:
        raise WatchError(f"the page cannot be filmed: {error.message.splitlines()[0]}") from error


def _encode(page: "Page", frames: Iterable[int], file: BinaryIO, suffix: str, size: tuple[int, int], fps: int) -> None:
    import av  # noqa: PLC0415  an extra

    with av.open(file, "w", format=suffix[1:]) as container:
        stream: Any = container.add_stream(_FORMATS[suffix], rate=fps)
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        stream.options = {"crf": "20"}
        pictures = page.context.new_cdp_session(page)
        for frame in frames:
            page.evaluate("(time) => window.viewer.seek(time)", frame / fps)
            picture = base64.b64decode(pictures.send("Page.captureScreenshot", _PICTURE)["data"])
            with av.open(io.BytesIO(picture), "r") as read:
                for image in read.decode(video=0):
                    container.mux(stream.encode(av.VideoFrame.from_ndarray(image.to_ndarray(format="rgb24"), format="rgb24")))
        container.mux(stream.encode())


def browser_program() -> str:
    """The program Chromium, or a relative of it; ``$CHROMIUM`` names another.

    Raises:
        WatchError: there is none.
    """
    for name in (os.environ.get("CHROMIUM", ""), *BROWSERS):
        if name and (found := shutil.which(name)):
            return found
    raise WatchError("a video needs Chromium or Chrome; install it, or name it in the variable CHROMIUM")


def browser_flags(*, mesa: bool | None = None) -> list[str]:
    """Flags of a browser without a window, which asks for nothing from outside.

    Where Mesa is installed it draws: without a graphics card two to three times as fast as the renderer that Chromium brings.

    Args:
        mesa: whether Mesa draws; None: where it is installed.
    """
    if mesa is None:
        mesa = find_library("EGL") is not None and any(Path("/usr/lib").glob("*/dri/swrast_dri.so"))
    return [*_FLAGS, f"--use-angle={'gl-egl' if mesa else 'swiftshader'}"]
