"""Files of reports: HTML pages, tables of figures, and PDF files where there is Chromium."""

import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa

from shuttle_marl.base.errors import OptionError, printable
from shuttle_marl.base.files import replace_file
from shuttle_marl.base.table_files import csv_bytes, parquet_bytes
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


def write_figures(figures: Mapping[str, Any], path: Path) -> None:
    """Write all figures of a report as a table: the name of each, such as ``briefs.0.dos.1.won``, and its number or text.

    Raises:
        OptionError: the name of the file does not end in ``.csv`` or ``.parquet``.
        FileWriteError: it cannot be written.
    """
    if path.suffix not in (".csv", ".parquet"):
        raise OptionError(f"--figures {path}: expected a file name that ends in .csv or .parquet")

    def parts(value: Any, name: str) -> Iterator[tuple[str, Any]]:
        inner = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list) else None
        if inner is None:
            yield name, value
        else:
            for key, part in inner:
                yield from parts(part, f"{name}.{key}" if name else f"{key}")

    names, values = zip(*parts(figures, ""), strict=True)
    numbers = [float(value) if isinstance(value, int | float) else None for value in values]
    texts = [value if isinstance(value, str) else None for value in values]
    table = pa.table({"figure": names, "number": pa.array(numbers, pa.float64()), "text": pa.array(texts, pa.string())})
    replace_file(path, csv_bytes(table) if path.suffix == ".csv" else parquet_bytes(table))


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
