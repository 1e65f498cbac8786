"""Files of reports: HTML pages, and PDF files where there is Chromium."""

import tempfile
from pathlib import Path

from shuttle_marl.base.errors import printable
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands import cli
from shuttle_marl.watch import WatchError


def write_report(page: bytes, out: Path, pdf: Path | None, *, quiet: bool = False) -> None:
    """Write a page, and print it as PDF if asked to.

    Args:
        page: content of the HTML file.
        out: the HTML file.
        pdf: the PDF file; None: none.
        quiet: print no file names.

    Raises:
        WatchError: there is no Chromium, or it cannot print; the page is written.
        FileWriteError: a file cannot be written.
    """
    replace_file(out, page)
    written = [out]
    if pdf is not None:
        replace_file(pdf, _printed(page, out))
        written.append(pdf)
    if not quiet:
        for path in written:
            cli.console().print(f"report: {printable(str(path))}", soft_wrap=True)


def _printed(page: bytes, out: Path) -> bytes:
    """A page on paper of size A4; ``out``: its file, for errors."""
    from playwright.sync_api import Error, sync_playwright  # noqa: PLC0415  an extra

    from shuttle_marl.watch.server import browser_flags, browser_program  # noqa: PLC0415

    program = browser_program()
    try:
        with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
            file = Path(folder) / "report.html"
            file.write_bytes(page)
            browser = playwright.chromium.launch(executable_path=program, args=browser_flags())
            tab = browser.new_page()
            tab.goto(file.as_uri())
            return tab.pdf(prefer_css_page_size=True, print_background=True)
    except Error as error:
        reason = error.message.partition("\n")[0]
        raise WatchError(f"{program} cannot print the report ({reason}); open {out} in another browser and print it") from error
