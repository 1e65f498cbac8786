"""Picture of tagging in the documentation: ``python -m docs.tools.tagging_picture``.

Needs the extra ``video`` and Chromium. Two simulated rallies are filmed, and the script of the benchmark tags them.
"""

import tempfile
from pathlib import Path

from rich.console import Console

from benchmarks.tagging import Script, film, tagging
from docs.tools.markdown import IMAGES
from shuttle_marl.base.files import replace_file
from shuttle_marl.watch.server import browser_page


def main() -> None:
    """Take a picture of the page when it asks for the fourth stroke of the second rally."""
    with tempfile.TemporaryDirectory() as name:
        played = film(Path(name) / "match.webm", 2, 3, Console(stderr=True))
        with tagging(played.path, Path(name) / "match.csv") as (address, _), browser_page() as page:
            page.set_default_timeout(120_000)
            script = Script(page, played)
            script.open(address)
            while [script.state()[name] for name in ("rally", "phase", "strokes")] != [2, "shot", 3]:
                script.step()
            script.until("window.viewer.state().suggested !== null")
            page.wait_for_timeout(500)
            replace_file(IMAGES / "tagging.jpg", page.screenshot(type="jpeg", quality=80))


if __name__ == "__main__":
    main()
