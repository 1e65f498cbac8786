"""Files of reports: HTML pages, and PDF files where there is Chromium."""

import tempfile
from pathlib import Path

from shuttle_marl.base.errors import printable
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands import cli


def write_report(page: bytes, out: Path, pdf: Path | None, *, quiet: bool = False) -> None:
    """Write a page, and print it as PDF if asked to.

    Args:
        page: content of the HTML file.
        out: the HTML file.
        pdf: the PDF file; None: none.
        quiet: print no file names.

    Raises:
        WatchError: there is no Chromium.
        FileWriteError: a file cannot be written.
    """
    replace_file(out, page)
    written = [out]
    if pdf is not None:
        replace_file(pdf, _printed(page))
        written.append(pdf)
    if not quiet:
        for path in written:
            cli.console().print(f"report: {printable(str(path))}", soft_wrap=True)


def _printed(page: bytes) -> bytes:
    """A page on paper of size A4."""
    from playwright.sync_api import sync_playwright  # noqa: PLC0415  an extra

    from shuttle_marl.watch.server import browser_flags, browser_program  # noqa: PLC0415

    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        file = Path(folder) / "report.html"
        file.write_bytes(page)
        browser = playwright.chromium.launch(executable_path=browser_program(), args=browser_flags())
        try:
            tab = browser.new_page()
            tab.goto(file.as_uri())
            return tab.pdf(prefer_css_page_size=True, print_background=True)
        finally:
            browser.close()
