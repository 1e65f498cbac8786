"""Files of reports: HTML pages, tables of figures, and PDF files where there is Chromium."""

import dataclasses
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa

from shuttle_marl.base.errors import OptionError, printable
from shuttle_marl.base.files import replace_file
from shuttle_marl.base.table_files import csv_bytes, parquet_bytes
from shuttle_marl.commands import cli
from shuttle_marl.commands.options import File, Json, PlayerOptions
from shuttle_marl.reports.languages import Language, speaking
from shuttle_marl.watch import WatchError


@dataclasses.dataclass(frozen=True, kw_only=True)
class ReportOptions(PlayerOptions):
    """What is written of a report."""

    out: File = None
    """HTML file; default: the name of the command."""
    pdf: File = None
    """PDF file, written by Chromium; its first page is one side for the player."""
    figures: File = None
    """CSV or Parquet file for a table of all figures."""
    language: Language = "en"
    """Language of the page: English, Chinese (simplified) or Indonesian."""
    json_output: Json = False
    """Print the figures as JSON, and write no page unless --out or --pdf is given."""

    def write(self, figures: Mapping[str, Any], page: Callable[[], bytes], name: str) -> None:
        """Write what is asked for.

        Args:
            page: makes the page, in the language.
            name: of its file by default.
        """
        if self.figures is not None:
            write_figures(figures, self.figures)
            if not self.json_output:
                cli.console().print(f"figures: {printable(str(self.figures))}", soft_wrap=True)
        if self.json_output:
            cli.print_json(figures)
        if not self.json_output or self.out is not None or self.pdf is not None:
            with speaking(self.language):
                content = page()
            write_report(content, self.out or Path(name), self.pdf, quiet=self.json_output)


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
    from playwright.sync_api import Error  # noqa: PLC0415  an extra

    from shuttle_marl.watch.server import browser_page, browser_program  # noqa: PLC0415

    try:
        with tempfile.TemporaryDirectory() as folder, browser_page() as tab:
            file = Path(folder) / "report.html"
            file.write_bytes(page)
            tab.goto(file.as_uri())
            return tab.pdf(prefer_css_page_size=True, print_background=True)
    except Error as error:
        reason = error.message.partition("\n")[0]
        advice = f"open {out} in another browser and print it"
        raise WatchError(f"{browser_program()} cannot print the report ({reason}); {advice}") from error
