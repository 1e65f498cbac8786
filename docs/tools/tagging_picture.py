"""Picture of tagging in the documentation: ``python -m docs.tools.tagging_picture``.

Needs the extra ``video`` and Chromium. Two simulated rallies are filmed, and the script of the benchmark tags them.
"""

import contextlib
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright
from rich.console import Console

from benchmarks.tagging import Script, film, tagging
from docs.tools.markdown import IMAGES
from shuttle_marl.base.files import replace_file
from shuttle_marl.watch.server import bind, browser_flags, browser_program


def main() -> None:
    """Take a picture of the page when it asks for the fourth stroke of the second rally."""
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        played = film(Path(name) / "match.webm", 2, 3, Console(stderr=True))
        with contextlib.closing(bind("127.0.0.1", 0)) as listener:
            port = listener.getsockname()[1]
        stack.enter_context(tagging(played.path, Path(name) / "match.csv", port))
        playwright = stack.enter_context(sync_playwright())
        browser = stack.enter_context(playwright.chromium.launch(executable_path=browser_program(), args=browser_flags()))
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        page.set_default_timeout(120_000)
        script = Script(page, played)
        script.open(f"http://127.0.0.1:{port}/")
        while [script.state()[name] for name in ("rally", "phase", "strokes")] != [2, "shot", 3]:
            script.step()
        script.until("window.viewer.state().suggested !== null")
        page.wait_for_timeout(500)
        replace_file(IMAGES / "tagging.jpg", page.screenshot(type="jpeg", quality=80))


if __name__ == "__main__":
    main()
